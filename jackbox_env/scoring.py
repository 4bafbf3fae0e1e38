"""Observation and reward of one state, in the arithmetic of its contact model.

The exact model's are compiled: the single environment then gives the very bits of the batched one. The pymunk model's
are Python's, and load no compiler.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from jackbox_env.observation import observe
from jackbox_env.scene import Scene
from jackbox_env.states import Array
from jackbox_env.tasks import TASKS


class Score(Protocol):
    """A function of the state, shape (12,), the mean torque [N m] and the impulse [N s] of a step."""

    def __call__(self, state: Array, torque: float, impulse: float) -> tuple[NDArray[np.float32], tuple[float, ...]]:
        """Return the observation, shape (10,), and the values of the reward's terms."""


def make_score(scene: Scene, task: str, contact: str) -> Score:
    """Return the function that observes and rewards."""
    return CompiledScore(scene, task) if contact == "exact" else PlainScore(scene, task)


class PlainScore:
    """In Python."""

    def __init__(self, scene: Scene, task: str) -> None:
        self._scene, self._values = scene, TASKS[task].values

    def __call__(self, state: Array, torque: float, impulse: float) -> tuple[NDArray[np.float32], tuple[float, ...]]:
        """See :class:`Score`."""
        numbers = state.tolist()
        return observe(self._scene, numbers), self._values(self._scene, numbers, torque, impulse)


class CompiledScore:
    """Compiled."""

    def __init__(self, scene: Scene, task: str) -> None:
        from jackbox_env.compiled.compiler import compiled
        from jackbox_env.compiled.score import score_one

        self._given = scene, task
        self._call, self._numbers, self._task = compiled(score_one), np.array(scene.numbers), list(TASKS).index(task)
        self._count = len(TASKS[task].terms)

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledScore, self._given

    def __call__(self, state: Array, torque: float, impulse: float) -> tuple[NDArray[np.float32], tuple[float, ...]]:
        """See :class:`Score`."""
        observation = np.empty(10, dtype=np.float32)
        terms = self._call(self._numbers, self._task, state, torque, impulse, observation)
        return observation, terms[: self._count]
