"""One step of the exact contact model: its drive cut into pieces, each given to the kernel.

The step happens in a frame that starts at the box's centre, so that far from the origin is as good as near it.
Everything here is compiled as it stands, see :mod:`jackbox_env.compiled.compiler`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.drives import ALPHA, DEGREE, chirp_piece, chirp_pieces, horner, integrate
from jackbox_env.compiled.search import (
    DONE,
    NONE,
    NOT_KNOWN,
    STEEPEST,
    TOO_FAST,
    Flight,
    advance,
    bounds_of,
    box_frame,
    contact_tolerance,
    next_impact,
    walls_in_reach,
)
from jackbox_env.compiled.workspace import HITS, PIECE, STATE, TALLY, Workspace
from jackbox_env.scene import SceneNumbers, chirp_turns
from jackbox_env.states import LARGEST

Array = NDArray[np.float64]

_COARSEST = 4.5e12  # whose unit in the last place is 1e-3

# What the scene's drive is.
NO_DRIVE, CHIRP, FUNCTIONS = range(3)
TOO_MANY_TURNS = 3  # how a step ended, besides the kernel's ways


class Plan(NamedTuple):
    """What all steps of a call have in common."""

    dt: float  # [s]
    drive: int
    clear: float  # square of the distance from the box's centre within which nothing is hit [m^2]; negative: none
    tolerance: float  # gap at which a foot touches [m]


def make_numbers(values: Array) -> SceneNumbers:
    """The scene's numbers from their array."""
    return SceneNumbers(
        values[0], values[1], values[2], values[3], values[4], values[5],
        values[6], values[7], values[8], values[9], values[10], values[11],
    )  # fmt: skip


def make_plan(n: SceneNumbers, dt: float, drive: int) -> Plan:
    """Work out what all steps have in common."""
    # The jack's path bends off its chord by at most g dt^2 / 8.
    distance = (n.box_half_width - n.jack_arm) * (1.0 - 1e-12) - 0.125 * n.gravity * dt * dt
    return Plan(dt, drive, distance * distance if distance > 0.0 else -1.0, contact_tolerance(n))


def step(
    n: SceneNumbers, plan: Plan, before: Array, after: Array, time: float, torque: float,
    table: Array, first: int, last: int, w: Workspace,
) -> tuple[int, float]:  # fmt: skip
    """Advance one state by ``plan.dt``.

    Args:
        n: the scene.
        plan: what all steps have in common.
        before: state, its first 12 numbers.
        after: where the new state goes; may be ``before``.
        time: at the step's start [s].
        torque: held on the box [N m]; NaN: the scene's drive.
        table: pieces of a drive of functions, shape (pieces, ``TABLE_WIDTH``).
        first: of this step's pieces.
        last: past the last of them.
        w: memory to work in; ``w`` then holds the impacts.

    Returns:
        How it ended, and the mean torque [N m]. Unless it ended well ``after`` is unchanged.
    """
    clear_tally(w)
    held = torque == torque
    dt = plan.dt
    if plan.drive == NO_DRIVE or (held and plan.drive == CHIRP):
        alpha = torque / n.box_inertia if held else 0.0
        x, y = before[3] - before[0], before[4] - before[1]
        vx, vy = before[9] - before[6], before[10] - before[7]
        if stays_clear(x, y, vx, vy, n.gravity * dt, plan) and abs(alpha) < STEEPEST:
            glide(n, before, after, dt, alpha)
            return DONE, n.box_inertia * alpha
        return step_near(n, plan, before, after, alpha, w), n.box_inertia * alpha
    together = start(plan, before, w[STATE])
    if not told_apart(n, before):
        return TOO_FAST, 0.0
    if plan.drive == CHIRP:
        ended, impulse = advance_chirp(n, plan, time, together, w)
    else:
        ended, impulse = advance_table(n, plan, torque, table, first, last, together, w)
    return finish(ended, before, w[STATE], after), torque if held else impulse / dt


def clear_tally(w: Workspace) -> None:
    """Forget what the last step did."""
    for place in range(4):
        w[TALLY, place] = 0.0


def step_near(n: SceneNumbers, plan: Plan, before: Array, after: Array, alpha: float, w: Workspace) -> int:
    """Step near a wall under a constant angular acceleration of the box; return how it ended."""
    if not (told_apart(n, before) and abs(alpha) < STEEPEST):
        return TOO_FAST
    flight = Flight(
        before[3] - before[0], before[4] - before[1], before[9] - before[6], before[10] - before[7], before[2],
        before[8], before[5], before[11], n.gravity, alpha, 0.0, 0.5 * plan.dt, False, False,
    )  # fmt: skip
    bounds = bounds_of(n, flight, plan.dt, abs(alpha), 0.0)
    frame = box_frame(flight.x, flight.y, flight.vx, flight.vy, flight.angle, flight.omega)
    walls = walls_in_reach(n, frame, plan.dt, bounds.bend)
    time, pair = plan.dt, NONE
    if walls:
        time, pair = next_impact(n, flight, frame, walls, w, plan.dt, bounds, plan.tolerance)
    if pair == NONE:
        glide(n, before, after, plan.dt, alpha)
        return DONE
    together = start(plan, before, w[STATE])
    ended = advance(n, w, plan.dt, False, False, alpha, plan.tolerance, together, time, pair)
    return finish(ended, before, w[STATE], after)


def stays_clear(x: float, y: float, vx: float, vy: float, fall: float, plan: Plan) -> bool:
    """Whether both ends of the jack's path are so near the box's centre that no foot can touch a wall on the way."""
    end_x, end_y = moved(x, vx, plan.dt), fallen(y, vy, fall, plan.dt)
    return bool((x * x + y * y < plan.clear) & (end_x * end_x + end_y * end_y < plan.clear))


def moved(place: float, rate: float, dt: float) -> float:
    """A coordinate after ``dt`` [s] at a constant rate."""
    return place + rate * dt


def fallen(place: float, rate: float, fall: float, dt: float) -> float:
    """A height after ``dt`` [s], in which gravity takes ``fall`` [m/s] from its rate."""
    return place + (rate - 0.5 * fall) * dt


def turned(angle: float, omega: float, alpha: float, dt: float) -> float:
    """An angle after ``dt`` [s] at a constant angular acceleration."""
    return angle + (omega + 0.5 * alpha * dt) * dt


def glide(n: SceneNumbers, before: Array, after: Array, dt: float, alpha: float) -> None:
    """Fly for ``dt`` [s] without looking for impacts."""
    fall = n.gravity * dt
    after[0] = moved(before[0], before[6], dt)
    after[1] = moved(before[1], before[7], dt)
    after[2] = turned(before[2], before[8], alpha, dt)
    after[3] = moved(before[3], before[9], dt)
    after[4] = fallen(before[4], before[10], fall, dt)
    after[5] = moved(before[5], before[11], dt)
    after[6] = before[6]
    after[7] = before[7]
    after[8] = before[8] + alpha * dt
    after[9] = before[9]
    after[10] = before[10] - fall
    after[11] = before[11]


def start(plan: Plan, before: Array, m: Array) -> float:
    """Take the state into the frame at the box's centre; return the gap within which feet touch together [m]."""
    for place in range(12):
        m[place] = before[place]
    m[0] = m[1] = 0.0
    m[3], m[4] = before[3] - before[0], before[4] - before[1]
    furthest = max(max(abs(before[0]), abs(before[1])), max(abs(before[3]), abs(before[4])))
    return float(max(plan.tolerance, 8.9e-16 * furthest))  # 4 units in the last place


def told_apart(n: SceneNumbers, state: Array) -> bool:
    """Whether float64 still tells places, angles and speeds apart by a thousandth of what matters here."""
    place = max(max(abs(state[0]), abs(state[1])), max(abs(state[3]), abs(state[4]))) / n.box_half_width
    angle = max(abs(state[2]), abs(state[5]))
    speed = max(max(abs(state[6]), abs(state[7])), max(abs(state[9]), abs(state[10]))) / n.speed_scale
    return bool(max(max(place, angle), speed) < _COARSEST)


def finish(ended: int, before: Array, m: Array, after: Array) -> int:
    """Take the state back to the world, if it is well."""
    if ended != DONE:
        return ended
    total = 0.0
    for place in range(12):
        total += abs(m[place])
    if not total < LARGEST:
        return TOO_FAST
    jack_x = before[3] + (m[3] - (before[3] - before[0]))
    jack_y = before[4] + (m[4] - (before[4] - before[1]))
    after[0], after[1] = before[0] + m[0], before[1] + m[1]
    after[3], after[4] = jack_x, jack_y
    after[2], after[5] = m[2], m[5]
    for place in range(6, 12):
        after[place] = m[place]
    return ended


def advance_chirp(n: SceneNumbers, plan: Plan, time: float, together: float, w: Workspace) -> tuple[int, float]:
    """Advance through a step under the chirp; return how it ended and the torque's impulse [N m s]."""
    pieces = chirp_pieces(n, time, plan.dt)
    if pieces == 0:
        return TOO_MANY_TURNS, 0.0
    turns = chirp_turns(n.chirp_start_frequency, n.chirp_rate, time)
    frequency = n.chirp_start_frequency + n.chirp_rate * time
    length = plan.dt / pieces
    impulse = 0.0
    for number in range(pieces):
        chirp_piece(n, turns, frequency, number * length, length, w)
        impulse += horner(w[PIECE + 3 * ALPHA + 1], DEGREE + 1, 1.0)
        ended = advance(n, w, length, True, False, 0.0, plan.tolerance, together, 0.0, NOT_KNOWN)
        if ended != DONE:
            return ended, 0.0
    return DONE, n.box_inertia * impulse


def advance_table(
    n: SceneNumbers, plan: Plan, torque: float, table: Array, first: int, last: int, together: float,
    w: Workspace,
) -> tuple[int, float]:  # fmt: skip
    """Advance through a step under a drive of functions, or a held torque and its side forces."""
    impulse = 0.0
    for number in range(first, last):
        length = table[number, 1]
        for axis in range(3):
            inertia = n.box_inertia if axis == ALPHA else n.box_mass
            for k in range(DEGREE + 1):
                w[PIECE + 3 * axis, k] = table[number, 2 + axis * (DEGREE + 1) + k] / inertia
            if axis == ALPHA and torque == torque:
                for k in range(DEGREE + 1):
                    w[PIECE + 3 * axis, k] = 0.0
                w[PIECE + 3 * axis, 0] = torque / inertia
            integrate(w, axis, length)
        impulse += horner(w[PIECE + 3 * ALPHA + 1], DEGREE + 1, 1.0)
        ended = advance(n, w, length, True, True, 0.0, plan.tolerance, together, 0.0, NOT_KNOWN)
        if ended != DONE:
            return ended, 0.0
    return DONE, n.box_inertia * impulse


def step_one(
    values: Array, dt: float, drive: int, before: Array, after: Array, time: float, torque: float, table: Array,
    w: Workspace,
) -> tuple[int, int, float]:  # fmt: skip
    """Advance one state; return how it ended, the number of impacts and the mean torque [N m]."""
    n = make_numbers(values)
    ended, mean = step(n, make_plan(n, dt, drive), before, after, time, torque, table, 0, table.shape[0], w)
    return ended, int(w[TALLY, HITS]), mean
