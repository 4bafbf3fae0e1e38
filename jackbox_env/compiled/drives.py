"""A drive as the exact contact model takes it: pieces of a step on which each acceleration of the box is a polynomial.

Each of the three accelerations (``TURN`` [rad/s^2], ``PUSH_X`` and ``PUSH_Y`` [m/s^2]) is a sum of powers of
u = 2 s / T - 1 in [-1, 1], with s [s] since the piece's start and T its length; its integrals once and twice from that
start are such sums too. A workspace holds the powers of each in row PIECE + 3 * acceleration + order of integration.

Exactness: rounding. The chirp's powers are its Taylor series about the piece's middle, with pieces of at most a sixth
of a turn; functions are interpolated in Chebyshev points on pieces halved until the residual is rounding, or until a
jump lies within 2^-44 of the step.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jackbox_env import _validation as check
from jackbox_env.compiled.trigonometry import cos_sin
from jackbox_env.compiled.workspace import PIECE, Workspace
from jackbox_env.scene import MOST_TURNS, Drive, SceneNumbers

Array = NDArray[np.float64]

TURN, PUSH_X, PUSH_Y = range(3)
POWERS = 16  # stored
DEGREE = 12  # of a polynomial before it is integrated
PIECES_PER_TURN = 6
_SHARES = 1.0 / np.arange(1.0, POWERS + 1.0)  # of integrated powers; a product is faster than a quotient
TABLE_WIDTH = 2 + 3 * (DEGREE + 1)  # of a row: start and length [s], powers of torque [N m] and of both forces [N]
_DEEPEST = 44  # halvings of a step
_MOST_PIECES = 4096  # of a step
_RESIDUAL = 1e-13  # of a function's interpolation, over the function's largest value in the step
_NOISE = 1e-5  # the same for a function whose residual does not shrink in _STALLED halvings: it is rounding, not shape
_STALLED = 4
_SHORTEST = 2.0**-1000  # [s] a time to divide by; no two times are that near but equal ones

# Chebyshev points of the first kind, and what makes values there into powers of u.
_POINTS = np.polynomial.chebyshev.chebpts1(DEGREE + 1)
_TO_CHEBYSHEV = np.linalg.inv(np.polynomial.chebyshev.chebvander(_POINTS, DEGREE))
_TO_POWERS = np.array([np.pad(np.polynomial.chebyshev.cheb2poly(row), (0, DEGREE - k)) for k, row in enumerate(
    [np.eye(DEGREE + 1)[j, : j + 1] for j in range(DEGREE + 1)])])  # fmt: skip


def horner(powers: Array, degree: int, u: float) -> float:
    """Sum of powers[k] u^k up to ``degree``."""
    value = powers[degree]
    for k in range(degree - 1, -1, -1):
        value = powers[k] + u * value
    return float(value)


def integrate(w: Workspace, axis: int, length: float) -> None:
    """Fill in both integrals of one acceleration over a piece of ``length`` [s], zero at its start."""
    for order in range(2):
        start, sign = 0.0, -1.0
        for k in range(DEGREE + 1 + order):
            power = 0.5 * length * w[PIECE + 3 * axis + order, k] * _SHARES[k]
            w[PIECE + 3 * axis + order + 1, k + 1] = power
            start += sign * power
            sign = -sign
        w[PIECE + 3 * axis + order + 1, 0] = -start


def chirp_piece(n: SceneNumbers, turns: float, frequency: float, start: float, length: float, w: Workspace) -> None:
    """Fill in the box's angular acceleration under the chirp, ``start`` [s] after the time of ``turns``, ``frequency``.

    sin and cos of a phase with phi' = a + 2 b u obey s' = phi' c, c' = -phi' s, so their powers follow one another.
    """
    half = 0.5 * length
    middle = start + half
    growth = 0.5 * n.chirp_rate
    phase = turns + (frequency + growth * middle) * middle
    c, s = cos_sin(2.0 * math.pi * (phase - math.floor(phase)))
    a = 2.0 * math.pi * (frequency + n.chirp_rate * middle) * half
    b2 = 4.0 * math.pi * growth * half * half
    peak = n.chirp_amplitude / n.box_inertia
    before_s = before_c = 0.0
    for k in range(DEGREE + 1):
        w[PIECE + 3 * TURN, k] = peak * s
        next_s = (a * c + b2 * before_c) * _SHARES[k]
        next_c = -(a * s + b2 * before_s) * _SHARES[k]
        before_s, before_c, s, c = s, c, next_s, next_c
    integrate(w, TURN, length)


def chirp_pieces(n: SceneNumbers, time: float, dt: float) -> int:
    """Number of equal pieces of a step of ``dt`` [s] after ``time`` [s]; 0 if the chirp turns too often in it."""
    frequency = n.chirp_start_frequency + n.chirp_rate * time
    fastest = max(abs(frequency), abs(frequency + n.chirp_rate * dt))
    turned = fastest * dt
    return max(1, math.ceil(PIECES_PER_TURN * turned)) if turned <= MOST_TURNS else 0


def function_pieces(drive: Drive, time: float, dt: float) -> Array:
    """Interpolate a drive's functions over a step of ``dt`` [s] after ``time`` [s], each piece to rounding.

    Returns:
        Pieces in time order, shape (pieces, ``TABLE_WIDTH``).

    Raises:
        TypeError, ValueError: a function returns no finite number, or has more jumps or kinks than can be followed.
    """
    parts = [(axis, name) for axis, name in enumerate(("torque", "force_x", "force_y")) if getattr(drive, name)]
    largest = np.full(3, 1e-300)
    rows: list[Array] = []
    # Start and length over dt, halvings, halvings in vain, and the residual before the last of them, over the largest.
    waiting = [(0.0, 1.0, 0, 0, math.inf)]
    while waiting:
        start, length, halvings, stalled, before = waiting.pop()
        row = np.zeros(TABLE_WIDTH)
        row[0], row[1] = start * dt, length * dt
        residual, accepted = 0.0, True
        for axis, name in parts:
            values = _sample(drive, name, time + row[0], row[1])
            powers = _TO_CHEBYSHEV @ values
            largest[axis] = max(largest[axis], np.abs(values).max())
            tail = np.abs(powers[-3:]).max()
            # A time that is rounded moves the value along the slope.
            slope = np.abs(np.diff(values) / np.diff(_POINTS)).max() / max(0.5 * row[1], _SHORTEST)
            accepted &= bool(tail <= _RESIDUAL * largest[axis] + 4.0 * slope * math.ulp(abs(time) + dt))
            residual = max(residual, tail / largest[axis])
            row[2 + axis * (DEGREE + 1) :][: DEGREE + 1] = powers @ _TO_POWERS
        stalled += residual > 0.7 * before
        accepted |= stalled >= _STALLED and residual <= _NOISE
        if not accepted and halvings < _DEEPEST:
            half = 0.5 * length
            waiting += [(start + half, half, halvings + 1, stalled, residual)]
            waiting += [(start, half, halvings + 1, stalled, residual)]
        else:
            rows.append(row)
        if len(rows) + len(waiting) > _MOST_PIECES:
            raise ValueError(
                f"drive must be smooth but for some jumps: over the {dt:g} s after t = {time:g} s it wants more than "
                f"{_MOST_PIECES} pieces"
            )
    return np.array(rows)


def _sample(drive: Drive, name: str, start: float, length: float) -> Array:
    function = getattr(drive, name)
    times = (start + 0.5 * length * (_POINTS + 1.0)).tolist()
    return np.array([check.real(f"{name}({time:g} s)", function(time)) for time in times])
