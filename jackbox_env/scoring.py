"""Observation and reward of one state, in the arithmetic of its contact model.

The exact model's are compiled: the single environment then gives the very bits of the batched one. The pymunk model's
are Python's, and load no compiler. Both hand the task the same scene numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from types import FunctionType
from typing import Any, Protocol, cast

import numpy as np
from numpy.typing import NDArray

from jackbox_env.observation import observe
from jackbox_env.scene import Scene
from jackbox_env.simulators import contact_model
from jackbox_env.states import Array
from jackbox_env.tasks import TASKS, Task, checked_terms


class Score(Protocol):
    """A function of the state, shape (12,), the mean torque [N m] and the impulse [N s] of a step."""

    def __call__(self, state: Array, torque: float, impulse: float) -> tuple[NDArray[np.float32], Sequence[float]]:
        """Return the observation, shape (10,), and the values of the reward's terms."""

    def of(self, scene: Scene) -> Score:
        """The same of another scene, with the task's function as it was read."""


def make_score(scene: Scene, task: Task, contact: str) -> Score:
    """Return the function that observes and rewards.

    Raises:
        TypeError: the task's function cannot be compiled, or does not return one number for each term.
    """
    return CompiledScore(scene, task) if contact_model(contact).compiled else PlainScore(scene, task)


class PlainScore:
    """In Python."""

    def __init__(self, scene: Scene, task: Task) -> None:
        self._scene, self._numbers, self._task = scene, scene.numbers, task

    def __call__(self, state: Array, torque: float, impulse: float) -> tuple[NDArray[np.float32], Sequence[float]]:
        """See :class:`Score`."""
        numbers = tuple(state.tolist())
        terms = self._task.values(self._numbers, numbers, torque, impulse)
        return observe(self._scene, numbers), checked_terms(self._task, terms)

    def of(self, scene: Scene) -> PlainScore:
        """See :class:`Score`."""
        return PlainScore(scene, self._task)


class CompiledScore:
    """Compiled."""

    def __init__(self, scene: Scene, task: Task, call: Callable[..., Any] | None = None) -> None:
        from jackbox_env.compiled.score import score_one

        self._given = scene, task
        self._call, self._numbers = call or compiled_for(task, score_one), np.array(scene.numbers)
        self._terms = np.empty(len(task.terms))  # written by each call

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledScore, self._given

    def __call__(self, state: Array, torque: float, impulse: float) -> tuple[NDArray[np.float32], Sequence[float]]:
        """See :class:`Score`."""
        observation = np.empty(10, dtype=np.float32)
        self._call(self._numbers, state, torque, impulse, observation, self._terms)
        return observation, self._terms.tolist()

    def of(self, scene: Scene) -> CompiledScore:
        """See :class:`Score`."""
        return CompiledScore(scene, self._given[1], self._call)


def compiled_for(task: Task, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of ``compiled.score``, compiled with the task's own as that is now.

    Raises:
        TypeError: the task's function cannot be compiled, or does not return one number for each term.
    """
    from jackbox_env.compiled.compiler import compiled, compiled_for_users

    if task in TASKS.values():
        return compiled(function, task_terms=task.values)
    _refuse_unfit(task)
    return compiled_for_users(function, task_terms=task.values)


def _refuse_unfit(task: Task) -> None:
    """Compile the function of a user's task, and look at what it returns."""
    from numba.core import types

    from jackbox_env.compiled.compiler import returned_by

    name = getattr(task.values, "__qualname__", "")
    try:
        found = returned_by(cast(FunctionType, task.values))
    except Exception as error:
        raise TypeError(
            f"the task's function {name} cannot be compiled, as contact='exact' needs: {_reason(error)}"
        ) from error
    fits = isinstance(found, types.UniTuple) and isinstance(found.dtype, types.Number | types.Boolean)
    if not (fits and len(found) == len(task.terms) and found.dtype not in types.complex_domain):
        raise TypeError(
            f"the task's function {name} must return a tuple of {len(task.terms)} floats, one for each term, "
            f"got what numba calls {found}"
        )


def _reason(error: Exception) -> str:
    """The line that says what numba refuses."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    if "NRT required" in text:
        return "it makes an array, a list or a dict; use single numbers"
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("Failed in")]
    called = [line for line in lines[1:3] if line.startswith(">>>")]  # the call that it does not know
    return " ".join([*lines[:1], *called])[:200] or type(error).__name__
