"""The complementarity problem of contacts that act at once: 0 <= x _|_ W (W^T x + c) >= 0.

Method: the solution minimises |W^T x + c|^2 / 2 over x >= 0, found by the active-set method of Lawson and Hanson (1974,
    Solving Least Squares Problems, ch. 23).
Exactness: rounding. W^T x is unique. Where rows depend on each other x is one of several; at most three are above 0.
Bits: the same on every processor. The sums are written out, because those of a linear algebra library differ in their
    last bits from one processor to the next, and where rows depend on each other such a bit decides which rows enter.
Fails: rows of rank 4 or more, which a jack and a box can not make.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

_RANK = 3  # every gradient of a gap is a combination of three: (n_x, n_y, n^perp . o)
_DEPENDENT = 1e-12  # of a row's length: if less of it is left beside other rows, it depends on them


def dot(a: Array, b: Array) -> float:
    """Sum of the products in the order written."""
    total = 0.0
    for product in (a * b).tolist():
        total += product
    return total


def dots(a: Array, b: Array) -> Array:
    """:func:`dot` of each row of two arrays, shape (n,)."""
    total = np.zeros(len(a))
    for products in (a * b).T:
        total += products
    return total


def combined(rows: Array, factors: Array) -> Array:
    """Sum of the rows times their factors, shape (6,)."""
    return np.array([dot(column, factors) for column in rows.T])


def complementary(rows: Array, velocity: Array) -> Array:
    """Solve 0 <= x _|_ W (W^T x + c) >= 0.

    A row within the span of the active ones has a gradient of 0, as they have, and what is computed of it is only
    rounding. So it is barred, and the active rows stay independent. No set of active rows is tried twice.

    Args:
        rows: W, each of length 1, shape (n, 6).
        velocity: c, shape (6,).

    Returns:
        x, shape (n,).
    """
    x, active = np.zeros(len(rows)), np.zeros(len(rows), dtype=bool)
    barred = np.zeros(len(rows), dtype=bool)  # tried in vain since x last moved
    seen = {active.tobytes()}
    while True:
        point = velocity + combined(rows, x)
        descent = np.array([-dot(row, point) for row in rows])
        promising = ~active & ~barred & (descent > 0.0)
        if not promising.any():
            return x
        chosen = int(np.argmax(np.where(promising, descent, -np.inf)))
        if _spanned(rows[active], rows[chosen]):
            barred[chosen] = True
            continue
        joined = active.copy()
        joined[chosen] = True
        trial, kept = _minimum_within(rows, velocity, x, joined)
        if trial[chosen] > 0.0 and kept.tobytes() not in seen:
            x, active = trial, kept
            seen.add(kept.tobytes())
            barred[:] = False
        else:
            barred[chosen] = True


def _minimum_within(rows: Array, velocity: Array, x: Array, active: Mask) -> tuple[Array, Mask]:
    """Move x towards the minimum over the active indices, dropping each index that reaches zero on the way."""
    active = active.copy()
    while True:
        trial = np.zeros_like(x)
        trial[active] = _minimum(rows[active], velocity)
        falling = active & (trial <= 0.0)
        if not falling.any():
            return trial, active
        fractions = np.where(falling, x / np.where(x > trial, x - trial, 1.0), np.inf)
        first = int(np.argmin(fractions))
        x = np.where(active, np.maximum(x + fractions[first] * (trial - x), 0.0), 0.0)
        active[first], x[first] = False, 0.0


def _minimum(rows: Array, velocity: Array) -> Array:
    """The x at which W^T x + c is least, for independent rows W: with W^T = Q R, R x = -Q^T c.

    W W^T x = -W c would have the square of W's condition number.
    """
    base, tall = _orthonormal(rows)
    _, shares = _apart(base, velocity)
    x = np.zeros(len(rows))
    for a in reversed(range(len(rows))):
        x[a] = -(shares[a] + dot(tall[a, a + 1 :], x[a + 1 :])) / tall[a, a]
    return x


def _orthonormal(rows: Array) -> tuple[Array, Array]:
    """Q^T and R of W^T = Q R, for independent rows W."""
    base, tall = np.zeros_like(rows), np.zeros((len(rows), len(rows)))
    for a, row in enumerate(rows):
        left, tall[:a, a] = _apart(base[:a], row)
        tall[a, a] = math.sqrt(dot(left, left))
        base[a] = left / tall[a, a]
    return base, tall


def _apart(base: Array, row: Array) -> tuple[Array, Array]:
    """What is left of a row beside an orthonormal base, and its shares in it, by modified Gram-Schmidt.

    Twice is enough to be orthogonal to rounding (Giraud et al. 2005).
    """
    shares = np.zeros(len(base))
    for _ in range(2):
        for place, direction in enumerate(base):
            share = dot(direction, row)
            shares[place] += share
            row = row - share * direction
    return row, shares


def _spanned(rows: Array, row: Array) -> bool:
    """Whether a row is within the span of independent ones."""
    if len(rows) >= _RANK:
        return True
    left, _ = _apart(_orthonormal(rows)[0], row)
    return dot(left, left) < _DEPENDENT**2
