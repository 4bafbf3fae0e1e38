"""The impact law at the moment of impact, for the exact contact model: which feet touch, and what it does to them.

Law: all contacts whose gap is within the tolerance take part in the simultaneous Newton law at restitution 1,

    0 <= lambda  _|_  J qdot+ + J qdot- >= 0,    M (qdot+ - qdot-) = J^T lambda,

the law of :func:`jackbox_env.mechanics.simultaneous_impact_map`, which tests compare this with. With w = J M^-1/2 and
v = M^1/2 qdot it is the reflection v+ = 2 P(v-) - v- at P(v), the nearest point to v in the cone w v >= 0. Contacts of
a jack and a square have rank 3 at most, so P is found by trying all sets of one, two and three contacts: each gives
a point by projection, and the right one pushes nowhere backwards and violates nothing.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.trigonometry import cos_sin
from jackbox_env.compiled.workspace import (
    BASE,
    BEST,
    ELAPSED,
    GRADIENTS,
    HITS,
    IMPULSE,
    IMPULSES,
    LENGTHS,
    PAIRS,
    POINT,
    PUSHES,
    RATES,
    RECORD,
    STATE,
    TALL,
    TALLY,
    UNIT,
    Workspace,
)
from jackbox_env.scene import SceneNumbers

Array = NDArray[np.float64]

_DEPENDENT = 1e-13  # a row that keeps less than this of its length beside the others is one of them


def quarter(cosine: float, sine: float, quarters: int) -> tuple[float, float]:
    """Cosine and sine of an angle moved by whole quarter turns."""
    quarters &= 3
    if quarters == 0:
        return cosine, sine
    if quarters == 1:
        return -sine, cosine
    if quarters == 2:
        return -cosine, -sine
    return sine, -cosine


def resolve(n: SceneNumbers, w: Workspace, tolerance: float, wall: int, foot: int) -> None:
    """Apply the law to every contact within ``tolerance`` [m], and to that of ``wall`` and ``foot`` in any case.

    The rates in ``w`` change, and it takes the record of the impacts.
    """
    m = w[STATE]
    c, s = cos_sin(m[2])
    cp, sp = cos_sin(m[5] - m[2])
    x, y = m[3] - m[0], m[4] - m[1]
    count = 0
    for k in range(4):
        nx, ny = quarter(c, s, k)
        depth, side = nx * x + ny * y, nx * y - ny * x  # n . r and n^perp . r
        for i in range(4):
            along, across = quarter(cp, sp, i - k)  # foot over arm, on n and n^perp
            gap = n.box_half_width - depth - n.jack_arm * along
            if gap <= tolerance or (k == wall and i == foot):
                arm = n.jack_arm * across
                row = w[GRADIENTS + count]
                row[0], row[1], row[2], row[3], row[4], row[5] = nx, ny, -side - arm, -nx, -ny, arm
                w[PAIRS, count], w[IMPULSES, count] = 4.0 * k + i, 0.0
                count += 1
    if count == 1:
        w[IMPULSES, 0] = bounce(n, m, w[GRADIENTS])
    else:
        bounce_together(n, w, count)
    for number in range(count):
        if w[IMPULSES, number] > 0.0:
            place = RECORD + int(w[TALLY, HITS])
            if place < w.shape[0]:
                w[place, 0], w[place, 3] = w[TALLY, ELAPSED], w[IMPULSES, number]
                w[place, 1], w[place, 2] = w[PAIRS, number] // 4.0, w[PAIRS, number] % 4.0
            w[TALLY, HITS] += 1.0
            w[TALLY, IMPULSE] += w[IMPULSES, number]


def bounce(n: SceneNumbers, m: Array, row: Array) -> float:
    """One contact, with the gap's gradient J in ``row``: lambda = -2 J qdot / (J M^-1 J^T) where J qdot < 0."""
    impulse = 0.0
    rate = row[0] * (m[6] - m[9]) + row[1] * (m[7] - m[10]) + row[2] * m[8] + row[5] * m[11]
    if rate < 0.0:
        yielding = 1.0 / n.box_mass + 1.0 / n.jack_mass
        yielding += row[2] * row[2] / n.box_inertia + row[5] * row[5] / n.jack_inertia
        impulse = -2.0 * rate / yielding
        kick(n, m, row, impulse)
    return impulse


def kick(n: SceneNumbers, m: Array, row: Array, impulse: float) -> None:
    """Change the rates by M^-1 J^T lambda."""
    m[6] += row[0] * impulse / n.box_mass
    m[7] += row[1] * impulse / n.box_mass
    m[8] += row[2] * impulse / n.box_inertia
    m[9] += row[3] * impulse / n.jack_mass
    m[10] += row[4] * impulse / n.jack_mass
    m[11] += row[5] * impulse / n.jack_inertia


def bounce_together(n: SceneNumbers, w: Workspace, count: int) -> None:
    """Several contacts: reflect the rates at their projection on the cone of rates that close no gap."""
    weigh(n, w, count)
    lowest = 0.0
    for i in range(count):
        lowest = min(lowest, _dot(w[UNIT + i], w[RATES]))
    if lowest >= 0.0:
        return  # nothing approaches
    least = math.inf
    one = two = three = -1
    for i in range(count):
        for j in range(i, count):
            for k in range(j, count):
                if k == j and j != i:
                    continue  # sets of one (i, i, i), two (i, i, k) and three (i, j, k)
                size = 1 if k == i else 2 if j == i else 3
                if not project(w, size, k, i, j):
                    continue
                violation = 0.0
                for other in range(count):
                    violation = max(violation, -_dot(w[UNIT + other], w[POINT]))
                if violation < least:
                    least = violation
                    one, two, three = k, i if size > 1 else -1, j if size > 2 else -1
                    for place in range(3):
                        w[BEST, place] = w[PUSHES, place]
    for place in range(3):
        chosen = one if place == 0 else two if place == 1 else three
        if chosen >= 0:
            impulse = 2.0 * w[BEST, place] / w[LENGTHS, chosen]
            w[IMPULSES, chosen] = impulse
            kick(n, w[STATE], w[GRADIENTS + chosen], impulse)


def weigh(n: SceneNumbers, w: Workspace, count: int) -> None:
    """Fill in v = M^1/2 qdot, the rows of J M^-1/2 at length 1, and their lengths."""
    for place in range(6):
        mass = n.box_mass if place < 2 else n.box_inertia if place == 2 else n.jack_mass
        root = math.sqrt(n.jack_inertia if place == 5 else mass)
        w[RATES, place] = root * w[STATE, 6 + place]
        for i in range(count):
            w[UNIT + i, place] = w[GRADIENTS + i, place] / root
    for i in range(count):
        w[LENGTHS, i] = math.sqrt(_dot(w[UNIT + i], w[UNIT + i]))
        for place in range(6):
            w[UNIT + i, place] /= w[LENGTHS, i]


def _dot(a: Array, b: Array) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5])


def project(w: Workspace, size: int, one: int, two: int, three: int) -> bool:
    """Project the weighted rates v on what ``size`` rows leave free, to the point v + sum of pushes times rows.

    Returns whether the rows are independent and no push is negative. By modified Gram-Schmidt, rows = tall^T base.
    """
    point, pushes = w[POINT], w[PUSHES]
    for place in range(6):
        point[place] = w[RATES, place]
    for a in range(size):
        picked = one if a == 0 else two if a == 1 else three
        for place in range(6):
            w[BASE + a, place] = w[UNIT + picked, place]
        for turn in range(2):  # twice is enough to be orthogonal to rounding (Giraud et al. 2005)
            for b in range(a):
                share = _dot(w[BASE + b], w[BASE + a])
                w[TALL + b, a] = share if turn == 0 else w[TALL + b, a] + share
                for place in range(6):
                    w[BASE + a, place] -= share * w[BASE + b, place]
        length = math.sqrt(_dot(w[BASE + a], w[BASE + a]))
        if length < _DEPENDENT:
            return False
        w[TALL + a, a] = length
        for place in range(6):
            w[BASE + a, place] /= length
        pushes[a] = -_dot(w[BASE + a], point)
        for place in range(6):
            point[place] += pushes[a] * w[BASE + a, place]
    for a in range(size - 1, -1, -1):
        for b in range(a + 1, size):
            pushes[a] -= w[TALL + a, b] * pushes[b]
        pushes[a] /= w[TALL + a, a]
        if pushes[a] < 0.0:
            return False
    return True
