"""Observation and reward of one state, in the arithmetic of its contact model.

The exact model's are compiled: the single environment then gives the very bits of the batched one. The pymunk model's
are Python's, and load no compiler. Both hand the task the same scene numbers.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from types import FunctionType
from typing import Any, Protocol, cast
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from jackbox_env import checks as check
from jackbox_env.observation import observe
from jackbox_env.scene import Scene
from jackbox_env.simulators import Simulator, contact_model
from jackbox_env.simulators.base import total_impulse
from jackbox_env.states import Array, State
from jackbox_env.tasks import TASKS, Task, TaskError, checked_reward, checked_terms

Scored = tuple[NDArray[np.float32], Sequence[float], bool]
# What has been compiled for each user's task, as long as the task lives.
_compiled: WeakKeyDictionary[Task, dict[Callable[..., Any], Callable[..., Any]]] = WeakKeyDictionary()
_ARITHMETIC = ArithmeticError, ValueError  # math.log(0.0) raises a ValueError


class Score(Protocol):
    """A function of the state, shape (12,), the mean torque [N m] and the impulse [N s] of a step."""

    def __call__(self, state: Array, torque: float, impulse: float) -> Scored:
        """Return the observation, shape (10,), the values of the reward's terms, and whether the episode is over."""

    def observe(self, state: Array) -> NDArray[np.float32]:
        """Return the observation of a state, shape (10,), and try the task there, without torque and impulse.

        An arithmetic error of the task does not count: perhaps no step ends so.

        Raises:
            TypeError: the task does not return what it should.
        """

    def of(self, scene: Scene) -> Score:
        """The same of another scene, with the task's function as it was read."""


def make_score(scene: Scene, task: Task, contact: str) -> Score:
    """Return the function that observes and rewards.

    Raises:
        TypeError: a function of the task cannot be compiled, or does not return what it should.
    """
    return CompiledScore(scene, task) if contact_model(contact).compiled else PlainScore(scene, task)


class PlainScore:
    """In Python."""

    def __init__(self, scene: Scene, task: Task) -> None:
        self._scene, self._numbers, self._task = scene, scene.numbers, task

    def __call__(self, state: Array, torque: float, impulse: float) -> Scored:
        """See :class:`Score`."""
        after, over = State(*state.tolist()), False
        terms = checked_terms(self._task, self._task.values(self._numbers, after, torque, impulse))
        if self._task.over is not None:
            over = self._task.over(self._numbers, after, torque, impulse)
            if not isinstance(over, bool | np.bool_):
                raise TypeError(f"a task's over must return True or False, got {check.shown(over)}")
        return observe(self._scene, after), terms, bool(over)

    def observe(self, state: Array) -> NDArray[np.float32]:
        """See :class:`Score`."""
        with suppress(*_ARITHMETIC):
            self(state, 0.0, 0.0)
        return observe(self._scene, state.tolist())

    def of(self, scene: Scene) -> PlainScore:
        """See :class:`Score`."""
        return PlainScore(scene, self._task)


class CompiledScore:
    """Compiled."""

    def __init__(self, scene: Scene, task: Task, call: Callable[..., Any] | None = None) -> None:
        from jackbox_env.exact.score import score_one

        self._given = scene, task
        self._call, self._numbers = call or compiled_for(task, score_one), np.array(scene.numbers)
        self._terms = np.empty(len(task.terms))  # written by each call

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledScore, self._given

    def __call__(self, state: Array, torque: float, impulse: float) -> Scored:
        """See :class:`Score`."""
        observation = np.empty(10, dtype=np.float32)
        over = self._call(self._numbers, state, torque, impulse, observation, self._terms)
        return observation, self._terms.tolist(), over

    def observe(self, state: Array) -> NDArray[np.float32]:
        """See :class:`Score`."""
        observation = np.empty(10, dtype=np.float32)
        with suppress(*_ARITHMETIC):  # the observation comes first
            self._call(self._numbers, state, 0.0, 0.0, observation, self._terms)
        return observation

    def of(self, scene: Scene) -> CompiledScore:
        """See :class:`Score`."""
        return CompiledScore(scene, self._given[1], self._call)


def bad_reward(task: Task, simulator: Simulator, where: str) -> TaskError:
    """What to raise where the exact model's last step has earned a reward that is NaN or infinite."""
    score = CompiledScore(simulator.scene, task)
    _, terms, _ = score(simulator.state, simulator.torque, total_impulse(simulator.impacts))
    try:
        checked_reward(task, terms)
    except TaskError as error:
        return TaskError(f"{error}, in {where}")
    return TaskError(f"the reward must be finite, got one that is not, in {where}")  # what the task reads has changed


def compiled_for(task: Task, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of ``exact.score``, compiled once for each Task, with the task's functions as they are then.

    Raises:
        TypeError: a function of the task cannot be compiled, or does not return what it should.
    """
    from jackbox_env.exact.compiler import compiled, compiled_for_users

    if task in TASKS.values():
        return compiled(function, task_terms=task.values)
    made = _compiled.setdefault(task, {})
    if function not in made:
        _refuse_unfit(task)
        ends = {} if task.over is None else {"task_over": task.over}
        made[function] = compiled_for_users(function, task_terms=task.values, **ends)
    return made[function]


def _refuse_unfit(task: Task) -> None:
    """Compile the functions of a user's task, and look at what they return."""
    from numba import config
    from numba.core import types

    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return  # plain Python says itself what does not fit
    found: Any = _returned_by(task.values)
    fits = isinstance(found, types.UniTuple) and isinstance(found.dtype, types.Number | types.Boolean)
    if not (fits and len(found) == len(task.terms) and found.dtype not in types.complex_domain):
        raise TypeError(
            f"the task's function {task.values.__qualname__} must return a tuple of {len(task.terms)} floats, one for "
            f"each term, got what numba calls {found}"
        )
    if task.over is not None and not isinstance(found := _returned_by(task.over), types.Boolean):
        raise TypeError(
            f"the task's function {task.over.__qualname__} must return True or False, got what numba calls {found}"
        )


def _returned_by(function: Callable[..., Any]) -> Any:
    """Numba's type of what a function of a user's task returns."""
    from jackbox_env.exact.compiler import returned_by

    try:
        return returned_by(cast(FunctionType, function))
    except Exception as error:
        raise TypeError(
            f"the task's function {function.__qualname__} cannot be compiled, as contact='exact' needs: "
            f"{_reason(error)}{_without_numpy(function)}"
        ) from error


def _without_numpy(function: Callable[..., Any]) -> str:
    """What to do instead, where a function uses numpy."""
    modules = (function.__globals__.get(name) for name in function.__code__.co_names)
    used = any(getattr(module, "__name__", "").split(".")[0] == "numpy" for module in modules)
    return "; write it without numpy, with single numbers and math" if used else ""


def _reason(error: Exception) -> str:
    """The line that says what numba refuses."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    if "NRT required" in text:
        return "it makes an array, a list or a dict; use single numbers"
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("Failed in")]
    called = [line for line in lines[1:3] if line.startswith(">>>")]  # the call that it does not know
    return " ".join([*lines[:1], *called])[:200] or type(error).__name__
