"""A batch of single environments, stepped one after the other: for any contact model, and for rendering."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple

import numpy as np
from gymnasium.utils.seeding import np_random

from jackbox_env.envs.batch import Change, EpisodeLimits, Outcome, Starts, bad_action
from jackbox_env.envs.infos import blank
from jackbox_env.envs.single import JackInBoxEnv, Snapshot
from jackbox_env.model.randomization import Randomization, next_scene
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, Counts, Flags, Floats, Indices
from jackbox_env.model.tasks import TaskError, draw_start
from jackbox_env.simulators import Impact


class PresentEnvs(NamedTuple):
    """The environments of a batch. What is in use is never written."""

    envs: list[Snapshot]
    decisions: Counts  # of the episodes, (N,)
    ended: Flags  # whether its episode has, (N,)
    generators: list[np.random.Generator]


class SingleBatch:
    """N environments with one scene for all or one for each. Steps do not change a finished episode.

    ``batch.py`` states how it changes. *Prepare* moves the environments themselves; *finish* returns them to their
    snapshots in :class:`PresentEnvs`, unless they are there.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        num_envs: int,
        limits: EpisodeLimits,
        with_infos: bool,
        randomize: Randomization | None = None,
        **settings: Any,
    ) -> None:
        """Make environments of one scene, or with a scene each, and other settings of the single one."""
        self._originals = list(scenes) if len(scenes) > 1 else list(scenes) * num_envs
        self._envs = [JackInBoxEnv(scene=scene, **settings) for scene in self._originals]
        self._with_infos, self._randomize, self._limits = with_infos, randomize, limits
        self._interface = self._envs[0].interface
        self._present = PresentEnvs(
            [env._snapshot() for env in self._envs], np.zeros(num_envs, dtype=np.int64),
            np.zeros(num_envs, dtype=np.bool_), [np_random()[0] for _ in range(num_envs)],
        )  # fmt: skip
        self._moved_to: PresentEnvs | None = self._present  # where the environments are; None: they move

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""
        return np.array([env.present.state for env in self._present.envs])

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return np.array([env.present.time for env in self._present.envs])

    @property
    def ended(self) -> Flags:
        """True for each episode that is over, shape (N,)."""
        return self._present.ended.copy()

    def scene(self, number: int, starts: Starts | None = None) -> Scene:
        """The scene that an environment has now, or once ``starts`` have begun."""
        if starts is None or starts.scenes is None or number not in starts.numbers:
            return self._present.envs[number].model.simulator.scene
        scene: Scene = starts.scenes[int(np.searchsorted(starts.numbers, number))]
        return scene

    def field(self, name: str) -> Array:
        """A number of each environment's scene as it is now, by the name of its field, a fresh array, shape (N,)."""
        return np.array([getattr(env.model.simulator.scene, name) for env in self._present.envs], dtype=np.float64)

    def impacts(self, number: int) -> list[Impact]:
        """The impacts of an environment's last step, in time order; none if its state was set since."""
        self._finish()
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
                change = changes[index] if changes else {}
                scenes.append(next_scene(self._originals[number], self._randomize, generators[-1], change))
                self._envs[number].simulator_of(scenes[-1])  # raises now if its contact model cannot simulate it
            if not placed:
                scene = scenes[-1] if scenes else self.scene(number)
                states.append(draw_start(self._interface.task, scene, generators[-1]))
        return Starts(numbers, generators, scenes or None, None if placed else np.array(states))

    def prepare_starts(self, starts: Starts, observations: Floats, after: PresentEnvs | None = None) -> PresentEnvs:
        """The environments once episodes begin: now, or ``after`` a step.

        Their observations are written into their rows, shape (N, numbers).

        Raises:
            TypeError: the function of a user's observation returns a wrong type.
            TaskError: a number of an observation is NaN.
        """
        after, numbers = self._prepare() if after is None else after, starts.numbers
        for index, number in enumerate(numbers.tolist()):
            scene = self.scene(number) if starts.scenes is None else starts.scenes[index]
            time = 0.0 if starts.times is None else float(starts.times[index])
            self._place(number, scene, starts.states[index], time, after)
            after.generators[number] = starts.generators[index]
        after.decisions[numbers], after.ended[numbers] = 0, False
        self._observe(numbers, observations)
        for env in self._envs if self._envs[0].render_mode == "human" else ():
            env.render()
        return after

    def set_states(self, chosen: Flags, states: Array, times: Array) -> None:
        """Set states, shape (N, 12), and times [s] of the ``chosen`` environments, checked beforehand.

        Their episodes continue. A finished episode starts anew.
        """
        after, anew = self._prepare(), chosen & self._present.ended
        for number in np.flatnonzero(chosen).tolist():
            steps = 0 if anew[number] else self._envs[number].elapsed_steps
            self._place(number, self.scene(number), states[number], float(times[number]), after, steps)
        after.decisions[anew], after.ended[anew] = 0, False
        self.commit(after)

    def _place(self, number: int, scene: Scene, state: Array, time: float, after: PresentEnvs, steps: int = 0) -> None:
        """Set an environment's scene, state, time [s] and control steps of its episode, now and in ``after``."""
        env = self._envs[number]
        env._place(env._model_of(scene), state, time, steps)
        after.envs[number] = env._snapshot()

    def _prepare(self) -> PresentEnvs:
        """A copy of the present to be changed, whose environments may move."""
        self._finish()
        self._moved_to = None
        return PresentEnvs._make(map(copy.copy, self._present))

    def commit(self, after: PresentEnvs) -> None:
        """Replace the present environments by those of a step or of starts."""
        self._present = after
        self._moved_to = after

    def _finish(self) -> None:
        """Return environments that have moved to the present."""
        if self._moved_to is not self._present:
            for env, snapshot in zip(self._envs, self._present.envs, strict=True):
                env._restore(snapshot)
            self._moved_to = self._present

    def observe(self, numbers: Indices, observations: Floats) -> None:
        """Write the observations of some environments into their rows, shape (N, numbers).

        Raises:
            TaskError: a number of an observation is NaN.
        """
        self._finish()
        self._observe(numbers, observations)

    def _observe(self, numbers: Indices, observations: Floats) -> None:
        for number in numbers.tolist():
            with within(number):
                observations[number] = self._envs[number].observation

    # -- stepping -----------------------------------------------------------------------------------------------------

    def prepare_step(self, actions: Array | None) -> Outcome:
        """Step all under ``actions``, shape (n, N), or under the scene's drive.

        Raises:
            ValueError, JackLostError, TaskError: as the single environment does.
        """
        count, going = len(self._envs), np.flatnonzero(~self._present.ended).tolist()
        observations, rewards = self._interface.new_observations(count), np.zeros(count)
        infos = blank(self._interface.task.terms if self._with_infos else None, count)
        chosen = [None] * count if actions is None else self._as_singles(actions, going)
        terminations, truncations = np.zeros((2, count), dtype=np.bool_)
        after, (steps, decisions) = self._prepare(), self._limits
        for number in going:
            env = self._envs[number]
            with within(number):
                observations[number], rewards[number], terminations[number], _, info = env.step(chosen[number])
            for name, values in infos.items():
                values[number] = info[name]
            after.envs[number] = env._snapshot()
            after.decisions[number] += 1
            truncations[number] = env.elapsed_steps >= steps or after.decisions[number] >= decisions
        ended = terminations | truncations
        after.ended[ended] = True
        return Outcome(observations, rewards, terminations, truncations, infos, int(ended.sum()), after)

    def _as_singles(self, actions: Array, going: list[int]) -> list[Any]:
        """The action of each environment, as it is passed to the single one."""
        for number in going:
            if not np.isfinite(actions[:, number]).all():
                raise bad_action(float(actions[0, number]), number)
        if self._interface.action.size:
            return list(np.ascontiguousarray(actions.T))
        return [int(choice) for choice in actions[0].tolist()]

    def render(self) -> tuple[Any, ...]:
        """A frame of each environment."""
        self._finish()
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
