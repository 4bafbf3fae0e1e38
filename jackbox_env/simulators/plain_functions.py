"""What an agent observes, does and earns in one state, in plain Python, which loads no compiler."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from jackbox_env.model.action import ACTIONS, Action
from jackbox_env.model.observation import (
    OBSERVATIONS,
    STATE,
    Observation,
    observe_named,
)
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, State
from jackbox_env.model.tasks import TASKS, Task, TaskError, checked_reward, checked_terms
from jackbox_env.simulators import Impact, Simulator
from jackbox_env.simulators.base import total_impulse
from jackbox_env.tools import checks as check

Seen = NDArray[Any]  # float32, or uint8 pictures


_ARITHMETIC = ArithmeticError, ValueError  # math.log(0.0) raises a ValueError


NO_OBSERVATION: Seen = np.empty(0, dtype=np.float32)  # in place of an observation that is not wanted


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


class ControlStep(NamedTuple):
    """Results of a control step, or of several with sums."""

    state: Array  # at its end, (12,)
    time: float  # at its end [s]
    torque: float  # mean [N m]
    impacts: Sequence[Impact]
    impulse: float  # [N s]
    terms: Sequence[float]  # of the reward
    reward: float
    over: bool  # whether it terminates the episode
    seen: Seen  # observation at its end, or empty


new_step: Callable[..., ControlStep] = tuple.__new__  # twice as fast as ControlStep(...)


class PlainFunctions:
    """An agent's functions in a scene, in plain Python."""

    def __init__(self, scene: Scene, nouns: Nouns) -> None:
        self._numbers, self.nouns, self._known = scene.numbers, nouns, nouns.task in TASKS.values()

    def step_and_score(self, simulator: Simulator, dt: float, torque: float | None, seen: bool) -> ControlStep:
        """Step a simulator of the scene, score its state, and observe it if it is to be ``seen``.

        The arguments of the step are checked.

        Raises:
            TypeError: a user's function returns a wrong type.
            TaskError: the reward is NaN or infinite, or a number of the observation NaN.
            JackLostError: the jack cannot be followed.
        """
        stored, time, mean, impacts = simulator.step_checked(dt, torque)
        after, impulse = State(*stored), total_impulse(impacts) if impacts else 0.0
        terms, over = self.score(after, mean, impulse)
        observation = observe_named(self._numbers, after, time, self.nouns.observation) if seen else NO_OBSERVATION
        reward = checked_reward(self.nouns.task, terms)
        return new_step(ControlStep, (np.array(stored), time, mean, impacts, impulse, terms, reward, over, observation))

    def score(self, after: State, torque: float, impulse: float) -> tuple[Sequence[float], bool]:
        """After a step: the values of the reward's terms, and whether the episode is over.

        Args:
            after: the state, of Python's numbers.
            torque: mean over the step [N m].
            impulse: of its impacts [N s].
        """
        over, task = False, self.nouns.task
        values = task.values(self._numbers, after, torque, impulse)
        terms = cast("tuple[float, ...]", values) if self._known else checked_terms(task, values)
        if task.over is not None:
            over = task.over(self._numbers, after, torque, impulse)
            if not isinstance(over, bool | np.bool_):
                raise TypeError(f"a task's over must return True or False, got {check.shown(over)}")
        return terms, bool(over)

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


def tried(functions: object, state: Array, control_dt: float | None = None) -> None:
    """Evaluate a user's plain functions in a start, without torque and impulse, to see wrong types early.

    Arithmetic errors are ignored, as perhaps no step begins or ends in this state. With a ``control_dt`` [s] the action
    that is nearest to zeros is tried too. Types of compiled functions are known when they are compiled.

    Raises:
        TypeError: a function returns a wrong type.
    """
    if not isinstance(functions, PlainFunctions):
        return
    with suppress(*_ARITHMETIC):
        functions.score(State(*state.tolist()), 0.0, 0.0)
    if control_dt is None:
        return
    with suppress(*_ARITHMETIC, TaskError):
        functions.observe(state, 0.0)
    action = functions.nouns.action
    if action is not ACTIONS["torque"]:
        with suppress(*_ARITHMETIC):
            functions.share(state, action.checked(np.zeros(action.size) if action.size else 0)[:, 0], 0.0, control_dt)
