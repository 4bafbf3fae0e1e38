"""The functions of a task, an observation or an action in compiled code; a user's are read once, and checked."""

from __future__ import annotations

import re
import sys
from collections import ChainMap
from collections.abc import Callable, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, cast
from weakref import WeakKeyDictionary

import numpy as np

from jackbox_env.model.action import ACTIONS, Action
from jackbox_env.model.observation import (
    OBSERVATIONS,
    STATE,
    Observation,
)
from jackbox_env.model.scene import Scene
from jackbox_env.model.tasks import TASKS, Task
from jackbox_env.simulators.plain_functions import Interface, PlainFunctions

if TYPE_CHECKING:
    from jackbox_env.jit.compiler import UsersFunctions

# What was read and compiled of each user's task, observation or action, as long as that lives.
_compiled: WeakKeyDictionary[Any, UsersFunctions] = WeakKeyDictionary()


_MANY = 100  # numbers of a function that takes more than seconds to compile


def compiled_for(owner: Task | Observation | Action, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of ``exact.score`` for a task, observation or action, whose functions are read at its first use.

    Raises:
        TypeError: a function of a user cannot be compiled, or returns a wrong type.
    """
    from jackbox_env.jit.compiler import compiled

    if name_of(owner):
        return compiled(function, **_SUBSTITUTES[type(owner)](owner, None))
    return users_functions(owner).entry(function)


def name_of(owner: Task | Observation | Action) -> str:
    """The name of a built-in one; empty if it is a user's."""
    names = (name for named in (TASKS, OBSERVATIONS, ACTIONS) for name, one in named.items() if owner is one)
    return next(names, "")


def functions_together(owners: Sequence[Task | Observation | Action], further: dict[str, Any]) -> UsersFunctions:
    """The functions of several, and ``further`` substitutes, to be compiled into one function.

    Raises:
        TypeError: those of a user cannot be compiled, or return wrong types.
    """
    from jackbox_env.jit.compiler import UsersFunctions

    built_in = [_SUBSTITUTES[type(one)](one, None) for one in owners if name_of(one)]
    users = [users_functions(one) for one in owners if not name_of(one)]
    return UsersFunctions(lambda _: dict(ChainMap(further, *built_in))).besides({}, *users)


def observer_of(observation: Observation) -> Callable[..., Any]:
    """The compiled function that observes the rows of a block."""
    from jackbox_env.exact.score import observe_block, observe_rows

    return compiled_for(observation, observe_block if observation is STATE else observe_rows)


def users_functions(owner: Task | Observation | Action) -> UsersFunctions:
    """The functions of a user's task, observation or action, read at its first use.

    Raises:
        TypeError: they cannot be compiled, or return a wrong type.
    """
    from jackbox_env.jit.compiler import UsersFunctions

    if owner not in _compiled:
        _compiled.setdefault(owner, UsersFunctions(partial(_SUBSTITUTES[type(owner)], owner)))
    return _compiled[owner]


def _of_task(task: Task, users: UsersFunctions | None) -> dict[str, Any]:
    """Substitutes for the placeholders of ``exact.score``, whose functions return the right types.

    ``users`` reads and compiles them; None if they are of this package.

    Raises:
        TypeError: they do not, or cannot be compiled.
    """
    if users is None:
        return {"task_terms": task.values}
    count, further = len(task.terms), (0.0, 0.0)
    numbers = (bool, float) if count == 1 else ()
    what = f"a tuple of {count} numbers, one for each term"
    _check_returned(users, task, task.values, further, what, (float,) * count, *numbers)
    if task.over is None:
        return {"task_terms": task.values}
    _check_returned(users, task, task.over, further, "True or False", bool)
    return {"task_terms": task.values, "task_over": task.over}


def _of_observation(observation: Observation, users: UsersFunctions | None) -> dict[str, Any]:
    """The substitutes of an observation; a built-in one is within its bounds."""
    from jackbox_env.exact.score import COSINES, observe_values

    if users is None:
        return {"observation_values": observation.values, **COSINES}
    count = len(observation.names)
    what = f"a tuple of {count} numbers, one for each name"
    _check_returned(users, observation, observation.values, (0.0,), what, (float,) * count)
    low, high = (bound.astype(np.float64) for bound in observation.bounds)
    return {"observe": observe_values, "observation_values": observation.values, "LOW": low, "HIGH": high}


def _of_action(action: Action, users: UsersFunctions | None) -> dict[str, Any]:
    """The substitutes of an action."""
    from jackbox_env.exact.score import choice_in, pair_in, tuple_in

    read = choice_in if not action.size else pair_in if users is None else tuple_in(action.size)
    if users is not None:
        example: Any = (0.0,) * action.size or 0
        _check_returned(users, action, action.torque, (example, 0.0, 0.0), "a number", bool, float)
    return {"action_torque": action.torque, "action_in": read}


_SUBSTITUTES: dict[type, Callable[[Any, UsersFunctions | None], dict[str, Any]]] = {
    Task: _of_task, Observation: _of_observation, Action: _of_action,
}  # fmt: skip


def _check_returned(
    users: UsersFunctions, owner: Any, function: Any, further: tuple[Any, ...], requirement: str, *allowed: Any
) -> None:
    """Check that a function of a user's task, observation or action can be compiled and returns what is ``allowed``.

    For these and ``further`` see ``UsersFunctions.returned_by``. Under NUMBA_DISABLE_JIT nothing is checked.

    Raises:
        TypeError: it returns something else, or cannot be compiled.
    """
    from jackbox_env.jit.compiler import is_disabled

    if is_disabled():
        return
    name = f"the {type(owner).__name__.lower()}'s function {function.__qualname__}"
    if isinstance(allowed[0], tuple) and len(allowed[0]) > _MANY:
        print(f"jackbox compiles {name}, in each process anew ({len(allowed[0])} numbers)", file=sys.stderr, flush=True)
    try:
        returned, named = users.returned_by(function, further)
    except Exception as error:
        raise TypeError(
            f"{name} cannot be compiled, as contact='exact' needs: {_reason(error)}{_without_numpy(function)}"
            f"{_without_compiling(owner)}"
        ) from error
    if returned not in allowed:
        raise TypeError(f"{name} must return {requirement}, got what numba calls {named}")


def _without_compiling(owner: Task | Observation | Action) -> str:
    """The advice if pymunk's environments accept what cannot be compiled; else empty."""
    interface = Interface(TASKS["juggle"])._replace(**cast(Any, {type(owner).__name__.lower(): owner}))
    try:
        PlainFunctions(Scene(), interface).check_types(np.zeros(12), 0.02)
    except Exception:
        return ""
    return "; environments with fidelity='balanced' run it"


def _without_numpy(function: Callable[..., Any]) -> str:
    """The advice if a function uses numpy; else empty."""
    modules = (function.__globals__.get(name) for name in function.__code__.co_names)
    used = any(getattr(module, "__name__", "").split(".")[0] == "numpy" for module in modules)
    return "; write it without numpy, with single numbers and math" if used else ""


def _reason(error: Exception) -> str:
    """The line of numba's error that has the reason."""
    if isinstance(error, RecursionError):
        return "its functions call one another too deeply"
    text = re.sub(r"\x1b\[[0-9;]*m", "", str(error))
    if "NRT required" in text:
        return "it makes an array, a list or a dict; use single numbers"
    lines = [line.strip() for line in text.splitlines() if line.strip() and not line.startswith("Failed in")]
    called = [line for line in lines[1:3] if line.startswith(">>>")]  # the call that it does not know
    return " ".join([*lines[:1], *called])[:200] or type(error).__name__
