"""Measures the time of a training's parts: time.json in its run folder."""

from __future__ import annotations

import time
from typing import Any

from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env.base_vec_env import VecEnvStepReturn

from jackbox_env.sb3 import JackInBoxVecEnv


class TimedEnvironments(JackInBoxVecEnv):
    """Environments that add up how long their steps take: ``seconds``; their rewards are multiplied by ``scale``."""

    seconds, scale = 0.0, 1.0

    def step_wait(self) -> VecEnvStepReturn:
        """Step."""
        began = time.perf_counter()
        observations, rewards, dones, infos = super().step_wait()
        self.seconds += time.perf_counter() - began
        return observations, rewards if self.scale == 1.0 else self.scale * rewards, dones, infos


class TrainingTimer(BaseCallback):
    """Adds up the time of a training's parts.

    Args:
        environments: of the training.
    """

    def __init__(self, environments: TimedEnvironments) -> None:
        super().__init__()
        self._environments, self._collecting = environments, 0.0

    def _on_training_start(self) -> None:
        self._began, self._first_step = time.perf_counter(), self.num_timesteps
        self._spent = time.process_time()

    def _on_rollout_start(self) -> None:
        self._rollout_began = time.perf_counter()

    def _on_rollout_end(self) -> None:
        self._collecting += time.perf_counter() - self._rollout_began

    def _on_step(self) -> bool:
        return True

    def record(self) -> dict[str, Any]:
        """Steps, seconds, those of the processor, and those of environment, acting and updates, of this process."""
        total, stepping = time.perf_counter() - self._began, self._environments.seconds
        return {
            "steps": self.num_timesteps - self._first_step,
            "seconds": total,
            "processor_seconds": time.process_time() - self._spent,
            "parts": {
                "environment": stepping,
                "choosing actions, evaluations and files": self._collecting - stepping,
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
