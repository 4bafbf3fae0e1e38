"""What an agent observes, does and earns in one state, in the arithmetic of its contact model.

With the exact model the functions are compiled, so the single environment equals the batched one bit for bit. With
pymunk they are plain Python, which loads no compiler. A user's functions get the same scene numbers from both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from typing_extensions import override

from jackbox_env.model.action import ACTIONS
from jackbox_env.model.observation import (
    Observation,
    bad_observation,
    observation_of,
)
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array
from jackbox_env.model.tasks import Task, TaskError, checked_reward
from jackbox_env.simulators import Simulator, StepResult, contact_model
from jackbox_env.simulators.base import total_impulse
from jackbox_env.simulators.plain_functions import (
    NO_OBSERVATION,
    ControlStep,
    Functions,
    Interface,
    Observed,
    PlainFunctions,
    new_step,
)
from jackbox_env.simulators.users_functions import compiled_for


class CompiledFunctions(Functions):
    """An agent's functions compiled by numba."""

    def __init__(self, scene: Scene, interface: Interface, calls: tuple[Any, ...] | None = None) -> None:
        self._scene, self.interface = scene, interface
        self._calls = calls or _calls_of(interface)
        self._observe, self._share, pack = self._calls
        self._numbers = np.array(scene.numbers)
        # Written by each step, at the addresses below.
        self._terms, verdict = np.empty(len(interface.task.terms)), np.zeros(1, np.int64)
        self._verdict = verdict.data
        self._observation = np.empty(len(interface.observation.names), np.float32)
        wanted = self._observation[:0], self._observation
        packed = [pack(self._numbers, self._terms, verdict, observation) for observation in wanted]
        self._scorings, self._kept = [address for address, *_ in packed], packed  # the memory at the addresses

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledFunctions, (self._scene, self.interface)

    @override
    def step_and_score(self, simulator: Simulator, dt: float, torque: float | None, observed: bool) -> ControlStep:
        stored, time, mean, impacts = simulator.step_checked(dt, torque, self._scorings[observed])
        verdict, impulse, terms = self._verdict[0], total_impulse(impacts) if impacts else 0.0, self._terms.tolist()
        if verdict < 0:
            raise bad_observation(self.interface.observation, self._observation.tolist())
        observation, reward = (
            self._observation.copy() if observed else NO_OBSERVATION,
            checked_reward(self.interface.task, terms),
        )
        return new_step(
            ControlStep, (np.array(stored), time, mean, impacts, impulse, terms, reward, verdict > 0, observation)
        )

    @override
    def observe(self, state: Array, time: float) -> Observed:
        observation = np.empty_like(self._observation)
        if not self._observe(self._numbers, state, time, observation):
            raise bad_observation(self.interface.observation, observation.tolist())
        return observation

    @override
    def share(self, state: Array, action: Array, time: float, dt: float) -> float:
        return float(self._share(self._numbers, state, action.reshape(-1, 1), time, dt))

    @override
    def of(self, scene: Scene) -> CompiledFunctions:
        return CompiledFunctions(scene, self.interface, self._calls)


def make_functions(scene: Scene, interface: Interface, contact: str) -> Functions:
    """Return the functions of a scene's agent.

    Raises:
        TypeError: a function of a user cannot be compiled, or returns a wrong type.
    """
    return CompiledFunctions(scene, interface) if contact_model(contact).compiled else PlainFunctions(scene, interface)


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


def observed(scene: Scene, states: Array, observation: str | Observation = "state", time: float = 0.0) -> Observed:
    """The observations of many states, shape (n, 12), at a time [s], by compiled code: float32, shape (n, numbers).

    Raises:
        TypeError, ValueError: no observation.
        TaskError: a number is NaN.
    """
    from jackbox_env.exact.score import observe_rows
    from jackbox_env.exact.workspace import HEIGHT, SCRATCH, TIME

    chosen, count = observation_of(observation), len(states)
    block, observations = np.zeros((HEIGHT, count)), np.empty((count, len(chosen.names)), dtype=np.float32)
    block[:12], block[TIME] = states.T, time
    numbers = np.array([scene.numbers])
    bad = compiled_for(chosen, observe_rows)(numbers, block, count, np.zeros((SCRATCH, count)), 0, observations)
    if bad >= 0:
        raise bad_observation(chosen, observations[bad].tolist())
    return observations


def _calls_of(interface: Interface) -> tuple[Any, ...]:
    """Compiled functions of one state, and one that makes a ``Scoring``."""
    from jackbox_env.exact.score import act_one, observe_one, pack_scoring, row_observer, row_scorer, score_one
    from jackbox_env.jit.compiler import PACKED, address_of, compiled

    observe, score = compiled_for(interface.observation, observe_one), compiled_for(interface.task, score_one)
    act = None if interface.action is ACTIONS["torque"] else compiled_for(interface.action, act_one)

    def pack(*arrays: Any) -> tuple[Any, ...]:
        """The address of a ``Scoring`` with these arrays, and what must live as long."""
        addresses = address_of(observe, row_observer), address_of(score, row_scorer)
        memory, everything = np.zeros(PACKED), (*arrays, *addresses)
        return compiled(pack_scoring)(memory, *everything), memory, arrays, observe, score

    return observe, act, pack
