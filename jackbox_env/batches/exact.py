"""A batch of environments of the exact contact model: one compiled call per step, shared out over threads."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env.batches.base import Change, Flags, Floats, Outcome, bad_action
from jackbox_env.batches.scenes import SceneTable
from jackbox_env.batches.threads import Halt, Threads, thread_count
from jackbox_env.compiled import glide, loop, restart, score
from jackbox_env.compiled.address import address_of
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.drives import TABLE_WIDTH
from jackbox_env.compiled.generator import WHOLE, WITH_HALVES, Words, fresh, packed, seeded, unpacked
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.workspace import new_workspace
from jackbox_env.randomization import Randomization
from jackbox_env.scene import Scene
from jackbox_env.scoring import compiled_for
from jackbox_env.simulators.base import end_of_step
from jackbox_env.simulators.exact import failure, pieces_for
from jackbox_env.states import Array
from jackbox_env.tasks import Task

_FEWEST_PER_THREAD = 4096  # below that, waking a thread costs more than it saves
_GRAIN = 4  # blocks that are worth a call
_NO_ACTIONS: Array = np.zeros(0)
_NO_TABLE: Array = np.zeros((0, TABLE_WIDTH))
_NO_RANGES = np.zeros((0, 2), dtype=np.int64)
_NOBODY = np.zeros(0, dtype=np.int64)
_NO_WORDS: Words = np.zeros((0, WHOLE), dtype=np.uint64)
_NO_ROWS: Array = np.zeros((0, 0))


@dataclass(slots=True)
class ExactHeld:
    """See :class:`jackbox_env.batches.base.Held`.

    A step's draft shares generators and scenes. It only notes the new ones of those environments that start anew.
    """

    count: int
    blocks: Array  # (blocks, 16, width)
    generators: Words  # (N, 4), or (N, 6) where a function draws from them, without what is noted
    scenes: SceneTable  # without what is noted
    drawn: NDArray[np.int64] = field(default_factory=lambda: _NOBODY)  # (k,) environments that have started anew
    words: Words = field(default_factory=lambda: _NO_WORDS)  # (k, 4 or 6) their generators since then
    rows: Array = field(default_factory=lambda: _NO_ROWS)  # (k, numbers of a scene) drawn for them, or (0, 0)
    book: Any = None

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""
        return self.blocks[:, :12].transpose(0, 2, 1).copy().reshape(-1, 12)[: self.count]

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return self.column(glide.TIME)

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""
        return np.not_equal(self.column(glide.OVER), 0.0)

    def column(self, place: int) -> Array:
        """A copy of one number of all environments, shape (N,)."""
        return self.blocks[:, place].reshape(-1)[: self.count].copy()

    def settle(self) -> None:
        """Write what is noted into generators and scenes. Interrupted anywhere, it is done again from the start."""
        if len(self.drawn):
            self.generators[self.drawn] = self.words
            if len(self.rows):
                self.scenes.put(self.drawn, self.rows)
            self.rows = _NO_ROWS
            self.drawn = _NOBODY
            self.words = _NO_WORDS

    def note(self, drawn: NDArray[np.int64], words: Words, rows: Array) -> None:
        """Note the generators of environments that start anew, and their scenes if they are drawn."""
        self.drawn, self.words, self.rows = drawn, words, rows

    def rows_of(self, numbers: NDArray[np.int64]) -> Array:
        """The numbers of some environments' scenes, what is noted included, or the only row."""
        rows = self.scenes.rows(numbers)
        if len(self.rows) and self.scenes.several:
            noted = np.isin(numbers, self.drawn)
            rows[noted] = self.rows[np.searchsorted(self.drawn, numbers[noted])]
        return self.rows if len(self.rows) and not self.scenes.several else rows


class ExactBatch:
    """See :class:`jackbox_env.batches.base.Batch`; 288 bytes per environment besides what is handed out.

    Scenes of their own take 152 bytes more for each environment.

    Memory that threads write to is taken out of the batch for a step and comes back when they have ended: memory
    that an interruption may have left to a thread is never used again.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        num_envs: int,
        task: Task,
        control_dt: float,
        max_episode_steps: int,
        with_infos: bool = False,
        num_threads: int | None = None,
        randomize: Randomization | None = None,
    ) -> None:
        """Make environments of one scene, or with a scene each.

        Raises:
            TypeError: the task's function cannot be compiled.
        """
        self._dt, self._terms = control_dt, [f"reward_{name}" for name in task.terms]
        self._limit, self._with_infos, self._randomize = float(max_episode_steps), with_infos, randomize
        self._score = compiled_for(task, score.score_block)  # kept, because the loop calls it by its address
        self._score_address = address_of(self._score)
        width = min(glide.WIDEST, -(-num_envs // (num_threads or 1)))
        blocks = np.zeros((-(-num_envs // width), glide.WIDTH, width))
        table = SceneTable(scenes, len(scenes) > 1 or randomize is not None, blocks.shape, num_envs, control_dt)
        by_function = randomize is not None and randomize.function is not None
        self.held = ExactHeld(num_envs, blocks, fresh(num_envs, WITH_HALVES if by_function else WHOLE), table)
        self._derived = np.array([randomize.derived(scene) for scene in scenes] if randomize else [], dtype=np.bool_)
        ranges = len(blocks) if num_threads else num_envs // _FEWEST_PER_THREAD
        self._threads = Threads(thread_count(num_threads, ranges))
        self._spare: Array | None = np.zeros_like(blocks)  # where the next step writes
        self._workspaces: list[tuple[Array, Array]] | None = self._new_workspaces()

    def _new_workspaces(self) -> list[tuple[Array, Array]]:
        width = self.held.blocks.shape[2]
        return [(np.zeros((score.LANES, width)), new_workspace()) for _ in range(self._threads.count)]

    def _taken_spare(self) -> Array:
        spare, self._spare = self._spare, None
        return np.zeros_like(self.held.blocks) if spare is None else spare

    def _taken_workspaces(self) -> list[tuple[Array, Array]]:
        workspaces, self._workspaces = self._workspaces, None
        return self._new_workspaces() if workspaces is None else workspaces

    @property
    def nbytes(self) -> int:
        """Bytes of the arrays that grow with the environments."""
        held, spare = self.held, self._spare
        return held.blocks.nbytes + held.generators.nbytes + (0 if spare is None else spare.nbytes)

    @property
    def info_names(self) -> list[str]:
        """Names of the infos, those of the single environment."""
        return ["state", "time", "torque", "impacts", "impulse", *self._terms]

    # -- episodes -----------------------------------------------------------------------------------------------------

    def scene(self, number: int, held: ExactHeld | None = None) -> Scene:
        """See :meth:`jackbox_env.batches.base.Batch.scene`."""
        held = held or self.held
        held.settle()
        return held.scenes.scene(number)

    def draft(self) -> ExactHeld:
        """See :meth:`jackbox_env.batches.base.Batch.draft`."""
        held = self.held
        held.settle()
        blocks = self._taken_spare()
        blocks[:] = held.blocks
        return ExactHeld(held.count, blocks, held.generators.copy(), held.scenes.copy(), book=held.book)

    def seed(self, draft: ExactHeld, number: int, seed: int) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.seed`."""
        draft.generators[number] = seeded(seed)[: draft.generators.shape[1]]

    def _noted(self, draft: ExactHeld, numbers: NDArray[np.int64]) -> tuple[Words, Array]:
        """The generators of environments that start anew, and their scenes if they were just drawn."""
        if draft.drawn is not self.held.drawn and np.array_equal(draft.drawn, numbers):
            return draft.words, draft.rows
        (self.held if draft.generators is self.held.generators else draft).settle()
        return draft.generators[numbers], _NO_ROWS

    def redraw(self, draft: ExactHeld, chosen: Flags, changes: Sequence[Change] | None = None) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.redraw`."""
        numbers, scenes = np.flatnonzero(chosen), draft.scenes
        if changes is not None:
            self._change(draft, numbers, changes)
        elif self._randomize is None:
            return
        elif self._randomize.function is not None or scenes.driven_otherwise[numbers if scenes.several else 0].any():
            self._change(draft, numbers, [{}] * len(numbers))
        else:
            words, _ = self._noted(draft, numbers)
            rows, derived = scenes.own_rows(numbers), self._derived
            follows = derived[numbers] if len(derived) > 1 else np.repeat(derived, len(numbers), axis=0)
            compiled(restart.draw_scenes)(rows, self._randomize.table, follows, words)
            draft.note(numbers, words, rows)

    def _change(self, draft: ExactHeld, numbers: NDArray[np.int64], changes: Sequence[Change]) -> None:
        """Give environments their own scenes with what is drawn and some fields changed."""
        if draft.scenes is self.held.scenes:
            self.held.settle()
            draft.scenes, draft.generators = draft.scenes.copy(), draft.generators.copy()
        words, scenes = draft.generators[numbers], []
        for place, (number, change) in enumerate(zip(numbers.tolist(), changes, strict=True)):
            own, drawn = draft.scenes.own_of(number), {}
            if self._randomize is not None:
                generator = unpacked(words[place])
                drawn = self._randomize.draw(own, generator)
                words[place] = packed(generator)[: words.shape[1]]
            scenes.append(own.changed(**{**drawn, **change}))
        if len(numbers) < draft.count or any(scene != scenes[0] for scene in scenes):
            draft.scenes = draft.scenes.spread_out(draft.blocks.shape)
        rows = np.array([scene.numbers for scene in scenes])
        draft.scenes.put(numbers, rows if draft.scenes.several else rows[:1])
        draft.scenes.put_drives(numbers, [scene.drive for scene in scenes])
        draft.generators[numbers] = words
        draft.note(_NOBODY, _NO_WORDS, _NO_ROWS)

    def restart(self, draft: ExactHeld, chosen: Flags) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.restart`."""
        numbers = np.flatnonzero(chosen)
        words, rows = self._noted(draft, numbers)
        values = rows if len(rows) else draft.scenes.rows(numbers)
        compiled(restart.restart_blocks)(values, draft.blocks, numbers, words)
        draft.note(numbers, words, rows)

    def place(self, draft: ExactHeld, chosen: Flags, states: Array, times: Array, anew: bool) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.place`."""
        blocks = draft.blocks
        block, lane = np.divmod(np.flatnonzero(chosen), blocks.shape[2])
        blocks[block, :12, lane] = states[chosen]
        blocks[block, glide.TIME, lane] = times[chosen]
        started = np.ones(len(lane), dtype=np.bool_) if anew else blocks[block, glide.OVER, lane] != 0.0
        block, lane = block[started], lane[started]
        blocks[block, glide.STEPS, lane] = blocks[block, glide.OVER, lane] = 0.0

    def observe(self, held: ExactHeld, chosen: Flags, observations: Floats) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.observe`."""
        numbers = np.flatnonzero(chosen)
        compiled(restart.look_blocks)(held.rows_of(numbers), held.blocks, numbers, observations)

    def keep(self, draft: ExactHeld) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.keep`."""
        before, self.held = self.held, draft
        self._spare = before.blocks

    # -- stepping -----------------------------------------------------------------------------------------------------

    def step(self, actions: Array | None) -> Outcome:
        """See :meth:`jackbox_env.batches.base.Batch.step`."""
        held, count, halt = self.held, self.held.count, Halt()
        held.settle()
        observations = np.empty((count, 10), dtype=np.float32)
        rewards, truncations = np.empty(count), np.empty(count, dtype=np.bool_)
        reports = np.zeros((count if self._with_infos else 0, score.TERMS + len(self._terms)))
        given = _NO_ACTIONS if actions is None else actions
        table, torque = held.scenes, int(actions is not None)
        scenes = table.values, table.lanes, table.kinds[torque]
        rules = self._dt, self._limit, table.gliding[torque], self._score_address
        pieces, ranges = self._pieces(actions)
        asked, filled = (given, pieces, ranges), (observations, rewards, truncations, reports)
        step_blocks = compiled(loop.step_blocks)
        blocks, after, workspaces = held.blocks, self._taken_spare(), self._taken_workspaces()

        def work(thread: int, low: int, high: int) -> tuple[int, int]:
            finished = 0
            while True:
                ended, number, now = step_blocks(
                    scenes, rules, (blocks, after), asked, (low, high), filled, workspaces[thread]
                )
                finished += now
                if ended != Status.PAUSED or halt.asked:
                    return ended, number if ended else finished
                low = number  # after a while, so that an interruption is heard

        results = self._threads.run(work, len(blocks), grain=_GRAIN, halt=halt)
        self._workspaces = workspaces
        for ended, number in results:
            if ended:
                self._spare = after
                raise self._failure(ended, number, given)
        draft = ExactHeld(
            count, after, held.generators, held.scenes, held.drawn, held.words, held.rows, held.book
        )  # fmt: skip
        infos = self._infos(draft, reports) if self._with_infos else {}
        finished = sum(finished for _, finished in results)
        return Outcome(observations, rewards, truncations, infos, finished, draft)

    def _pieces(self, actions: Array | None) -> tuple[Array, NDArray[np.int64]]:
        """The pieces of drives of functions, once for each drive and time, and each environment's range of them."""
        scenes = self.held.scenes
        if not scenes.cutting[actions is not None]:
            return _NO_TABLE, _NO_RANGES
        going = np.flatnonzero(scenes.cut[actions is not None] & ~self.held.over).tolist()
        times, drives = self.held.column(glide.TIME).tolist(), scenes.drives
        torque = None if actions is None else 0.0  # whatever is held
        tables, found = [_NO_TABLE], dict[tuple[int, float], tuple[int, int]]()
        ranges, end = np.zeros((self.held.count, 2), dtype=np.int64), 0
        for number in going:
            drive, time = drives[number if scenes.several else 0], times[number]
            if (id(drive), time) not in found:
                end_of_step(time, self._dt)
                tables.append(pieces_for(drive, time, self._dt, torque))
                found[id(drive), time] = end, end + len(tables[-1])
                end += len(tables[-1])
            ranges[number] = found[id(drive), time]
        return np.concatenate(tables), ranges

    def _infos(self, draft: ExactHeld, reports: Array) -> dict[str, NDArray[Any]]:
        numbers = [
            draft.states,
            draft.times,
            reports[:, score.REPORTED_TORQUE].copy(),
            reports[:, score.REPORTED_HITS].astype(np.int64),
            reports[:, score.REPORTED_IMPULSE].copy(),
            *(reports[:, score.TERMS + k].copy() for k in range(len(self._terms))),
        ]
        return dict(zip(self.info_names, numbers, strict=True))

    def _failure(self, ended: int, number: int, actions: Array) -> Exception:
        if ended == Status.BAD_ACTION:
            return bad_action(float(actions[number]), number)
        time = float(self.held.column(glide.TIME)[number])
        if ended == Status.TOO_LATE:
            try:
                end_of_step(time, self._dt)
            except ValueError as error:
                return error
        return failure(ended, self.scene(number), time, self._dt, f"the jack of environment {number}")

    def render(self) -> tuple[Any, ...]:
        """Nothing: environments with pictures are stepped one by one."""
        return ()

    def close(self) -> None:
        """Release nothing."""
