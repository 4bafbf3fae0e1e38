"""Drives in compiled code: pieces of a step on which each acceleration of the box is a polynomial.

``step.py`` cuts a step into these pieces, and ``flight.py`` evaluates the polynomials.
Each of the three accelerations (``TURN`` [rad/s^2], ``PUSH_X`` and ``PUSH_Y`` [m/s^2]) is a sum of powers of
u = 2 s / T - 1 in [-1, 1], with s [s] since the piece's start and T its length. Its integrals once and twice from that
start are such sums too. Their powers are in row 3 * acceleration + order of integration of a workspace's ``powers``.

Exactness: rounding. The chirp's powers are its Taylor series about the piece's middle, with pieces of at most a sixth
of a turn. The powers of a drive's functions go through 13 values (``functions.py``), in the Chebyshev points of the
second kind, both ends of [-1, 1] among them. Points are literals and sums have a written order, so the result is the
same on every machine (Trefethen 2013, "Approximation Theory and Approximation Practice", ch. 3 and 4).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.polynomial.chebyshev import cheb2poly

from jackbox_env.exact.trigonometry import cos_sin
from jackbox_env.exact.workspace import Workspace
from jackbox_env.model.scene import MOST_TURNS, SceneNumbers
from jackbox_env.model.states import Array

TURN, PUSH_X, PUSH_Y = range(3)
POWERS = 16  # stored of each polynomial
DEGREE = 12  # of a polynomial before it is integrated
PIECES_PER_TURN = 6
SHARES = 1.0 / np.arange(1.0, POWERS + 1.0)  # of integrated powers; a product is faster than a quotient
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
            power = 0.5 * length * memory.powers[3 * axis + order, k] * SHARES[k]
            memory.powers[3 * axis + order + 1, k + 1] = power
            start += sign * power
            sign = -sign
        memory.powers[3 * axis + order + 1, 0] = -start


def chirp_piece(
    scene: SceneNumbers, turns: float, frequency: float, start: float, length: float, memory: Workspace
) -> None:
    """Fill in the box's angular acceleration under the chirp, ``start`` [s] after the time of ``turns``, ``frequency``.

    sin and cos of a phase with phi' = a + 2 b u obey s' = phi' c, c' = -phi' s, so their powers follow one another.
    """
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
        next_s = (a * c + b2 * before_c) * SHARES[k]
        next_c = -(a * s + b2 * before_s) * SHARES[k]
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
