"""PPO training in a run folder, with checkpoints, separate evaluations that choose the best model, and resuming."""

from __future__ import annotations

import json
import time
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from scipy import stats
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, ProgressBarCallback
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.logger import configure
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from agents.policies.network import WEIGHTS
from agents.runs import SETTINGS, TIME, describe, locked, read_settings
from agents.settings import TrainSettings
from agents.training.best import KeepBest, read_evaluations
from agents.training.checkpoints import (
    CHECKPOINTS,
    Checkpoint,
    checkpoint_path,
    latest_checkpoint,
    model_file,
)
from agents.training.models import derived_seed, make_ppo
from jackbox_env.sb3 import Durations, JackInBoxVecEnv, load_model
from jackbox_env.sb3.saved_models import write_entries
from jackbox_env.tools.files import new_folder, remove_partials, write_bytes, write_json
from jackbox_env.tools.model_files import MODEL, is_whole
from jackbox_env.tools.reading import first_line, unpacked

FRESH_EPISODES = 64  # that judge the trained model
# Of the rewards, if policy and value share the convolutions of pictures: about 1 in sum, so that neither loss is lost
# beside the other.
PICTURED_SCALE = 0.01


class ScaledEnvironments(JackInBoxVecEnv):
    """Environments whose rewards are multiplied by ``scale``."""

    scale: float

    def step_wait(self) -> VecEnvStepReturn:
        """Step."""
        observations, rewards, dones, infos = super().step_wait()
        return observations, rewards if self.scale == 1.0 else self.scale * rewards, dones, infos


def train(settings: TrainSettings, folder: Path, progress: bool = True) -> PPO:
    """Train in a run folder to ``settings.total_steps``, from its newest whole checkpoint if it has one.

    An interruption leaves a checkpoint as of the start of the rollout under way. A kill at any moment leaves whole
    files. Files that are damaged all the same are skipped, with a note on standard error.

    Raises:
        FileExistsError: the run is finished, or the folder is that of an exported policy.
        FolderInUseError: another process trains in the folder.
        OSError: the folder cannot be written to.
        ValueError: the checkpoint was made by other settings.
    """
    if (folder / WEIGHTS).exists():
        raise FileExistsError(f"{folder} is an exported policy, which cannot be trained further: choose another folder")
    with locked(folder):
        remove_partials(folder, folder / CHECKPOINTS)
        if is_whole(folder / MODEL):
            raise FileExistsError(
                f"{folder} is finished: it has a {MODEL}, and runs are never overwritten. To train it further, resume "
                "it with more total steps"
            )
        write_entries(folder, settings.named, settings.arguments)
        model = _resumed(settings, folder)
        done = model.num_timesteps
        print(f"Continuing after {done:,} steps" if done else "Starting from the beginning")
        model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
        checkpoint = Checkpoint(folder, settings.checkpoint_steps)
        callbacks: list[BaseCallback] = [checkpoint, KeepBest(folder, settings, checkpoint, done)]
        if settings.action_repeat == "bounce":
            callbacks.append(Durations())
        began, spent = time.perf_counter(), time.process_time()
        try:
            _learn(model, max(0, settings.total_steps - done), callbacks, progress)
        except KeyboardInterrupt:
            checkpoint.save()
            raise
        steps, seconds, spent = model.num_timesteps - done, time.perf_counter() - began, time.process_time() - spent
        write_json(folder / TIME, {"steps": steps, "seconds": seconds, "processor_seconds": spent})
        write_bytes(folder / MODEL, model_file(model))  # last: a run with this file is finished
        print(f"{steps:,} steps in {seconds:.0f} s, {steps / seconds:,.0f} per second")
        print(reached(folder, settings))
        return model


def _learn(model: PPO, steps: int, callbacks: list[BaseCallback], progress: bool) -> None:
    """Train for a number of further steps, with a progress bar that is closed on any exit."""
    bar = ProgressBarCallback()
    try:
        model.learn(steps, callback=[*callbacks, *[bar] * progress], reset_num_timesteps=False)
    finally:
        if hasattr(bar, "pbar"):  # from the training's start on; an error is shown on a line of its own
            bar.pbar.close()


def extended(folder: Path, total_steps: int) -> TrainSettings:
    """Extend a run to more steps: its settings are changed, and its last model becomes a checkpoint.

    Raises:
        FolderInUseError: another process trains in the folder.
        ValueError: ``total_steps`` is not above what the run has.
    """
    with locked(folder):
        settings = read_settings(folder)
        if total_steps <= settings.total_steps:
            raise ValueError(f"total_steps must be above the run's {settings.total_steps:,}, got {total_steps:,}")
        longer = replace(settings, total_steps=total_steps)
        if is_whole(folder / MODEL):
            steps = json.loads(unpacked((folder / MODEL).read_bytes(), MODEL)["data"])["num_timesteps"]
            (folder / CHECKPOINTS).mkdir(parents=True, exist_ok=True)
            (folder / MODEL).replace(checkpoint_path(folder, int(steps)))
        write_json(folder / SETTINGS, asdict(longer))
        return longer


def reached(folder: Path, settings: TrainSettings) -> str:
    """One line: the return of a run's best model, or of its last one, on starts that neither trained nor chose it."""
    evaluations = read_evaluations(folder, settings.eval_episodes)
    if evaluations.results:
        steps = evaluations.timesteps[int(np.mean(evaluations.results, axis=1).argmax())]
        name = f"best model, after {steps:,} steps,"
    else:
        name = "last model (no evaluation was made: the run was shorter than eval_steps)"
    model, environments = load_model(folder, FRESH_EPISODES)
    environments.seed(derived_seed("evaluation", settings.seed))
    returns, _ = evaluate_policy(model, environments, FRESH_EPISODES, return_episode_rewards=True)
    half = float(stats.t.ppf(0.975, FRESH_EPISODES - 1) * stats.sem(returns))
    return (
        f"The {name} earns {np.mean(returns):.1f} ± {half:.1f} on {settings.task}: mean and 95 % interval of "
        f"{FRESH_EPISODES} episodes from fresh starts"
    )


def trained_in(folder: Path, settings: TrainSettings, progress: bool = True) -> None:
    """Train in a new or interrupted run folder; does nothing if the run is finished.

    Raises:
        ValueError: the folder is a run of other settings.
    """
    if not folder.exists():
        new_folder(folder, settings.task, lambda made: describe(made, settings))
    if read_settings(folder) != settings:
        raise ValueError(f"{folder} is a run of other settings: move it away, or choose another folder")
    if not is_whole(folder / MODEL):
        train(settings, folder, progress)


def _resumed(settings: TrainSettings, folder: Path) -> PPO:
    """The model as of the newest checkpoint, or a new one. Its environments get new starts."""
    torch.set_num_threads(settings.torch_threads)
    done, parameters = latest_checkpoint(folder)
    starts = derived_seed("training", settings.seed, done)
    environments = ScaledEnvironments(settings.num_envs, **settings.env_settings)
    environments.scale = PICTURED_SCALE if settings.pixels else 1.0
    model = make_ppo(settings, environments)
    environments.seed(starts)  # PPO has seeded them by its own seed
    if parameters is not None:
        try:
            model.set_parameters(parameters, device="cpu")
        except Exception as error:
            problem = f"{checkpoint_path(folder, done)} was made by other settings than its run's"
            raise ValueError(f"{problem}: {first_line(error)}") from error
        model.num_timesteps = done
    return model
