"""A batch of environments of the exact contact model: one compiled call per step, shared out over threads."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env.batches.base import Flags, Floats, Outcome, bad_action
from jackbox_env.batches.threads import Threads, thread_count
from jackbox_env.compiled import loop
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.drives import TABLE_WIDTH
from jackbox_env.compiled.generator import fresh, seeded
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.workspace import new_workspace
from jackbox_env.scene import Scene
from jackbox_env.simulators.base import end_of_step
from jackbox_env.simulators.exact import WITH_PIECES, ExactSimulator, drive_kind, failure, pieces_for
from jackbox_env.states import Array
from jackbox_env.tasks import TASKS

_FEWEST_PER_THREAD = 4096  # below that, waking a thread costs more than it saves
_GRAIN = 4  # blocks that are worth a call
_NO_ACTIONS: Array = np.zeros(0)
_NO_TABLE: Array = np.zeros((0, TABLE_WIDTH))
_NO_RANGES = np.zeros((0, 2), dtype=np.int64)


class ExactBatch:
    """See :class:`jackbox_env.batches.base.Batch`; 288 bytes per environment besides what is handed out."""

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
        ExactSimulator.refuse(scene)
        self._scene, self._task, self._dt = scene, list(TASKS).index(task), control_dt
        self._terms = [f"reward_{name}" for name in TASKS[task].terms]
        self._limit, self._with_infos = float(max_episode_steps), with_infos
        self._count = num_envs
        width = min(loop.WIDEST, -(-num_envs // (num_threads or 1)))
        self._blocks = np.zeros((-(-num_envs // width), loop.WIDTH, width))
        self._spare = np.zeros_like(self._blocks)  # where the next step writes
        self._generators = fresh(num_envs)
        ranges = len(self._blocks) if num_threads else num_envs // _FEWEST_PER_THREAD
        self._threads = Threads(thread_count(num_threads, ranges))
        self._workspaces = self._new_workspaces()
        self._numbers = np.array(scene.numbers)
        self._kinds = drive_kind(scene), drive_kind(scene, held=True)

    def _new_workspaces(self) -> list[tuple[Array, Array]]:
        return [(np.zeros((loop.LANES, self._blocks.shape[2])), new_workspace()) for _ in range(self._threads.count)]

    @property
    def _rows(self) -> Array:
        """A copy of all environments, shape (N, 16)."""
        return self._blocks.transpose(0, 2, 1).reshape(-1, loop.WIDTH)[: self._count]

    def _column(self, place: int) -> Array:
        """A copy of one number of all environments, shape (N,)."""
        return self._blocks[:, place].reshape(-1)[: self._count].copy()

    # -- what it holds ------------------------------------------------------------------------------------------------

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""
        return np.ascontiguousarray(self._rows[:, :12])

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return self._column(loop.TIME)

    @property
    def over(self) -> Flags:
        """Which episodes are over, shape (N,)."""
        return np.not_equal(self._column(loop.OVER), 0.0)

    @property
    def info_names(self) -> list[str]:
        """Names of the infos, those of the single environment."""
        return ["state", "time", "torque", "impacts", "impulse", *self._terms]

    # -- episodes -----------------------------------------------------------------------------------------------------

    def seed(self, number: int, seed: int) -> None:
        """Seed one environment's random starts."""
        self._generators[number] = seeded(seed)

    def restart(self, chosen: Flags) -> None:
        """Start an episode in the ``chosen`` environments, each at a drawn start and time 0."""
        compiled(loop.restart_blocks)(self._numbers, self._blocks, self._generators, chosen)

    def place(self, chosen: Flags, states: Array, times: Array, anew: bool) -> None:
        """See :meth:`jackbox_env.batches.base.Batch.place`."""
        block, lane = np.divmod(np.flatnonzero(chosen), self._blocks.shape[2])
        self._blocks[block, :12, lane] = states[chosen]
        self._blocks[block, loop.TIME, lane] = times[chosen]
        started = np.ones(len(lane), dtype=np.bool_) if anew else self._blocks[block, loop.OVER, lane] != 0.0
        block, lane = block[started], lane[started]
        self._blocks[block, loop.STEPS, lane] = self._blocks[block, loop.OVER, lane] = 0.0

    def observe(self, chosen: Flags, observations: Floats) -> None:
        """Write what the ``chosen`` environments' agents see, shape (N, 10)."""
        compiled(loop.look_blocks)(self._numbers, self._blocks, chosen, observations)

    # -- stepping -----------------------------------------------------------------------------------------------------

    def step(self, actions: Array | None) -> Outcome:
        """See :meth:`jackbox_env.batches.base.Batch.step`."""
        count, blocks, spare = self._count, self._blocks, self._spare
        observations = np.empty((count, 10), dtype=np.float32)
        rewards, truncations = np.empty(count), np.empty(count, dtype=np.bool_)
        reports = np.zeros((count if self._with_infos else 0, loop.REPORT_WIDTH))
        given = _NO_ACTIONS if actions is None else actions
        rules = self._dt, self._kinds[actions is not None], self._task, self._limit
        table, ranges = self._pieces(actions)
        asked, filled = (given, table, ranges), (observations, rewards, truncations, reports)
        step_blocks = compiled(loop.step_blocks)

        def work(thread: int, low: int, high: int) -> tuple[int, int]:
            finished = 0
            while True:
                ended, number, now = step_blocks(
                    self._numbers, rules, (blocks, spare), asked, (low, high), filled, self._workspaces[thread]
                )
                finished += now
                if ended != Status.PAUSED:
                    return ended, number if ended else finished
                low = number  # after a while, so that an interruption is heard

        try:
            results = self._threads.run(work, len(blocks), grain=_GRAIN)
        except BaseException:
            # A thread may still write: leave it what it writes to.
            self._spare, self._workspaces = np.zeros_like(blocks), self._new_workspaces()
            raise
        for ended, number in results:
            if ended:
                raise self._failure(ended, number, given)
        self._blocks, self._spare = spare, blocks
        infos = self._infos(reports) if self._with_infos else {}
        return Outcome(observations, rewards, truncations, infos, sum(finished for _, finished in results))

    def _pieces(self, actions: Array | None) -> tuple[Array, NDArray[np.int64]]:
        """The pieces of a drive of functions, once for each different time, and each environment's range of them."""
        if self._kinds[actions is not None] not in WITH_PIECES:
            return _NO_TABLE, _NO_RANGES
        going = ~self.over
        times, places = np.unique(self._column(loop.TIME)[going], return_inverse=True)
        torque = None if actions is None else 0.0  # whatever is held
        tables = [_NO_TABLE]
        for time in times.tolist():
            end_of_step(time, self._dt)
            tables.append(pieces_for(self._scene, time, self._dt, torque))
        ends = np.cumsum([len(table) for table in tables])
        ranges = np.zeros((self._count, 2), dtype=np.int64)
        ranges[going] = np.stack([ends[places], ends[places + 1]], axis=1)
        return np.concatenate(tables), ranges

    def _infos(self, reports: Array) -> dict[str, NDArray[Any]]:
        numbers = [
            self.states,
            self.times,
            reports[:, loop.REPORTED_TORQUE].copy(),
            reports[:, loop.REPORTED_HITS].astype(np.int64),
            reports[:, loop.REPORTED_IMPULSE].copy(),
            *(reports[:, loop.TERMS + k].copy() for k in range(len(self._terms))),
        ]
        return dict(zip(self.info_names, numbers, strict=True))

    def _failure(self, ended: int, number: int, actions: Array) -> Exception:
        if ended == Status.BAD_ACTION:
            return bad_action(float(actions[number]), number)
        time = float(self._column(loop.TIME)[number])
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
