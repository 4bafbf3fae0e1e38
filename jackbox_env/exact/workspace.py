"""The memory of compiled code: of a step, its log of impacts, and the arguments of ``run.run``.

Callers allocate all of it, and compiled code allocates nothing. A workspace is one record with named fields: passing
its address costs less than passing several arrays, which would take longer than the physics.
"""

from __future__ import annotations

import math
from enum import IntEnum
from functools import cache
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

from jackbox_env.jit.compiler import PACKED, compiled, packed, unpacked_as
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import Array, Counts, Flags, Floats


class Contacts(np.record):  # type: ignore[misc]
    """Contacts that touch, or those of held feet. "Weighted" means in the coordinates M^1/2 q."""

    pairs: Annotated[Counts, 17]  # 4 * wall + foot
    gaps: Annotated[Array, 17]  # [m]
    gradients: Annotated[Array, 17, 6]
    units: Annotated[Array, 17, 6]  # the same in weighted coordinates, at length 1
    lengths: Annotated[Array, 17]  # of the weighted gradients
    bias: Annotated[Array, 17]  # added to the gaps' rates, in units of the weighted gradients
    impulses: Annotated[Array, 17]  # [N s]
    rates: Annotated[Array, 6]  # weighted
    projected: Annotated[Array, 6]  # the weighted rates' projection
    multipliers: Annotated[Array, 3]  # of the projection
    best: Annotated[Array, 3]  # multipliers of the best projection so far
    basis: Annotated[Array, 4, 6]  # of Gram-Schmidt, orthonormal rows, with triangle and goals
    triangle: Annotated[Array, 3, 3]
    goals: Annotated[Array, 3]


class HeldFeet(np.record):  # type: ignore[misc]
    """Feet at rest, and the motion while walls hold them, see ``rest.py`` and ``constrained.py``."""

    holding: int  # number of feet at rest, now or last in this step; they are the first of the listed contacts
    released: int  # feet that were released at this moment, bit 4 * wall + foot of each
    resting: Annotated[Array, 16]  # impulses of held feet in this step [N s], by 4 * wall + foot
    order: Annotated[Counts, 3]  # of held feet among the listed contacts
    targets: Annotated[Array, 3]  # of their gaps [m]
    free: Annotated[Array, 6]  # accelerations without contact
    series: Annotated[Array, 31, 16]  # powers of time over a stretch, in the rows below
    inverse: Annotated[Array, 3, 3]  # of J M^-1 J^T
    column: Annotated[Array, 3]  # of the inverse of a triangle, see constrained.invert
    rhs: Annotated[Array, 3]  # of J qddot


class Workspace(np.record):  # type: ignore[misc]
    """Scratch of one thread: a step's counts and states, and two parts."""

    hits: int  # impacts of the step so far
    impulse: float  # of them [N s]
    evaluations: float  # of gaps
    pieces: int  # of the drive in the step
    work: float  # of the call so far, in gap evaluations
    lane: int  # of a block at which a paused call goes on; 0: at the block's start
    glided: int  # whether the rows of that block that are in free flight have moved
    elapsed: float  # since the step's start [s]
    nonsmooth: int  # 1 if the step is not differentiable, or rounding hides its derivative, see derivatives.py
    state: Annotated[Array, 12]  # in a frame at the box's centre
    before: Annotated[Array, 12]  # of a tangent: the state just before an impact
    after: Annotated[Array, 12]  # of a tangent: the state at the step's end, in the same frame
    drift: Annotated[Array, 6]  # of a tangent's free flight, see tangents.py
    rest: int  # address of ``late.settle_and_advance``; 0: not compiled yet, see late.py
    together: int  # address of ``contact.bounce_together``; 0: not compiled yet
    powers: Annotated[Array, 9, 16]  # accelerations of the box, see flight.py
    contacts: Contacts
    held: HeldFeet


Workspaces = NDArray[Any]  # of records
# Rows of the series of held feet, on the box's axes, see constrained.py.
POSITION_X, POSITION_Y, PSI, TURNED = range(4)  # jack's centre [m], its relative angle, the box's turn [rad]
RATE_X, RATE_Y, SPIN, OMEGA = range(4, 8)  # their rates, per stretch
ALPHA, JACK_ALPHA = 8, 9  # angular accelerations of box and jack, per stretch squared
DRIVEN, PUSHED_X, PUSHED_Y = 10, 11, 12  # accelerations of the box by the drive: angular, and of its centre
BOX_COSINE, BOX_SINE, COSINE, SINE = range(13, 17)  # of the box's angle and of psi
OMEGA_SQUARED, SPIN_SQUARED = 17, 18
FORCE = 19  # at held feet, 3 rows; below: their levers about box and jack, and their extent along the normal [m]
BOX_LEVER, JACK_LEVER, EXTENT = 22, 25, 28  # 3 rows each
# Rows of a block of environments, (HEIGHT, width): the 12 numbers of the state, and these.
TIME, STEPS, OVER = 12, 13, 14  # [s], steps in the episode, 1 if it has ended, 2 if an impact has stopped the row
DECISIONS = 15  # in the episode, counted if each has several steps
HEIGHT = 16
WIDEST = 128  # environments in a block
# Rows of a block's scenes, with one number for each environment.
LIMIT = 0  # of the torque [N m]
INERTIA = 1  # of the box [kg m^2]
FALL = 2  # speed that the jack gains in a step [m/s]
CLEAR = 3  # squared centre distance within which contact is impossible [m^2], as in ``step.StepParameters``
ROOM = 4  # distance of the centres at which the jack's feet reach a wall [m]
ORDINARY = 5  # bound of ordinary numbers of the state, see ``glide.ordinary``
JACK_ARM = 6  # of the jack [m]
SCENE_PARAMS = 7
# Rows of a thread's memory for a block of environments, (SCRATCH, width); 0 to 3 are scratch.
TORQUE, TURNING = 4, 5  # mean over the step [N m]; angular acceleration of the box [rad/s^2], or a bound of it
NEAR, HITS, IMPULSE_SUM = 6, 7, 8  # whether a foot may touch a wall; impacts, their impulse [N s]
# Rows of lanes near a wall, gathered at the front by ``glide.clear_marks``.
ALPHA_BOUND, LANE_COSINE, LANE_SINE, AHEAD, ASIDE, LANE_OMEGA = range(9, 15)
LANE_CURVATURE, LANE_INDEX, LANE_ROOM, LANE_PULL, ORDINARY_LANE = range(15, 20)
RELATIVE_COSINE, RELATIVE_SINE, LANE_SPIN, LANE_ARM, CLEARANCE = range(20, 25)
UNSCORED = 25  # whether a row earns nothing because its episode is over
SEPARATED = 26  # whether a step of the call had no impact
APPLIED = 27  # torque of the controls [N m]
LEFT = 28  # whether a row is left to be stepped alone
SCRATCH = 29


def column_of(blocks: Array, row: int, count: int) -> Array:
    """A copy of one row of blocks, such as ``TIME``, shape (N,)."""
    return blocks[:, row].reshape(-1)[:count].copy()


def states_of(blocks: Array, count: int) -> Array:
    """A copy of the states in blocks, shape (N, 12)."""
    return blocks[:, :12].transpose(0, 2, 1).copy().reshape(-1, 12)[:count]


@cache
def _layout(record: type[np.record]) -> np.dtype[Any]:
    """The layout of a record with these fields, with the shapes of arrays, and of records within it."""
    fields = []
    for name, hint in get_type_hints(record, include_extras=True).items():
        of, *shape = get_args(hint) or (hint,)
        kind: Any = np.int64 if of in (int, Counts) else np.float64
        if of in (Contacts, HeldFeet):
            kind = _layout(of)
        fields.append((name, kind, tuple(shape)))
    return np.dtype((record, np.dtype(fields, align=True)))


def new_workspaces() -> Workspaces:
    """The workspace of one thread, as an array of one record."""
    return np.zeros(1, _layout(Workspace))


# Columns of a log: time since the step's start [s], wall, foot, impulse [N s]. A wide log, for derivatives, adds the
# state just before the impact, and the accelerations of the box by the drive there: angular, along x and along y.
AT_IMPACT, DRIVEN_THERE, WIDE = 4, 16, 19
# A log of jumps adds the states before and after instead, in the step's frame, and the number of feet held in the step
# so far; -1 if the row is the impulse of a foot at rest, which has no jump.
BEFORE, AFTER, HELD_SO_FAR, JUMPS = 4, 16, 28, 29


def new_log(impacts: int = 0, wide: bool = False) -> Array:
    """A log with room for ``impacts`` impacts of a step."""
    return np.zeros((impacts, WIDE if wide else AT_IMPACT))


class Status(IntEnum):
    """How a step or a call ended.

    All but DONE, PAUSED, FULL, FREE and UNCOMPILED are errors, which leave the state unchanged.
    """

    DONE = 0
    TOO_MUCH_WORK = 1  # more gap evaluations than a step may take
    TOO_FAST = 2  # float64 does not resolve the motion, or it is too far off
    TOO_MANY_TURNS = 3  # of the chirp, within one step
    BAD_ACTION = 4  # NaN or infinite
    TOO_LATE = 5  # the time would stand still or pass its limit
    BAD_REWARD = 6  # NaN or infinite
    PAUSED = 7  # after long work, so that Python can handle an interruption: call again
    FULL = 8  # no room for a step's impacts: call again with more
    FREE = 9  # of a piece: no foot touches a wall, or of feet at rest: there are none; the state is unchanged
    NO_DRIVE = 10  # a function of the drive fails over the step
    BAD_TORQUE = 11  # of an action: NaN
    BAD_OBSERVATION = 12  # NaN
    UNCOMPILED = 13  # a step needs what is compiled later: call again with it, see late.py


class Scenes(NamedTuple):
    """The scenes and their drives: one for all rows, or one for each."""

    values: Array  # (1 or N, numbers of a scene)
    scene_params: Array  # (1 or blocks, SCENE_PARAMS, width), see ``glide.write_scene_params``
    drive_kinds: Counts  # (1 or N,), what turns the box, see step.py
    table: Array  # pieces of the drives' functions, (pieces, TABLE_WIDTH)
    begins: Counts  # (1 or N,), where the steps of a row's drive begin in ``ends``
    ends: Counts  # past the last piece of each step, after a leading 0 or the end of the step before; none: a failure


# Kinds of controls: torques [N m]; shares of the torque limit, clipped to [-1, 1]; actions, whose torques ``act_block``
# computes.
CONTROL_TORQUES, CONTROL_SHARES, CONTROL_ACTIONS = range(3)


class Rules(NamedTuple):
    """Settings of all rows and steps."""

    dt: float  # control step [s]
    steps: int = 1
    longest: float = math.inf  # steps after which an episode is truncated
    controls: int = CONTROL_TORQUES  # their kind: CONTROL_TORQUES, CONTROL_SHARES or CONTROL_ACTIONS
    continue_after_done: bool = False  # whether rows go on after their episode's end, without rewards
    # 0: impacts stop no row; else one does after a step without, or once so many steps are made.
    max_contact_steps: int = 0
    decisions: float = math.inf  # calls after which an episode is truncated; counted if it is finite
    score: Any = 0  # address of the task's ``score_block``; unused without rewards
    observe: Any = 0  # address of the observation's ``observe_rows``; unused without observations
    act: Any = 0  # address of the action's ``act_block``; unused but with CONTROL_ACTIONS
    patience: float = math.inf  # work before the call pauses, in gap evaluations


class Results(NamedTuple):
    """Arrays that a call fills in, except those of length 0."""

    observations: Floats = np.zeros((0, 10), np.float32)  # after the last step, (N, numbers)
    rewards: Array = np.zeros((0, 0))  # (steps, N), zeros before; (1, N): of the last step alone
    returns: Array = np.zeros(0)  # sums of the rewards, (N,), zeros before
    terminations: Flags = np.zeros(0, np.bool_)  # (N,), False before; whether the task has ended the episode
    truncations: Flags = np.zeros(0, np.bool_)  # (N,), False before
    reports: Array = np.zeros((0, 0))  # sums over the steps, (N, TERMS + number of terms), zeros before
    lengths: Counts = np.zeros(0, np.int64)  # steps until the task ends the episode, (N,), all steps before
    # States after step k in place k, (N, steps + 1, 12); with fewer places, k modulo their number.
    trajectories: Array = np.zeros((0, 0, 12))
    energies: Array = np.zeros((0, 0))  # of the states [J], (N, steps + 1)
    hits: Counts = np.zeros((0, 0), np.int64)  # impacts in each step, (steps, N), zeros before
    impulses: Array = np.zeros((0, 0))  # their sum [N s], (steps, N), zeros before
    nonsmooth: Flags = np.zeros((0, 0), np.bool_)  # whether a step has no derivative, (N, steps)


class ThreadMemory(NamedTuple):
    """The memory of one thread."""

    scratch: Array  # (SCRATCH, width)
    workspaces: Workspaces  # (1,)
    log: Array  # (impacts, AT_IMPACT or WIDE), records of impacts; (0, ...): they are not recorded


def new_memory(width: int, impacts: int = 0, wide: bool = False) -> ThreadMemory:
    """Memory for one thread.

    Args:
        width: rows in a block.
        impacts: room in the log at first.
        wide: whether the log records the states at impacts, for derivatives.
    """
    return ThreadMemory(np.zeros((SCRATCH, width)), new_workspaces(), new_log(impacts, wide))


class Arguments(NamedTuple):
    """All arguments of :func:`jackbox_env.exact.run.run`."""

    scenes: Scenes
    rules: Rules
    before: Array  # (blocks, 16, width): the rows; overwritten if there are several steps
    after: Array  # (blocks, 16, width): the rows after an odd number of steps; else they are in ``before``
    controls: (
        Array  # (steps / repeat, N), each repeated for as many steps; CONTROL_ACTIONS: (n, N). (0, 0): the drives act
    )
    results: Results
    memory: ThreadMemory


def example() -> Arguments:
    """Empty arguments of the types that :func:`jackbox_env.exact.run.run` is compiled for."""
    none, cube, counts = np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros(0, np.int64)
    scenes, memory = Scenes(none, cube, counts, none, counts, counts), ThreadMemory(none, new_workspaces(), none)
    return Arguments(scenes, Rules(0.02), cube, cube, none, Results(), memory)


arguments_at = unpacked_as(example)


class Call:
    """A call of :func:`jackbox_env.exact.run.run`: its arguments at an ``address``, and the calling thread's memory."""

    def __init__(self, memory: ThreadMemory) -> None:
        self.memory = memory
        self._packed = np.zeros(PACKED)  # the arguments as compiled code reads them
        self.address, self._pack, self._pack_arrays = 0, compiled(pack), compiled(pack_arrays)

    def set_arguments(
        self, scenes: Scenes, rules: Rules, before: Array, after: Array, controls: Array, results: Results
    ) -> None:
        """Set the arguments. Numba unpacks plain tuples faster than named ones."""
        self._arguments = scenes, rules, before, after, controls, results  # keeps the arrays alive
        self.address = self._pack(
            self._packed, tuple(scenes), tuple(rules), before, after, controls, tuple(results), *self.memory
        )

    def set_arrays(self, before: Array, after: Array, controls: Array, results: Results) -> None:
        """Set other arrays for the same scenes and rules. From ``lengths`` on, the results have length 0."""
        scenes, rules, *_ = self._arguments
        self._arguments = scenes, rules, before, after, controls, results
        self.address = self._pack_arrays(
            self._packed, self.address, before, after, controls, results.observations, results.rewards,
            results.returns, results.terminations, results.truncations, results.reports,
        )  # fmt: skip

    def with_room(self) -> Call:
        """A copy of this call whose log has room for twice as many impacts; an interruption leaves this one intact."""
        log = self.memory.log
        twin = Call(self.memory._replace(log=np.zeros((2 * len(log), log.shape[1]))))
        twin.set_arguments(*self._arguments)
        return twin


def pack(
    memory: Array, scenes: Any, rules: Any, before: Array, after: Array, controls: Array, results: Any,
    scratch: Array, workspaces: Workspaces, log: Array,
) -> Any:  # fmt: skip
    """Store the arguments of :func:`jackbox_env.exact.run.run` in ``memory``; return the address there."""
    return packed(
        memory.ctypes.data,
        Arguments(
            Scenes(*scenes), Rules(*rules), before, after, controls, Results(*results),
            ThreadMemory(scratch, workspaces, log),
        ),
    )  # fmt: skip


def pack_arrays(
    memory: Array, address: Any, before: Array, after: Array, controls: Array, observations: Floats, rewards: Array,
    returns: Array, terminations: Flags, truncations: Flags, reports: Array,
) -> Any:  # fmt: skip
    """Replace some arguments in ``memory``, which has this ``address``."""
    call = arguments_at(address)
    rest = call.results
    results = Results(
        observations=observations,
        rewards=rewards,
        returns=returns,
        terminations=terminations,
        truncations=truncations,
        reports=reports,
        lengths=rest.lengths,
        trajectories=rest.trajectories,
        energies=rest.energies,
        hits=rest.hits,
        impulses=rest.impulses,
        nonsmooth=rest.nonsmooth,
    )
    return packed(memory.ctypes.data, Arguments(call.scenes, call.rules, before, after, controls, results, call.memory))


def make_numbers(values: Array) -> SceneNumbers:
    """The scene's numbers from their array."""
    return SceneNumbers(
        values[0], values[1], values[2], values[3], values[4], values[5],
        values[6], values[7], values[8], values[9], values[10], values[11], values[12],
    )  # fmt: skip


def scene_at(values: Array, row: int) -> SceneNumbers:
    """The numbers of a row's scene, where ``values`` has one row for all or one for each."""
    return make_numbers(values[row if values.shape[0] > 1 else 0])
