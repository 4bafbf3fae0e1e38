"""An agent's observation, action and reward in one state, in plain Python, which loads no compiler."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from contextlib import suppress
from typing import Any, NamedTuple, cast

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray
from typing_extensions import override

from jackbox_env.model.action import ACTIONS, Action
from jackbox_env.model.observation import (
    OBSERVATIONS,
    STATE,
    Observation,
    observe,
)
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, State, total
from jackbox_env.model.tasks import TASKS, Task, TaskError, checked_reward, checked_terms
from jackbox_env.simulators import Impact, Simulator
from jackbox_env.tools import checks as check

Observed = NDArray[Any]  # float32, or uint8 pictures


_ARITHMETIC = ArithmeticError, ValueError  # math.log(0.0) raises a ValueError


NO_OBSERVATION: Observed = np.empty(0, dtype=np.float32)  # in place of an observation that is not wanted


class Interface(NamedTuple):
    """The task, the observation and the action of an environment."""

    task: Task
    observation: Observation = STATE
    action: Action = ACTIONS["torque"]
    pixels: Pixels | None = None  # observed in place of ``observation``

    @property
    def builtin(self) -> bool:
        """Whether none of them has functions of a user, which may fail."""
        return (
            self.task in TASKS.values()
            and self.observation in OBSERVATIONS.values()
            and self.action in ACTIONS.values()
        )

    @property
    def space(self) -> gym.spaces.Box:
        """The space of the observations."""
        pictures = self.pixels and gym.spaces.Box(0, 255, self.pixels.shape, np.uint8)
        return pictures or gym.spaces.Box(*self.observation.bounds, dtype=np.float32)

    def new_observations(self, count: int) -> Observed:
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
    terminated: bool  # whether the task ends the episode
    observation: Observed  # at its end, or empty


new_step: Callable[..., ControlStep] = tuple.__new__  # twice as fast as ControlStep(...)


class Functions(ABC):
    """An agent's reward, observation and action in a scene, in the arithmetic of its contact model."""

    interface: Interface

    @abstractmethod
    def step_and_score(self, simulator: Simulator, dt: float, torque: float | None, observed: bool) -> ControlStep:
        """Step a simulator of the scene, score its state, and observe it if it is to be ``observed``.

        The arguments of the step are checked.

        Raises:
            TypeError: a user's function returns a wrong type.
            TaskError: the reward is NaN or infinite, or a number of the observation NaN.
            JackLostError: the jack cannot be followed.
        """

    @abstractmethod
    def observe(self, state: Array, time: float) -> Observed:
        """The observation of a state, shape (12,), at a time [s].

        Raises:
            TypeError: the function of a user's observation returns a wrong type.
            TaskError: a number is NaN.
        """

    @abstractmethod
    def share(self, state: Array, action: Array, time: float, dt: float) -> float:
        """The torque over its limit, not clipped; arguments as of ``Action.share``."""

    @abstractmethod
    def of(self, scene: Scene) -> Functions:
        """The functions of another scene with the same task, observation and action."""

    def check_types(self, state: Array, control_dt: float | None = None) -> None:  # noqa: B027
        """Evaluate a user's plain functions in a start, without torque and impulse, to see wrong types early.

        Arithmetic errors are ignored, as perhaps no step begins or ends in this state. With a ``control_dt`` [s] the
        observation and the action that is nearest to zeros are evaluated too. Types of compiled functions are known
        when they are compiled.

        Raises:
            TypeError: a function returns a wrong type.
        """


class PlainFunctions(Functions):
    """An agent's functions in plain Python."""

    def __init__(self, scene: Scene, interface: Interface) -> None:
        self._numbers, self.interface, self._known = scene.numbers, interface, interface.task in TASKS.values()

    @override
    def step_and_score(self, simulator: Simulator, dt: float, torque: float | None, observed: bool) -> ControlStep:
        stored, time, mean, impacts = simulator.step_checked(dt, torque)
        after, impulse = State(*stored), total([impact.impulse for impact in impacts]) if impacts else 0.0
        terms, over = self.score(after, mean, impulse)
        observation = observe(self._numbers, after, time, self.interface.observation) if observed else NO_OBSERVATION
        reward = checked_reward(self.interface.task, terms)
        return new_step(ControlStep, (np.array(stored), time, mean, impacts, impulse, terms, reward, over, observation))

    def score(self, after: State, torque: float, impulse: float) -> tuple[Sequence[float], bool]:
        """After a step: the values of the reward's terms, and whether the episode is over.

        Args:
            after: the state, of Python's numbers.
            torque: mean over the step [N m].
            impulse: of its impacts [N s].
        """
        over, task = False, self.interface.task
        values = task.values(self._numbers, after, torque, impulse)
        terms = cast("tuple[float, ...]", values) if self._known else checked_terms(task, values)
        if task.over is not None:
            over = task.over(self._numbers, after, torque, impulse)
            if not isinstance(over, bool | np.bool_):
                raise TypeError(f"a task's over must return True or False, got {check.shown(over)}")
        return terms, bool(over)

    @override
    def observe(self, state: Array, time: float) -> Observed:
        return observe(self._numbers, State(*state.tolist()), time, self.interface.observation)

    @override
    def share(self, state: Array, action: Array, time: float, dt: float) -> float:
        return self.interface.action.share(self._numbers, State(*state.tolist()), action, time, dt)

    @override
    def of(self, scene: Scene) -> PlainFunctions:
        return PlainFunctions(scene, self.interface)

    @override
    def check_types(self, state: Array, control_dt: float | None = None) -> None:
        with suppress(*_ARITHMETIC):
            self.score(State(*state.tolist()), 0.0, 0.0)
        if control_dt is None:
            return
        with suppress(*_ARITHMETIC, TaskError):
            self.observe(state, 0.0)
        action = self.interface.action
        if action is not ACTIONS["torque"]:
            with suppress(*_ARITHMETIC):
                self.share(state, action.checked(np.zeros(action.size) if action.size else 0)[:, 0], 0.0, control_dt)
