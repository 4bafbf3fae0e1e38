"""A batch made of single environments, stepped one after the other: any contact model, and pictures."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from jackbox_env.batches.base import Flags, Floats, Outcome, bad_action
from jackbox_env.env import JackInBoxEnv
from jackbox_env.states import Array


class SingleBatch:
    """See :class:`jackbox_env.batches.base.Batch`."""

    def __init__(self, num_envs: int, max_episode_steps: int, with_infos: bool, **settings: Any) -> None:
        self._envs = [JackInBoxEnv(**settings) for _ in range(num_envs)]
        self._limit, self._with_infos = max_episode_steps, with_infos
        self._steps = np.zeros(num_envs, dtype=np.int64)
        self._names = list(self._envs[0].reset()[1])

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""
        return np.array([env.state for env in self._envs])

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return np.array([env.time for env in self._envs])

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""
        return self._steps >= self._limit

    @property
    def info_names(self) -> list[str]:
        """Names of the infos, those of the single environment."""
        return list(self._names)

    def seed(self, number: int, seed: int) -> None:
        """Seed one environment's random starts."""
        gym.Env.reset(self._envs[number], seed=seed)  # seeds, and no more

    def restart(self, chosen: Flags) -> None:
        """Start an episode in the ``chosen`` environments, each at a drawn start and time 0."""
        for number in np.flatnonzero(chosen):
            self._envs[number].reset()
        self._steps[chosen] = 0

    def place(self, chosen: Flags, states: Array, times: Array, anew: bool) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.place`."""
        for number in np.flatnonzero(chosen):
            self._envs[number].set_state(states[number], float(times[number]))
        self._steps[chosen if anew else chosen & self.over] = 0

    def observe(self, chosen: Flags, observations: Floats) -> None:
        """Write what the ``chosen`` environments' agents see, shape (N, 10)."""
        for number in np.flatnonzero(chosen):
            observations[number] = self._envs[number].observation

    def step(self, actions: Array | None) -> Outcome:
        """See :meth:`jackbox_env.batches.base.Batch.step`."""
        count, going = len(self._envs), np.flatnonzero(~self.over).tolist()
        self._refuse(actions, going)
        observations, rewards = np.zeros((count, 10), dtype=np.float32), np.zeros(count)
        infos = self._blank_infos() if self._with_infos else {}
        moved: list[tuple[JackInBoxEnv, Array, float]] = []
        try:
            for number in going:
                env = self._envs[number]
                moved.append((env, env.state, env.time))
                action = None if actions is None else float(actions[number])
                observations[number], rewards[number], _, _, info = env.step(action)
                for name, values in infos.items():
                    values[number] = info[name]
        except BaseException:
            for env, state, time in moved:  # all or none
                env.set_state(state, time)
            raise
        self._steps[going] += 1
        truncations = self.over
        truncations[np.setdiff1d(np.arange(count), going)] = False
        return Outcome(observations, rewards, truncations, infos, int(truncations.sum()))

    def _refuse(self, actions: Array | None, going: list[int]) -> None:
        for number in going if actions is not None else []:
            if not np.isfinite(actions[number]):  # type: ignore[index]
                raise bad_action(float(actions[number]), number)  # type: ignore[index]

    def _blank_infos(self) -> dict[str, NDArray[Any]]:
        count = len(self._envs)
        infos: dict[str, NDArray[Any]] = {name: np.zeros(count) for name in self._names}
        infos["state"], infos["impacts"] = np.zeros((count, 12)), np.zeros(count, dtype=np.int64)
        return infos

    def render(self) -> tuple[Any, ...]:
        """A frame of each environment."""
        return tuple(env.render() for env in self._envs)

    def close(self) -> None:
        """Release what the renderers hold."""
        for env in self._envs:
            env.close()
