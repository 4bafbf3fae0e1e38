"""Observation and reward of one state, in the arithmetic of its contact model.

With the exact model they are compiled, so the single environment equals the batched one bit for bit. With pymunk they
are plain Python, which loads no compiler. The task gets the same scene numbers from both.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from types import FunctionType
from typing import Any, cast
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
# Compiled functions of each user's task, as long as the task lives.
_compiled: WeakKeyDictionary[Task, dict[Callable[..., Any], Callable[..., Any]]] = WeakKeyDictionary()
_ARITHMETIC = ArithmeticError, ValueError  # math.log(0.0) raises a ValueError


class PlainScore:
    """A function of the state, shape (12,), the mean torque [N m] and the impulse [N s] of a step; in plain Python."""

    def __init__(self, scene: Scene, task: Task) -> None:
        self._scene, self._numbers, self._task = scene, scene.numbers, task

    def __call__(self, state: Array, torque: float, impulse: float) -> Scored:
        """Return the observation, shape (10,), the values of the reward's terms, and whether the episode is over."""
        after, over = State(*state.tolist()), False
        terms = checked_terms(self._task, self._task.values(self._numbers, after, torque, impulse))
        if self._task.over is not None:
            over = self._task.over(self._numbers, after, torque, impulse)
            if not isinstance(over, bool | np.bool_):
                raise TypeError(f"a task's over must return True or False, got {check.shown(over)}")
        return observe(self._scene, after), terms, bool(over)

    def observe(self, state: Array) -> NDArray[np.float32]:
        """Return the observation of a state, shape (10,), and evaluate the task there, without torque and impulse.

        Arithmetic errors of the task are ignored: perhaps no step ends in this state.

        Raises:
            TypeError: the task returns a wrong type.
        """
        with suppress(*_ARITHMETIC):
            self(state, 0.0, 0.0)
        return observe(self._scene, state.tolist())

    def of(self, scene: Scene) -> PlainScore:
        """The same for another scene."""
        return PlainScore(scene, self._task)


class CompiledScore:
    """:class:`PlainScore` compiled by numba."""

    def __init__(self, scene: Scene, task: Task, call: Callable[..., Any] | None = None) -> None:
        from jackbox_env.exact.score import score_one

        self._arguments = scene, task
        self._call, self._numbers = call or compiled_for(task, score_one), np.array(scene.numbers)
        self._terms = np.empty(len(task.terms))  # written by each call

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledScore, self._arguments

    def __call__(self, state: Array, torque: float, impulse: float) -> Scored:
        """Return the observation, the values of the terms, and whether the episode is over."""
        observation = np.empty(10, dtype=np.float32)
        over = self._call(self._numbers, state, torque, impulse, observation, self._terms)
        return observation, self._terms.tolist(), over

    def observe(self, state: Array) -> NDArray[np.float32]:
        """Return the observation, shape (10,), and evaluate the task."""
        observation = np.empty(10, dtype=np.float32)
        with suppress(*_ARITHMETIC):  # the observation comes first
            self._call(self._numbers, state, 0.0, 0.0, observation, self._terms)
        return observation

    def of(self, scene: Scene) -> CompiledScore:
        """The same for another scene, without compiling again."""
        return CompiledScore(scene, self._arguments[1], self._call)


Score = PlainScore | CompiledScore


def make_score(scene: Scene, task: Task, contact: str) -> Score:
    """Return the function that observes and rewards.

    Raises:
        TypeError: a function of the task cannot be compiled, or returns a wrong type.
    """
    return CompiledScore(scene, task) if contact_model(contact).compiled else PlainScore(scene, task)


def bad_reward(task: Task, simulator: Simulator, where: str) -> TaskError:
    """The error of the exact model's last step, whose reward is NaN or infinite."""
    score = CompiledScore(simulator.scene, task)
    _, terms, _ = score(simulator.state, simulator.torque, total_impulse(simulator.impacts))
    try:
        checked_reward(task, terms)
    except TaskError as error:
        return TaskError(f"{error}, in {where}")
    # A value that the task reads has changed since.
    return TaskError(f"the reward must be finite, got one that is not, in {where}")


def compiled_for(task: Task, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of ``exact.score``, compiled once for each Task, with the task's functions as they are then.

    Raises:
        TypeError: a function of the task cannot be compiled, or returns a wrong type.
    """
    from jackbox_env.exact.compiler import compiled, compiled_for_users

    if task in TASKS.values():
        return compiled(function, task_terms=task.values)
    variants = _compiled.setdefault(task, {})
    if function not in variants:
        ends = {} if task.over is None else {"task_over": task.over}
        variants[function] = compiled_for_users(function, **_terms_of(task), **ends)
    return variants[function]


def _terms_of(task: Task) -> dict[str, Any]:
    """Substitutes for the placeholders of ``exact.score`` in a user's task, whose functions return the right types.

    Raises:
        TypeError: they do not, or cannot be compiled.
    """
    from numba import config
    from numba.core import types

    from jackbox_env.exact.score import one_term

    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return {"task_terms": partial(_plain_terms, task.values)}
    returned: Any = _returned_by(task.values)
    single = isinstance(returned, types.Number | types.Boolean)
    terms: Any = types.UniTuple(returned, 1) if single else returned  # type: ignore[no-untyped-call]
    fits = isinstance(terms, types.UniTuple) and isinstance(terms.dtype, types.Number | types.Boolean)
    if not (fits and len(terms) == len(task.terms) and terms.dtype not in types.complex_domain):
        raise TypeError(
            f"the task's function {task.values.__qualname__} must return a tuple of {len(task.terms)} floats, one for "
            f"each term, got what numba calls {returned}"
        )
    if task.over is not None and not isinstance(returned := _returned_by(task.over), types.Boolean):
        raise TypeError(
            f"the task's function {task.over.__qualname__} must return True or False, got what numba calls {returned}"
        )
    return {"task_terms": one_term, "task_number": task.values} if single else {"task_terms": task.values}


def _plain_terms(values: Callable[..., Any], *arguments: Any) -> tuple[float, ...]:
    """What a task's function returns, as a tuple; its types are not checked."""
    returned = values(*arguments)
    return returned if isinstance(returned, tuple) else (returned,)


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
    """The advice if a function uses numpy; else empty."""
    modules = (function.__globals__.get(name) for name in function.__code__.co_names)
    used = any(getattr(module, "__name__", "").split(".")[0] == "numpy" for module in modules)
    return "; write it without numpy, with single numbers and math" if used else ""


def _reason(error: Exception) -> str:
    """The line of numba's error that has the reason."""
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    if "NRT required" in text:
        return "it makes an array, a list or a dict; use single numbers"
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("Failed in")]
    called = [line for line in lines[1:3] if line.startswith(">>>")]  # the call that it does not know
    return " ".join([*lines[:1], *called])[:200] or type(error).__name__
