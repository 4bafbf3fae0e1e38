"""A batch of environments of the exact contact model: one compiled call per step, shared out over threads."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import islice
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.envs.batch import Change, EpisodeLimits, Outcome, Starts
from jackbox_env.envs.repeated_step import RepeatedStep, bad_numbers
from jackbox_env.envs.scene_table import SceneTable
from jackbox_env.exact import pcg64, run, score, workspace
from jackbox_env.exact.pcg64 import fresh, generator_of, seeded, words_of
from jackbox_env.exact.threads import Ended, Halt, Threads, run_blocks, thread_count
from jackbox_env.exact.workspace import Call, Results, Rules, Scenes, Status, column_of, new_memory, states_of
from jackbox_env.jit.compiler import address_of, compiled
from jackbox_env.model.action import ACTIONS, Repeat
from jackbox_env.model.randomization import Randomization, next_scene
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import RATES, Array, Flags, Floats, Indices
from jackbox_env.model.tasks import draw_start
from jackbox_env.render.raster import Past
from jackbox_env.simulators.base import Impact
from jackbox_env.simulators.exact import ensure_compiled
from jackbox_env.simulators.plain_functions import Interface
from jackbox_env.simulators.users_functions import compiled_for, observer_of

_FEWEST_PER_THREAD = 4096  # below that, waking a thread costs more than it saves
_GRAIN = 4  # blocks that are worth a call
_AHEAD = 100  # control steps for which drives are read at first: those of the longest bounce by default


class PresentRows(NamedTuple):
    """The environments of a batch. Blocks in use are never written."""

    blocks: Array  # states, (blocks, 16, width)
    scenes: SceneTable
    last: tuple[Array, Array | None] | None = None  # blocks before the last step, and its actions
    starts: Starts | None = None  # begun, but generators and scenes may not have them yet
    past: Past | None = None  # what pictures show, if those are observed


class ExactBatch:
    """N environments of the exact model, stepped by one compiled loop, with the interface of :class:`.SingleBatch`.

    Each takes 432 bytes besides the arrays returned, with a scene for each environment 160 bytes more.

    ``batch.py`` states how it changes. *Prepare* writes states into spare memory. *Finish* writes the generators and
    scenes of ``starts`` in :class:`PresentRows` in place, because copies of all would cost as much as a step.

    A step drops the memory that threads write to, and restores it when they have ended. So memory that a thread may
    still write to after an interruption is never used again. The states before the last step are stored elsewhere, so
    a step that fails leaves that one's impacts.
    """

    def __init__(
        self,
        scenes: Sequence[Scene],
        num_envs: int,
        interface: Interface,
        control_dt: float,
        repeat: Repeat,
        limits: EpisodeLimits,
        with_infos: bool = False,
        num_threads: int | None = None,
        randomize: Randomization | None = None,
    ) -> None:
        """Make environments of one scene, or with a scene each.

        Raises:
            TypeError: a function of the user cannot be compiled.
        """
        self._dt, self._interface, self._repeat, self._limits = control_dt, interface, repeat, limits
        self._with_infos, self._randomize = with_infos, randomize
        self._compile()
        self._count, self._width = num_envs, min(workspace.WIDEST, -(-num_envs // (num_threads or 1)))
        blocks = np.zeros((-(-num_envs // self._width), workspace.HEIGHT, self._width))
        several, pixels = len(scenes) > 1 or randomize is not None, interface.pixels
        past = None if pixels is None else Past(pixels, np.zeros((num_envs, pixels.stack, RATES)))
        self._present = PresentRows(blocks, SceneTable(scenes, several, blocks.shape, num_envs, control_dt), past=past)
        self._generators = fresh(num_envs)  # (N, 6)
        self._derived = np.array([randomize.derived(scene) for scene in scenes] if randomize else [], dtype=np.bool_)
        ranges = len(blocks) if num_threads else num_envs // (past.grain if past else _FEWEST_PER_THREAD)
        self._threads = Threads(thread_count(num_threads, ranges))
        self._spare: Array | None = np.zeros_like(blocks)  # where the next step writes
        self._calls: tuple[list[Call], Scenes] | None = None  # of each thread, and the scenes in their arguments

    def _compile(self) -> None:
        """Compile the functions that the loop calls by their address, and store them as long as it may."""
        task, observation, action, _ = self._interface
        plain = action is ACTIONS["torque"]
        scorer = compiled_for(task, score.score_block)
        observer = observer_of(observation)
        actor = None if plain else compiled_for(action, score.act_block)
        self._compiled = scorer, observer, actor
        self._rules = Rules(
            self._dt,
            steps=self._repeat.steps,
            longest=self._limits.steps,
            controls=workspace.CONTROL_SHARES if plain else workspace.CONTROL_ACTIONS,
            max_contact_steps=self._repeat.max_contact_steps,
            decisions=self._limits.decisions,
            score=address_of(scorer, score.block_scorer),
            observe=address_of(observer, score.block_observer),
            act=address_of(actor, score.block_actor),
            patience=run.PATIENCE,
        )

    def __getstate__(self) -> dict[str, Any]:
        return {**vars(self), "_compiled": None, "_rules": None, "_calls": None}  # addresses are of this process

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._compile()

    @property
    def states(self) -> Array:
        """A copy of all states, shape (N, 12)."""
        return states_of(self._present.blocks, self._count)

    @property
    def times(self) -> Array:
        """A copy of all times [s], shape (N,)."""
        return self._column(workspace.TIME)

    @property
    def ended(self) -> Flags:
        """True for each episode that is over, shape (N,)."""
        return np.not_equal(self._column(workspace.OVER), 0.0)

    def _column(self, row: int) -> Array:
        """A copy of one row of the blocks, shape (N,)."""
        return column_of(self._present.blocks, row, self._count)

    # -- episodes -----------------------------------------------------------------------------------------------------

    def scene(self, number: int, starts: Starts | None = None) -> Scene:
        """The scene that an environment has now, or once ``starts`` have begun."""
        table, starts = self._present.scenes, starts or self._present.starts
        if starts is None or starts.scenes is None or number not in starts.numbers:
            return table.scene(number)
        scene = starts.scenes[int(np.searchsorted(starts.numbers, number))]
        return scene if isinstance(scene, Scene) else table.scene_of(number, scene)

    def draw(
        self,
        numbers: Indices,
        seeds: Sequence[int | None] | None = None,
        changes: Sequence[Change] | None = None,
        placed: bool = False,
    ) -> Starts:
        """Seed generators, and draw scenes and starts for episodes to come."""
        ensure_compiled(self._present.scenes.lossy)
        self._finish()
        words, table = self._generators[numbers], self._present.scenes
        for index, seed in enumerate(seeds or ()):
            if seed is not None:
                words[index] = seeded(seed)
        drawn, starting = self._randomize, self._interface.task.start is not None and not placed
        if changes is None and drawn is None and not starting:
            return Starts(numbers, words, None)
        otherwise = table.driven_otherwise[numbers if table.several else 0].any()
        if changes is None and drawn is not None and drawn.function is None and not (otherwise or starting):
            rows, derived = table.original_rows(numbers), self._derived
            follows = derived[numbers] if len(derived) > 1 else np.repeat(derived, len(numbers), axis=0)
            compiled(pcg64.draw_scenes)(rows, drawn.table, follows, words)
            return Starts(numbers, words, rows)
        scenes, states = list[Scene](), list[Array]()
        for index, number in enumerate(numbers.tolist()):
            generator, scene = generator_of(words[index]), table.scene(number)
            if changes is not None or drawn is not None:
                scene = next_scene(table.original_of(number), drawn, generator, changes[index] if changes else {})
                scenes.append(scene)
            if starting:
                states.append(draw_start(self._interface.task, scene, generator))
            words[index] = words_of(generator)
        return Starts(numbers, words, scenes or None, np.array(states) if starting else None)

    def prepare_starts(self, starts: Starts, observations: Floats, after: PresentRows | None = None) -> PresentRows:
        """The environments once episodes begin, now or ``after`` a step; this writes their rows of ``observations``.

        Raises:
            TaskError: a number of an observation is NaN.
        """
        numbers, words, scenes, states, times = starts
        after = self._prepare() if after is None else after
        blocks, table, past = after.blocks, after.scenes, after.past
        if scenes is None:
            rows = table.rows(numbers)
        elif isinstance(scenes, list):
            rows = np.array([scene.numbers for scene in scenes])
            if len(numbers) < self._count or any(scene != scenes[0] for scene in scenes):
                table = table.spread_out(blocks.shape)
        else:
            rows = scenes
        block, lane = np.divmod(numbers, self._width)
        if states is None:
            compiled(pcg64.restart_blocks)(rows, blocks, numbers, words)
        else:
            blocks[block, :, lane] = 0.0
            blocks[block, :12, lane] = states
        if times is not None:
            blocks[block, workspace.TIME, lane] = times
        past = past and past.begun(numbers, states_of(blocks, self._count))
        self._observe(rows, blocks, numbers, observations, past)
        return after._replace(scenes=table, starts=starts, past=past)

    def set_states(self, chosen: Flags, states: Array, times: Array) -> None:
        """Set states, shape (N, 12), and times [s] of the ``chosen`` environments, checked beforehand."""
        after = self._prepare()
        blocks, past, (block, lane) = after.blocks, after.past, np.divmod(np.flatnonzero(chosen), self._width)
        blocks[block, :12, lane] = states[chosen]
        blocks[block, workspace.TIME, lane] = times[chosen]
        over = blocks[block, workspace.OVER, lane] != 0.0
        for row in (workspace.STEPS, workspace.DECISIONS, workspace.OVER):
            blocks[block[over], row, lane[over]] = 0.0
        self.commit(after._replace(past=past and past.begun(np.flatnonzero(chosen), states)))

    def _prepare(self) -> PresentRows:
        """A copy of the present to be changed, in spare memory."""
        blocks = self._taken()
        np.copyto(blocks, self._present.blocks)
        return self._present._replace(blocks=blocks)

    def _taken(self) -> Array:
        """The spare blocks, which are no longer spare."""
        spare, self._spare = self._spare, None
        return np.zeros_like(self._present.blocks) if spare is None else spare

    def commit(self, after: PresentRows) -> None:
        """Replace the present environments by those of a step or of starts."""
        before, self._present = self._present, after
        self._spare = before.blocks if after.last is before.last else before.last and before.last[0]
        self._finish()

    def _finish(self) -> None:
        """Write the generators and scenes of the last starts in place, unless this is done."""
        if starts := self._present.starts:
            self._generators[starts.numbers] = starts.generators
            if starts.scenes is not None:
                self._present.scenes.set_scenes(starts.numbers, starts.scenes)
            self._present = self._present._replace(starts=None)

    def observe(self, numbers: Indices, observations: Floats) -> None:
        """Write the observations of some environments into their rows, shape (N, numbers).

        Raises:
            TaskError: a number of an observation is NaN.
        """
        self._finish()
        present = self._present
        self._observe(present.scenes.rows(numbers), present.blocks, numbers, observations, present.past)

    def _observe(self, rows: Array, blocks: Array, numbers: Indices, observations: Any, past: Past | None) -> None:
        """Write the observations of environments in ``blocks``, whose scenes have these ``rows`` of numbers."""
        if past is not None:
            past.draw(rows, numbers, observations, self._threads)
            return
        bad = compiled_for(self._interface.observation, score.observe_chosen)(rows, blocks, numbers, observations)
        if bad >= 0:
            raise bad_numbers(self._interface.observation, observations, bad)

    def field(self, name: str) -> Array:
        """A number of each environment's scene, by the name of its field, shape (N,)."""
        table = self._present.scenes
        if self._present.starts is not None:
            return np.array([getattr(self.scene(number), name) for number in range(self._count)], dtype=np.float64)
        return np.repeat(table.column(name), 1 if table.several else self._count)

    def impacts(self, number: int) -> list[Impact]:
        """The impacts of an environment's last step, in time order; none if its state was set since.

        The step is repeated.
        """
        if self._present.last is None:
            return []
        block, lane = divmod(number, self._width)
        row, repeated = self._present.blocks[block, :, lane], self._repeated(number, *self._present.last)
        count = int(row[workspace.STEPS] - repeated.row[workspace.STEPS])
        if count < 1:  # it has restarted, possibly in another scene, or it waits
            return []
        steps = list(islice(repeated.steps(), count))
        same = np.array_equal(steps[-1].state, row[:12])
        return [impact for step in steps for impact in step.impacts] if same else []

    def _repeated(self, number: int, before: Array, actions: Array | None) -> RepeatedStep:
        """A step of one environment from the blocks ``before`` under ``actions``, to be repeated."""
        block, lane = divmod(number, self._width)
        controls = None if actions is None else actions[:, number]
        return RepeatedStep(number, self.scene(number), self._interface, self._dt, before[block, :, lane], controls)

    # -- stepping -----------------------------------------------------------------------------------------------------

    def prepare_step(self, actions: Array | None, ahead: int = _AHEAD) -> Outcome:
        """Step all under ``actions``, shape (n, N), or under the scene's drive.

        Functions of drives are read ``ahead``, for so many control steps. If a decision lasts longer, it begins anew.
        """
        self._finish()
        steps, halt, loop, filled = self._repeat.steps, Halt(), compiled(run.run), self._new_results()
        scenes = self._scenes_of_steps(int(actions is not None), steps, ahead)
        present = self._present.blocks
        before, spare = present.copy() if steps > 1 else present, self._taken()  # several steps overwrite it
        calls = self._calls_with(scenes, before, spare, np.zeros((0, 0)) if actions is None else actions, filled)

        # Threads that a second interruption left at work keep alive what the loop calls by its address.
        def work(thread: int, low: int, high: int, _called: Any = self._compiled) -> Ended:
            """Run blocks; if some fail, return the earliest failure, which does not depend on the number of threads."""
            earliest = ended = run_blocks(loop, calls, thread, low, high, halt)
            while ended[0] and not halt.requested and ended[1] // self._width + 1 < high:
                ended = run_blocks(loop, calls, thread, ended[1] // self._width + 1, high, halt)
                earliest = ended if ended[0] and ended[2] < earliest[2] else earliest
            return earliest

        parts = self._threads.run(work, len(before), grain=_GRAIN, halt=halt)
        self._calls = calls, scenes
        failures = [(made, number, ended) for ended, number, made, *_ in parts if ended]
        if failures:
            self._spare = spare
            made, number, ended = min(failures)
            if ended == Status.NO_DRIVE and made >= ahead:
                return self.prepare_step(actions, 10 * ahead)
            raise self._repeated(number, present, actions).failure(ended, made, filled.observations)
        after, finished = spare if steps & 1 else before, sum(finished for *_, finished, _ in parts)
        return self._outcome(filled, finished, after, actions)

    def _new_results(self) -> Results:
        """Memory for the results of a step."""
        count, several, pixels = self._count, self._repeat.steps > 1, self._interface.pixels
        shown = min(self._repeat.steps, pixels.stack) if several and pixels else 0
        return Results(
            observations=np.empty((0 if pixels else count, len(self._interface.observation.names)), np.float32),
            rewards=np.zeros((1, count)),
            returns=np.zeros(count if several else 0),
            terminations=np.zeros(count, dtype=np.bool_),
            truncations=np.zeros(count, dtype=np.bool_),
            reports=np.zeros((count if self._with_infos else 0, score.TERMS + len(self._interface.task.terms))),
            trajectories=np.empty((count if shown else 0, shown, 12)),
        )

    def _calls_with(self, scenes: Scenes, before: Array, spare: Array, controls: Array, filled: Results) -> list[Call]:
        """A call for each thread. They are not stored while threads use them."""
        stored, self._calls = self._calls, None
        if stored and stored[1] is scenes and not filled.trajectories.size:
            calls = stored[0]
            for call in calls:
                call.set_arrays(before, spare, controls, filled)
        else:
            calls = stored[0] if stored else [Call(new_memory(self._width)) for _ in range(self._threads.count)]
            for call in calls:
                call.set_arguments(scenes, self._rules, before, spare, controls, filled)
        return calls

    def _outcome(self, filled: Results, finished: int, after: Array, actions: Array | None) -> Outcome:
        """The outcome of a step under ``actions``, which ends with the blocks ``after``."""
        made: Array | float = 1.0
        if self._repeat.steps > 1:
            made = column_of(after, workspace.STEPS, self._count) - self._column(workspace.STEPS)
        durations = np.empty(self._count)
        durations[:] = made * self._dt  # faster than np.full
        infos = self._infos(after, filled.reports, made, durations) if self._with_infos else {"duration": durations}
        rewards = filled.returns if self._repeat.steps > 1 else filled.rewards[0]
        observations, scenes, past = filled.observations, self._present.scenes, self._present.past
        if past is not None:
            observations, everyone = self._interface.new_observations(self._count), np.arange(self._count)
            last = filled.trajectories if self._repeat.steps > 1 else states_of(after, self._count)[:, None]
            past = past.after(last, column_of(after, workspace.STEPS, self._count) - self._column(workspace.STEPS))
            past.draw(scenes.rows(everyone), everyone, observations, self._threads)
        return Outcome(
            observations, rewards, filled.terminations, filled.truncations, infos, finished,
            PresentRows(after, scenes, last=(self._present.blocks, actions), past=past),
        )  # fmt: skip

    def _scenes_of_steps(self, torque: int, steps: int, ahead: int) -> Scenes:
        """The scenes for these numbers of steps: ``SceneTable.of_steps``."""
        scenes = self._present.scenes
        if not scenes.cutting[torque]:
            return scenes.plain[torque]
        remaining = np.where(self.ended, 0.0, np.minimum(steps, self._limits.steps - self._column(workspace.STEPS)))
        return scenes.of_steps(torque, self.times, remaining.astype(np.int64), ahead)

    def _infos(self, after: Array, reports: Array, made: Array | float, durations: Array) -> dict[str, NDArray[Any]]:
        return {
            "state": states_of(after, self._count),
            "time": column_of(after, workspace.TIME, self._count),
            "torque": reports[:, score.REPORTED_TORQUE] / np.maximum(made, 1.0),
            "impacts": reports[:, score.REPORTED_HITS].astype(np.int64),
            "impulse": reports[:, score.REPORTED_IMPULSE].copy(),
            "duration": durations,
            **{
                f"reward_{name}": reports[:, score.TERMS + k].copy()
                for k, name in enumerate(self._interface.task.terms)
            },
        }
