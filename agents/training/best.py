"""The separate evaluations of a training, all from the same starts, and the model that did best in them."""

from __future__ import annotations

import io
import math
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.evaluation import evaluate_policy

from agents.files import DamagedFileError, parsing, say_skipped
from agents.runs import EVALUATIONS
from agents.settings import TrainSettings
from agents.training.archives import unpacked_arrays
from agents.training.checkpoints import Checkpoint, model_file, read_model_file
from agents.training.models import derived_seed, make_vec_env
from jackbox_env.recording.files import write_bytes

BEST = "best_model.zip"


def choosing_seed(settings: TrainSettings) -> int:
    """Seed of the evaluation that chooses the best model: starts that neither training nor the final one sees."""
    return derived_seed("choosing", settings.seed)


@dataclass
class Evaluations:
    """What evaluations.npz holds, in the names that Stable-Baselines3 gives it; one entry per evaluation."""

    timesteps: list[int] = field(default_factory=list)
    results: list[list[float]] = field(default_factory=list)  # returns, one per episode
    ep_lengths: list[list[int]] = field(default_factory=list)

    @property
    def means(self) -> list[float]:
        """Mean return of each evaluation."""
        return [float(np.mean(returns)) for returns in self.results]

    def until(self, steps: int) -> Evaluations:
        """Those of the first ``steps`` steps; what came later will be evaluated again."""
        count = sum(at <= steps for at in self.timesteps)
        return Evaluations(self.timesteps[:count], self.results[:count], self.ep_lengths[:count])

    def write(self, folder: Path) -> None:
        """Write them in one stroke."""
        file = io.BytesIO()
        np.savez(file, timesteps=self.timesteps, results=self.results, ep_lengths=self.ep_lengths)
        write_bytes(folder / EVALUATIONS, file.getvalue())


def read_evaluations(folder: Path, episodes: int) -> Evaluations:
    """The evaluations of a run of so many episodes each; none, and a sentence that says so, where they are damaged."""
    path = folder / EVALUATIONS
    if not path.is_file():
        return Evaluations()
    content = path.read_bytes()
    try:
        with parsing(path):
            stored = unpacked_arrays(content, path.name)
            timesteps, results, lengths = stored["timesteps"], stored["results"], stored["ep_lengths"]
            shape = (len(timesteps), episodes)
            if results.shape != shape or lengths.shape != shape or np.any(np.diff(timesteps) <= 0):
                raise ValueError(f"it does not hold evaluations of {episodes} episodes each")
            return Evaluations(timesteps.tolist(), results.tolist(), lengths.tolist())
    except DamagedFileError as error:
        say_skipped(error)
        return Evaluations()


def best_mean(folder: Path, evaluations: Evaluations) -> float:
    """Mean return of the best model so far; -inf where there is none that is whole, so that the next one is kept."""
    try:
        read_model_file(folder / BEST)
    except FileNotFoundError:
        return -math.inf
    except DamagedFileError as error:
        say_skipped(error)
        return -math.inf
    return max(evaluations.means, default=-math.inf)


class KeepBest(BaseCallback):
    """Evaluate apart from training and keep the best model; the checkpoint that was evaluated is kept too.

    So a run that is resumed there repeats the evaluation bit for bit.
    """

    def __init__(
        self, folder: Path, settings: TrainSettings, checkpoint: Checkpoint, evaluations: Evaluations, best: float
    ) -> None:
        super().__init__()
        self._folder, self._settings, self._checkpoint = folder, settings, checkpoint
        self._evaluations, self._best = evaluations, best
        self._every = max(1, settings.eval_steps // settings.num_envs)
        num_envs = min(settings.num_envs, settings.eval_episodes)
        self._environments = make_vec_env(settings.env_settings, num_envs, choosing_seed(settings))

    def _init_callback(self) -> None:
        # evaluate at the same steps as an uninterrupted run
        self.n_calls = self.model.num_timesteps // self._settings.num_envs

    def _on_step(self) -> bool:
        if self.n_calls % self._every == 0:
            self._evaluate()
        return True

    def _evaluate(self) -> None:
        assert isinstance(self.model, PPO)
        self._checkpoint.keep()
        self._environments.seed(choosing_seed(self._settings))  # the same starts every time
        returns, lengths = evaluate_policy(
            self.model, self._environments, self._settings.eval_episodes, return_episode_rewards=True
        )
        assert isinstance(returns, list)
        assert isinstance(lengths, list)
        mean = float(np.mean(returns))
        self.logger.record("eval/mean_reward", mean)
        self.logger.record("eval/mean_ep_length", float(np.mean(lengths)))
        self.logger.record("time/total_timesteps", self.num_timesteps, exclude="tensorboard")
        self.logger.dump(self.num_timesteps)
        if mean > self._best:
            write_bytes(self._folder / BEST, model_file(self.model))
            self._best = mean
        self._evaluations.timesteps.append(self.num_timesteps)
        self._evaluations.results.append(returns)
        self._evaluations.ep_lengths.append(lengths)
        self._evaluations.write(self._folder)
