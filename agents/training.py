"""PPO training in a run folder: checkpoints, a separate evaluation that keeps the best, resuming."""

from __future__ import annotations

import copy
import os
import re
import time
from pathlib import Path

import numpy as np
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback, CallbackList, EvalCallback
from stable_baselines3.common.logger import configure

from agents.models import derived_seed, make_ppo, make_vec_env
from agents.settings import TrainSettings

CHECKPOINTS = "checkpoints"


def choosing_seed(settings: TrainSettings) -> int:
    """Seed of the evaluation that chooses the best model: starts that neither training nor the final one sees."""
    return derived_seed("choosing", settings.seed)


def save(model: PPO, path: Path) -> None:
    """Save in one stroke: an interruption leaves the old file or the new one, never half of one."""
    partial = path.with_name(path.name + ".partial.zip")
    model.save(partial)
    os.replace(partial, path)


class Checkpoint(BaseCallback):
    """Save weights and optimiser at the start of a rollout, when the last one has been learnt from."""

    def __init__(self, folder: Path, every: int) -> None:
        super().__init__()
        self._folder, self._every = folder, every
        self._last = 0
        self.rollout_start = 0

    def _init_callback(self) -> None:
        self._folder.mkdir(exist_ok=True)
        self._last = self.rollout_start = self.model.num_timesteps

    def _on_rollout_start(self) -> None:
        self.rollout_start = self.num_timesteps
        assert isinstance(self.model, PPO)
        self._parameters = copy.deepcopy(self.model.get_parameters())  # an update may be cut short later
        if self.num_timesteps - self._last >= self._every:
            self.keep()

    def keep(self) -> None:
        """Save as of the start of this rollout, unless that is saved already."""
        if self.rollout_start > self._last:
            assert isinstance(self.model, PPO)
            self.model.set_parameters(self._parameters, device="cpu")  # type: ignore[arg-type]
            save(self.model, self._folder / f"ppo_{self.rollout_start}.zip")
            self._last = self.rollout_start

    def _on_step(self) -> bool:
        return True


class Deadline(BaseCallback):
    """Stop when the time is up."""

    def __init__(self, minutes: float) -> None:
        super().__init__()
        self._end = time.monotonic() + 60.0 * minutes

    def _on_step(self) -> bool:
        return time.monotonic() < self._end


class KeepBest(EvalCallback):
    """Evaluate apart from training, keep the best model, and go on from the evaluations already in the folder."""

    def __init__(self, folder: Path, settings: TrainSettings, done: int) -> None:
        num_envs = min(settings.num_envs, settings.eval_episodes)
        environments = make_vec_env(settings.env_settings, num_envs, choosing_seed(settings))
        self._seed = choosing_seed(settings)
        super().__init__(
            environments,
            n_eval_episodes=settings.eval_episodes,
            eval_freq=max(1, settings.eval_steps // settings.num_envs),
            verbose=0,
        )
        self.n_calls = done // settings.num_envs  # evaluate at the same steps as an uninterrupted run
        self.best_model_path = folder / "best_model.zip"
        self.log_path = str(folder / "evaluations")
        earlier = folder / "evaluations.npz"
        if earlier.exists():
            stored = np.load(earlier)
            self.best_mean_reward = float(np.mean(stored["results"], axis=1).max())
            kept = stored["timesteps"] <= done  # what came after the checkpoint will be evaluated again
            self.evaluations_timesteps = stored["timesteps"][kept].tolist()
            self.evaluations_results = stored["results"][kept].tolist()
            self.evaluations_length = stored["ep_lengths"][kept].tolist()

    def _on_step(self) -> bool:
        best_before = self.best_mean_reward
        due = self.eval_freq > 0 and self.n_calls % self.eval_freq == 0
        if due:
            self.eval_env.seed(self._seed)  # the same starts every time
        going_on = super()._on_step()
        if self.best_mean_reward > best_before:
            assert isinstance(self.model, PPO)
            save(self.model, self.best_model_path)
        return going_on


def latest_checkpoint(folder: Path) -> tuple[Path, int] | None:
    """The newest checkpoint of a run and the steps it was made after."""
    found = []
    for path in (folder / CHECKPOINTS).glob("ppo_*.zip"):
        match = re.fullmatch(r"ppo_(\d+)\.zip", path.name)
        if match:
            found.append((path, int(match[1])))
    return max(found, key=lambda entry: entry[1], default=None)


def train(settings: TrainSettings, folder: Path, progress: bool = True) -> PPO:
    """Train in a run folder to ``settings.total_steps``, from its newest checkpoint if it has one.

    An interruption leaves a checkpoint as of the start of the rollout under way.

    Raises:
        FileExistsError: the run is finished.
    """
    if (folder / "model.zip").exists():
        raise FileExistsError(f"{folder} is finished: it has a model.zip, and runs are never overwritten")
    torch.set_num_threads(settings.torch_threads)
    resumed = latest_checkpoint(folder)
    done = resumed[1] if resumed else 0
    starts = derived_seed("training", settings.seed, done)  # not again the starts that were already learnt from
    environments = make_vec_env(settings.env_settings, settings.num_envs, starts)
    model = make_ppo(settings, environments)
    environments.seed(starts)  # PPO has seeded them by its own seed
    if resumed:
        model.set_parameters(str(resumed[0]), device="cpu")
        model.num_timesteps = done
    model.set_logger(configure(str(folder / "tensorboard"), ["tensorboard"]))
    checkpoint = Checkpoint(folder / CHECKPOINTS, settings.checkpoint_steps)
    callbacks: list[BaseCallback] = [checkpoint, KeepBest(folder, settings, done)]
    if settings.max_minutes is not None:
        callbacks.append(Deadline(settings.max_minutes))
    try:
        model.learn(
            max(0, settings.total_steps - done),
            callback=CallbackList(callbacks),
            reset_num_timesteps=False,
            progress_bar=progress,
        )
    except KeyboardInterrupt:
        checkpoint.keep()
        raise
    save(model, folder / "model.zip")
    return model
