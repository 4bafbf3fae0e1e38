"""Feet at rest on walls, for the exact contact model: which ones, and how box and jack move while walls carry them.

A bounce too low to be told from rest, below :attr:`search.Touch.together`, ends in rest. From then on the foot is held:
its gap is a constraint of the Lagrangian motion

    M qddot = f + J^T lambda,    J qddot + Jdot qdot = 0,    lambda >= 0,

until lambda is 0 and the wall would have to pull. Among feet that touch and neither approach nor part, the ones that
are held solve 0 <= lambda _|_ J qddot + Jdot qdot >= 0: the accelerations are the nearest to the free ones, in the
norm of M, that close no gap (Gauss's principle; Brogliato 2016, "Nonsmooth Mechanics", ch. 5).

Method: collocation in the 13 Chebyshev points of a stretch of time, by Picard iteration. The accelerations and forces
that it finds are polynomials, so the motion is a flight under a known drive, and the search for the next impact of
another foot has the same guarantee as in free flight. Where a force falls to 0 is found by the same walk, along its
polynomial. At the end of a stretch the held gaps are brought back to 0 and their rates with them, by the nearest step
in the norm of M, so that nothing drifts and no energy is gained.
Order: 13 in a stretch, which is halved until the last Chebyshev coefficients are rounding.
Cost: some 10 iterations of 13 moments for a stretch, which is a whole control step unless something turns fast.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.drives import DEGREE, PUSH_X, PUSH_Y, TURN, horner, integrate
from jackbox_env.compiled.impacts import (
    Frame,
    dot,
    frame_of,
    gradient,
    kick,
    nearest,
    project,
    resolve,
    root_mass,
    weigh,
)
from jackbox_env.compiled.interpolation import POINTS, interpolate
from jackbox_env.compiled.search import (
    ENDLESS,
    HELD_AXES,
    MOST_WORK,
    NONE,
    Flight,
    Piece,
    Touch,
    evolve,
    first_impact,
    largest,
    parabola_root,
    why_endless,
)
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.workspace import (
    BASE,
    BEST,
    BIAS,
    COUNT,
    ELAPSED,
    FREE,
    GAPS,
    GRADIENTS,
    HITS,
    HOLDING,
    IMPULSE,
    LENGTHS,
    LOOSE,
    NODE,
    ORDER,
    PAIRS,
    PIECE,
    POINT,
    PUSHES,
    RATES,
    RECORD,
    RESTING,
    SPARE,
    STATE,
    TALLY,
    TARGETS,
    UNIT,
    VALUES,
    WORK,
    Workspace,
)
from jackbox_env.scene import SceneNumbers

Array = NDArray[np.float64]

_FORCES = HELD_AXES + 6  # of the held feet, after the accelerations of box and jack
_TURNED = 0.5  # [rad] that a stretch may turn at first
_ROUNDS = 40  # of Picard iteration
_SETTLED = 2e-16  # change of the accelerations in a round, over a speed by the stretch's length
_RESOLVED = 1e-14  # last Chebyshev coefficients of the accelerations, likewise
_ALONG = 1e-18  # square of what a unit gradient may keep beside those of held feet, to be held along with them
_FAINT = 1e-9  # of the strongest push at held feet: an acceleration that is none
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


def list_slow(scene: SceneNumbers, work: Workspace, frame: Frame, touch: Touch, slow: float) -> int:
    """List the contacts that touch, at rates up to ``slow`` [m/s], but for those let go; return how many there are."""
    count, loose = 0, int(work[HOLDING, LOOSE])
    for pair in range(16):
        row = work[GRADIENTS + count]
        gap = gradient(scene, frame, pair // 4, pair % 4, row)
        if gap <= touch.together and abs(rate_of(work[STATE], row)) <= slow and not loose & (1 << pair):
            work[PAIRS, count] = pair
            count += 1
    return count


def settle(scene: SceneNumbers, work: Workspace, piece: Piece, since: float, touch: Touch, slow: float) -> int:
    """Find the feet at rest on walls, and bring their gaps and rates to rest.

    Args:
        scene: the scene.
        work: memory with the state.
        piece: what acts on the box.
        since: [s] after the piece's start.
        touch: when feet touch.
        slow: rate above which no foot that touches is looked at [m/s].

    Returns:
        The pairs that are held, as bits. Their number is in ``work[HOLDING, COUNT]``, and they are first in
        ``work[PAIRS]``.
    """
    state = work[STATE]
    frame = frame_of(state)
    count = list_slow(scene, work, frame, touch, slow)
    accelerations(scene, work, piece, since)
    while count > 0:
        work[TALLY, WORK] += 1.0
        list_contacts(scene, work, work[STATE], count)
        bend_all(scene, work, state, frame, count)
        chosen = nearest(work, count)
        # A foot that would bounce higher than can be told from rest is not at rest.
        bouncing = -1
        for place in range(3):
            number = chosen[place]
            if number >= 0:
                # The acceleration that this contact takes from the foot, were it the only one.
                pressed = work[BEST, place] * work[LENGTHS, number]
                rate = rate_of(state, work[GRADIENTS + number])
                if rate * rate > 2.0 * touch.together * pressed:
                    bouncing = number
        if bouncing < 0:
            return hold_these(scene, work, touch, count, chosen)
        count -= 1
        work[PAIRS, bouncing] = work[PAIRS, count]
    return 0


def hold_these(scene: SceneNumbers, work: Workspace, touch: Touch, count: int, chosen: tuple[int, int, int]) -> int:
    """Hold the chosen of ``count`` contacts and bring them to rest; return them as bits, with those they hold along.

    A contact that needs no force and does not part either is held too, so that nobody has to watch it. If its wall
    would have to pull, it is let go at once. A contact whose gradient is a sum of held ones stays closed by itself.
    """
    size, strongest = 0, 0.0
    for place in range(3):
        number = chosen[place]
        if number >= 0:
            work[ORDER, size] = number
            strongest = max(strongest, work[BEST, place])
            size += 1
    if size == 0:
        return 0
    project(work, size, chosen[0], chosen[1], chosen[2])
    faint, held = _FAINT * strongest, 0
    for number in range(count):
        row = work[UNIT + number]
        parting = dot(row, work[POINT]) + work[BIAS, number]
        rate = rate_of(work[STATE], work[GRADIENTS + number]) / work[LENGTHS, number]
        beside = aside(work, size, row)
        if beside < _ALONG:
            held |= 1 << int(work[PAIRS, number])
        elif size < 3 and abs(parting) <= faint and rate * rate <= 2.0 * touch.together * faint:
            beside = math.sqrt(beside)
            for place in range(6):
                work[BASE + size, place] = work[SPARE, place] / beside
            work[ORDER, size] = number
            size += 1
            held |= 1 << int(work[PAIRS, number])
    for place in range(size):
        work[SPARE, place] = work[PAIRS, int(work[ORDER, place])]
        gap = work[GAPS, int(work[ORDER, place])]
        work[TARGETS, place] = gap if abs(gap) > touch.together else 0.0
    for place in range(size):
        work[PAIRS, place] = work[SPARE, place]
    work[HOLDING, COUNT] = size
    bring_back(scene, work)
    return held


def aside(work: Workspace, size: int, row: Array) -> float:
    """Square of what a unit row keeps beside the first ``size`` rows of the base; that is left in ``work[SPARE]``."""
    spare = work[SPARE]
    for place in range(6):
        spare[place] = row[place]
    for base in range(size):
        share = dot(spare, work[BASE + base])
        for place in range(6):
            spare[place] -= share * work[BASE + base, place]
    return dot(spare, spare)


def bring_back(scene: SceneNumbers, work: Workspace) -> None:
    """Bring the held gaps to their targets and their rates to 0, each by the nearest change in the norm of M.

    Two steps of Newton bring a gap there to rounding.
    """
    state, count = work[STATE], int(work[HOLDING, COUNT])
    for turn in range(3):
        list_contacts(scene, work, state, count)
        weigh(scene, work, count, state[6:])
        for number in range(count):
            off = work[GAPS, number] - work[TARGETS, number] if turn < 2 else 0.0
            work[BIAS, number] = off / work[LENGTHS, number]
        for place in range(6):
            work[RATES, place] *= 0.0 if turn < 2 else 1.0
        project(work, count, 0, 1, 2)
        for number in range(count):
            share = work[PUSHES, number] / work[LENGTHS, number]
            kick(scene, state[(0 if turn < 2 else 6) :], work[GRADIENTS + number], share)


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
                row = PIECE + 3 * (_FORCES + place)
                for k in range(16):
                    work[row, k] = 0.0
                interpolate(work[VALUES + 6 + place], work[row], 0)
                integrate(work, _FORCES + place, length)
            return bool(tail * length <= _RESOLVED * speed)
        if not changed < 2.0 * before or work[TALLY, WORK] > MOST_WORK:
            return False
        before = changed
    return False


def let_go(work: Workspace, place: int, length: float, peak: float) -> float:
    """When a held foot's force falls to 0 and the wall would have to pull, in [s]; infinity if it never does."""
    powers = work[PIECE + 3 * (_FORCES + place)]
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


def hold(
    scene: SceneNumbers, work: Workspace, piece: Piece, touch: Touch, since: float, held: int
) -> tuple[Status, float]:
    """Move with held feet to the end of a stretch, an impact, or until a wall would have to pull.

    Args:
        scene: the scene.
        work: memory with the state, the drive's polynomials and the pairs that are held.
        piece: what acts on the box.
        touch: when feet touch.
        since: [s] after the piece's start.
        held: the pairs that are held, as bits.

    Returns:
        How it ended, and how long it took [s]. Feet that were let go at once are noted in ``work[HOLDING, LOOSE]``.
    """
    state, count, left = work[STATE], int(work[HOLDING, COUNT]), piece.length - since
    turning = abs(state[8]) + abs(state[11])
    length = left if turning * left <= _TURNED else _TURNED / turning
    while not stretch(scene, work, piece, since, length):
        length *= 0.5
        if work[TALLY, WORK] > MOST_WORK or not since + length > since:
            return Status.TOO_MUCH_WORK, 0.0
    end, loose, peak = length, -1, 0.0
    for place in range(count):
        for number in range(DEGREE + 1):
            peak = max(peak, abs(work[VALUES + 6 + place, number]))
    for place in range(count):
        time = let_go(work, place, length, peak)
        if time < end:
            end, loose = time, place
    flight = Flight(
        state[3] - state[0], state[4] - state[1], state[9] - state[6], state[10] - state[7], state[2], state[8],
        state[5], state[11], 0.0, 0.0, 0.0, 0.5 * length, True, True, held,
        abs(state[6]) + abs(state[7]) + abs(state[9]) + abs(state[10]),
    )  # fmt: skip
    # Bounds of the accelerations beside gravity, which the search adds.
    turn = largest(work, HELD_AXES + 2) + largest(work, HELD_AXES + 5)
    pushed = scene.gravity
    for place in (0, 1, 3, 4):
        pushed += largest(work, HELD_AXES + place)
    bounds = Piece(length, 0.0, True, True, turn, pushed)
    time, pair = first_impact(scene, work, flight, bounds, end, touch.tolerance, -math.inf)
    if pair == ENDLESS:
        return why_endless(work), 0.0
    if pair != NONE:
        end = time
    u = 2.0 * end / length - 1.0 if end < length else 1.0
    for place in range(count):
        impulse = horner(work[PIECE + 3 * (_FORCES + place) + 1], DEGREE + 1, u)
        work[RESTING, int(work[PAIRS, place])] += max(impulse, 0.0)
    evolve(work, flight, end)
    bring_back(scene, work)
    work[TALLY, ELAPSED] += end
    if pair != NONE:
        work[TALLY, WORK] += 1.0
        resolve(scene, work, touch.together, pair // 4, pair % 4)
    elif loose >= 0 and end == 0.0:
        work[HOLDING, LOOSE] += 1 << int(work[PAIRS, loose])
    if end > 0.0:
        work[HOLDING, LOOSE] = 0.0
    return Status.DONE, end


def record_rest(work: Workspace, dt: float) -> None:
    """Record the impulse of each held foot over the step, at its end."""
    for pair in range(16):
        if work[RESTING, pair] > 0.0:
            place = RECORD + int(work[TALLY, HITS])
            if place < work.shape[0]:
                work[place, 0], work[place, 1], work[place, 2] = dt, pair // 4, pair % 4
                work[place, 3] = work[RESTING, pair]
            work[TALLY, HITS] += 1.0
            work[TALLY, IMPULSE] += work[RESTING, pair]
