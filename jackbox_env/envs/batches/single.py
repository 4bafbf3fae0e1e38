"""A batch of single environments, stepped one after the other: for any contact model, and for rendering."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from jackbox_env.envs.batches.base import Change, Limits, Outcome, Starts, bad_action
from jackbox_env.envs.batches.infos import blank
from jackbox_env.envs.scoring import make_functions
from jackbox_env.envs.single import JackInBoxEnv, go_back, moment, put
from jackbox_env.model.observation import OBSERVATIONS
from jackbox_env.model.randomization import Randomization
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, Flags, Floats, Indices
from jackbox_env.model.tasks import TaskError, draw_start
from jackbox_env.simulators import Impact


class SingleBatch:
    """N environments with one scene for all or one for each. Steps do not change a finished episode.

    :meth:`step` and :meth:`draw` may raise and change nothing. :meth:`take`, :meth:`start` and :meth:`set_states` then
    commit the results; they cannot fail. :class:`jackbox_env.envs.batches.exact.ExactBatch` has the same methods.

    A step moves the environments. If it is not taken, they go back to the moment before it at their next use.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        num_envs: int,
        limits: Limits,
        with_infos: bool,
        randomize: Randomization | None = None,
        **settings: Any,
    ) -> None:
        """Make environments of one scene, or with a scene each, and other settings of the single one."""
        self._originals = list(scenes) if len(scenes) > 1 else list(scenes) * num_envs
        self._envs = [JackInBoxEnv(scene=scene, **settings) for scene in self._originals]
        self._with_infos, self._randomize, self._limits = with_infos, randomize, limits
        self._nouns = self._envs[0].nouns
        self._states = np.array([env.state for env in self._envs])
        self._times = np.zeros(num_envs)
        self._counts = np.zeros((2, num_envs), dtype=np.int64)  # control steps and decisions of the episodes
        self._over = np.zeros(num_envs, dtype=np.bool_)
        self._generators, self._scenes = [np_random()[0] for _ in range(num_envs)], list(self._originals)
        self._before: list[tuple[Any, ...]] | None = None  # the moment before a step that is not taken

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""
        return self._states.copy()

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return self._times.copy()

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""
        return self._over.copy()

    def scene(self, number: int, starts: Starts | None = None) -> Scene:
        """The scene that an environment has now, or once ``starts`` have begun."""
        if starts is None or starts.scenes is None or number not in starts.numbers:
            return self._scenes[number]
        scene: Scene = starts.scenes[int(np.searchsorted(starts.numbers, number))]
        return scene

    def field(self, name: str) -> Array:
        """A number of each environment's scene as it is now, by the name of its field, a fresh array, shape (N,)."""
        return np.array([getattr(scene, name) for scene in self._scenes], dtype=np.float64)

    def impacts(self, number: int) -> list[Impact]:
        """The impacts of an environment's last step, in time order; none if its state was set since."""
        self._gather()
        return self._envs[number].impacts

    # -- episodes -----------------------------------------------------------------------------------------------------

    def draw(
        self,
        numbers: Indices,
        seeds: Sequence[int | None] | None = None,
        changes: Sequence[Change] | None = None,
        placed: bool = False,
    ) -> Starts:
        """Seed generators, and draw scenes and starts for episodes to come.

        Args:
            numbers: of the environments, shape (k,).
            seeds: of each one's generator; None: the generator continues.
            changes: for each of them, fields of its original scene that an option changes. None: no change, unless
                scenes are drawn at each reset.
            placed: whether the caller sets the first states, so that no start is drawn.

        Raises:
            TypeError, ValueError: an invalid scene, or an invalid start from the task.
        """
        generators, scenes, states = list[np.random.Generator](), list[Scene](), list[Array]()
        for index, number in enumerate(numbers.tolist()):
            seed = seeds[index] if seeds else None
            generators.append(copy.deepcopy(self._generators[number]) if seed is None else np_random(seed)[0])
            if self._randomize or changes is not None:
                drawn = self._randomize.draw(self._originals[number], generators[-1]) if self._randomize else {}
                scenes.append(self._originals[number].changed(**{**drawn, **(changes[index] if changes else {})}))
                self._envs[number].simulator_of(scenes[-1])  # raises now if its contact model cannot simulate it
            if not placed:
                states.append(
                    draw_start(self._nouns.task, scenes[-1] if scenes else self._scenes[number], generators[-1])
                )
        return Starts(numbers, generators, scenes or None, None if placed else np.array(states))

    def observed(self, starts: Starts, times: Array) -> Starts:
        """The same starts, at times [s], shape (N,), if the functions of a user's observation work there.

        Raises:
            TypeError: they return a wrong type.
            TaskError: a number of an observation is NaN.
        """
        if self._nouns.observation not in OBSERVATIONS.values() and starts.states is not None:
            for number, state in zip(starts.numbers.tolist(), starts.states, strict=True):
                with within(number):
                    functions = make_functions(self.scene(number, starts), self._nouns, self._envs[0].contact)
                    functions.observe(state, float(times[number]))
        return starts

    def start(self, starts: Starts) -> None:
        """Begin episodes at time 0. If all begin, this also repairs what an interruption left half changed."""
        self._gather()
        numbers = starts.numbers
        for index, number in enumerate(numbers.tolist()):
            self._generators[number] = starts.generators[index]
            if starts.scenes is not None:
                self._scenes[number] = starts.scenes[index]
        self._states[numbers], self._times[numbers] = starts.states, 0.0
        self._counts[:, numbers], self._over[numbers] = 0, False
        self._put(numbers)
        for env in self._envs if self._envs[0].render_mode == "human" else ():
            env.render()

    def set_states(self, chosen: Flags, states: Array, times: Array) -> None:
        """Set states, shape (N, 12), and times [s] of the ``chosen`` environments, checked beforehand.

        Their episodes continue. A finished episode starts anew.
        """
        self._gather()
        self._states[chosen], self._times[chosen] = states[chosen], times[chosen]
        anew = chosen & self._over
        self._counts[:, anew], self._over[anew] = 0, False
        self._put(np.flatnonzero(chosen))

    def _put(self, numbers: Indices) -> None:
        """Set some environments to the batch's scenes, states and times."""
        for number in numbers.tolist():
            time, steps = float(self._times[number]), int(self._counts[0, number])
            put(self._envs[number], self._scenes[number], self._states[number], time, steps)

    def _gather(self) -> None:
        """Undo a step that was not taken."""
        if self._before is not None:
            for env, before in zip(self._envs, self._before, strict=True):
                go_back(env, before)
            self._before = None

    def observe(self, numbers: Indices, observations: Floats) -> None:
        """Write the observations of some environments into their rows, shape (N, numbers).

        Raises:
            TaskError: a number of an observation is NaN.
        """
        self._gather()
        for number in numbers.tolist():
            with within(number):
                observations[number] = self._envs[number].observation

    # -- stepping -----------------------------------------------------------------------------------------------------

    def step(self, actions: Array | None) -> Outcome:
        """Step all under ``actions``, shape (n, N), or under the scene's drive; nothing changes before :meth:`take`.

        Raises:
            ValueError, JackLostError, TaskError: as the single environment does.
        """
        count, going = len(self._envs), np.flatnonzero(~self.over).tolist()
        shape = (count, len(self._nouns.observation.names))
        observations, rewards = np.zeros(shape, dtype=np.float32), np.zeros(count)
        infos = blank(self._nouns.task.terms if self._with_infos else None, count)
        chosen = [None] * count if actions is None else self._as_singles(actions, going)
        self._gather()
        self._before = [moment(env) for env in self._envs]
        states, times, counts = self.states, self.times, self._counts.copy()
        terminations, truncations = np.zeros((2, count), dtype=np.bool_)
        for number in going:
            env = self._envs[number]
            with within(number):
                observations[number], rewards[number], terminations[number], _, info = env.step(chosen[number])
            states[number], times[number] = info["state"], info["time"]
            for name, values in infos.items():
                values[number] = info[name]
            counts[:, number] = env.elapsed_steps, counts[1, number] + 1
            steps, decisions = self._limits
            truncations[number] = counts[0, number] >= steps or counts[1, number] >= decisions
        ended = terminations | truncations
        after = states, times, counts, self._over | ended
        return Outcome(observations, rewards, terminations, truncations, infos, int(ended.sum()), after)

    def _as_singles(self, actions: Array, going: list[int]) -> list[Any]:
        """The action of each environment, as it is passed to the single one."""
        for number in going:
            if not np.isfinite(actions[:, number]).all():
                raise bad_action(float(actions[0, number]), number)
        if self._nouns.action.size:
            return list(np.ascontiguousarray(actions.T))
        return [int(choice) for choice in actions[0].tolist()]

    def take(self, after: tuple[Array, Array, NDArray[np.int64], Flags]) -> None:
        """Replace the present environments by those of an outcome."""
        self._states, self._times, self._counts, self._over = after
        self._before = None

    def render(self) -> tuple[Any, ...]:
        """A frame of each environment."""
        self._gather()
        return tuple(env.render() for env in self._envs)

    def close(self) -> None:
        """Release the renderers' resources."""
        for env in self._envs:
            env.close()


@contextmanager
def within(number: int) -> Iterator[None]:
    """Name an environment in the errors of a user's functions."""
    try:
        yield
    except TaskError as error:
        raise TaskError(f"{error}, in environment {number}") from error
