"""The memory that a step of the exact contact model works in, so that nothing is allocated on the way.

A workspace is one record with named fields: compiled code hands on its address, where several arrays would take longer
to pass than the physics takes.
"""

from __future__ import annotations

from enum import IntEnum
from typing import Annotated, Any, NamedTuple, get_args, get_type_hints

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]


class Workspace(np.record):  # type: ignore[misc]
    """A record of these fields, arrays of the shapes that stand beside them. Listed gaps are those that are closed."""

    hits: int  # impacts of the step so far
    impulse: float  # of them [N s]
    evaluations: float  # gaps evaluated
    elapsed: float  # since the step's start [s]
    nonsmooth: int  # 1 where the step has no derivative, or none that can be told, see tangents.py
    state: Annotated[Array, 12]  # in a frame near the box
    before: Annotated[Array, 12]  # of a tangent: the state just before an impact
    after: Annotated[Array, 12]  # of a tangent: the state at the step's end, in the same frame
    powers: Annotated[Array, 9, 16]  # accelerations of the box, see drives.py

    pairs: Annotated[Counts, 17]  # 4 * wall + foot of the listed gaps
    gaps: Annotated[Array, 17]  # [m]
    gradients: Annotated[Array, 17, 6]
    units: Annotated[Array, 17, 6]  # the same in weighted coordinates, at length 1
    lengths: Annotated[Array, 17]  # of the weighted gradients
    bias: Annotated[Array, 17]  # what is added to the gaps' rates, in units of the weighted gradients
    impulses: Annotated[Array, 17]  # [N s]
    rates: Annotated[Array, 6]  # weighted
    projected: Annotated[Array, 6]  # the weighted rates' projection
    pushes: Annotated[Array, 3]  # that lead to it
    best: Annotated[Array, 3]  # of the pushes
    basis: Annotated[Array, 4, 6]  # of Gram-Schmidt, orthonormal rows, with triangle and goals
    triangle: Annotated[Array, 3, 3]
    goals: Annotated[Array, 3]

    holding: int  # how many feet are held, or were last in this step; they are first in pairs
    loose: int  # feet that were let go at this moment, bit 4 * wall + foot of each
    resting: Annotated[Array, 16]  # impulses of held feet in this step [N s], by 4 * wall + foot
    order: Annotated[Counts, 3]  # of held feet among the listed gaps
    targets: Annotated[Array, 3]  # to which their gaps are brought back [m]
    free: Annotated[Array, 6]  # accelerations without contact
    column: Annotated[Array, 3]  # of the inverse of a triangle, see constrained.invert
    drift: Annotated[Array, 6]  # of a tangent's free flight, see tangents.py
    series: Annotated[Array, 31, 16]  # powers of time over a stretch, in the rows below
    inverse: Annotated[Array, 3, 3]  # of J M^-1 J^T at held feet
    lack: Annotated[Array, 3]  # of J qddot there


Workspaces = NDArray[Any]  # of records

# Rows of a workspace's series, on the box's axes, see constrained.py.
PLACE_X, PLACE_Y, PSI, TURNED = range(4)  # jack's centre [m], its relative angle, the box's turn [rad]
RATE_X, RATE_Y, SPIN, OMEGA = range(4, 8)  # their rates, per stretch
ALPHA, JACK_ALPHA = 8, 9  # angular accelerations of box and jack, per stretch squared
DRIVEN, PUSHED_X, PUSHED_Y = 10, 11, 12  # what the drive gives the box: angular acceleration, and that of its centre
BOX_COSINE, BOX_SINE, COSINE, SINE = range(13, 17)  # of the box's angle and of psi
OMEGA_SQUARED, SPIN_SQUARED = 17, 18
FORCE = 19  # at held feet, 3 rows; of each the levers about box and jack [m], and the foot's extent along the normal
BOX_LEVER, JACK_LEVER, EXTENT = 22, 25, 28  # 3 rows each

# Rows of a thread's memory for a block of environments, (LANES, width); 0 to 3 are scratch.
TORQUE, TURNING = 4, 5  # [N m]; angular acceleration of the box [rad/s^2], or a bound of it
NEAR, HIT, IMPULSE_SUM = 6, 7, 8  # whether a foot may touch a wall; impacts, their impulse [N s]
# Where lanes near a wall are brought together, see ``glide.look_at_walls``.
AT_MOST, LANE_COSINE, LANE_SINE, AHEAD, ASIDE, LANE_OMEGA, BEND, LANE, APART, PULL, OFF = range(9, 20)
UNPAID = 20  # whether a row earns nothing, because its episode is over
LANES = 21


def _field(name: str, hint: Any) -> tuple[Any, ...]:
    of, *shape = get_args(hint) or (hint,)
    return name, np.int64 if of in (int, Counts) else np.float64, tuple(shape)


_FIELDS = [_field(*of) for of in get_type_hints(Workspace, include_extras=True).items()]
_LAYOUT = np.dtype((Workspace, np.dtype(_FIELDS, align=True)))


def new_lanes(width: int) -> Array:
    """Memory for one thread's blocks of so many environments."""
    return np.zeros((LANES, width))


def new_workspaces(count: int = 1) -> Workspaces:
    """So many workspaces, each for one thread."""
    return np.zeros(count, _LAYOUT)


# Columns of a log: time since the step's start [s], wall, foot, impulse [N s]. A wide log, for derivatives,
# adds the state at the impact, with the rates before it, and the accelerations that the drive gives the box there:
# angular, along x and along y.
AT_IMPACT, DRIVEN_THERE, WIDE = 4, 16, 19


def new_log(impacts: int = 0, wide: bool = False) -> Array:
    """Memory to record so many impacts of a step."""
    return np.zeros((impacts, WIDE if wide else AT_IMPACT))


class Status(IntEnum):
    """How a step ended; all but DONE, PAUSED, FULL and FREE are refusals, after which the state is as it was."""

    DONE = 0
    TOO_MUCH_WORK = 1  # more gap evaluations than a step may take
    TOO_FAST = 2  # motion that float64 no longer resolves, or too far off
    TOO_MANY_TURNS = 3  # of the chirp, within one step
    BAD_ACTION = 4  # NaN or infinite
    TOO_LATE = 5  # the time would not move, or would pass its limit
    BAD_REWARD = 6  # NaN or infinite
    PAUSED = 7  # after long work, so that an interruption is heard: to be called again
    FULL = 8  # no room for a step's impacts: to be called again with more
    FREE = 9  # of a piece: no foot touches a wall, and the state is as it was


class Scenes(NamedTuple):
    """The scenes: one for all rows, or one for each, with what drives their boxes."""

    values: Array  # (1 or N, numbers of a scene)
    lanes: Array  # (1 or blocks, SCENE_LANES, width), see ``restart.spread``
    kinds: Counts  # (1 or N,), what turns the box, see exact.step
    table: Array  # pieces of the drives' functions, (pieces, TABLE_WIDTH)
    begins: Counts  # (1 or N,), where the steps of a row's drive begin in ``ends``
    ends: Counts  # past the last piece of each step, after a leading 0 or the end of the step before


class Rules(NamedTuple):
    """What holds for all rows and steps."""

    dt: float  # control step [s]
    steps: int
    longest: float  # steps after which an episode is truncated
    actions: bool  # whether controls are shares of the torque limit, clipped to [-1, 1], and not torques [N m]
    goes_on: bool  # whether a row is stepped on after its episode's end, without rewards
    until_impact: bool  # whether a row stops after the step of its first impact
    score: Any  # address of the task's ``score_block``; called only where rewards are filled in
    patience: float  # gaps evaluated before the call pauses


class Results(NamedTuple):
    """What a call fills in. Arrays of length 0 are not filled."""

    observations: Floats  # after the last step, (N, 10)
    rewards: Array  # (steps, N), zeros before
    terminations: Flags  # (N,), False before; whether the task has ended the episode
    truncations: Flags  # (N,)
    reports: Array  # of the last step, (N, TERMS + number of terms), zeros before
    lengths: Counts  # steps until the task ends the episode, (N,), all steps before
    trajectories: Array  # (N, steps + 1, 12), without the first states
    energies: Array  # of the states [J], (N, steps + 1)
    hits: Counts  # impacts in each step, (steps, N), zeros before
    impulses: Array  # their sum [N s], (steps, N), zeros before
    nonsmooth: Flags  # whether a step has no derivative, (N, steps)


class Memory(NamedTuple):
    """What one thread works in."""

    lanes: Array  # (LANES, width)
    workspaces: Workspaces  # (1,)
    log: Array  # (impacts, AT_IMPACT or WIDE), records of impacts; (0, ...): they are not recorded


def new_memory(width: int, impacts: int = 0, wide: bool = False) -> Memory:
    """Memory for one thread.

    Args:
        width: rows in a block.
        impacts: how many can be recorded at first.
        wide: whether each is recorded with the state at the impact, for derivatives.
    """
    return Memory(new_lanes(width), new_workspaces(), new_log(impacts, wide))


class Arguments(NamedTuple):
    """All arguments of :func:`run`."""

    scenes: Scenes
    rules: Rules
    before: Array  # (blocks, 16, width): the rows; scratch where there are several steps
    after: Array  # (blocks, 16, width): where they go; after an even number of steps they are back in ``before``
    controls: Array  # (whole part of the steps, N), each held for as many steps; (0, 0): the drives act
    results: Results
    memory: Memory


NOTHING = Results(
    np.zeros((0, 10), np.float32), np.zeros((0, 0)), np.zeros(0, np.bool_), np.zeros(0, np.bool_), np.zeros((0, 0)),
    np.zeros(0, np.int64), np.zeros((0, 0, 12)), np.zeros((0, 0)), np.zeros((0, 0), np.int64), np.zeros((0, 0)),
    np.zeros((0, 0), np.bool_),
)  # fmt: skip
"""Results of no rows, of which nothing is filled in."""
