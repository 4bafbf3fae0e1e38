"""A batch of environments of the exact contact model: one compiled call per step, shared out over threads."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env.batches.base import Flags, Floats, Outcome, bad_action
from jackbox_env.batches.threads import Halt, Threads, thread_count
from jackbox_env.compiled import loop
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.drives import TABLE_WIDTH
from jackbox_env.compiled.generator import Words, fresh, seeded
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.workspace import new_workspace
from jackbox_env.scene import Scene
from jackbox_env.simulators.base import end_of_step
from jackbox_env.simulators.exact import WITH_PIECES, drive_kind, failure, pieces_for
from jackbox_env.states import Array
from jackbox_env.tasks import TASKS

_FEWEST_PER_THREAD = 4096  # below that, waking a thread costs more than it saves
_GRAIN = 4  # blocks that are worth a call
_NO_ACTIONS: Array = np.zeros(0)
_NO_TABLE: Array = np.zeros((0, TABLE_WIDTH))
_NO_RANGES = np.zeros((0, 2), dtype=np.int64)
_NOBODY = np.zeros(0, dtype=np.int64)
_NO_WORDS: Words = np.zeros((0, 4), dtype=np.uint64)


@dataclass(slots=True)
class ExactHeld:
    """See :class:`jackbox_env.batches.base.Held`.

    A step's draft shares the generators. It only notes the new state of those that it draws from.
    """

    count: int
    blocks: Array  # (blocks, 16, width)
    generators: Words  # (N, 4), without what is noted
    drawn: NDArray[np.int64] = field(default_factory=lambda: _NOBODY)  # (k,) environments that have drawn a start
    words: Words = field(default_factory=lambda: _NO_WORDS)  # (k, 4) their generators since then
    book: Any = None

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""
        return self.blocks[:, :12].transpose(0, 2, 1).copy().reshape(-1, 12)[: self.count]

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return self.column(loop.TIME)

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""
        return np.not_equal(self.column(loop.OVER), 0.0)

    def column(self, place: int) -> Array:
        """A copy of one number of all environments, shape (N,)."""
        return self.blocks[:, place].reshape(-1)[: self.count].copy()

    def settled(self) -> Words:
        """The generators with the noted states written into them; writing them twice changes nothing."""
        self.generators[self.drawn] = self.words
        return self.generators


class ExactBatch:
    """See :class:`jackbox_env.batches.base.Batch`; 288 bytes per environment besides what is handed out.

    Memory that threads write to is taken out of the batch for a step and comes back when they have ended: memory
    that an interruption may have left to a thread is never used again.
    """

    def __init__(
        self,
        scene: Scene,
        num_envs: int,
        task: str,
        control_dt: float,
        max_episode_steps: int,
        with_infos: bool = False,
        num_threads: int | None = None,
    ) -> None:
        self._scene, self._task, self._dt = scene, list(TASKS).index(task), control_dt
        self._terms = [f"reward_{name}" for name in TASKS[task].terms]
        self._limit, self._with_infos = float(max_episode_steps), with_infos
        width = min(loop.WIDEST, -(-num_envs // (num_threads or 1)))
        blocks = np.zeros((-(-num_envs // width), loop.WIDTH, width))
        self.held = ExactHeld(num_envs, blocks, fresh(num_envs))
        ranges = len(blocks) if num_threads else num_envs // _FEWEST_PER_THREAD
        self._threads = Threads(thread_count(num_threads, ranges))
        self._spare: Array | None = np.zeros_like(blocks)  # where the next step writes
        self._workspaces: list[tuple[Array, Array]] | None = self._new_workspaces()
        self._numbers = np.array(scene.numbers)
        self._kinds = drive_kind(scene), drive_kind(scene, held=True)

    def _new_workspaces(self) -> list[tuple[Array, Array]]:
        width = self.held.blocks.shape[2]
        return [(np.zeros((loop.LANES, width)), new_workspace()) for _ in range(self._threads.count)]

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

    def draft(self) -> ExactHeld:
        """See :meth:`jackbox_env.batches.base.Batch.draft`."""
        blocks = self._taken_spare()
        blocks[:] = self.held.blocks
        return ExactHeld(self.held.count, blocks, self.held.settled().copy(), book=self.held.book)

    def seed(self, draft: ExactHeld, number: int, seed: int) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.seed`."""
        draft.generators[number] = seeded(seed)

    def restart(self, draft: ExactHeld, chosen: Flags) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.restart`."""
        shared = draft.generators is self.held.generators
        drawn = np.flatnonzero(chosen)
        words = (self.held if shared else draft).settled()[drawn]
        compiled(loop.restart_blocks)(self._numbers, draft.blocks, drawn, words)
        draft.drawn, draft.words = drawn, words

    def place(self, draft: ExactHeld, chosen: Flags, states: Array, times: Array, anew: bool) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.place`."""
        blocks = draft.blocks
        block, lane = np.divmod(np.flatnonzero(chosen), blocks.shape[2])
        blocks[block, :12, lane] = states[chosen]
        blocks[block, loop.TIME, lane] = times[chosen]
        started = np.ones(len(lane), dtype=np.bool_) if anew else blocks[block, loop.OVER, lane] != 0.0
        block, lane = block[started], lane[started]
        blocks[block, loop.STEPS, lane] = blocks[block, loop.OVER, lane] = 0.0

    def observe(self, held: ExactHeld, chosen: Flags, observations: Floats) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.observe`."""
        compiled(loop.look_blocks)(self._numbers, held.blocks, chosen, observations)

    def keep(self, draft: ExactHeld) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.keep`."""
        before, self.held = self.held, draft
        self._spare = before.blocks

    # -- stepping -----------------------------------------------------------------------------------------------------

    def step(self, actions: Array | None) -> Outcome:
        """See :meth:`jackbox_env.batches.base.Batch.step`."""
        held, count, halt = self.held, self.held.count, Halt()
        observations = np.empty((count, 10), dtype=np.float32)
        rewards, truncations = np.empty(count), np.empty(count, dtype=np.bool_)
        reports = np.zeros((count if self._with_infos else 0, loop.REPORT_WIDTH))
        given = _NO_ACTIONS if actions is None else actions
        rules = self._dt, self._kinds[actions is not None], self._task, self._limit
        table, ranges = self._pieces(actions)
        asked, filled = (given, table, ranges), (observations, rewards, truncations, reports)
        step_blocks = compiled(loop.step_blocks)
        blocks, after, workspaces = held.blocks, self._taken_spare(), self._taken_workspaces()

        def work(thread: int, low: int, high: int) -> tuple[int, int]:
            finished = 0
            while True:
                ended, number, now = step_blocks(
                    self._numbers, rules, (blocks, after), asked, (low, high), filled, workspaces[thread]
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
        draft = ExactHeld(count, after, held.generators, held.drawn, held.words, held.book)
        infos = self._infos(draft, reports) if self._with_infos else {}
        finished = sum(finished for _, finished in results)
        return Outcome(observations, rewards, truncations, infos, finished, draft)

    def _pieces(self, actions: Array | None) -> tuple[Array, NDArray[np.int64]]:
        """The pieces of a drive of functions, once for each different time, and each environment's range of them."""
        if self._kinds[actions is not None] not in WITH_PIECES:
            return _NO_TABLE, _NO_RANGES
        going = ~self.held.over
        times, places = np.unique(self.held.column(loop.TIME)[going], return_inverse=True)
        torque = None if actions is None else 0.0  # whatever is held
        tables = [_NO_TABLE]
        for time in times.tolist():
            end_of_step(time, self._dt)
            tables.append(pieces_for(self._scene, time, self._dt, torque))
        ends = np.cumsum([len(table) for table in tables])
        ranges = np.zeros((self.held.count, 2), dtype=np.int64)
        ranges[going] = np.stack([ends[places], ends[places + 1]], axis=1)
        return np.concatenate(tables), ranges

    def _infos(self, draft: ExactHeld, reports: Array) -> dict[str, NDArray[Any]]:
        numbers = [
            draft.states,
            draft.times,
            reports[:, loop.REPORTED_TORQUE].copy(),
            reports[:, loop.REPORTED_HITS].astype(np.int64),
            reports[:, loop.REPORTED_IMPULSE].copy(),
            *(reports[:, loop.TERMS + k].copy() for k in range(len(self._terms))),
        ]
        return dict(zip(self.info_names, numbers, strict=True))

    def _failure(self, ended: int, number: int, actions: Array) -> Exception:
        if ended == Status.BAD_ACTION:
            return bad_action(float(actions[number]), number)
        time = float(self.held.column(loop.TIME)[number])
        if ended == Status.TOO_LATE:
            try:
                end_of_step(time, self._dt)
            except ValueError as error:
                return error
        return failure(ended, self._scene, time, self._dt, f"the jack of environment {number}")

    def render(self) -> tuple[Any, ...]:
        """Nothing: environments with pictures are stepped one by one."""
        return ()

    def close(self) -> None:
        """Release nothing."""
