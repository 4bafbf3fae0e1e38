"""What an agent observes, does and earns in one state, in the arithmetic of its contact model.

With the exact model the functions are compiled, so the single environment equals the batched one bit for bit. With
pymunk they are plain Python, which loads no compiler. A user's functions get the same scene numbers from both.
"""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Sequence
from contextlib import suppress
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple, cast
from weakref import WeakKeyDictionary

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from jackbox_env.model.action import ACTIONS, Action
from jackbox_env.model.observation import (
    OBSERVATIONS,
    STATE,
    Observation,
    bad_observation,
    observation_of,
    observe_named,
)
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, State
from jackbox_env.model.tasks import TASKS, Task, TaskError, checked_reward, checked_terms
from jackbox_env.simulators import Impact, Simulator, StepResult, contact_model
from jackbox_env.simulators.base import total_impulse
from jackbox_env.tools import checks as check

if TYPE_CHECKING:
    from jackbox_env.jit.compiler import UsersFunctions

Seen = NDArray[Any]  # float32, or uint8 pictures
Judged = tuple[Seen, Sequence[float], bool]
# State, time [s], mean torque [N m], impacts, their impulse [N s], and what is judged.
Stepped = tuple[Array, float, float, Sequence[Impact], float, Seen, Sequence[float], bool]
# What was read and compiled of each user's task, observation or action, as long as that lives.
_compiled: WeakKeyDictionary[Any, UsersFunctions] = WeakKeyDictionary()
_ARITHMETIC = ArithmeticError, ValueError  # math.log(0.0) raises a ValueError
_MANY = 100  # numbers of a function that takes more than seconds to compile
_NOTHING: Seen = np.empty(0, dtype=np.float32)  # in place of an observation that is not wanted


class Nouns(NamedTuple):
    """What an agent earns, observes and does."""

    task: Task
    observation: Observation = STATE
    action: Action = ACTIONS["torque"]
    pixels: Pixels | None = None  # observed in place of ``observation``

    @property
    def builtin(self) -> bool:
        """Whether none of them has functions of a user, which may fail."""
        return self.task in TASKS.values() and self.observation in OBSERVATIONS.values() and self.steady

    @property
    def steady(self) -> bool:
        """Whether the action has no function of a user."""
        return self.action in ACTIONS.values()

    @property
    def space(self) -> gym.spaces.Box:
        """Of the observations."""
        pictures = self.pixels and gym.spaces.Box(0, 255, self.pixels.shape, np.uint8)
        return pictures or gym.spaces.Box(*self.observation.bounds, dtype=np.float32)

    def unfilled(self, count: int) -> Seen:
        """Memory for so many observations."""
        one, kind = (self.pixels.shape, np.uint8) if self.pixels else ((len(self.observation.names),), np.float32)
        return np.empty((count, *one), dtype=kind)


class PlainFunctions:
    """Their functions in a scene, in plain Python."""

    def __init__(self, scene: Scene, nouns: Nouns) -> None:
        self._numbers, self.nouns, self._known = scene.numbers, nouns, nouns.task in TASKS.values()

    def step(self, simulator: Simulator, dt: float, torque: float | None, seen: bool) -> Stepped:
        """Step a simulator of the scene, and :meth:`judge` the state; the arguments of the step are checked."""
        stored, time, mean, impacts = simulator.step_checked(dt, torque)
        state, impulse = np.array(stored), total_impulse(impacts) if impacts else 0.0
        return (state, time, mean, impacts, impulse, *self.judge(state, time, mean, impulse, seen))

    def judge(self, state: Array, time: float, torque: float, impulse: float, seen: bool = True) -> Judged:
        """After a step: the observation, the values of the reward's terms, and whether the episode is over.

        Args:
            state: shape (12,).
            time: [s].
            torque: mean over the step [N m].
            impulse: of its impacts [N s].
            seen: False: the observation is not wanted, and empty.
        """
        after, over, task = State(*state.tolist()), False, self.nouns.task
        values = task.values(self._numbers, after, torque, impulse)
        terms = cast("tuple[float, ...]", values) if self._known else checked_terms(task, values)
        if task.over is not None:
            over = task.over(self._numbers, after, torque, impulse)
            if not isinstance(over, bool | np.bool_):
                raise TypeError(f"a task's over must return True or False, got {check.shown(over)}")
        observation = observe_named(self._numbers, after, time, self.nouns.observation) if seen else _NOTHING
        return observation, terms, bool(over)

    def observe(self, state: Array, time: float) -> Seen:
        """The observation of a state, shape (12,), at a time [s].

        Raises:
            TypeError: the function of a user's observation returns a wrong type.
            TaskError: a number is NaN.
        """
        return observe_named(self._numbers, State(*state.tolist()), time, self.nouns.observation)

    def share(self, state: Array, action: Array, time: float, dt: float) -> float:
        """The torque over its limit, not clipped; arguments as of ``Action.share``."""
        return self.nouns.action.share(self._numbers, State(*state.tolist()), action, time, dt)

    def of(self, scene: Scene) -> PlainFunctions:
        """The same for another scene."""
        return PlainFunctions(scene, self.nouns)


class CompiledFunctions:
    """:class:`PlainFunctions` compiled by numba."""

    def __init__(self, scene: Scene, nouns: Nouns, calls: tuple[Any, ...] | None = None) -> None:
        self._scene, self.nouns = scene, nouns
        self._calls = calls or _calls_of(nouns)
        self._judge, self._observe, self._share, *_ = self._calls
        self._numbers, self._names = np.array(scene.numbers), len(nouns.observation.names)
        self._terms = np.empty(len(nouns.task.terms))  # written by each call
        self._memory, self._address = self._calls[-1](self._numbers, self._terms)  # of the arguments of judge

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledFunctions, (self._scene, self.nouns)

    def step(self, simulator: Simulator, dt: float, torque: float | None, seen: bool) -> Stepped:
        """As :meth:`PlainFunctions.step`, in one call of compiled code."""
        observation = np.empty(self._names, np.float32) if seen else _NOTHING
        stored, time, mean, impacts = simulator.step_checked(dt, torque, self._address, observation)
        state, impulse, verdict = np.array(stored), total_impulse(impacts) if impacts else 0.0, simulator.verdict
        if verdict < 0:
            raise self._bad_observation(state, time)
        return state, time, mean, impacts, impulse, observation, self._terms.tolist(), verdict > 0

    def judge(self, state: Array, time: float, torque: float, impulse: float, seen: bool = True) -> Judged:
        """As :meth:`PlainFunctions.judge`."""
        observation = np.empty(self._names, np.float32) if seen else _NOTHING
        over = self._judge(self._address, state, time, torque, impulse, observation)
        if over < 0:
            raise self._bad_observation(state, time)
        return observation, self._terms.tolist(), over > 0

    def observe(self, state: Array, time: float) -> Seen:
        """As :meth:`PlainFunctions.observe`."""
        observation = np.empty(self._names, dtype=np.float32)
        if not self._observe(self._numbers, state, time, observation):
            raise self._bad_observation(state, time)
        return observation

    def share(self, state: Array, action: Array, time: float, dt: float) -> float:
        """As :meth:`PlainFunctions.share`."""
        return float(self._share(self._numbers, state, action.reshape(-1, 1), time, dt))

    def of(self, scene: Scene) -> CompiledFunctions:
        """The same for another scene, without compiling again."""
        return CompiledFunctions(scene, self.nouns, self._calls)

    def _bad_observation(self, state: Array, time: float) -> TaskError:
        observation = np.empty(self._names, dtype=np.float32)
        self._observe(self._numbers, state, time, observation)
        return bad_observation(self.nouns.observation, observation.tolist())


Functions = PlainFunctions | CompiledFunctions


def make_functions(scene: Scene, nouns: Nouns, contact: str) -> Functions:
    """Return the functions of a scene's agent.

    Raises:
        TypeError: a function of a user cannot be compiled, or returns a wrong type.
    """
    return CompiledFunctions(scene, nouns) if contact_model(contact).compiled else PlainFunctions(scene, nouns)


def tried(functions: Functions, state: Array, control_dt: float | None = None) -> None:
    """Evaluate a user's functions in a start, without torque and impulse, to see wrong types early.

    Arithmetic errors are ignored, as perhaps no step begins or ends in this state. With a ``control_dt`` [s] the action
    that is nearest to zeros is tried too.

    Raises:
        TypeError: a function returns a wrong type.
    """
    with suppress(*_ARITHMETIC):
        functions.judge(state, 0.0, 0.0, 0.0, seen=False)
    if control_dt is None:
        return
    with suppress(*_ARITHMETIC, TaskError):
        functions.observe(state, 0.0)
    action = functions.nouns.action
    if action is not ACTIONS["torque"]:
        with suppress(*_ARITHMETIC):
            functions.share(state, action.checked(np.zeros(action.size) if action.size else 0)[:, 0], 0.0, control_dt)


def bad_reward(task: Task, scene: Scene, step: StepResult, where: str) -> TaskError:
    """The error of a step of the exact model whose reward is NaN or infinite."""
    from jackbox_env.exact.score import score_one

    terms, numbers = np.empty(len(task.terms)), np.array(scene.numbers)
    compiled_for(task, score_one)(numbers, step.state, step.torque, total_impulse(step.impacts), terms)
    try:
        checked_reward(task, terms.tolist())
    except TaskError as error:
        return TaskError(f"{error}, in {where}")
    # A function of the drive has returned something else since.
    return TaskError(f"the reward must be finite, got one that is not, in {where}")


def observed(scene: Scene, states: Array, observation: str | Observation = "state", time: float = 0.0) -> Seen:
    """The observations of many states, shape (n, 12), at a time [s], by compiled code: float32, shape (n, numbers).

    Raises:
        TypeError, ValueError: no observation.
        TaskError: a number is NaN.
    """
    from jackbox_env.exact.score import observe_rows
    from jackbox_env.exact.workspace import SCRATCH, TIME, WIDTH

    chosen, count = observation_of(observation), len(states)
    block, seen = np.zeros((WIDTH, count)), np.empty((count, len(chosen.names)), dtype=np.float32)
    block[:12], block[TIME] = states.T, time
    numbers = np.array([scene.numbers])
    bad = compiled_for(chosen, observe_rows)(numbers, block, count, np.zeros((SCRATCH, count)), 0, seen)
    if bad >= 0:
        raise bad_observation(chosen, seen[bad].tolist())
    return seen


def _calls_of(nouns: Nouns) -> tuple[Any, ...]:
    """Compiled functions of one state, and the addresses of those that ``judge`` calls."""
    from jackbox_env.exact.score import act_one, judge, observe_one, pack_judged, row_observer, row_scorer, score_one
    from jackbox_env.jit.compiler import PACKED, address_of, compiled

    observe, score = compiled_for(nouns.observation, observe_one), compiled_for(nouns.task, score_one)
    act = None if nouns.action is ACTIONS["torque"] else compiled_for(nouns.action, act_one)
    addresses = address_of(observe, row_observer), address_of(score, row_scorer)

    def pack(numbers: Array, terms: Array) -> tuple[Array, int]:
        """Memory with the arguments of ``judge``, and its address."""
        memory = np.zeros(PACKED)
        return memory, compiled(pack_judged)(memory, numbers, terms, *addresses)

    return compiled(judge), observe, act, score, pack


def compiled_for(owner: Task | Observation | Action, function: Callable[..., Any]) -> Callable[..., Any]:
    """A function of ``exact.score`` for a task, observation or action, whose functions are read at its first use.

    Raises:
        TypeError: a function of a user cannot be compiled, or returns a wrong type.
    """
    from jackbox_env.jit.compiler import compiled

    if any(owner is one for named in (TASKS, OBSERVATIONS, ACTIONS) for one in named.values()):
        return compiled(function, **_SUBSTITUTES[type(owner)](owner, None))
    return users_functions(owner).entry(function)


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
    """The same for an observation."""
    from jackbox_env.exact.score import observe_landing, observe_values

    if users is None:
        return {} if observation is STATE else {"observe": observe_landing}
    count = len(observation.names)
    what = f"a tuple of {count} numbers, one for each name"
    _check_returned(users, observation, observation.values, (0.0,), what, (float,) * count)
    low, high = (bound.astype(np.float64) for bound in observation.bounds)
    return {"observe": observe_values, "observation_values": observation.values, "LOW": low, "HIGH": high}


def _of_action(action: Action, users: UsersFunctions | None) -> dict[str, Any]:
    """The same for an action."""
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
    nouns = Nouns(TASKS["juggle"])._replace(**cast(Any, {type(owner).__name__.lower(): owner}))
    try:
        tried(PlainFunctions(Scene(), nouns), np.zeros(12), 0.02)
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
