"""A batch made of single environments, stepped one after the other: any contact model, and pictures."""

from __future__ import annotations

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from gymnasium.utils.seeding import np_random
from numpy.typing import NDArray

from jackbox_env.batches.base import Change, Flags, Floats, Outcome, bad_action
from jackbox_env.env import JackInBoxEnv
from jackbox_env.randomization import Randomization
from jackbox_env.scene import Scene
from jackbox_env.states import Array
from jackbox_env.tasks import sample_start


@dataclass(slots=True)
class SingleHeld:
    """See :class:`jackbox_env.batches.base.Held`."""

    rows: Array  # states, (N, 12)
    moments: Array  # times [s], (N,)
    steps: NDArray[np.int64]  # in the episode, (N,)
    limit: int  # of them
    generators: list[np.random.Generator]  # never drawn from, but copied
    scenes: list[Scene]  # of each
    book: Any = None

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""
        return self.rows.copy()

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return self.moments.copy()

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""
        return self.steps >= self.limit

    def copied(self) -> SingleHeld:
        """A draft; it shares the generators and the scenes."""
        return SingleHeld(
            self.rows.copy(), self.moments.copy(), self.steps.copy(), self.limit, self.generators, self.scenes,
            self.book,
        )  # fmt: skip


class SingleBatch:
    """See :class:`jackbox_env.batches.base.Batch`.

    The environments move while a draft is made. Where it is not kept they are put back before they are used again.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        num_envs: int,
        max_episode_steps: int,
        with_infos: bool,
        randomize: Randomization | None = None,
        **settings: Any,
    ) -> None:
        """Make environments of one scene, or with a scene each, and other settings of the single one."""
        self._own = list(scenes) if len(scenes) > 1 else list(scenes) * num_envs
        self._envs = [JackInBoxEnv(scene=scene, **settings) for scene in self._own]
        self._with_infos, self._randomize = with_infos, randomize
        self._names = list(self._envs[0].reset()[1])
        states = np.array([env.state for env in self._envs])
        steps, generators = np.zeros(num_envs, dtype=np.int64), [np_random()[0] for _ in range(num_envs)]
        self.held = SingleHeld(states, np.zeros(num_envs), steps, max_episode_steps, generators, list(self._own))
        self._at: SingleHeld | None = self.held  # where the environments are, or on their way to

    @property
    def info_names(self) -> list[str]:
        """Names of the infos, those of the single environment."""
        return list(self._names)

    def scene(self, number: int, held: SingleHeld | None = None) -> Scene:
        """See :meth:`jackbox_env.batches.base.Batch.scene`."""
        return (held or self.held).scenes[number]

    def draft(self) -> SingleHeld:
        """See :meth:`jackbox_env.batches.base.Batch.draft`."""
        self._move_to(self.held)
        draft = self.held.copied()
        draft.generators = list(draft.generators)
        self._at = draft
        return draft

    def _move_to(self, held: SingleHeld) -> None:
        """Put the environments where they are held, unless they are there."""
        if self._at is held:
            return
        self._at = None
        for env, scene, state, time in zip(self._envs, held.scenes, held.rows, held.moments.tolist(), strict=True):
            if env.time != time or env.scene is not scene or env.state.tobytes() != state.tobytes():
                env._put(scene, state, time)
        self._at = held

    def seed(self, draft: SingleHeld, number: int, seed: int) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.seed`."""
        draft.generators[number] = np_random(seed)[0]

    def redraw(self, draft: SingleHeld, chosen: Flags, changes: Sequence[Change] | None = None) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.redraw`."""
        if self._randomize is None and changes is None:
            return
        numbers = np.flatnonzero(chosen).tolist()
        draft.generators, draft.scenes = list(draft.generators), list(draft.scenes)
        for number, change in zip(numbers, changes or [{}] * len(numbers), strict=True):
            own, drawn = self._own[number], dict[str, Any]()
            if self._randomize is not None:
                draft.generators[number] = copy.deepcopy(draft.generators[number])
                drawn = self._randomize.draw(own, draft.generators[number])
            draft.scenes[number] = own.changed(**{**drawn, **change})  # to be put where a start is known

    def _put(self, draft: SingleHeld, numbers: list[int]) -> None:
        """Put some environments where a draft has them."""
        for number in numbers:
            self._envs[number]._put(draft.scenes[number], draft.rows[number], float(draft.moments[number]))

    def restart(self, draft: SingleHeld, chosen: Flags) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.restart`."""
        draft.generators = list(draft.generators)
        for number in np.flatnonzero(chosen).tolist():
            generator = copy.deepcopy(draft.generators[number])
            draft.generators[number] = generator
            draft.rows[number] = sample_start(draft.scenes[number], generator)
            draft.moments[number], draft.steps[number] = 0.0, 0
        self._put(draft, np.flatnonzero(chosen).tolist())
        for env in self._envs if self._envs[0].render_mode == "human" else ():
            env.render()

    def place(self, draft: SingleHeld, chosen: Flags, states: Array, times: Array, anew: bool) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.place`."""
        draft.rows[chosen], draft.moments[chosen] = states[chosen], times[chosen]
        self._put(draft, np.flatnonzero(chosen).tolist())
        draft.steps[chosen if anew else chosen & draft.over] = 0

    def observe(self, held: SingleHeld, chosen: Flags, observations: Floats) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.observe`."""
        self._move_to(held)
        for number in np.flatnonzero(chosen):
            observations[number] = self._envs[number].observation

    def keep(self, draft: SingleHeld) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.keep`."""
        self.held = draft

    def step(self, actions: Array | None) -> Outcome:
        """See :meth:`jackbox_env.batches.base.Batch.step`."""
        count, going = len(self._envs), np.flatnonzero(~self.held.over).tolist()
        self._refuse(actions, going)
        observations, rewards = np.zeros((count, 10), dtype=np.float32), np.zeros(count)
        infos = self._blank_infos() if self._with_infos else {}
        self._move_to(self.held)
        self._at = draft = self.held.copied()
        for number in going:
            action = None if actions is None else float(actions[number])
            observations[number], rewards[number], _, _, info = self._envs[number].step(action)
            draft.rows[number], draft.moments[number] = info["state"], info["time"]
            for name, values in infos.items():
                values[number] = info[name]
        draft.steps[going] += 1
        truncations = draft.over & ~self.held.over
        return Outcome(observations, rewards, truncations, infos, int(truncations.sum()), draft)

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
        self._move_to(self.held)
        return tuple(env.render() for env in self._envs)

    def close(self) -> None:
        """Release what the renderers hold."""
        for env in self._envs:
            env.close()
