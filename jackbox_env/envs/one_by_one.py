"""A batch of single environments, stepped one after the other: for any contact model, and for rendering."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from jackbox_env.envs.batch import Change, Limits, Outcome, Starts, bad_action
from jackbox_env.envs.infos import blank
from jackbox_env.envs.single import JackInBoxEnv, go_back, moment, put
from jackbox_env.model.randomization import Randomization
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, Flags, Floats, Indices
from jackbox_env.model.tasks import TaskError, draw_start
from jackbox_env.simulators import Impact


class Present(NamedTuple):
    """The environments of a batch: replaced by one assignment, so that an interruption cannot leave a part of it."""

    states: Array  # (N, 12)
    times: Array  # (N,) [s]
    counts: NDArray[np.int64]  # control steps and decisions of the episodes, (2, N)
    over: Flags  # (N,)
    generators: list[np.random.Generator]
    scenes: list[Scene]


class SingleBatch:
    """N environments with one scene for all or one for each. Steps do not change a finished episode.

    :meth:`draw`, :meth:`step` and :meth:`start` may raise, and change nothing: they return what :meth:`take` then makes
    the present. :class:`jackbox_env.envs.compiled_batch.ExactBatch` has the same methods.

    A step and a start move the environments. If they are not taken, these go back to the moment before at their next
    use.
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
        self._present = Present(
            np.array([env.state for env in self._envs]), np.zeros(num_envs), np.zeros((2, num_envs), dtype=np.int64),
            np.zeros(num_envs, dtype=np.bool_), [np_random()[0] for _ in range(num_envs)], list(self._originals),
        )  # fmt: skip
        # The present from which environments have moved, and the moments to which they go back if it stays.
        self._moved: tuple[Present, list[tuple[Any, ...]]] | None = None

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""
        return self._present.states.copy()

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return self._present.times.copy()

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""
        return self._present.over.copy()

    def scene(self, number: int, starts: Starts | None = None) -> Scene:
        """The scene that an environment has now, or once ``starts`` have begun."""
        if starts is None or starts.scenes is None or number not in starts.numbers:
            return self._present.scenes[number]
        scene: Scene = starts.scenes[int(np.searchsorted(starts.numbers, number))]
        return scene

    def field(self, name: str) -> Array:
        """A number of each environment's scene as it is now, by the name of its field, a fresh array, shape (N,)."""
        return np.array([getattr(scene, name) for scene in self._present.scenes], dtype=np.float64)

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
            generators.append(copy.deepcopy(self._present.generators[number]) if seed is None else np_random(seed)[0])
            if self._randomize or changes is not None:
                drawn = self._randomize.draw(self._originals[number], generators[-1]) if self._randomize else {}
                scenes.append(self._originals[number].changed(**{**drawn, **(changes[index] if changes else {})}))
                self._envs[number].simulator_of(scenes[-1])  # raises now if its contact model cannot simulate it
            if not placed:
                scene = scenes[-1] if scenes else self._present.scenes[number]
                states.append(draw_start(self._nouns.task, scene, generators[-1]))
        return Starts(numbers, generators, scenes or None, None if placed else np.array(states))

    def start(self, starts: Starts, observations: Floats, after: Present | None = None) -> Present:
        """What :meth:`take` makes the present if episodes begin now, or ``after`` a step.

        Their observations are written into their rows, shape (N, numbers).

        Raises:
            TypeError: the function of a user's observation returns a wrong type.
            TaskError: a number of an observation is NaN.
        """
        after, numbers = self._changing() if after is None else after, starts.numbers
        for index, number in enumerate(numbers.tolist()):
            after.generators[number] = starts.generators[index]
            if starts.scenes is not None:
                after.scenes[number] = starts.scenes[index]
        after.states[numbers], after.times[numbers] = starts.states, 0.0 if starts.times is None else starts.times
        after.counts[:, numbers], after.over[numbers] = 0, False
        self._put(numbers, after)
        self._observe(numbers, observations)
        for env in self._envs if self._envs[0].render_mode == "human" else ():
            env.render()
        return after

    def set_states(self, chosen: Flags, states: Array, times: Array) -> None:
        """Set states, shape (N, 12), and times [s] of the ``chosen`` environments, checked beforehand.

        Their episodes continue. A finished episode starts anew.
        """
        after = self._changing()
        after.states[chosen], after.times[chosen] = states[chosen], times[chosen]
        anew = chosen & after.over
        after.counts[:, anew], after.over[anew] = 0, False
        self._put(np.flatnonzero(chosen), after)
        self.take(after)

    def _put(self, numbers: Indices, after: Present) -> None:
        """Set some environments to scenes, states and times."""
        for number in numbers.tolist():
            time, steps = float(after.times[number]), int(after.counts[0, number])
            put(self._envs[number], after.scenes[number], after.states[number], time, steps)

    def _changing(self) -> Present:
        """A copy of the present to be changed, whose environments may move."""
        self._gather()
        self._moved = self._present, [moment(env) for env in self._envs]
        return Present._make(map(copy.copy, self._present))

    def _gather(self) -> None:
        """Undo a step or a start that was not taken."""
        if self._moved is not None:
            present, moments = self._moved
            for env, before in zip(self._envs, moments, strict=True) if present is self._present else ():
                go_back(env, before)
            self._moved = None

    def observe(self, numbers: Indices, observations: Floats) -> None:
        """Write the observations of some environments into their rows, shape (N, numbers).

        Raises:
            TaskError: a number of an observation is NaN.
        """
        self._gather()
        self._observe(numbers, observations)

    def _observe(self, numbers: Indices, observations: Floats) -> None:
        for number in numbers.tolist():
            with within(number):
                observations[number] = self._envs[number].observation

    # -- stepping -----------------------------------------------------------------------------------------------------

    def step(self, actions: Array | None) -> Outcome:
        """Step all under ``actions``, shape (n, N), or under the scene's drive; nothing changes before :meth:`take`.

        Raises:
            ValueError, JackLostError, TaskError: as the single environment does.
        """
        count, going = len(self._envs), np.flatnonzero(~self._present.over).tolist()
        observations, rewards = self._nouns.unfilled(count), np.zeros(count)
        infos = blank(self._nouns.task.terms if self._with_infos else None, count)
        chosen = [None] * count if actions is None else self._as_singles(actions, going)
        after = self._changing()
        counts = after.counts
        terminations, truncations = np.zeros((2, count), dtype=np.bool_)
        for number in going:
            env = self._envs[number]
            with within(number):
                observations[number], rewards[number], terminations[number], _, info = env.step(chosen[number])
            after.states[number], after.times[number] = info["state"], info["time"]
            for name, values in infos.items():
                values[number] = info[name]
            counts[:, number] = env.elapsed_steps, counts[1, number] + 1
            steps, decisions = self._limits
            truncations[number] = counts[0, number] >= steps or counts[1, number] >= decisions
        ended = terminations | truncations
        after.over[ended] = True
        return Outcome(observations, rewards, terminations, truncations, infos, int(ended.sum()), after)

    def _as_singles(self, actions: Array, going: list[int]) -> list[Any]:
        """The action of each environment, as it is passed to the single one."""
        for number in going:
            if not np.isfinite(actions[:, number]).all():
                raise bad_action(float(actions[0, number]), number)
        if self._nouns.action.size:
            return list(np.ascontiguousarray(actions.T))
        return [int(choice) for choice in actions[0].tolist()]

    def take(self, after: Present) -> None:
        """Replace the present environments by those of a step or of :meth:`start`."""
        self._present = after
        self._moved = None

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
