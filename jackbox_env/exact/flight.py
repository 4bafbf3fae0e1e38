"""Evolve: the motion of box and jack between impacts, in one piece of a step, under gravity and the drive.

``search.py`` evaluates gaps and rates here, and ``step.py`` moves the state with :func:`evolve`.
Law of flight: the jack falls with g and keeps its spin. The box keeps its velocity except for side forces, and its
angle is the double integral of torque / J_b. While feet are held, power series describe the relative motion
(``constrained.py``).

Drives: ``step.py`` cuts a step into pieces on which each of the three accelerations of the box (``TURN`` [rad/s^2],
``PUSH_X`` and ``PUSH_Y`` [m/s^2]) is a sum of powers of u = 2 s / T - 1 in [-1, 1], with s [s] since the piece's start
and T its length. Its integrals once and twice from that start are such sums too. Their powers are in row
3 * acceleration + order of integration of a workspace's ``powers``.

Exactness: rounding. The chirp's powers are its Taylor series about the piece's middle, with pieces of at most a sixth
of a turn. The powers of a drive's functions go through 13 values (``drives.py``), in the Chebyshev points of the
second kind, both ends of [-1, 1] among them. Points are literals and sums have a written order, so the result is the
same on every machine (Trefethen 2013, "Approximation Theory and Approximation Practice", ch. 3 and 4).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly

from jackbox_env.exact.geometry import BoxFrame, View, box_frame, cos_sin, foot_gap, towards, view_of
from jackbox_env.exact.workspace import POSITION_X, POSITION_Y, PSI, RATE_X, RATE_Y, SPIN, HeldFeet, Workspace
from jackbox_env.jit.compiler import inlined
from jackbox_env.model.scene import MOST_TURNS, SceneNumbers, chirp_turns
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
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

TURN, PUSH_X, PUSH_Y = range(3)
POWERS = 16  # stored of each polynomial
DEGREE = 12  # of a polynomial before it is integrated
PIECES_PER_TURN = 6
RECIPROCALS = 1.0 / np.arange(1.0, POWERS + 1.0)  # of integrated powers; a product is faster than a quotient
TABLE_WIDTH = 2 + 3 * (DEGREE + 1)  # of a row: start and length [s], powers of torque [N m] and of both forces [N]


def horner(powers: Array, degree: int, u: float) -> float:
    """Sum of powers[k] u^k up to ``degree``."""
    value = powers[degree]
    for k in range(degree - 1, -1, -1):
        value = powers[k] + u * value
    return float(value)


def integrate(memory: Workspace, axis: int, length: float) -> None:
    """Fill in both integrals of one acceleration over a piece of ``length`` [s], zero at its start."""
    for order in range(2):
        start, sign = 0.0, -1.0
        for k in range(DEGREE + 1 + order):
            power = 0.5 * length * memory.powers[3 * axis + order, k] * RECIPROCALS[k]
            memory.powers[3 * axis + order + 1, k + 1] = power
            start += sign * power
            sign = -sign
        memory.powers[3 * axis + order + 1, 0] = -start


def chirp_piece(scene: SceneNumbers, time: float, start: float, length: float, memory: Workspace) -> None:
    """Fill in the box's angular acceleration under the chirp, from ``start`` [s] after ``time`` [s] on.

    sin and cos of a phase with phi' = a + 2 b u obey s' = phi' c, c' = -phi' s, so their powers follow one another.
    """
    turns = chirp_turns(scene.chirp_start_frequency, scene.chirp_rate, time)
    frequency = scene.chirp_start_frequency + scene.chirp_rate * time
    half = 0.5 * length
    middle = start + half
    growth = 0.5 * scene.chirp_rate
    phase = turns + (frequency + growth * middle) * middle
    c, s = cos_sin(2.0 * math.pi * (phase - math.floor(phase)))
    a = 2.0 * math.pi * (frequency + scene.chirp_rate * middle) * half
    b2 = 4.0 * math.pi * growth * half * half
    peak = scene.chirp_amplitude / scene.box_inertia
    before_s = before_c = 0.0
    for k in range(DEGREE + 1):
        memory.powers[3 * TURN, k] = peak * s
        next_s = (a * c + b2 * before_c) * RECIPROCALS[k]
        next_c = -(a * s + b2 * before_s) * RECIPROCALS[k]
        before_s, before_c, s, c = s, c, next_s, next_c
    integrate(memory, TURN, length)


def chirp_pieces(scene: SceneNumbers, time: float, dt: float) -> int:
    """Number of equal pieces of a step of ``dt`` [s] after ``time`` [s]; 0 if the chirp turns too often in it."""
    frequency = scene.chirp_start_frequency + scene.chirp_rate * time
    fastest = max(abs(frequency), abs(frequency + scene.chirp_rate * dt))
    turned = fastest * dt
    return max(1, math.ceil(PIECES_PER_TURN * turned)) if turned <= MOST_TURNS else 0


# cos(k pi / 12) for k = 0 to 6, written out: C libraries differ in the last place.
_COSINES = (1.0, 0.9659258262890683, 0.8660254037844386, 0.7071067811865476, 0.5, 0.25881904510252074, 0.0)


def _cosine(twelfths: int) -> float:
    """Cosine of a number of twelfths of pi."""
    folded = min(twelfths % 24, -twelfths % 24)
    return _COSINES[folded] if folded <= 6 else -_COSINES[12 - folded]


POINTS = np.array([-_cosine(j) for j in range(DEGREE + 1)])  # in [-1, 1]
# Coefficient k of an interpolant is the sum of row k times the values; the first and last of each count half.
_TO_CHEBYSHEV = np.array(
    [
        [_cosine(k * (DEGREE - j)) / (6.0 * (1 + (k in (0, DEGREE))) * (1 + (j in (0, DEGREE)))) for j in range(13)]
        for k in range(DEGREE + 1)
    ]
)
# The powers of u in T_0 to T_12: whole numbers, so they are exact.
_TO_POWERS = np.array([np.pad(cheb2poly(unit[: k + 1]), (0, DEGREE - k)) for k, unit in enumerate(np.eye(DEGREE + 1))])


def interpolate(values: Array, row: Array, first: int) -> tuple[float, float, float]:
    """Write the powers of u of the polynomial through 13 values to ``row``, from column ``first`` on.

    Returns:
        The largest value, the largest of the last three Chebyshev coefficients, and the second steepest slope per u:
        a jump makes only one gap steep.
    """
    tail, middle = 0.0, values[DEGREE // 2]
    row[first] = middle  # so that a constant is exact
    for k in range(DEGREE + 1):
        coefficient = 0.0
        for j in range(DEGREE + 1):
            coefficient += _TO_CHEBYSHEV[k, j] * (values[j] - middle)
        for i in range(k & 1, k + 1, 2):
            row[first + i] += _TO_POWERS[k, i] * coefficient
        if k > DEGREE - 3:
            tail = max(tail, abs(coefficient))
    peak, steepest, slope = abs(values[0]), 0.0, 0.0
    for j in range(DEGREE):
        peak = max(peak, abs(values[j + 1]))
        rise = abs(values[j + 1] - values[j]) / (POINTS[j + 1] - POINTS[j])
        slope = max(slope, min(rise, steepest))
        steepest = max(steepest, rise)
    return peak, tail, slope


class Piece(NamedTuple):
    """The accelerations of the box by the drive in one piece of a step."""

    length: float  # [s]
    alpha: float  # angular acceleration if it is constant [rad/s^2]
    curved: bool  # whether the accelerations are polynomials
    pushed: bool  # whether the box's centre is accelerated too
    max_angular_acceleration: float  # bound of the angular acceleration [rad/s^2]
    max_acceleration: float  # bound of the centre's acceleration [m/s^2]


class Flight(NamedTuple):
    """Relative motion from a moment on: the jack's centre relative to the box's, and both angles."""

    x: float  # [m]
    y: float
    vx: float  # [m/s]
    vy: float
    angle: float  # of the box [rad]
    omega: float  # [rad/s]
    jack_angle: float
    jack_omega: float
    gravity: float  # [m/s^2]
    alpha: float  # of the box if it is constant [rad/s^2]
    since: float  # the moment, since the piece's start [s]
    half: float  # half the piece's length; while feet are held, the stretch's length [s]
    curved: bool  # whether the accelerations are polynomials
    pushed: bool  # whether the box's centre is accelerated too
    held: int  # feet at rest on walls, bit 4 * wall + foot of each
    speeds: float  # sum of the speeds of box and jack, to bound the rounding of a gap's rate [m/s]


def constant_piece(length: float, alpha: float) -> Piece:
    """A piece of ``length`` [s] under a constant angular acceleration [rad/s^2]."""
    return Piece(length, alpha, False, False, abs(alpha), 0.0)


def curved_piece(memory: Workspace, length: float, pushed: bool) -> Piece:
    """A piece of ``length`` [s] under the polynomial accelerations in ``memory``."""
    max_acceleration = largest(memory, PUSH_X) + largest(memory, PUSH_Y) if pushed else 0.0
    return Piece(length, 0.0, True, pushed, largest(memory, TURN), max_acceleration)


def largest(memory: Workspace, axis: int) -> float:
    """Bound of a polynomial acceleration over its piece."""
    bound = 0.0
    for k in range(DEGREE + 1):
        bound += abs(memory.powers[3 * axis, k])
    return bound


def flight_of(scene: SceneNumbers, state: Array, piece: Piece, since: float) -> Flight:
    """The relative motion of a state ``since`` [s] after the start of a piece."""
    return Flight(
        state[X_JACK] - state[X_BOX], state[Y_JACK] - state[Y_BOX],
        state[VX_JACK] - state[VX_BOX], state[VY_JACK] - state[VY_BOX],
        state[THETA_BOX], state[OMEGA_BOX], state[THETA_JACK], state[OMEGA_JACK],
        scene.gravity, piece.alpha, since, 0.5 * piece.length, piece.curved, piece.pushed, 0,
        abs(state[VX_BOX]) + abs(state[VY_BOX]) + abs(state[VX_JACK]) + abs(state[VY_JACK]),
    )  # fmt: skip


def excursion(memory: Workspace, axis: int, flight: Flight, s: float) -> tuple[float, float]:
    """Change of a coordinate and of its rate in ``s`` [s] by the polynomial acceleration."""
    end = (flight.since + s) / flight.half - 1.0
    moved, rate = (
        horner(memory.powers[3 * axis + 2], DEGREE + 2, end),
        horner(memory.powers[3 * axis + 1], DEGREE + 1, end),
    )
    if flight.since == 0.0:
        return moved, rate
    start = flight.since / flight.half - 1.0
    before = horner(memory.powers[3 * axis + 1], DEGREE + 1, start)
    return moved - horner(memory.powers[3 * axis + 2], DEGREE + 2, start) - before * s, rate - before


def driven_at(flight: Flight, memory: Workspace, s: float) -> tuple[float, float, float]:
    """Accelerations of the box by the drive ``s`` [s] into the flight: angular, along x and along y."""
    u = (flight.since + s) / flight.half - 1.0
    turn = horner(memory.powers[3 * TURN], DEGREE, u) if flight.curved else flight.alpha
    if not flight.pushed:
        return turn, 0.0, 0.0
    return turn, horner(memory.powers[3 * PUSH_X], DEGREE, u), horner(memory.powers[3 * PUSH_Y], DEGREE, u)


@inlined
def view_at(flight: Flight, memory: Workspace, s: float) -> View:
    """The jack relative to the box ``s`` [s] into the flight."""
    x = flight.x + flight.vx * s
    y = flight.y + (flight.vy - 0.5 * flight.gravity * s) * s
    vx, vy = flight.vx, flight.vy - flight.gravity * s
    turned, spun = 0.5 * flight.alpha * s * s, flight.alpha * s
    if flight.curved:
        turned, spun = excursion(memory, TURN, flight, s)
        if flight.pushed:
            moved, pushed = excursion(memory, PUSH_X, flight, s)
            x, vx = x - moved, vx - pushed
            moved, pushed = excursion(memory, PUSH_Y, flight, s)
            y, vy = y - moved, vy - pushed
    angle, omega = flight.angle + (flight.omega * s + turned), flight.omega + spun
    jack_angle = flight.jack_angle + flight.jack_omega * s
    return view_of(box_frame(x, y, vx, vy, angle, omega), jack_angle - angle, flight.jack_omega - omega, s)


@inlined
def evolve(memory: Workspace, flight: Flight, s: float) -> None:
    """Fly for ``s`` [s]: move the state."""
    state = memory.state
    turned, spun = 0.5 * flight.alpha * s * s, flight.alpha * s
    if flight.curved:
        turned, spun = excursion(memory, TURN, flight, s)
    for index in (X_BOX, Y_BOX, X_JACK, THETA_JACK):
        state[index] += state[RATES + index] * s
    if flight.pushed:
        moved, pushed = excursion(memory, PUSH_X, flight, s)
        state[X_BOX], state[VX_BOX] = state[X_BOX] + moved, state[VX_BOX] + pushed
        moved, pushed = excursion(memory, PUSH_Y, flight, s)
        state[Y_BOX], state[VY_BOX] = state[Y_BOX] + moved, state[VY_BOX] + pushed
    state[THETA_BOX] += state[OMEGA_BOX] * s + turned
    state[OMEGA_BOX] += spun
    state[Y_JACK] += (state[VY_JACK] - 0.5 * flight.gravity * s) * s
    state[VY_JACK] -= flight.gravity * s


def stays_clear(x: float, y: float, vx: float, vy: float, fall: float, dt: float, clear: float) -> bool:
    """Whether both ends of the jack's path are so near the box's centre that no foot can touch a wall on the way.

    ``clear`` is the square of that distance, see ``step.StepParameters``.
    """
    end_x, end_y = moved(x, vx, dt), fallen(y, vy, fall, dt)
    return bool((x * x + y * y < clear) & (end_x * end_x + end_y * end_y < clear))


def moved(position: float, rate: float, dt: float) -> float:
    """A coordinate after ``dt`` [s] at a constant velocity."""
    return position + rate * dt


def fallen(height: float, rate: float, fall: float, dt: float) -> float:
    """A height after ``dt`` [s], in which gravity reduces its velocity by ``fall`` [m/s]."""
    return height + (rate - 0.5 * fall) * dt


def turned(angle: float, omega: float, alpha: float, dt: float) -> float:
    """An angle after ``dt`` [s] at a constant angular acceleration."""
    return angle + (omega + 0.5 * alpha * dt) * dt


def free_flight(before: Array, after: Array, fall: float, dt: float, alpha: float) -> None:
    """Fly for ``dt`` [s] without a search for impacts; gravity reduces the jack's velocity by ``fall`` [m/s]."""
    for index in (X_BOX, Y_BOX, X_JACK, THETA_JACK):
        after[index] = moved(before[index], before[RATES + index], dt)
    after[THETA_BOX] = turned(before[THETA_BOX], before[OMEGA_BOX], alpha, dt)
    after[Y_JACK] = fallen(before[Y_JACK], before[VY_JACK], fall, dt)
    copy_numbers(6, before[RATES:], after[RATES:])
    after[OMEGA_BOX] += alpha * dt
    after[VY_JACK] -= fall


@inlined
def gap_at(
    scene: SceneNumbers, flight: Flight, memory: Workspace, wall: int, foot: int, s: float
) -> tuple[float, float]:
    """Gap between a wall and a foot ``s`` [s] into the flight [m], and its rate [m/s]."""
    memory.evaluations += 1.0
    view = held_view(flight, memory.held, s) if flight.held else view_at(flight, memory, s)
    ahead, speed = towards(view.frame, wall)
    return foot_gap(scene, ahead, speed, view.cosine, view.sine, view.spin, foot - wall)


def held_view(flight: Flight, held: HeldFeet, s: float) -> View:
    """The jack relative to the box ``s`` [s] into a stretch with feet at rest."""
    length = flight.half
    u = s / length
    frame = BoxFrame(
        horner(held.series[POSITION_X], DEGREE + 2, u), horner(held.series[POSITION_Y], DEGREE + 2, u),
        horner(held.series[RATE_X], DEGREE + 1, u) / length, horner(held.series[RATE_Y], DEGREE + 1, u) / length,
    )  # fmt: skip
    spin = horner(held.series[SPIN], DEGREE + 1, u) / length
    return view_of(frame, horner(held.series[PSI], DEGREE + 2, u), spin, s)
