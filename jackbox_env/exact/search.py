"""Detect: the next impact of a flight, or the proof that there is none.

``step.advance`` calls :func:`first_impact`, and then flies to the impact and resolves it. The head of
``simulators/exact.py`` states order, cost and limits.

Guarantee: gap = L - n . (r + o), with L half the box's width, n a wall's normal, r the jack's centre from the box's,
o a foot from there, |o| = l. With |gap''| <= K until the horizon,

    gap(t + s) >= gap + gap' s - K s^2 / 2,

so a walk to the first positive root of that parabola never passes an impact by a foot that arrives. A foot that touches
already and slides or leaves may get deeper, by at most ``contact.deepest``, and so may all feet while a step chatters:
see :func:`search`. A foot that starts outside is free while it comes back, and bounces where it turns round: see
:func:`turning`. The walk converges quadratically if the foot arrives at speed. If |r| + l < L throughout, no contact is
possible and no gap is evaluated. In a box that turns far, K is large and many feet may reach many walls:
:func:`first_impact_fast_rotation` then follows all of them at once.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from jackbox_env.exact.bounds import bounds_of, curvature_to_impact, inside, reach_of, rounding, walls_in_reach
from jackbox_env.exact.contact import deepest, widened
from jackbox_env.exact.flight import Flight, Piece, gap_at, view_at
from jackbox_env.exact.geometry import View, box_frame, foot_gap, towards, view_of
from jackbox_env.exact.workspace import Status, Workspace
from jackbox_env.jit.compiler import inlined
from jackbox_env.model.scene import SceneNumbers


def parabola_root(gap: float, rate: float, curvature: float) -> float:
    """First s > 0 at which gap + rate s - curvature s^2 / 2 is 0, for gap >= 0; infinity if it never is."""
    root = math.sqrt(rate * rate + 2.0 * curvature * gap)
    if rate < 0.0:
        return 2.0 * gap / (root - rate)
    return (rate + root) / curvature if curvature > 0.0 else math.inf


# Kinds of events: an impact, none within the horizon, undecided after reasonable work, or a foot may be at rest now.
IMPACT, NO_IMPACT, UNDECIDED, AT_REST = range(4)
MOST_WORK = 1_000_000  # gap evaluations in one step
_CHATTER_WORK = 65_536  # gap evaluations before a step may count as chattering
SHORT_HORIZON = 2.0**-12  # of a piece: how far a chattering step searches ahead
STEEPEST = 1e40  # K [m/s^2] and alpha [rad/s^2] beyond which squares overflow
ALL = 15  # walls, as bits
_TURNED = 0.25  # [rad] of the box's turn until the horizon, beyond which all feet are followed together
_CLOSING = 4.0  # rate^2 / (K gap) beyond which a foot is about to arrive
_SHORT = 2.0**-12  # of the horizon: below this step the feet are searched one by one
OUTSIDE = 2.5  # of ``deepest``: a foot that strikes from inside is less deep
_DIP = 1e-3  # of the depth of a foot outside: how much deeper it may be between two gap evaluations
_PATIENT = 10_000.0  # gap evaluations in a search for one foot's impact before it is followed as one outside


class Event(NamedTuple):
    """What a search has found."""

    outcome: int  # IMPACT, NO_IMPACT, UNDECIDED or AT_REST
    time: float  # since the flight's start [s]; NO_IMPACT: the search's end
    wall: int  # of an impact
    foot: int


class Limits(NamedTuple):
    """Bounds of a search for an impact."""

    curvature: float  # bound of a gap's second derivative [m/s^2]
    end: float  # of the search, since the flight's start [s]
    half_tolerance: float  # half the contact tolerance [m]


def is_chattering(scene: SceneNumbers, memory: Workspace) -> bool:
    """Whether the step chatters (Zeno): many gap evaluations, and next to no impulse per impact.

    Such a step searches only as far ahead as its next impacts. Otherwise it would search all that remains of the step
    after each of thousands of impacts.
    """
    if memory.evaluations <= _CHATTER_WORK:
        return False
    return bool(memory.impulse <= 1e-3 * scene.jack_mass * scene.speed_scale * memory.hits)


@inlined
def first_impact(
    scene: SceneNumbers,
    memory: Workspace,
    flight: Flight,
    piece: Piece,
    horizon: float,
    tolerance: float,
    resolution: float,
) -> Event:
    """Locate the first impact of a flight within ``horizon`` [s].

    Args:
        scene: the scene.
        memory: with the polynomial accelerations.
        flight: the relative motion.
        piece: what acts on the box.
        horizon: how far to search [s], at most to the end of the piece.
        tolerance: gap at which a foot touches [m].
        resolution: gap within which a slow foot may be at rest [m]; -inf: none may.

    Returns:
        The impact, or an event of another kind.
    """
    none = Event(NO_IMPACT, horizon, 0, 0)
    if reach_of(scene, flight, horizon, piece.max_acceleration) + scene.jack_arm < scene.box_half_width:
        return none
    bounds = bounds_of(scene, flight, horizon, piece.max_angular_acceleration, piece.max_acceleration)
    frame = box_frame(flight.x, flight.y, flight.vx, flight.vy, flight.angle, flight.omega)
    walls = walls_in_reach(scene, frame, horizon, bounds.centre_curvature)
    if walls == 0:
        return none
    curvature = bounds.centre_curvature + bounds.foot_curvature
    if not curvature < STEEPEST:
        return Event(UNDECIDED, horizon, 0, 0)
    # Half the tolerance, so that the foot that the search locates touches in spite of rounding.
    limits = Limits(curvature, horizon, 0.5 * tolerance)
    view = view_of(frame, flight.jack_angle - flight.angle, flight.jack_omega - flight.omega, 0.0)
    if flight.held == 0 and (abs(flight.omega) + piece.max_angular_acceleration * horizon) * horizon > _TURNED:
        return first_impact_fast_rotation(scene, memory, flight, view, limits, resolution, piece)
    return first_of_all(scene, memory, flight, view, walls, none, limits, resolution)


@inlined
def first_of_all(
    scene: SceneNumbers, memory: Workspace, flight: Flight, view: View, walls: int, likely: Event,
    limits: Limits, resolution: float,
) -> Event:  # fmt: skip
    """The first impact of any foot on any of these ``walls`` (as bits): see :func:`first_impact`.

    There is none before the moment of the ``view``. The contact of ``likely``, if that is an impact, is searched first.
    """
    first = Event(NO_IMPACT, limits.end, 0, 0)
    curvature, half_tolerance = limits.curvature, limits.half_tolerance
    frame, cosine, sine, spin, since = view
    longest = scene.jack_arm * max(abs(cosine), abs(sine))
    if likely.outcome == IMPACT:
        ahead, speed = towards(frame, likely.wall)
        gap, rate = foot_gap(scene, ahead, speed, cosine, sine, spin, likely.foot - likely.wall)
        time = search(scene, memory, flight, limits, likely.wall, likely.foot, since, gap, rate)
        if time <= first.time:
            first = Event(IMPACT, time, likely.wall, likely.foot)
    for wall in range(4):
        if not walls & (1 << wall):
            continue
        ahead, speed = towards(frame, wall)
        nearest = scene.box_half_width - ahead - longest  # gap of the nearest foot, now
        horizon = first.time - since
        fall = max(speed, 0.0) + scene.jack_arm * abs(spin) + 0.5 * curvature * horizon
        if nearest > half_tolerance and nearest - fall * horizon > 0.0:
            continue
        for foot in range(4):
            gap, rate = foot_gap(scene, ahead, speed, cosine, sine, spin, foot - wall)
            horizon = first.time - since
            if gap > half_tolerance and gap + (rate - 0.5 * curvature * horizon) * horizon > 0.0:
                continue
            searched = likely.outcome == IMPACT and likely.wall == wall and likely.foot == foot
            if flight.held & (1 << (4 * wall + foot)) or searched:
                continue
            if may_rest(scene, memory, flight, limits, gap, rate, resolution):
                return Event(AT_REST, 0.0, wall, foot)
            until = Limits(curvature, first.time, half_tolerance)
            time = search(scene, memory, flight, until, wall, foot, since, gap, rate)
            if time < first.time or (time == first.time and first.outcome == NO_IMPACT):
                first = Event(IMPACT, time, wall, foot)
    return Event(UNDECIDED, first.time, 0, 0) if memory.evaluations > MOST_WORK else first


def first_impact_fast_rotation(
    scene: SceneNumbers,
    memory: Workspace,
    flight: Flight,
    view: View,
    limits: Limits,
    resolution: float,
    piece: Piece,
) -> Event:
    """The first impact in a box that turns far: see :func:`first_impact`.

    The bound K grows with the square of the box's angular velocity, and many feet may reach many walls. So all feet
    are followed together, from pose to pose, until one is about to arrive.
    """
    half_tolerance, end = limits.half_tolerance, limits.end
    none = Event(NO_IMPACT, end, 0, 0)
    frame, cosine, sine = view.frame, view.cosine, view.sine
    outermost = max(abs(frame.x), abs(frame.y)) + scene.jack_arm * max(abs(cosine), abs(sine))
    to_impact = curvature_to_impact(
        scene, flight, end, piece.max_angular_acceleration, piece.max_acceleration, outermost
    )
    curvature = min(limits.curvature, to_impact)
    away, back = inside(scene, flight, end, piece.max_acceleration)
    while True:
        frame, cosine, sine, spin, s = view
        step, likely, closing, arrived = end - s, none, False, False
        for wall in range(4):
            ahead, speed = towards(frame, wall)
            for foot in range(4):
                gap, rate = foot_gap(scene, ahead, speed, cosine, sine, spin, foot - wall)
                resting = s == 0.0 and may_rest(scene, memory, flight, limits, gap, rate, resolution)
                if (gap <= half_tolerance and rate < 0.0) or resting:
                    arrived = True
                gap = max(gap, 0.1 * half_tolerance)  # above 0, so that the time advances
                if gap + (rate - 0.5 * curvature * step) * step <= 0.0:
                    step = parabola_root(gap, rate, curvature)
                    likely = Event(IMPACT, s + step, wall, foot)
                    closing = rate < 0.0 and rate * rate > _CLOSING * curvature * gap
        if arrived or closing or step < _SHORT * end:
            break
        s += step
        if away < s < back:
            s = back
        if likely.outcome == NO_IMPACT or s >= end:
            return none
        memory.evaluations += 1.0
        view = view_at(flight, memory, s)
    if view.time == 0.0:
        return first_of_all(scene, memory, flight, view, ALL, none, limits, resolution)
    return first_of_all(scene, memory, flight, view, ALL, likely, Limits(curvature, end, half_tolerance), -math.inf)


def may_rest(
    scene: SceneNumbers,
    memory: Workspace,
    flight: Flight,
    limits: Limits,
    gap: float,
    rate: float,
    resolution: float,
) -> bool:
    """Whether a foot with this gap [m] and rate [m/s] may be at rest, within ``resolution`` [m]; -inf: none may.

    With loss a foot rests if it would rise by ``resolution`` at most. Without loss nothing comes to rest, but a foot
    whose rate is rounding does not bounce.
    """
    if not gap <= resolution:
        return False
    if scene.restitution < 1.0:
        return abs(rate) <= math.sqrt(2.0 * limits.curvature * resolution)
    still = rounding(scene, flight, limits.end)
    if abs(rate) <= still:
        return True
    return is_outside(scene, memory, limits, gap) and abs(rate) <= unresolved(flight, limits, still)


def is_outside(scene: SceneNumbers, memory: Workspace, limits: Limits, gap: float) -> bool:
    """Whether a foot is deeper than those that strike from inside, or the step takes too much work for their law."""
    depth = max(OUTSIDE * deepest(scene), 4.0 * limits.half_tolerance)
    return gap < -depth or memory.evaluations > 0.5 * MOST_WORK


def unresolved(flight: Flight, limits: Limits, still: float) -> float:
    """Rounding of a rate in all of a piece [m/s], which is ``still`` [m/s] in a flight that begins at angles near 0."""
    turned = abs(flight.angle) + abs(flight.jack_angle)
    return still * (1.0 + turned) + 2e-15 * limits.curvature * flight.half


@inlined
def search(
    scene: SceneNumbers, memory: Workspace, flight: Flight, limits: Limits, wall: int, foot: int, s: float, gap: float,
    rate: float,
) -> float:  # fmt: skip
    """First time within ``limits.end`` [s] at which a foot touches a wall and approaches; infinity if there is none.

    ``s`` [s] is where the search starts, with the ``gap`` [m] and ``rate`` [m/s] there.

    A foot within half the contact tolerance touches, and one more step to the parabola's root ends the walk. The gap
    stays above that parabola, so the foot is not in the wall there. The step s is at most sqrt(2 gap / K), so the gap
    there is at most K s^2 <= 2 gap, within the contact tolerance.

    A receding or sliding foot may penetrate by ``sink``; otherwise time would stall. For a receding foot ``sink`` is
    half the contact tolerance at first and grows with the step's impacts, up to :func:`deepest`. For a sliding foot it
    is :func:`deepest` at once. So a jack that rests on a wall or slides along it costs thousands of gap evaluations and
    impacts, not millions. While :func:`is_chattering`, a foot that does not touch yet may penetrate as deep.
    A foot that :func:`is_outside`, or takes more than ``_PATIENT`` evaluations, bounces where it turns round instead:
    see :func:`turning`.
    """
    still = rounding(scene, flight, limits.end)
    half_tolerance = limits.half_tolerance
    patient = memory.evaluations + _PATIENT
    while True:
        if gap > half_tolerance:
            granted = deepest(scene) if is_chattering(scene, memory) else 0.0
            after = s + parabola_root(gap + granted, rate, limits.curvature)
        elif rate < -still:
            return min(s + parabola_root(max(gap, 0.0), rate, limits.curvature), limits.end)
        elif is_outside(scene, memory, limits, gap) or memory.evaluations > patient:
            s = turning(scene, memory, flight, limits, wall, foot, s, gap, rate, still)
            if s > limits.end:
                return math.inf
            gap, rate = gap_at(scene, flight, memory, wall, foot, s)
            if gap <= half_tolerance:
                return s
            continue
        else:
            sink = widened(scene, memory, half_tolerance) if rate > still else deepest(scene)
            least = 0.0 if rate > still else 0.1 * half_tolerance  # above 0: sliding does not advance time
            after = s + parabola_root(max(gap + sink, least), max(rate, 0.0), limits.curvature)
        if not after <= limits.end or memory.evaluations > MOST_WORK:
            return math.inf
        if after == s:
            if rate < 0.0:  # float64 does not resolve the time to the wall
                return s
            after = s + 2.3e-16 * s
        s = after
        gap, rate = gap_at(scene, flight, memory, wall, foot, s)


def turning(
    scene: SceneNumbers, memory: Workspace, flight: Flight, limits: Limits, wall: int, foot: int, s: float, gap: float,
    rate: float, still: float,
) -> float:  # fmt: skip
    """When a foot outside that does not approach at ``s`` [s] turns round; infinity if it does not within the limits.

    Its rate is rounding there, or else the time is the first that float64 resolves after it turned. So a foot that is
    pressed outwards rests from then on, and gets no deeper. A foot that comes back into the box is followed no further:
    the time is then one at which it is there. Between two evaluations a foot may get deeper and come back unseen, by
    :func:`deepest` or ``_DIP`` of its depth.
    """
    still = unresolved(flight, limits, still)
    while s < limits.end and gap <= limits.half_tolerance and memory.evaluations <= MOST_WORK:
        sink = max(deepest(scene), -_DIP * gap)
        after = min(s + parabola_root(sink, max(rate, 0.0), limits.curvature), limits.end)
        gap, rate = gap_at(scene, flight, memory, wall, foot, after)
        if rate >= -still:
            s = after
            continue
        while s < 0.5 * (s + after) < after:
            middle = 0.5 * (s + after)
            _, rate = gap_at(scene, flight, memory, wall, foot, middle)
            if abs(rate) <= still:
                return middle
            s, after = (s, middle) if rate < 0.0 else (middle, after)
        return after
    return s if gap > limits.half_tolerance else math.inf


def why_undecided(memory: Workspace) -> Status:
    """The status of a step whose search is undecided."""
    return Status.TOO_MUCH_WORK if memory.evaluations > MOST_WORK else Status.TOO_FAST
