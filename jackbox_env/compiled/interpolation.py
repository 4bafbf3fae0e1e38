"""Polynomials through 13 values, compiled: in the Chebyshev points of the second kind, both ends of [-1, 1] among them.

The points are literals and the sums have a written order, so the result is the same on every machine (Trefethen 2013,
"Approximation Theory and Approximation Practice", ch. 3 and 4).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.drives import DEGREE

Array = NDArray[np.float64]

# cos(k pi / 12) for k = 0 to 6, written out: C libraries differ in the last place.
_COSINES = (1.0, 0.9659258262890683, 0.8660254037844386, 0.7071067811865476, 0.5, 0.25881904510252074, 0.0)


def _cosine(twelfths: int) -> float:
    """Cosine of a number of twelfths of pi."""
    folded = min(twelfths % 24, -twelfths % 24)
    return _COSINES[folded] if folded <= 6 else -_COSINES[12 - folded]


def _powers_of_chebyshev() -> list[list[int]]:
    """The powers of u in T_0 to T_12: T_k = 2 u T_{k-1} - T_{k-2}."""
    rows = [[1] + [0] * DEGREE, [0, 1] + [0] * (DEGREE - 1)]
    while len(rows) <= DEGREE:
        rows.append([2 * a - b for a, b in zip([0, *rows[-1][:-1]], rows[-2], strict=True)])
    return rows


POINTS = np.array([-_cosine(j) for j in range(DEGREE + 1)])  # in [-1, 1]
# Coefficient k of an interpolant is the sum of row k times the values; the first and last of each count half.
_TO_CHEBYSHEV = np.array(
    [
        [_cosine(k * (DEGREE - j)) / (6.0 * (1 + (k in (0, DEGREE))) * (1 + (j in (0, DEGREE)))) for j in range(13)]
        for k in range(DEGREE + 1)
    ]
)
_TO_POWERS = np.array(_powers_of_chebyshev(), dtype=np.float64)


def interpolate(values: Array, row: Array, place: int) -> tuple[float, float, float]:
    """Write the powers of u of the polynomial through 13 values to ``row``, from ``place`` on.

    Returns:
        The largest value, the largest of the last three Chebyshev coefficients, and the steepest slope per u but one:
        a jump makes one gap steep.
    """
    tail, middle = 0.0, values[DEGREE // 2]
    row[place] = middle  # a constant comes out as it is
    for k in range(DEGREE + 1):
        coefficient = 0.0
        for j in range(DEGREE + 1):
            coefficient += _TO_CHEBYSHEV[k, j] * (values[j] - middle)
        for i in range(k & 1, k + 1, 2):
            row[place + i] += _TO_POWERS[k, i] * coefficient
        if k > DEGREE - 3:
            tail = max(tail, abs(coefficient))
    peak, steepest, slope = abs(values[0]), 0.0, 0.0
    for j in range(DEGREE):
        peak = max(peak, abs(values[j + 1]))
        rise = abs(values[j + 1] - values[j]) / (POINTS[j + 1] - POINTS[j])
        slope = max(slope, min(rise, steepest))
        steepest = max(steepest, rise)
    return peak, tail, slope
