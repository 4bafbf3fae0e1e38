"""One step of the exact contact model: detect -> evolve -> resolve -> record, until the step's time has passed.

``run.py`` calls :func:`step` for one row. The step is cut into pieces in which the drive is a constant or a polynomial.
:func:`advance` loops over the impacts of a piece: ``search.py`` detects the next one, ``flight.py`` evolves the state
to it, ``contact.py`` resolves it and records it in the log. ``rest.py`` moves the jack while feet rest on walls.
Positions are measured from the box's centre at the step's start, so a step far from the origin is as accurate as one
near it.
A step covers the times in (0, dt]: an impact at its very end belongs to it and not to the next step. Only a foot that
touches and approaches in the first state strikes at time 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from jackbox_env.exact.contact import ContactTolerances, contact_resolution, record_rest, resolve
from jackbox_env.exact.flight import (
    DEGREE,
    TURN,
    Flight,
    Piece,
    chirp_piece,
    chirp_pieces,
    constant_piece,
    curved_piece,
    driven_at,
    evolve,
    flight_of,
    free_flight,
    horner,
    integrate,
    stays_clear,
)
from jackbox_env.exact.geometry import without_turns
from jackbox_env.exact.late import advance_resting
from jackbox_env.exact.search import (
    AT_REST,
    NO_IMPACT,
    SHORT_HORIZON,
    STEEPEST,
    UNDECIDED,
    Event,
    first_impact,
    is_chattering,
    why_undecided,
)
from jackbox_env.exact.workspace import AT_IMPACT, DRIVEN_THERE, WIDE, Status, Workspace
from jackbox_env.jit.compiler import inlined
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import (
    LARGEST,
    RATES,
    THETA_BOX,
    THETA_JACK,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
    copy_numbers,
)

# Gap evaluations that take as long as a step with feet at rest; a piece of a drive takes as long as one.
_HOLDING_COST = 40.0
_LARGEST_RESOLVED = 4.5e12  # its unit in the last place is 1e-3
_FOUR_ULPS = 8.9e-16  # of 1
# What turns the box in a step: a constant torque (0 if nothing acts), the scene's chirp, the functions of its drive, or
# a constant torque together with the side forces of its drive.
CONSTANT, CHIRP, FUNCTIONS, CONSTANT_BESIDE_FORCES = range(4)


class StepParameters(NamedTuple):
    """Numbers that all steps of a call have in common."""

    dt: float  # [s]
    drive_kind: int  # what turns the box: CONSTANT, CHIRP, FUNCTIONS or CONSTANT_BESIDE_FORCES
    clear: float  # squared centre distance within which contact is impossible [m^2]; negative: test disabled
    tolerance: float  # gap at which a foot touches [m]
    per_radian: float  # angle-rounding tolerance per radian of the larger angle [m/rad]; 0 if restitution is 1


class Pieces(NamedTuple):
    """The pieces of one step under a drive of functions: rows ``first`` to ``last`` - 1 of a table."""

    table: Array  # (all pieces, TABLE_WIDTH), see flight.py
    first: int
    last: int


def make_parameters(scene: SceneNumbers, dt: float, kind: int) -> StepParameters:
    """The numbers that all steps have in common."""
    # The jack's path bends off its chord by at most g dt^2 / 8.
    distance = (scene.box_half_width - scene.jack_arm) * (1.0 - 1e-12) - 0.125 * scene.gravity * dt * dt
    clear = distance * distance if distance > 0.0 else -1.0
    per_radian = _FOUR_ULPS * scene.box_half_width if scene.restitution < 1.0 else 0.0
    # 1e-13 m, less in boxes below 1 m, never below the rounding of a gap.
    tolerance = max(1e-13 * min(1.0, scene.box_half_width), 3.6e-15 * scene.box_half_width)
    return StepParameters(dt, kind, clear, tolerance, per_radian)


def step(
    scene: SceneNumbers, params: StepParameters, before: Array, after: Array, time: float, torque: float,
    pieces: Pieces, memory: Workspace, log: Array,
) -> tuple[Status, float]:  # fmt: skip
    """Advance one state by ``params.dt``.

    Args:
        scene: the scene.
        params: what all steps have in common.
        before: the state, in the first 12 numbers.
        after: written with the new state; another array than ``before``.
        time: at the step's start [s].
        torque: constant, on the box [N m]; ignored under a drive.
        pieces: of the drive's functions; none for other drives.
        memory: scratch.
        log: filled with impacts, see ``workspace.new_log``.

    Returns:
        How it ended, and the mean torque [N m]. ``after`` is unchanged unless the step is ``DONE``.
    """
    reset_counters(memory)
    if params.drive_kind == CONSTANT:
        alpha = torque / scene.box_inertia
        x, y = before[X_JACK] - before[X_BOX], before[Y_JACK] - before[Y_BOX]
        vx, vy = before[VX_JACK] - before[VX_BOX], before[VY_JACK] - before[VY_BOX]
        fall = scene.gravity * params.dt
        clear = stays_clear(x, y, vx, vy, fall, params.dt, params.clear)
        if not abs(alpha) < STEEPEST or not (clear or is_resolved(scene, before)):
            return Status.TOO_FAST, 0.0
        ended = Status.FREE
        if not clear:
            ended = advance(scene, memory, log, constant_piece(params.dt, alpha), enter_frame(params, before, memory))
        if ended == Status.FREE:  # no foot touches a wall
            free_flight(before, after, fall, params.dt, alpha)
            return Status.DONE, scene.box_inertia * alpha
        return leave_frame(ended, params, before, after, memory, log), scene.box_inertia * alpha
    if not is_resolved(scene, before):
        return Status.TOO_FAST, 0.0
    tolerances = enter_frame(params, before, memory)
    ended, impulse = advance_pieces(scene, params, time, torque, pieces, tolerances, memory, log)
    mean = torque if params.drive_kind == CONSTANT_BESIDE_FORCES else impulse / params.dt
    return leave_frame(ended, params, before, after, memory, log), mean


def reset_counters(memory: Workspace) -> None:
    """Set what is counted during a step to 0."""
    held = memory.held
    memory.hits, memory.impulse, memory.evaluations, memory.elapsed, memory.nonsmooth = 0, 0.0, 0.0, 0.0, 0
    memory.pieces = 0
    if held.holding > 0:
        held.holding = 0
        held.resting[:] = 0.0


def effort(memory: Workspace) -> float:
    """The cost of the last step, in gap evaluations; feet at rest cost as much as 40 of them."""
    return float(memory.evaluations + memory.pieces + (_HOLDING_COST if memory.held.holding > 0 else 0.0))


def tolerances_of(params: StepParameters, before: Array) -> ContactTolerances:
    """The gaps at which feet touch in a step from a state."""
    furthest = max(max(abs(before[X_BOX]), abs(before[Y_BOX])), max(abs(before[X_JACK]), abs(before[Y_JACK])))
    tolerance = max(params.tolerance, params.per_radian * max(abs(before[THETA_BOX]), abs(before[THETA_JACK])))
    return ContactTolerances(tolerance, max(tolerance, _FOUR_ULPS * furthest))


@inlined
def enter_frame(params: StepParameters, before: Array, memory: Workspace) -> ContactTolerances:
    """Copy the state to ``memory.state``, in a frame at the box's centre; return the gaps at which feet touch.

    With loss whole turns are taken off the angles, so that a foot at rest stays in place however far the box has
    turned.
    """
    state = memory.state
    copy_numbers(12, before, state)
    state[X_BOX] = state[Y_BOX] = 0.0
    state[X_JACK], state[Y_JACK] = before[X_JACK] - before[X_BOX], before[Y_JACK] - before[Y_BOX]
    if params.per_radian > 0.0:
        state[THETA_BOX], state[THETA_JACK] = angles_in_step(before)
    return tolerances_of(params, before)


def angles_in_step(before: Array) -> tuple[float, float]:
    """The angle of the box without whole turns, and that of the jack without its whole turns relative to the box."""
    angle = without_turns(before[THETA_BOX])
    return angle, angle + without_turns(before[THETA_JACK] - before[THETA_BOX])


def is_resolved(scene: SceneNumbers, state: Array) -> bool:
    """Whether float64 resolves positions, angles and speeds to a thousandth of L, 1 rad and the speed scale."""
    position = (
        max(max(abs(state[X_BOX]), abs(state[Y_BOX])), max(abs(state[X_JACK]), abs(state[Y_JACK])))
        / scene.box_half_width
    )
    angle = max(abs(state[THETA_BOX]), abs(state[THETA_JACK]))
    speed = (
        max(max(abs(state[VX_BOX]), abs(state[VY_BOX])), max(abs(state[VX_JACK]), abs(state[VY_JACK])))
        / scene.speed_scale
    )
    return bool(max(max(position, angle), speed) < _LARGEST_RESOLVED)


@inlined
def leave_frame(
    ended: Status, params: StepParameters, before: Array, after: Array, memory: Workspace, log: Array
) -> Status:
    """Write the state back to ``after``, and record the impulses of feet at rest.

    Nothing is written if the step failed or a number is too large.
    """
    if ended != Status.DONE:
        return ended
    state = memory.state
    total = 0.0
    for index in range(12):
        total += abs(state[index])
    if not total < LARGEST:
        return Status.TOO_FAST
    for box, jack in ((X_BOX, X_JACK), (Y_BOX, Y_JACK)):
        after[box] = before[box] + state[box]
        after[jack] = before[jack] + (state[jack] - (before[jack] - before[box]))
    after[THETA_BOX], after[THETA_JACK] = state[THETA_BOX], state[THETA_JACK]
    if params.per_radian > 0.0:
        angle, jack_angle = angles_in_step(before)
        after[THETA_BOX], after[THETA_JACK] = (
            before[THETA_BOX] + (state[THETA_BOX] - angle),
            before[THETA_JACK] + (state[THETA_JACK] - jack_angle),
        )
    copy_numbers(6, state[RATES:], after[RATES:])
    record_rest(memory, log, params.dt)
    return ended


def advance_pieces(
    scene: SceneNumbers, params: StepParameters, time: float, torque: float, pieces: Pieces,
    tolerances: ContactTolerances, memory: Workspace, log: Array,
) -> tuple[Status, float]:  # fmt: skip
    """Advance through a step under the chirp, a drive of functions, or a held torque and the side forces of a drive.

    Returns how it ended, and the torque's impulse [N m s].
    """
    chirp = params.drive_kind == CHIRP
    count = chirp_pieces(scene, time, params.dt) if chirp else pieces.last - pieces.first
    if count == 0:
        return Status.TOO_MANY_TURNS if chirp else Status.NO_DRIVE, 0.0
    length, impulse, memory.pieces = params.dt / count, 0.0, count
    for number in range(count):
        if chirp:
            chirp_piece(scene, time, number * length, length, memory)
        else:
            length = pieces.table[pieces.first + number, 1]
            function_piece(scene, params, torque, pieces.table[pieces.first + number], memory)
        impulse += horner(memory.powers[3 * TURN + 1], DEGREE + 1, 1.0)
        ended = advance(scene, memory, log, curved_piece(memory, length, not chirp), tolerances)
        if ended != Status.DONE:
            return ended, 0.0
    return Status.DONE, scene.box_inertia * impulse


def function_piece(scene: SceneNumbers, params: StepParameters, torque: float, row: Array, memory: Workspace) -> None:
    """Fill in the accelerations of the box by functions, a row of their table, and by a ``torque`` if one is held."""
    for axis in range(3):
        inertia = scene.box_inertia if axis == TURN else scene.box_mass
        for k in range(DEGREE + 1):
            memory.powers[3 * axis, k] = row[2 + axis * (DEGREE + 1) + k] / inertia
        if axis == TURN and params.drive_kind == CONSTANT_BESIDE_FORCES:  # for which the table has no torque
            memory.powers[3 * axis, 0] = torque / inertia
        integrate(memory, axis, row[1])


def advance(scene: SceneNumbers, memory: Workspace, log: Array, piece: Piece, tolerances: ContactTolerances) -> Status:
    """Advance ``memory.state`` through a piece, from impact to impact; return how it ended.

    Under a constant acceleration it returns FREE if no foot touches a wall. The state is then unchanged, because
    :func:`free_flight` needs no frame at the box. The polynomial accelerations are in ``memory``.
    """
    memory.held.released = 0
    since, untouched = 0.0, not piece.curved
    none_rests = False  # whether no foot rests now
    while since < piece.length:
        # Detect.
        remaining = piece.length - since
        resolution = contact_resolution(scene, memory, tolerances)
        horizon = min(remaining, SHORT_HORIZON * piece.length) if is_chattering(scene, memory) else remaining
        flight = flight_of(scene, memory.state, piece, since)
        rest_resolution = -math.inf if none_rests else resolution
        event = first_impact(scene, memory, flight, piece, horizon, tolerances.tolerance, rest_resolution)
        if event.outcome == AT_REST:
            ended, time = advance_resting(scene, memory, log, piece, flight, horizon, tolerances, resolution)
            if ended == Status.FREE:
                none_rests = True
                continue
            untouched = False
            if ended != Status.DONE:
                return ended
            since += time
            continue
        none_rests = False
        memory.held.released = 0
        if event.outcome == UNDECIDED:
            return why_undecided(memory)
        if event.outcome == NO_IMPACT:
            if untouched and horizon == remaining:
                return Status.FREE
            evolve(memory, flight, horizon)  # without an impact
            memory.elapsed += horizon
            if horizon == remaining:
                return Status.DONE
            since += horizon
            continue
        untouched = False
        # Evolve, resolve, record.
        ended = strike(scene, memory, log, flight, event, resolution)
        if ended != Status.DONE:
            return ended
        since += event.time
    return Status.DONE


def strike(
    scene: SceneNumbers, memory: Workspace, log: Array, flight: Flight, impact: Event, resolution: float
) -> Status:
    """Fly to an impact, and resolve all contacts there; return DONE, or UNCOMPILED as ``contact.resolve`` does."""
    evolve(memory, flight, impact.time)
    memory.elapsed += impact.time
    memory.evaluations += 1.0
    if memory.hits < log.shape[0] and log.shape[1] == WIDE:
        record_state(log[memory.hits], flight, memory, impact.time)
    return resolve(scene, memory, log, resolution, impact.wall, impact.foot)


def record_state(row: Array, flight: Flight, memory: Workspace, time: float) -> None:
    """Write the state before an impact ``time`` [s] into the flight, and the drive's accelerations, to a wide log."""
    copy_numbers(12, memory.state, row[AT_IMPACT:])
    row[DRIVEN_THERE], row[DRIVEN_THERE + 1], row[DRIVEN_THERE + 2] = driven_at(flight, memory, time)
