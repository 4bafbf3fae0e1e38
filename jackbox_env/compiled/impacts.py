"""The impact law at the moment of impact, for the exact contact model: which feet touch, and what it does to them.

Law: all contacts whose gap is within the tolerance take part in the simultaneous Newton law at restitution e,

    0 <= lambda  _|_  J qdot+ + e J qdot- >= 0,    M (qdot+ - qdot-) = J^T lambda,

the law of :func:`jackbox_env.mechanics.simultaneous_impact_map`, which tests compare this with. With w = J M^-1/2 and
v = M^1/2 qdot it is v+ = (1 + e) P(v-) - e v-, where P(v) is the nearest point to v in the cone w v >= 0. Contacts of
a jack and a square have rank 3 at most, so P is found by trying all sets of one, two and three contacts. Each set
gives a point by projection. The right point needs no negative push and closes no gap.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.trigonometry import cos_sin
from jackbox_env.compiled.workspace import (
    BASE,
    BEST,
    BIAS,
    ELAPSED,
    GOALS,
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


class Frame(NamedTuple):
    """The jack's place and both angles."""

    x: float  # from the box's centre [m]
    y: float
    cosine: float  # of the box's angle
    sine: float
    relative_cosine: float  # of the jack's angle relative to the box
    relative_sine: float


def gradient(scene: SceneNumbers, frame: Frame, wall: int, foot: int, row: Array) -> float:
    """Write the gradient J of a gap to ``row``; return the gap [m]."""
    nx, ny = quarter(frame.cosine, frame.sine, wall)
    depth, side = nx * frame.x + ny * frame.y, nx * frame.y - ny * frame.x  # n . r and n^perp . r
    along, across = quarter(frame.relative_cosine, frame.relative_sine, foot - wall)  # foot over arm, on n and n^perp
    arm = scene.jack_arm * across
    row[0], row[1], row[2], row[3], row[4], row[5] = nx, ny, -side - arm, -nx, -ny, arm
    return scene.box_half_width - depth - scene.jack_arm * along


def frame_of(state: Array) -> Frame:
    """Place and angles of a state."""
    c, s = cos_sin(state[2])
    cp, sp = cos_sin(state[5] - state[2])
    return Frame(state[3] - state[0], state[4] - state[1], c, s, cp, sp)


def list_touching(scene: SceneNumbers, work: Workspace, tolerance: float, wall: int, foot: int) -> int:
    """List the contacts within ``tolerance`` [m], and that of ``wall`` and ``foot``; return how many there are."""
    frame = frame_of(work[STATE])
    count = 0
    for k in range(4):
        for i in range(4):
            gap = gradient(scene, frame, k, i, work[GRADIENTS + count])
            if gap <= tolerance or (k == wall and i == foot):
                work[PAIRS, count], work[IMPULSES, count] = 4.0 * k + i, 0.0
                count += 1
    return count


def resolve(scene: SceneNumbers, work: Workspace, tolerance: float, wall: int, foot: int) -> None:
    """Apply the law to every contact within ``tolerance`` [m], and to that of ``wall`` and ``foot`` in any case.

    Changes the rates in ``work`` and records the impacts there.
    """
    state = work[STATE]
    count = list_touching(scene, work, tolerance, wall, foot)
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
    """One contact, with the gap's gradient J in ``row``: lambda = -(1 + e) J qdot / (J M^-1 J^T) where J qdot < 0."""
    impulse = 0.0
    rate = row[0] * (state[6] - state[9]) + row[1] * (state[7] - state[10]) + row[2] * state[8] + row[5] * state[11]
    if rate < 0.0:
        yielding = 1.0 / scene.box_mass + 1.0 / scene.jack_mass
        yielding += row[2] * row[2] / scene.box_inertia + row[5] * row[5] / scene.jack_inertia
        impulse = -(1.0 + scene.restitution) * rate / yielding
        kick(scene, state[6:], row, impulse)
    return impulse


def kick(scene: SceneNumbers, rates: Array, row: Array, impulse: float) -> None:
    """Change six rates, those of box and jack, by M^-1 J^T lambda."""
    rates[0] += row[0] * impulse / scene.box_mass
    rates[1] += row[1] * impulse / scene.box_mass
    rates[2] += row[2] * impulse / scene.box_inertia
    rates[3] += row[3] * impulse / scene.jack_mass
    rates[4] += row[4] * impulse / scene.jack_mass
    rates[5] += row[5] * impulse / scene.jack_inertia


def bounce_together(scene: SceneNumbers, work: Workspace, count: int) -> None:
    """Several contacts: reflect the rates at their projection on the cone of rates that close no gap."""
    weigh(scene, work, count, work[STATE, 6:])
    for i in range(count):
        work[BIAS, i] = 0.0
    chosen = nearest(work, count)
    for place in range(3):
        number = chosen[place]
        if number >= 0:
            impulse = (1.0 + scene.restitution) * work[BEST, place] / work[LENGTHS, number]
            work[IMPULSES, number] = impulse
            kick(scene, work[STATE, 6:], work[GRADIENTS + number], impulse)


def nearest(work: Workspace, count: int) -> tuple[int, int, int]:
    """The contacts, -1 for none, that push the weighted rates v to the nearest point with w v + bias >= 0 everywhere.

    Their pushes are in ``work[BEST]``. By trying all sets of one, two and three of ``count`` contacts.
    """
    lowest = 0.0
    for i in range(count):
        lowest = min(lowest, dot(work[UNIT + i], work[RATES]) + work[BIAS, i])
    if lowest >= 0.0:
        return -1, -1, -1  # nothing approaches
    least = math.inf
    one = two = three = -1
    for i in range(count):
        for j in range(i, count):
            for k in range(j, count):
                if k == j and j != i:
                    continue  # sets of one (i, i, i), two (i, i, k) and three (i, j, k)
                size = 1 if k == i else 2 if j == i else 3
                violation = violation_of(work, count, size, k, i, j)
                if violation < least:
                    least = violation
                    one, two, three = k, i if size > 1 else -1, j if size > 2 else -1
                    for place in range(3):
                        work[BEST, place] = work[PUSHES, place]
    return one, two, three


def violation_of(work: Workspace, count: int, size: int, one: int, two: int, three: int) -> float:
    """By how much a set's projection closes gaps; infinity if its rows depend on each other or a push pulls."""
    if not (project(work, size, one, two, three) and pushing(work, size)):
        return math.inf
    violation = 0.0
    for other in range(count):
        violation = max(violation, -(dot(work[UNIT + other], work[POINT]) + work[BIAS, other]))
    return violation


def root_mass(scene: SceneNumbers, place: int) -> float:
    """Square root of a diagonal element of M."""
    mass = scene.box_mass if place < 2 else scene.box_inertia if place == 2 else scene.jack_mass
    return math.sqrt(scene.jack_inertia if place == 5 else mass)


def weigh(scene: SceneNumbers, work: Workspace, count: int, rates: Array) -> None:
    """Fill in v = M^1/2 ``rates``, the rows of J M^-1/2 at length 1, and their lengths."""
    for place in range(6):
        root = root_mass(scene, place)
        work[RATES, place] = root * rates[place]
        for i in range(count):
            work[UNIT + i, place] = work[GRADIENTS + i, place] / root
    for i in range(count):
        work[LENGTHS, i] = math.sqrt(dot(work[UNIT + i], work[UNIT + i]))
        for place in range(6):
            work[UNIT + i, place] /= work[LENGTHS, i]


def dot(a: Array, b: Array) -> float:
    """Scalar product of six numbers."""
    return float(a[0] * b[0] + a[1] * b[1] + a[2] * b[2] + a[3] * b[3] + a[4] * b[4] + a[5] * b[5])


def project(work: Workspace, size: int, one: int, two: int, three: int) -> bool:
    """Project the weighted rates v on where ``size`` rows have w v + bias = 0: the point v + sum of pushes times rows.

    Returns whether the rows are independent. By modified Gram-Schmidt, rows = tall^T base.
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
                share = dot(work[BASE + b], work[BASE + a])
                work[TALL + b, a] = share if turn == 0 else work[TALL + b, a] + share
                for place in range(6):
                    work[BASE + a, place] -= share * work[BASE + b, place]
        length = math.sqrt(dot(work[BASE + a], work[BASE + a]))
        if length < _DEPENDENT:
            return False
        work[TALL + a, a] = length
        for place in range(6):
            work[BASE + a, place] /= length
        goal = work[BIAS, picked]
        for b in range(a):
            goal += work[TALL + b, a] * work[GOALS, b]
        work[GOALS, a] = 0.0 - goal / length
        pushes[a] = -(dot(work[BASE + a], point) - work[GOALS, a])
        for place in range(6):
            point[place] += pushes[a] * work[BASE + a, place]
    for a in range(size - 1, -1, -1):
        for b in range(a + 1, size):
            pushes[a] -= work[TALL + a, b] * pushes[b]
        pushes[a] /= work[TALL + a, a]
    return True


def pushing(work: Workspace, size: int) -> bool:
    """Whether no push of a projection pulls."""
    pulling = False
    for a in range(size):
        pulling |= work[PUSHES, a] < 0.0
    return not pulling
