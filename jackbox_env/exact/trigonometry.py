"""Cosine and sine together, for the compiled code: half the time of two calls, and the same bits on every machine.

Method: Cody and Waite reduction by multiples of pi/2 in three parts, then the polynomials of fdlibm's k_sin.c and
k_cos.c (Sun Microsystems 1993). Beyond 1e6 rad whole turns are first taken off, 29 at a time, because 29 turns are a
float64 to 2.5e-18 rad. Error: below 1 unit in the last place, beyond 1e6 rad below 1.2. Fails: beyond 2^53 rad, where
float64 does not resolve radians, it calls the C library, whose last place differs between machines.
"""

from __future__ import annotations

import math

import numpy as np

LARGEST = 1e6  # [rad] that one reduction covers
FARTHEST = 2.0**53  # [rad] that two cover
_QUARTERS_PER_RADIAN = 6.36619772367581382433e-01  # 2 / pi
# pi / 2 in parts; multiples of the first two up to 2^20 are exact
_QUARTER_HIGH = 1.57079632673412561417e00
_QUARTER_MIDDLE = 6.07710050630396597660e-11
_QUARTER_LOW = 2.02226624879595063154e-21
_TURNS = 182.212373908208  # [rad] 29 turns, rounded
_TURNS_OVER = 2.475922546353431e-18  # [rad] by which that exceeds 29 turns


def cos_sin(angle: float) -> tuple[float, float]:
    """Return the cosine and the sine of ``angle`` [rad]; NaN for an angle that is not finite."""
    if -LARGEST < angle < LARGEST:
        return cos_sin_within(angle)
    if -FARTHEST < angle < FARTHEST:
        rest = abs(angle) % _TURNS  # exact
        over = (abs(angle) - rest) / _TURNS * _TURNS_OVER
        near = rest + over
        residue = (rest - near) + over
        c, s = cos_sin_within(near)
        return c - residue * s, (s + residue * c) * math.copysign(1.0, angle)
    if -math.inf < angle < math.inf:
        return math.cos(angle), math.sin(angle)
    return math.nan, math.nan


def without_turns(angle: float) -> float:
    """The angle [rad] less whole turns, to within half a turn; unchanged beyond 2^53 rad, unresolved by float64."""
    if -math.pi <= angle <= math.pi or not -FARTHEST < angle < FARTHEST:
        return angle
    near, over = angle, 0.0
    if not -LARGEST < angle < LARGEST:
        near = math.copysign(abs(angle) % _TURNS, angle)  # exact
        over = (angle - near) / _TURNS * _TURNS_OVER
    quarters = 4.0 * np.floor(near * (0.25 * _QUARTERS_PER_RADIAN) + 0.5)
    return float(((near - quarters * _QUARTER_HIGH) - quarters * _QUARTER_MIDDLE) - (quarters * _QUARTER_LOW - over))


def cos_sin_within(angle: float) -> tuple[float, float]:
    """Like :func:`cos_sin` for +-``LARGEST``, without a branch, so that a compiled loop is vectorized."""
    quarters = np.floor(angle * _QUARTERS_PER_RADIAN + 0.5)
    reduced = angle - quarters * _QUARTER_HIGH
    middle = quarters * _QUARTER_MIDDLE
    x = reduced - middle
    rest = (reduced - x) - middle - quarters * _QUARTER_LOW  # x + rest is the angle from the nearest quarter
    z = x * x
    v = z * x
    tail = z * (2.75573137070700676789e-06 + z * (-2.50507602534068634195e-08 + z * 1.58969099521155010221e-10))
    tail = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + tail)
    sine = x - ((z * (0.5 * rest - v * tail) - rest) - v * -1.66666666666666324348e-01)
    tail = z * (-2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 + z * -1.13596475577881948265e-11))
    tail = z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + tail))
    near_one = 1.0 - 0.5 * z
    cosine = near_one + (((1.0 - near_one) - 0.5 * z) + (z * z * (4.16666666666666019037e-02 + tail) - x * rest))
    halves = quarters * 0.5
    odd = halves != np.floor(halves)
    turned = halves - 2.0 * np.floor(halves * 0.5)  # 0, 0.5, 1, 1.5
    first = sine if odd else cosine
    second = cosine if odd else sine
    return -first if (turned == 0.5) | (turned == 1.0) else first, -second if turned >= 1.0 else second
