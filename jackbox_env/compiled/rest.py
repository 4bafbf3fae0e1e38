"""Feet at rest on walls, for the exact contact model: which ones, and how box and jack move while walls carry them.

A bounce too low to be told from rest, below :attr:`search.Touch.together`, ends in rest. From then on the foot is held:
its gap is a constraint of the Lagrangian motion

    M qddot = f + J^T lambda,    J qddot + Jdot qdot = 0,    lambda >= 0,

until lambda is 0 and the wall would have to pull. Among feet that touch and neither approach nor part, the ones that
are held solve 0 <= lambda _|_ J qddot + Jdot qdot >= 0: the accelerations are the nearest to the free ones, in the
norm of M, that close no gap (Gauss's principle; Brogliato 2016, "Nonsmooth Mechanics", ch. 5).

Method: over a stretch of time the motion is found by collocation (``collocation.py``). It is a flight under a known
drive, so the search for the next impact of another foot has the same guarantee as in free flight. At the end of a
stretch the held gaps are brought back to 0 and their rates with them, by the nearest step in the norm of M. So nothing
drifts and no energy is gained.
Order: 13 in a stretch, which is halved until the last Chebyshev coefficients are rounding.
Cost: some 10 iterations of 13 moments for a stretch, which is a whole control step unless something turns fast.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.collocation import (
    FORCES,
    accelerations,
    bend_all,
    let_go,
    list_contacts,
    rate_of,
    stretch,
)
from jackbox_env.compiled.drives import DEGREE, horner
from jackbox_env.compiled.impacts import Frame, dot, frame_of, gradient, kick, nearest, project, resolve, weigh
from jackbox_env.compiled.motion import HELD_AXES, Flight, Piece, evolve, largest
from jackbox_env.compiled.search import ENDLESS, MOST_WORK, NONE, Touch, first_impact, why_endless
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.workspace import (
    BASE,
    BEST,
    BIAS,
    COUNT,
    ELAPSED,
    GAPS,
    GRADIENTS,
    HITS,
    HOLDING,
    IMPULSE,
    LENGTHS,
    LOOSE,
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

_TURNED = 0.5  # [rad] that a stretch may turn at first
_ALONG = 1e-18  # square of what a unit gradient may keep beside those of held feet, to be held along with them
_FAINT = 1e-9  # of the strongest push at held feet: an acceleration that is none


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
        impulse = horner(work[PIECE + 3 * (FORCES + place) + 1], DEGREE + 1, u)
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
