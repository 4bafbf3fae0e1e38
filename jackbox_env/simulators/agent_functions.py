"""An agent's observation, action and reward in the arithmetic of its contact model.

With the exact model the functions are compiled, so the single environment equals the batched one bit for bit. With
pymunk they are plain Python, which loads no compiler. A user's functions get the same scene numbers from both.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from typing_extensions import override

from jackbox_env.exact import score
from jackbox_env.exact.workspace import HEIGHT, SCRATCH, TIME, Results, Status
from jackbox_env.jit.compiler import address_of
from jackbox_env.model.action import ACTIONS
from jackbox_env.model.observation import Observation, bad_observation, observation_of
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array
from jackbox_env.model.tasks import checked_reward
from jackbox_env.simulators import Simulator, contact_model
from jackbox_env.simulators.exact import Scoring
from jackbox_env.simulators.plain_functions import (
    NO_OBSERVATION,
    ControlStep,
    Functions,
    Interface,
    Observed,
    PlainFunctions,
    new_step,
)
from jackbox_env.simulators.users_functions import compiled_for, observer_of


class CompiledFunctions(Functions):
    """An agent's functions compiled by numba."""

    def __init__(self, scene: Scene, interface: Interface) -> None:
        self._scene, self.interface, self._numbers = scene, interface, np.array(scene.numbers)
        task, observation, action, _ = interface
        self._observe = compiled_for(observation, score.observe_one)
        self._act: Any = None if action is ACTIONS["torque"] else compiled_for(action, score.act_one)
        self._called = compiled_for(task, score.score_block), observer_of(observation)  # they live as long
        scorer, observer = self._called
        # Written by each step. An observation of length 0 is not wanted.
        results = Results(
            observations=np.empty((1, len(observation.names)), np.float32), rewards=np.zeros((1, 1)),
            terminations=np.zeros(1, np.bool_), truncations=np.zeros(1, np.bool_),
            reports=np.zeros((1, score.TERMS + len(task.terms))),
        )  # fmt: skip
        self._observation, self._report = results.observations[0], results.reports[0]
        self._reward, self._terminated = results.rewards[0].data, results.terminations.data
        addresses = address_of(scorer, score.block_scorer), address_of(observer, score.block_observer)
        self._scorings = [
            Scoring(*addresses, results._replace(observations=results.observations[:wanted]), self._refuse)
            for wanted in range(2)
        ]

    def __reduce__(self) -> tuple[Any, ...]:
        return CompiledFunctions, (self._scene, self.interface)

    @override
    def step_and_score(self, simulator: Simulator, dt: float, torque: float | None, observed: bool) -> ControlStep:
        self._terminated[0] = False
        stored, time, mean, impacts = simulator.step_checked(dt, torque, self._scorings[observed])
        _, _, impulse, *terms = self._report.tolist()
        observation = self._observation.copy() if observed else NO_OBSERVATION
        return new_step(
            ControlStep,
            (np.array(stored), time, mean, impacts, impulse, terms, self._reward[0], self._terminated[0], observation),
        )

    def _refuse(self, ended: int) -> None:
        """Raise TaskError if a step ended with a reward that is not finite, or an observation with NaN."""
        if ended == Status.BAD_OBSERVATION:
            raise bad_observation(self.interface.observation, self._observation.tolist())
        if ended == Status.BAD_REWARD:
            checked_reward(self.interface.task, self._report[score.TERMS :].tolist())

    @override
    def observe(self, state: Array, time: float) -> Observed:
        observation: Observed = np.empty_like(self._observation)
        if not self._observe(self._numbers, state, time, observation):
            raise bad_observation(self.interface.observation, observation.tolist())
        return observation

    @override
    def share(self, state: Array, action: Array, time: float, dt: float) -> float:
        return float(self._act(self._numbers, state, action.reshape(-1, 1), time, dt))

    @override
    def of(self, scene: Scene) -> CompiledFunctions:
        twin = object.__new__(CompiledFunctions)  # with the same memory for results, as one of both is used at a time
        vars(twin).update(vars(self), _scene=scene, _numbers=np.array(scene.numbers))
        return twin


def make_functions(scene: Scene, interface: Interface, contact: str) -> Functions:
    """Return the functions of a scene's agent.

    Raises:
        TypeError: a function of a user cannot be compiled, or returns a wrong type.
    """
    return CompiledFunctions(scene, interface) if contact_model(contact).compiled else PlainFunctions(scene, interface)


def observed(scene: Scene, states: Array, observation: str | Observation = "state", time: float = 0.0) -> Observed:
    """The observations of many states, shape (n, 12), at a time [s], by compiled code: float32, shape (n, numbers).

    Raises:
        TypeError, ValueError: no observation.
        TaskError: a number is NaN.
    """
    chosen, count = observation_of(observation), len(states)
    block, observations = np.zeros((HEIGHT, count)), np.empty((count, len(chosen.names)), dtype=np.float32)
    block[:12], block[TIME] = states.T, time
    numbers = np.array([scene.numbers])
    bad = compiled_for(chosen, score.observe_rows)(numbers, block, count, np.zeros((SCRATCH, count)), 0, observations)
    if bad >= 0:
        raise bad_observation(chosen, observations[bad].tolist())
    return observations
