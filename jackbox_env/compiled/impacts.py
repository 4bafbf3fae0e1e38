"""The impact law at the moment of impact, for the exact contact model: which feet touch, and what it does to them.

Law: all contacts whose gap is within the tolerance take part in the simultaneous Newton law at restitution 1,

    0 <= lambda  _|_  J qdot+ + J qdot- >= 0,    M (qdot+ - qdot-) = J^T lambda,

the law of :func:`jackbox_env.mechanics.simultaneous_impact_map`, which tests compare this with. With w = J M^-1/2 and
v = M^1/2 qdot it is the reflection v+ = 2 P(v-) - v- at P(v), the nearest point to v in the cone w v >= 0. Contacts of
a jack and a square have rank 3 at most, so P is found by trying all sets of one, two and three contacts. Each set
gives a point by projection. The right point needs no negative push and closes no gap.
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

_DEPENDENT = 1e-13  # a row that keeps less than this of its length beside the others depends on them


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


def resolve(scene: SceneNumbers, work: Workspace, tolerance: float, wall: int, foot: int) -> None:
    """Apply the law to every contact within ``tolerance`` [m], and to that of ``wall`` and ``foot`` in any case.

    Changes the rates in ``work`` and records the impacts there.
    """
    state = work[STATE]
    c, s = cos_sin(state[2])
    cp, sp = cos_sin(state[5] - state[2])
    x, y = state[3] - state[0], state[4] - state[1]
    count = 0
    for k in range(4):
        nx, ny = quarter(c, s, k)
        depth, side = nx * x + ny * y, nx * y - ny * x  # n . r and n^perp . r
        for i in range(4):
            along, across = quarter(cp, sp, i - k)  # foot over arm, on n and n^perp
            gap = scene.box_half_width - depth - scene.jack_arm * along
            if gap <= tolerance or (k == wall and i == foot):
                arm = scene.jack_arm * across
                row = work[GRADIENTS + count]
                row[0], row[1], row[2], row[3], row[4], row[5] = nx, ny, -side - arm, -nx, -ny, arm
                work[PAIRS, count], work[IMPULSES, count] = 4.0 * k + i, 0.0
                count += 1
    if count == 1:
        work[IMPULSES, 0] = bounce(scene, state, work[GRADIENTS])
    else:
        bounce_together(scene, work, count)
    for number in range(count):
        if work[IMPULSES, number] > 0.0:
            place = RECORD + int(work[TALLY, HITS])
            if place < work.shape[0]:
                work[place, 0], work[place, 3] = work[TALLY, ELAPSED], work[IMPULSES, number]
                work[place, 1], work[place, 2] = work[PAIRS, number] // 4.0, work[PAIRS, number] % 4.0
            work[TALLY, HITS] += 1.0
            work[TALLY, IMPULSE] += work[IMPULSES, number]


def bounce(scene: SceneNumbers, state: Array, row: Array) -> float:
    """One contact, with the gap's gradient J in ``row``: lambda = -2 J qdot / (J M^-1 J^T) where J qdot < 0."""
    impulse = 0.0
    rate = row[0] * (state[6] - state[9]) + row[1] * (state[7] - state[10]) + row[2] * state[8] + row[5] * state[11]
    if rate < 0.0:
        yielding = 1.0 / scene.box_mass + 1.0 / scene.jack_mass
        yielding += row[2] * row[2] / scene.box_inertia + row[5] * row[5] / scene.jack_inertia
        impulse = -2.0 * rate / yielding
        kick(scene, state, row, impulse)
    return impulse


def kick(scene: SceneNumbers, state: Array, row: Array, impulse: float) -> None:
    """Change the rates by M^-1 J^T lambda."""
    state[6] += row[0] * impulse / scene.box_mass
    state[7] += row[1] * impulse / scene.box_mass
    state[8] += row[2] * impulse / scene.box_inertia
    state[9] += row[3] * impulse / scene.jack_mass
    state[10] += row[4] * impulse / scene.jack_mass
    state[11] += row[5] * impulse / scene.jack_inertia


def bounce_together(scene: SceneNumbers, work: Workspace, count: int) -> None:
    """Several contacts: reflect the rates at their projection on the cone of rates that close no gap."""
    weigh(scene, work, count)
    lowest = 0.0
    for i in range(count):
        lowest = min(lowest, _dot(work[UNIT + i], work[RATES]))
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
                if not project(work, size, k, i, j):
                    continue
                violation = 0.0
                for other in range(count):
                    violation = max(violation, -_dot(work[UNIT + other], work[POINT]))
                if violation < least:
                    least = violation
                    one, two, three = k, i if size > 1 else -1, j if size > 2 else -1
                    for place in range(3):
                        work[BEST, place] = work[PUSHES, place]
    for place in range(3):
        chosen = one if place == 0 else two if place == 1 else three
        if chosen >= 0:
            impulse = 2.0 * work[BEST, place] / work[LENGTHS, chosen]
            work[IMPULSES, chosen] = impulse
            kick(scene, work[STATE], work[GRADIENTS + chosen], impulse)


def weigh(scene: SceneNumbers, work: Workspace, count: int) -> None:
    """Fill in v = M^1/2 qdot, the rows of J M^-1/2 at length 1, and their lengths."""
    for place in range(6):
        mass = scene.box_mass if place < 2 else scene.box_inertia if place == 2 else scene.jack_mass
        root = math.sqrt(scene.jack_inertia if place == 5 else mass)
        work[RATES, place] = root * work[STATE, 6 + place]
        for i in range(count):
            work[UNIT + i, place] = work[GRADIENTS + i, place] / root
    for i in range(count):
        work[LENGTHS, i] = math.sqrt(_dot(work[UNIT + i], work[UNIT + i]))
        for place in range(6):
            work[UNIT + i, place] /= work[LENGTHS, i]


def _dot(a: Array, b: Array) -> float:
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5])


def project(work: Workspace, size: int, one: int, two: int, three: int) -> bool:
    """Project the weighted rates v on what ``size`` rows leave free, to the point v + sum of pushes times rows.

    Returns whether the rows are independent and no push is negative. By modified Gram-Schmidt, rows = tall^T base.
    """
    point, pushes = work[POINT], work[PUSHES]
    for place in range(6):
        point[place] = work[RATES, place]
    for a in range(size):
        picked = one if a == 0 else two if a == 1 else three
        for place in range(6):
            work[BASE + a, place] = work[UNIT + picked, place]
        for turn in range(2):  # twice is enough to be orthogonal to rounding (Giraud et al. 2005)
            for b in range(a):
                share = _dot(work[BASE + b], work[BASE + a])
                work[TALL + b, a] = share if turn == 0 else work[TALL + b, a] + share
                for place in range(6):
                    work[BASE + a, place] -= share * work[BASE + b, place]
        length = math.sqrt(_dot(work[BASE + a], work[BASE + a]))
        if length < _DEPENDENT:
            return False
        work[TALL + a, a] = length
        for place in range(6):
            work[BASE + a, place] /= length
        pushes[a] = -_dot(work[BASE + a], point)
        for place in range(6):
            point[place] += pushes[a] * work[BASE + a, place]
    for a in range(size - 1, -1, -1):
        for b in range(a + 1, size):
            pushes[a] -= work[TALL + a, b] * pushes[b]
        pushes[a] /= work[TALL + a, a]
        if pushes[a] < 0.0:
            return False
    return True
