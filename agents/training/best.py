"""The separate evaluations of a training, all from the same starts, and the best model in them."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy

from agents.runs import EVALUATIONS
from agents.settings import TrainSettings
from agents.training.checkpoints import Checkpoint, model_file
from agents.training.models import derived_seed, make_vec_env
from jackbox_env.tools.files import replacing, write_bytes
from jackbox_env.tools.model_files import BEST, is_whole
from jackbox_env.tools.reading import DamagedFileError, parsing, report_skipped, unpacked_arrays


class Evaluations(NamedTuple):
    """The arrays in evaluations.npz, named as Stable-Baselines3 names them; one entry per evaluation."""

    timesteps: list[Any]
    results: list[Any]  # lists of returns, one per episode
    ep_lengths: list[Any]


def read_evaluations(folder: Path, episodes: int) -> Evaluations:
    """The evaluations of a run, of so many episodes each; none if the file is damaged, which standard error reports."""
    path = folder / EVALUATIONS
    try:
        if path.is_file():
            with parsing(path):
                stored = unpacked_arrays(path.read_bytes(), path.name)
                timesteps, *others = (stored[name] for name in Evaluations._fields)
                shape = (len(timesteps), episodes)
                if any(other.shape != shape for other in others) or np.any(np.diff(timesteps) <= 0):
                    raise ValueError(f"its evaluations are not of {episodes} episodes each")
                return Evaluations(timesteps.tolist(), *(other.tolist() for other in others))
    except DamagedFileError as error:
        report_skipped(error)
    return Evaluations([], [], [])


class KeepBest(BaseCallback):
    """Evaluate apart from training and save the best model, and a checkpoint at each evaluation.

    So a resumed run repeats the evaluation bit for bit. The model is written before the evaluation is recorded: after a
    kill in between it is evaluated again. The next model replaces a best model that is damaged or missing.
    """

    def __init__(self, folder: Path, settings: TrainSettings, checkpoint: Checkpoint, done: int) -> None:
        super().__init__()
        self._folder, self._settings, self._checkpoint = folder, settings, checkpoint
        earlier = read_evaluations(folder, settings.eval_episodes)
        means = np.mean(earlier.results, axis=1) if earlier.results and is_whole(folder / BEST) else []
        self._best = max(means, default=-math.inf)
        count = sum(steps <= done for steps in earlier.timesteps)  # later models will be evaluated again
        self._evaluations = Evaluations(*(column[:count] for column in earlier))
        self._every = max(1, settings.eval_steps // settings.num_envs)
        num_envs = min(settings.num_envs, settings.eval_episodes)
        self._starts = derived_seed("choosing", settings.seed)  # neither training nor the final evaluation uses them
        self._environments = make_vec_env(settings.env_settings, num_envs, self._starts)

    def _init_callback(self) -> None:
        # evaluate at the same steps as an uninterrupted run
        self.n_calls = self.model.num_timesteps // self._settings.num_envs

    def _on_step(self) -> bool:
        if self.n_calls % self._every == 0:
            self._evaluate()
        return True

    def _evaluate(self) -> None:
        assert isinstance(self.model, PPO)
        self._checkpoint.save()
        self._environments.seed(self._starts)  # the same starts every time
        returns, lengths = evaluate_policy(
            self.model, self._environments, self._settings.eval_episodes, return_episode_rewards=True
        )
        mean = float(np.mean(returns))
        self.logger.record("eval/mean_reward", mean)
        self.logger.record("eval/mean_ep_length", float(np.mean(lengths)))
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)
        if mean > self._best:
            write_bytes(self._folder / BEST, model_file(self.model))
            self._best = mean
        for column, one in zip(self._evaluations, (self.num_timesteps, returns, lengths), strict=True):
            column.append(one)
        with replacing(self._folder / EVALUATIONS) as partial:
            np.savez(partial, **self._evaluations._asdict())
