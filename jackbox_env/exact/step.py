"""One step of the exact contact model: its drive is cut into pieces, and :func:`advance` goes through each.

A piece is cut where feet strike walls, come to rest on them or leave. It reads detect -> evolve -> resolve, in
``search.py``, ``flight.py`` and ``contact.py``; ``rest.py`` treats feet at rest.
The step works in a frame that starts at the box's centre, so it is as good far from the origin as near it.
Everything here is compiled as it stands, see :mod:`jackbox_env.exact.compiler`.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from jackbox_env.exact.drives import DEGREE, TURN, chirp_piece, chirp_pieces, horner, integrate
from jackbox_env.exact.flight import Piece, constant_piece, curved_piece, evolve, flight_of, glide, stays_clear
from jackbox_env.exact.rest import hold, record_rest, settle
from jackbox_env.exact.search import (
    AT_REST,
    ENDLESS,
    GLANCE,
    NONE,
    STEEPEST,
    Touch,
    contact_tolerance,
    first_impact,
    resolution,
    rests,
    strike,
    why_endless,
)
from jackbox_env.exact.trigonometry import without_turns
from jackbox_env.exact.workspace import Array, Status, Workspace
from jackbox_env.scene import SceneNumbers, chirp_turns
from jackbox_env.states import (
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
)

_HOLDING = 40.0  # gaps that take as long as holding feet through a step
_COARSEST = 4.5e12  # whose unit in the last place is 1e-3
_FOUR_PLACES = 8.9e-16  # units in the last place of 1

# What turns the box in a step: a torque held throughout (0 where nothing acts), the scene's chirp, the functions of its
# drive, or a held torque beside the side forces of its drive.
CONSTANT, CHIRP, FUNCTIONS, CONSTANT_BESIDE_FORCES = range(4)


class Plan(NamedTuple):
    """What all steps of a call have in common."""

    dt: float  # [s]
    kind: int  # what turns the box
    clear: float  # square of the distance from the box's centre within which nothing is hit [m^2]; negative: none
    tolerance: float  # gap at which a foot touches [m]
    per_radian: float  # how much larger that is for each radian of an angle [m/rad]


class Pieces(NamedTuple):
    """The pieces of one step's drive of functions."""

    table: Array  # (all pieces, TABLE_WIDTH)
    first: int  # of this step's
    last: int  # past the last of them


def make_numbers(values: Array) -> SceneNumbers:
    """The scene's numbers from their array."""
    return SceneNumbers(
        values[0], values[1], values[2], values[3], values[4], values[5],
        values[6], values[7], values[8], values[9], values[10], values[11], values[12],
    )  # fmt: skip


def make_plan(scene: SceneNumbers, dt: float, kind: int) -> Plan:
    """Work out what all steps have in common."""
    # The jack's path bends off its chord by at most g dt^2 / 8.
    distance = (scene.box_half_width - scene.jack_arm) * (1.0 - 1e-12) - 0.125 * scene.gravity * dt * dt
    clear = distance * distance if distance > 0.0 else -1.0
    per_radian = _FOUR_PLACES * scene.box_half_width if scene.restitution < 1.0 else 0.0
    return Plan(dt, kind, clear, contact_tolerance(scene), per_radian)


def step(
    scene: SceneNumbers, plan: Plan, before: Array, after: Array, time: float, torque: float, pieces: Pieces,
    memory: Workspace, log: Array,
) -> tuple[Status, float]:  # fmt: skip
    """Advance one state by ``plan.dt``.

    Args:
        scene: the scene.
        plan: what all steps have in common.
        before: state, its first 12 numbers.
        after: where the new state goes; may be ``before``.
        time: at the step's start [s].
        torque: held on the box [N m]; not looked at where a drive acts.
        pieces: of the drive's functions, none for other drives.
        memory: to work in.
        log: memory that records impacts, see ``workspace.new_log``.

    Returns:
        How it ended, and the mean torque [N m]. Unless it ended well ``after`` is unchanged.
    """
    clear_tally(memory)
    if plan.kind == CONSTANT:
        alpha = torque / scene.box_inertia
        x, y = before[X_JACK] - before[X_BOX], before[Y_JACK] - before[Y_BOX]
        vx, vy = before[VX_JACK] - before[VX_BOX], before[VY_JACK] - before[VY_BOX]
        fall = scene.gravity * plan.dt
        clear = stays_clear(x, y, vx, vy, fall, plan.dt, plan.clear)
        if not abs(alpha) < STEEPEST or not (clear or is_resolved(scene, before)):
            return Status.TOO_FAST, 0.0
        ended = Status.FREE
        if not clear:
            ended = advance(scene, memory, log, constant_piece(plan.dt, alpha), start(plan, before, memory))
        if ended == Status.FREE:
            glide(before, after, fall, plan.dt, alpha)
            return Status.DONE, scene.box_inertia * alpha
        return finish(ended, plan, before, after, memory, log), scene.box_inertia * alpha
    if not is_resolved(scene, before):
        return Status.TOO_FAST, 0.0
    touch = start(plan, before, memory)
    if plan.kind == CHIRP:
        ended, impulse = advance_chirp(scene, plan, time, touch, memory, log)
    else:
        ended, impulse = advance_pieces(scene, plan, torque, pieces, touch, memory, log)
    mean = torque if plan.kind == CONSTANT_BESIDE_FORCES else impulse / plan.dt
    return finish(ended, plan, before, after, memory, log), mean


def clear_tally(memory: Workspace) -> None:
    """Forget what the last step did."""
    memory.hits, memory.impulse, memory.evaluations, memory.elapsed, memory.nonsmooth = 0, 0.0, 0.0, 0.0, 0
    if memory.holding > 0:
        memory.holding = 0
        for pair in range(16):
            memory.resting[pair] = 0.0


def effort(memory: Workspace) -> float:
    """What a step has cost, in gaps evaluated; a step with held feet takes as long as some forty of them."""
    return float(memory.evaluations + (_HOLDING if memory.holding > 0 else 0.0))


def touch_of(plan: Plan, before: Array) -> Touch:
    """The gaps at which feet touch in a step from a state."""
    furthest = max(max(abs(before[X_BOX]), abs(before[Y_BOX])), max(abs(before[X_JACK]), abs(before[Y_JACK])))
    tolerance = max(plan.tolerance, plan.per_radian * max(abs(before[THETA_BOX]), abs(before[THETA_JACK])))
    return Touch(tolerance, max(tolerance, _FOUR_PLACES * furthest))


def start(plan: Plan, before: Array, memory: Workspace) -> Touch:
    """Take the state into the frame at the box's centre; return the gaps at which feet touch there.

    With loss angles are counted without whole turns, so that a foot at rest stays where it is however far the box has
    turned.
    """
    state = memory.state
    for place in range(12):
        state[place] = before[place]
    state[X_BOX] = state[Y_BOX] = 0.0
    state[X_JACK], state[Y_JACK] = before[X_JACK] - before[X_BOX], before[Y_JACK] - before[Y_BOX]
    if plan.per_radian > 0.0:
        state[THETA_BOX], state[THETA_JACK] = angles_in_step(before)
    return touch_of(plan, before)


def angles_in_step(before: Array) -> tuple[float, float]:
    """The angles of box and jack without the box's whole turns, nor the jack's in it."""
    angle = without_turns(before[THETA_BOX])
    return angle, angle + without_turns(before[THETA_JACK] - before[THETA_BOX])


def is_resolved(scene: SceneNumbers, state: Array) -> bool:
    """Whether float64 resolves places, angles and speeds to a thousandth of what matters here."""
    place = (
        max(max(abs(state[X_BOX]), abs(state[Y_BOX])), max(abs(state[X_JACK]), abs(state[Y_JACK])))
        / scene.box_half_width
    )
    angle = max(abs(state[THETA_BOX]), abs(state[THETA_JACK]))
    speed = (
        max(max(abs(state[VX_BOX]), abs(state[VY_BOX])), max(abs(state[VX_JACK]), abs(state[VY_JACK])))
        / scene.speed_scale
    )
    return bool(max(max(place, angle), speed) < _COARSEST)


def finish(ended: Status, plan: Plan, before: Array, after: Array, memory: Workspace, log: Array) -> Status:
    """Take the state back to the world, unless the step failed or a number is too large; record what held feet took."""
    if ended != Status.DONE:
        return ended
    state = memory.state
    total = 0.0
    for place in range(12):
        total += abs(state[place])
    if not total < LARGEST:
        return Status.TOO_FAST
    jack_x = before[X_JACK] + (state[X_JACK] - (before[X_JACK] - before[X_BOX]))
    jack_y = before[Y_JACK] + (state[Y_JACK] - (before[Y_JACK] - before[Y_BOX]))
    after[X_BOX], after[Y_BOX] = before[X_BOX] + state[X_BOX], before[Y_BOX] + state[Y_BOX]
    after[X_JACK], after[Y_JACK] = jack_x, jack_y
    after[THETA_BOX], after[THETA_JACK] = state[THETA_BOX], state[THETA_JACK]
    if plan.per_radian > 0.0:
        angle, jack_angle = angles_in_step(before)
        after[THETA_BOX], after[THETA_JACK] = (
            before[THETA_BOX] + (state[THETA_BOX] - angle),
            before[THETA_JACK] + (state[THETA_JACK] - jack_angle),
        )
    for place in range(RATES, 12):
        after[place] = state[place]
    record_rest(memory, log, plan.dt)
    return ended


def advance_chirp(
    scene: SceneNumbers, plan: Plan, time: float, touch: Touch, memory: Workspace, log: Array
) -> tuple[Status, float]:
    """Advance through a step under the chirp; return how it ended and the torque's impulse [N m s]."""
    count = chirp_pieces(scene, time, plan.dt)
    if count == 0:
        return Status.TOO_MANY_TURNS, 0.0
    turns = chirp_turns(scene.chirp_start_frequency, scene.chirp_rate, time)
    frequency = scene.chirp_start_frequency + scene.chirp_rate * time
    length = plan.dt / count
    impulse = 0.0
    for number in range(count):
        chirp_piece(scene, turns, frequency, number * length, length, memory)
        impulse += horner(memory.powers[3 * TURN + 1], DEGREE + 1, 1.0)
        ended = advance(scene, memory, log, curved_piece(memory, length, False), touch)
        if ended != Status.DONE:
            return ended, 0.0
    return Status.DONE, scene.box_inertia * impulse


def advance_pieces(
    scene: SceneNumbers, plan: Plan, torque: float, pieces: Pieces, touch: Touch, memory: Workspace, log: Array
) -> tuple[Status, float]:
    """Advance through a step under a drive of functions, or a held torque and its side forces."""
    impulse, table = 0.0, pieces.table
    for number in range(pieces.first, pieces.last):
        length = table[number, 1]
        for axis in range(3):
            inertia = scene.box_inertia if axis == TURN else scene.box_mass
            for k in range(DEGREE + 1):
                memory.powers[3 * axis, k] = table[number, 2 + axis * (DEGREE + 1) + k] / inertia
            if axis == TURN and plan.kind == CONSTANT_BESIDE_FORCES:
                for k in range(DEGREE + 1):
                    memory.powers[3 * axis, k] = 0.0
                memory.powers[3 * axis, 0] = torque / inertia
            integrate(memory, axis, length)
        impulse += horner(memory.powers[3 * TURN + 1], DEGREE + 1, 1.0)
        ended = advance(scene, memory, log, curved_piece(memory, length, True), touch)
        if ended != Status.DONE:
            return ended, 0.0
    return Status.DONE, scene.box_inertia * impulse


def advance(scene: SceneNumbers, memory: Workspace, log: Array, piece: Piece, touch: Touch) -> Status:
    """Advance the state ``memory.state`` through a piece; return how it ended.

    FREE: no foot touches a wall under a constant acceleration, and the state is as it was, because :func:`glide` needs
    no frame near the box. ``memory`` has the polynomial accelerations.
    """
    memory.loose = 0
    since, untouched = 0.0, not piece.curved
    restless = False  # whether the state has been found to be without a foot at rest
    while since < piece.length:
        remaining = piece.length - since
        near = resolution(scene, memory, touch)
        left = min(remaining, GLANCE * piece.length) if rests(scene, memory) else remaining
        flight = flight_of(scene, memory.state, piece, since)
        rest = -math.inf if restless else near
        time, pair = first_impact(scene, memory, flight, piece, left, touch.tolerance, rest)
        if pair == AT_REST:
            held = settle(scene, memory, piece, flight, left, touch, near)
            if held == 0:
                restless = True
                continue
            untouched = False
            ended, time = hold(scene, memory, log, piece, touch, near, since, held)
            if ended != Status.DONE:
                return ended
            since += time
            continue
        restless = False
        memory.loose = 0
        if pair == ENDLESS:
            return why_endless(memory)
        if pair == NONE:
            if untouched and left == remaining:
                return Status.FREE
            evolve(memory, flight, left)
            memory.elapsed += left
            if left == remaining:
                return Status.DONE
            since += left
            continue
        untouched = False
        strike(scene, memory, log, flight, time, pair, near)
        since += time
    return Status.DONE
