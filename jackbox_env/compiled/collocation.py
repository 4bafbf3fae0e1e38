"""The motion of box and jack over a stretch of time while walls hold feet.

A held foot's gap is a constraint of the Lagrangian motion

    M qddot = f + J^T lambda,    J qddot + Jdot qdot = 0.

Method: collocation in the 13 Chebyshev points of the stretch, by Picard iteration. The accelerations and forces that it
finds are polynomials, so the motion is a flight under a known drive. Where a force falls to 0 is found by the walk
along parabolas of ``search.py``, here along the force's polynomial.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.bounds import parabola_root
from jackbox_env.compiled.drives import DEGREE, PUSH_X, PUSH_Y, TURN, horner, integrate
from jackbox_env.compiled.impacts import Frame, frame_of, gradient, project, root_mass, weigh
from jackbox_env.compiled.interpolation import POINTS, interpolate
from jackbox_env.compiled.motion import HELD_AXES, Piece
from jackbox_env.compiled.search import MOST_WORK
from jackbox_env.compiled.workspace import (
    BIAS,
    COUNT,
    FREE,
    GAPS,
    GRADIENTS,
    HOLDING,
    LENGTHS,
    NODE,
    PAIRS,
    PIECE,
    POINT,
    PUSHES,
    STATE,
    TALLY,
    VALUES,
    WORK,
    Workspace,
)
from jackbox_env.scene import SceneNumbers

Array = NDArray[np.float64]

FORCES = HELD_AXES + 6  # of the held feet, after the accelerations of box and jack
_ROUNDS = 40  # of Picard iteration
_SETTLED = 2e-16  # change of the accelerations in a round, over a speed by the stretch's length
_RESOLVED = 1e-14  # last Chebyshev coefficients of the accelerations, likewise
_PULL = 1e-12  # of the largest force in a stretch: that much a wall may pull before it lets go


def bend(scene: SceneNumbers, state: Array, frame: Frame, row: Array, gap: float) -> float:
    """Jdot qdot of a gap with the gradient ``row``: its second derivative where nothing accelerates [m/s^2]."""
    omega, spin = state[8], state[11] - state[8]
    depth = row[0] * frame.x + row[1] * frame.y  # n . r
    sideways = row[0] * (state[10] - state[7]) - row[1] * (state[9] - state[6])  # n^perp . v
    along = scene.box_half_width - depth - gap  # of the foot from the jack's centre, on n
    return float(-2.0 * omega * sideways + omega * omega * depth + spin * spin * along)


def accelerations(scene: SceneNumbers, work: Workspace, piece: Piece, since: float) -> None:
    """Fill in the accelerations that gravity and the drive give box and jack ``since`` [s] after the piece's start."""
    u = 2.0 * since / piece.length - 1.0
    free = work[FREE]
    free[0] = free[1] = free[3] = free[5] = 0.0
    free[2], free[4] = piece.alpha, -scene.gravity
    if piece.curved:
        free[2] = horner(work[PIECE + 3 * TURN], DEGREE, u)
    if piece.pushed:
        free[0] = horner(work[PIECE + 3 * PUSH_X], DEGREE, u)
        free[1] = horner(work[PIECE + 3 * PUSH_Y], DEGREE, u)


def list_contacts(scene: SceneNumbers, work: Workspace, state: Array, count: int) -> Frame:
    """Fill in gaps and gradients of the pairs in ``work[PAIRS]`` for a state."""
    frame = frame_of(state)
    for number in range(count):
        pair = int(work[PAIRS, number])
        work[GAPS, number] = gradient(scene, frame, pair // 4, pair % 4, work[GRADIENTS + number])
    return frame


def rate_of(state: Array, row: Array) -> float:
    """J qdot [m/s]."""
    return float(
        row[0] * (state[6] - state[9]) + row[1] * (state[7] - state[10]) + row[2] * state[8] + row[5] * state[11]
    )


def bend_all(scene: SceneNumbers, work: Workspace, state: Array, frame: Frame, count: int) -> None:
    """Weigh the free accelerations and the gradients, and fill in the bias that makes J qddot + Jdot qdot of them."""
    weigh(scene, work, count, work[FREE])
    for number in range(count):
        turn = bend(scene, state, frame, work[GRADIENTS + number], work[GAPS, number])
        work[BIAS, number] = turn / work[LENGTHS, number]


def moment(scene: SceneNumbers, work: Workspace, piece: Piece, since: float, length: float, number: int) -> float:
    """Fill in accelerations and forces at one of the 13 moments; return by how much the accelerations changed.

    Accelerations of angles count by what they do to a foot and a wall [m/s^2].
    """
    count = int(work[HOLDING, COUNT])
    s = 0.5 * (1.0 + POINTS[number]) * length
    state, node = work[STATE], work[NODE]
    for place in range(6):
        row = PIECE + 3 * (HELD_AXES + place)
        node[place] = state[place] + (state[6 + place] * s + horner(work[row + 2], DEGREE + 2, POINTS[number]))
        node[6 + place] = state[6 + place] + horner(work[row + 1], DEGREE + 1, POINTS[number])
    accelerations(scene, work, piece, since + s)
    frame = list_contacts(scene, work, node, count)
    bend_all(scene, work, node, frame, count)
    if not project(work, count, 0, 1, 2):
        return math.inf
    changed = 0.0
    for place in range(6):
        value = work[POINT, place] / root_mass(scene, place)
        reach = scene.box_half_width if place == 2 else scene.jack_arm if place == 5 else 1.0
        changed = max(changed, reach * abs(value - work[VALUES + place, number]))
        work[VALUES + place, number] = value
    for place in range(count):
        work[VALUES + 6 + place, number] = work[PUSHES, place] / work[LENGTHS, place]
    return changed


def stretch(scene: SceneNumbers, work: Workspace, piece: Piece, since: float, length: float) -> bool:
    """Find the motion of box and jack with held feet over ``length`` [s]; return whether it is resolved to rounding."""
    count, state = int(work[HOLDING, COUNT]), work[STATE]
    speed = scene.speed_scale + abs(state[9] - state[6]) + abs(state[10] - state[7])
    speed += scene.box_half_width * abs(state[8]) + scene.jack_arm * abs(state[11])
    for place in range(6):  # at first, as it begins
        for k in range(16):
            for order in range(3):
                work[PIECE + 3 * (HELD_AXES + place) + order, k] = 0.0
        for number in range(DEGREE + 1):
            work[VALUES + place, number] = 0.0
    before = math.inf
    for _ in range(_ROUNDS):
        changed = 0.0
        for number in range(DEGREE + 1):
            changed = max(changed, moment(scene, work, piece, since, length, number))
        work[TALLY, WORK] += DEGREE + 1.0
        tail = 0.0
        for place in range(6):
            row = PIECE + 3 * (HELD_AXES + place)
            for k in range(DEGREE + 1):
                work[row, k] = 0.0
            _, last, _ = interpolate(work[VALUES + place], work[row], 0)
            integrate(work, HELD_AXES + place, length)
            reach = scene.box_half_width if place == 2 else scene.jack_arm if place == 5 else 1.0
            tail = max(tail, reach * last)
        if changed * length <= _SETTLED * speed or (changed >= before and changed * length <= 1e-13 * speed):
            for place in range(count):
                row = PIECE + 3 * (FORCES + place)
                for k in range(16):
                    work[row, k] = 0.0
                interpolate(work[VALUES + 6 + place], work[row], 0)
                integrate(work, FORCES + place, length)
            return bool(tail * length <= _RESOLVED * speed)
        if not changed < 2.0 * before or work[TALLY, WORK] > MOST_WORK:
            return False
        before = changed
    return False


def let_go(work: Workspace, place: int, length: float, peak: float) -> float:
    """When a held foot's force falls to 0 and the wall would have to pull, in [s]; infinity if it never does."""
    powers = work[PIECE + 3 * (FORCES + place)]
    curvature = 0.0
    for k in range(2, DEGREE + 1):
        curvature += k * (k - 1.0) * abs(powers[k])
    margin, u = _PULL * peak, -1.0
    while work[TALLY, WORK] <= MOST_WORK:
        work[TALLY, WORK] += 1.0
        force, slope = powers[DEGREE], 0.0
        for k in range(DEGREE - 1, -1, -1):
            slope = force + u * slope
            force = powers[k] + u * force
        if force + margin <= 0.5 * margin:
            return 0.5 * (1.0 + u) * length
        u += parabola_root(force + margin, slope, curvature)
        if not u <= 1.0:
            return math.inf
    return math.inf
