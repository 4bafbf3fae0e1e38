"""``contact="exact"``: from impact to impact in compiled code; none is missed, each is located to rounding.

Law: flight in closed form (``exact/flight.py``); at an impact all feet that touch, within 1e-13 m or 4 units in the
    last place of a far-off position, obey the simultaneous Newton law of
    :func:`jackbox_env.mechanics.simultaneous_impact_map`. With loss, bounces accumulate (Zeno). A foot that would rise
    by at most 1e-13 m comes to rest; this limit doubles with every 256 impacts of a step, up to 1e-10 m. By the law
    alone, the rest of the series would dissipate that energy too. The foot then stays on the wall until the force
    changes sign (``exact/rest.py``). A resting foot counts as one impact per wall and step: at the step's end, with the
    impulse of the whole step. So ``impacts``, the environment's counts and impulses, and the task rattle include the
    weight on a wall, m_j g dt in a step.
Order: none; the error is rounding for every control step. The system is chaotic and multiplies any error by about 10
    per impact (docs/physics.md), so even this model predicts only 12 to 16 impacts.
Cost: below 0.1 microseconds per control step in a batch, in proportion to the number of impacts. A step with resting
    feet takes a few microseconds.
Fails: a step that needs more than 1,000,000 gap evaluations raises JackLostError: rotation or impacts far too fast for
    the step. A chirp of more than 83,333 turns in a step raises ValueError. Without loss a foot that bounces by 1e-10 m
    or less does so about a thousand times per control step; a foot that reaches another wall meanwhile may be as deep
    in that wall when it bounces. With loss no foot is deeper than 2.4e-10 m. Angles are rounded to their unit in the
    last place: beyond 1e6 rad a foot may be outside by up to 4 L times that unit (5e-10 L at 1e6 rad, 5e-4 L at
    1e12 rad). A drive's functions are interpolated, see ``drives.py``: a pulse between two of the 13 points of a
    piece is missed.
Bits: the same on every x86-64 CPU and under Linux on ARM, whatever the C library, for states, impacts, observations and
    rewards. Compiled code adds in the order written, fuses no product with a sum, and has its own cosines
    (``geometry.py``).
    Three things depend on the C library: functions of a drive that call it (``math.sin``), the cosine of an angle
    beyond 2^53 rad, and whether a state at the limit of valid ones raises ValueError.
Reference: Lygeros et al. 2003, "Dynamical properties of hybrid automata"; the bound is in ``exact/bounds.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray
from typing_extensions import override

from jackbox_env.exact.flight import TABLE_WIDTH
from jackbox_env.exact.late import AGAIN, repaired, with_all
from jackbox_env.exact.run import run
from jackbox_env.exact.search import MOST_WORK
from jackbox_env.exact.step import CHIRP, CONSTANT, CONSTANT_BESIDE_FORCES, FUNCTIONS
from jackbox_env.exact.workspace import (
    HEIGHT,
    SCENE_PARAMS,
    TIME,
    TORQUE,
    Call,
    Results,
    Rules,
    Scenes,
    Status,
    new_memory,
    new_workspaces,
)
from jackbox_env.jit.compiler import compiled
from jackbox_env.model.scene import Chirp, Drive, Scene, too_many_turns
from jackbox_env.model.states import Array, Counts, Numbers
from jackbox_env.simulators.base import Impact, JackLostError, Simulator, StepResult, end_of_step
from jackbox_env.simulators.drives import function_pieces

WITH_PIECES = (FUNCTIONS, CONSTANT_BESIDE_FORCES)  # kinds with functions, which are cut into pieces
NO_TABLE: Array = np.zeros((0, TABLE_WIDTH))
NO_PIECES = NO_TABLE, np.zeros(0, np.int64), np.zeros(1, np.int64)  # as of ``joined``, where no function acts


def drive_kind(drive: Chirp | Drive | None, held: bool = False) -> int:
    """The kind of a step in compiled code: under a constant (``held``) torque, or under the scene's drive."""
    if isinstance(drive, Chirp):
        return CONSTANT if held else CHIRP
    forced = drive is not None and drive.force_bound > 0.0
    if held:
        return CONSTANT_BESIDE_FORCES if forced else CONSTANT
    return FUNCTIONS if forced or (drive is not None and drive.torque_bound > 0.0) else CONSTANT


def pieces_for(drive: Chirp | Drive | None, time: float, dt: float, torque: float | None) -> Array:
    """The pieces of a drive of functions over a step; none for any other drive, or if no function acts."""
    if not isinstance(drive, Drive) or drive_kind(drive, torque is not None) not in WITH_PIECES:
        return NO_TABLE
    if torque is not None:
        drive = Drive(force_x=drive.force_x, force_y=drive.force_y)
    return function_pieces(drive, time, dt)


def joined(tables: list[Array], begins: NDArray[np.int64]) -> tuple[Array, NDArray[np.int64], NDArray[np.int64]]:
    """Pieces in the form of ``workspace.Scenes``, from tables of one step each; rows begin at table ``begins``."""
    tables = tables or [NO_TABLE]  # a step for rows without pieces
    ends = np.cumsum([0, *map(len, tables)], dtype=np.int64)
    return np.concatenate(tables), begins, ends


def cut(
    drives: Sequence[Chirp | Drive | None], kinds: Counts, times: Array, steps: Counts, dt: float,
    torque: float | None, ahead: int | None = None,
) -> tuple[Array, Counts, Counts]:  # fmt: skip
    """The pieces of drives of functions in the form of ``workspace.Scenes``, cut once for each drive, time and steps.

    Args:
        drives: one for all rows, or one for each of N.
        kinds: of steps under them, (1 or N,), as of :func:`drive_kind`.
        times: at which the rows start [s], (N,).
        steps: that each of them makes at most, (N,).
        dt: duration of a step [s].
        torque: that is held; any number stands for all. None: the drives' torques act.
        ahead: steps for which pieces are cut, at most; there are none either from a step on that a drive fails over,
            after the first, as a row may not reach it. None: all steps need pieces.

    Raises:
        Exception: a drive fails over a step that needs pieces.
    """
    tables, known, begins = list[Array](), dict[tuple[int, float, int], int](), np.zeros(len(times), np.int64)
    for row in np.flatnonzero(np.isin(kinds, WITH_PIECES) & (steps > 0)).tolist():
        drive, time, most = drives[row if len(drives) > 1 else 0], float(times[row]), int(steps[row])
        most = min(most, ahead or most)
        begin = known.setdefault((id(drive), time, most), len(tables))
        begins[row] = begin
        if begin < len(tables):
            continue
        end_of_step(time, dt)
        for start in np.add.accumulate([time, *[dt] * (most - 1)]).tolist():
            try:
                tables.append(pieces_for(drive, start, dt, torque))
            except Exception:
                if ahead is None or len(tables) == begin:
                    raise
                break
        tables += [NO_TABLE] * (begin + most + 1 - len(tables))
    return joined(tables, begins)


def failure(ended: int, scene: Scene, time: float, dt: float, who: str = "the jack") -> Exception:
    """The error for a step that failed with the status ``ended``."""
    if ended == Status.TOO_MANY_TURNS and isinstance(scene.drive, Chirp):
        return ValueError(too_many_turns(scene.drive.fastest(time, dt) * dt, time, dt))
    if ended == Status.TOO_MUCH_WORK:
        return JackLostError(
            f"{who} needs more than {MOST_WORK:,} gap evaluations in the dt = {dt:g} s after t = {time:g} s; use a "
            "smaller time step or less torque"
        )
    return JackLostError(
        f"{who} moves too fast to be followed in the dt = {dt:g} s after t = {time:g} s, or is too far off; use a "
        "smaller time step, less speed or less torque"
    )


@cache
def ensure_compiled(lossy: bool = False) -> None:
    """Compile a step, or load it: at an episode's start, and not in its first step behind a progress bar.

    Feet at rest are included if a scene is ``lossy``.
    """
    ExactSimulator(Scene()).step(0.02, 0.0)
    if lossy:
        with_all(new_workspaces())


class Scoring(NamedTuple):
    """How a step is rewarded and observed, in compiled code, and where the results are written."""

    score: int = 0  # address of the task's ``score_block``
    observe: int = 0  # address of the observation's ``observe_rows``
    results: Results = Results(terminations=np.zeros(1, np.bool_), truncations=np.zeros(1, np.bool_))
    refuse: Callable[[int], None] = lambda ended: None  # raises for a step that ended with a bad reward or observation


UNSCORED = Scoring()


class ExactSimulator(Simulator):
    """Event-driven simulation; the module's head states the law, :class:`Simulator` the methods."""

    name = "exact"
    room = 500
    compiled = True
    _states: Sequence[Array] = ()

    @override
    def stepped(self, dt: float, torque: float | None, scoring: Scoring = UNSCORED) -> StepResult:
        present, set_for = self._present, self._set_for
        if torque is not None:
            self._control[0] = torque
        if set_for[0] != dt or set_for[1] is not (torque is not None) or set_for[2] is not scoring:
            self._set_arguments(dt, torque, scoring)
        into = 1 if present.state is self._states[0] else 0  # the state in the other block stays as it is
        if present.state is not self._states[1 - into]:
            self._states[1 - into][:] = present.state
        call, self._times[1 - into][0] = self._calls[into], present.time
        while True:
            ended, _, _, _, hits = self._loop(call.address, 0, 1, 0)
            if not ended:
                break
            if ended not in AGAIN:
                scoring.refuse(ended)
                end_of_step(present.time, dt)
                raise failure(ended, self.scene, present.time, dt)
            call = self._calls[into] = repaired(call, ended)  # and repeat the step
        impacts = recorded(call.memory.log[:hits], present.time) if hits else ()
        return _new(StepResult, (self._states[into], present.time + dt, self._torques[into][0], impacts))

    @property
    def evaluations(self) -> float:
        """Gap evaluations of the last step; those of the one before if the step was in free flight, far from walls."""
        into = 1 if self._present.state is self._states[1] else 0
        return float(self._calls[into].memory.workspaces["evaluations"][0])

    @override
    def reset(self, state: ArrayLike, time: float = 0.0) -> None:
        ensure_compiled(not self.scene.elastic)
        super().reset(state, time)

    @override
    def snapshot(self) -> StepResult:
        return self._present._replace(state=self.state)  # the block is overwritten by the next step but one

    def _as_stored(self, state: Array) -> Numbers:
        """The state in the block that the present state is not in, once there are blocks."""
        if not self._states:
            return state
        into = 1 if self._present.state is self._states[0] else 0
        self._states[into][:] = state
        return self._states[into]

    def _build_unpickled(self) -> None:
        blocks = np.zeros((2, 1, HEIGHT, 1))  # before and after a step, in turn
        self._blocks, self._states = blocks, list(blocks[:, 0, :12, 0])
        self._calls, self._controls = [Call(new_memory(1, 64)) for _ in range(2)], np.zeros((1, 1))
        self._loop = compiled(run)
        self._times, self._control = list(map(_view, blocks[:, 0, TIME])), _view(self._controls[0])
        self._torques = [_view(call.memory.scratch[TORQUE]) for call in self._calls]
        self._kinds = [np.array([drive_kind(self.scene.drive, held)], np.int64) for held in (False, True)]
        self._cut = [kind[0] in WITH_PIECES for kind in self._kinds]
        # The steps for which arguments are set: their dt [s], whether a torque is held, and how they are scored.
        self._set_for: tuple[float | None, bool, Scoring] = None, False, UNSCORED
        self._present = self._present._replace(state=self._as_stored(self._present.state))

    def _set_arguments(self, dt: float, torque: float | None, scoring: Scoring) -> None:
        """Set the arguments of steps from one block to the other, and back."""
        held, pieces = torque is not None, NO_PIECES
        if self._cut[held]:
            pieces = joined([pieces_for(self.scene.drive, self.time, dt, torque)], np.zeros(1, np.int64))
        numbers, scene_params = np.array([self.scene.numbers]), np.zeros((1, SCENE_PARAMS, 1))
        scenes = Scenes(numbers, scene_params, self._kinds[held], *pieces)
        controls = self._controls if held else np.zeros((0, 0))
        rules = Rules(dt, continue_after_done=True, score=scoring.score, observe=scoring.observe)
        self._set_for = None, held, scoring
        for into, call in enumerate(self._calls):
            call.set_arguments(scenes, rules, self._blocks[1 - into], self._blocks[into], controls, scoring.results)
        self._set_for = None if self._cut[held] else dt, held, scoring


_new: Callable[..., StepResult] = tuple.__new__  # twice as fast as StepResult(...)


def _view(number: Array) -> memoryview[float]:
    """A number in an array, shape (1,), for faster access."""
    return cast("memoryview[float]", number.data)


def recorded(log: Array, time: float) -> tuple[Impact, ...]:
    """The impacts in the rows of a step's log, which started at ``time`` [s]."""
    return tuple(Impact(time + since, int(wall), int(foot), impulse) for since, wall, foot, impulse in log.tolist())
