"""Measures the time of a training's parts: time.json in its run folder."""

from __future__ import annotations

import time
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from jackbox_env.sb3 import JackInBoxVecEnv


class TimedVecEnv(VecEnvWrapper):
    """A wrapper that adds up how long steps take: ``seconds``."""

    def __init__(self, venv: VecEnv) -> None:
        super().__init__(venv)
        self.seconds = 0.0

    def reset(self) -> Any:
        """Start an episode in each environment."""
        return self.venv.reset()

    def step_wait(self) -> VecEnvStepReturn:
        """Step."""
        began = time.perf_counter()
        result = self.venv.step_wait()
        self.seconds += time.perf_counter() - began
        return result


class TimedEnvironments(JackInBoxVecEnv):
    """The environments without wrappers, with the same ``seconds``."""

    seconds = 0.0

    def step_wait(self) -> VecEnvStepReturn:
        """Step."""
        began = time.perf_counter()
        result = super().step_wait()
        self.seconds += time.perf_counter() - began
        return result


class TrainingTimer(BaseCallback):
    """Adds up the time of a training's parts.

    Args:
        inner: the environments alone.
        outer: the same with their wrappers, as the training steps them.
        between: what these wrappers do, in words.
    """

    def __init__(self, inner: TimedEnvironments, outer: TimedVecEnv, between: str) -> None:
        super().__init__()
        self._inner, self._outer, self._between = inner, outer, between
        self._collecting = 0.0

    def _on_training_start(self) -> None:
        self._began, self._first_step = time.perf_counter(), self.num_timesteps

    def _on_rollout_start(self) -> None:
        self._rollout_began = time.perf_counter()

    def _on_rollout_end(self) -> None:
        self._collecting += time.perf_counter() - self._rollout_began

    def _on_step(self) -> bool:
        return True

    def record(self) -> dict[str, Any]:
        """Steps, seconds, and the seconds of environment, wrappers, acting and updates, of this process."""
        total = time.perf_counter() - self._began
        return {
            "steps": self.num_timesteps - self._first_step,
            "seconds": total,
            "parts": {
                "environment": self._inner.seconds,
                self._between: self._outer.seconds - self._inner.seconds,
                "choosing actions, evaluations and files": self._collecting - self._outer.seconds,
                "learning": total - self._collecting,
            },
        }


def formatted(record: dict[str, Any]) -> str:
    """One line: steps per second, and the shares of the parts of :meth:`TrainingTimer.record`."""
    steps, total = record["steps"], record["seconds"]
    shares = ", ".join(
        f"{name} {seconds / total:.1%}" for name, seconds in record["parts"].items() if seconds > 0.001 * total
    )
    return f"{steps:,} steps in {total:.0f} s, {steps / total:,.0f} per second: {shares}"
