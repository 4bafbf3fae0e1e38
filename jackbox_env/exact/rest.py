"""Feet at rest on walls: which ones rest, and how box and jack move while walls hold them.

``step.advance`` calls ``late.advance_resting`` when ``search.py`` detects a slow foot on a wall: :func:`settle` selects
the feet that rest, and :func:`advance_held` integrates the motion with them. Both are compiled when a step first needs
them (``late.py``).
A bounce lower than the resolution of contacts ends in rest. From then on the foot is held: it may slide, since walls
have no friction, but its gap is a constraint of the Lagrangian motion

    M qddot = f + J^T lambda,    J qddot + Jdot qdot = 0,    lambda >= 0,

until lambda is 0 and the wall would have to pull. Among feet that touch and neither approach nor leave, those held
solve 0 <= lambda _|_ J qddot + Jdot qdot >= 0: the accelerations are the nearest to the free ones, in the
norm of M, that close no gap (Gauss's principle; Brogliato 2016, "Nonsmooth Mechanics", ch. 5).

Method: over a stretch of time the motion is a power series (``constrained.py``). The gaps of the other feet follow from
it, so the search for the next impact has the same guarantee as in free flight. At the start of a stretch the state is
projected: the held gaps towards 0, by ``ContactTolerances.resolution`` at most (1e-13 m, more far from the origin), and
their rates to 0, by the smallest change in the norm of M. So gaps do not drift. A foot that starts outside stays as
deep: to come nearer would renew the force that has just released it. The projection of the velocities cannot
gain energy; that of the positions changes the energy by about the weight times the correction.
Resolution: with loss, a foot is at rest if it would rise by ``contact.contact_resolution`` at most. That is
``ContactTolerances.resolution``, and grows to 1e-10 m in a step with many impacts. Coming to rest loses at most m_j K
times the resolution in energy for each foot by itself, with K of ``bounds.py``.
Cost: about 2 microseconds a stretch, mostly a whole control step; counted as 40 gap evaluations (``step.effort``).
"""

from __future__ import annotations

import math

from jackbox_env.exact.bounds import bounds_of
from jackbox_env.exact.constrained import accelerations, bias_acceleration, carry, curvature_while_held, stretch
from jackbox_env.exact.contact import ContactTolerances, deepest, kick, resolve
from jackbox_env.exact.flight import (
    DEGREE,
    RECIPROCALS,
    Flight,
    Piece,
    flight_of,
)
from jackbox_env.exact.geometry import Frame, box_frame, frame_of, gradient, rate_of, view_of
from jackbox_env.exact.search import (
    ALL,
    IMPACT,
    MOST_WORK,
    NO_IMPACT,
    OUTSIDE,
    UNDECIDED,
    Event,
    Limits,
    first_of_all,
    may_rest,
    parabola_root,
    why_undecided,
)
from jackbox_env.exact.workspace import FORCE, Contacts, HeldFeet, Status, Workspace
from jackbox_env.model.complementarity import dot, mass_scale, nearest, project, violation_of
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import RATES, X_BOX, Array, add_numbers, copy_numbers

_DEPENDENT = 1e-18  # square of a unit gradient's part orthogonal to those of held feet: below it, linearly dependent
_FAINT = 1e-9  # of the largest multiplier at held feet: a smaller acceleration counts as 0
_PULL = 1e-12  # of the largest power of the forces in a stretch: a wall may pull that much before the foot is released
_ROUNDED = 4e-16  # of L: rounding of a gap
_FAR_OUT = 1000.0  # resolutions: rounding far from the origin leaves feet less deep
_PATIENT = 1000.0  # evaluations of a force before its least step


def list_contacts(scene: SceneNumbers, contacts: Contacts, state: Array, count: int) -> Frame:
    """Fill in gaps and gradients of the pairs in ``contacts.pairs`` for a state."""
    frame = frame_of(state)
    for number in range(count):
        pair = contacts.pairs[number]
        contacts.gaps[number] = gradient(scene, frame, pair // 4, pair % 4, contacts.gradients[number])
    return frame


def list_slow(
    scene: SceneNumbers, memory: Workspace, flight: Flight, limits: Limits, frame: Frame, resolution: float
) -> int:
    """List the contacts that may be at rest within ``resolution`` [m], but not released ones; return how many."""
    count, released = 0, memory.held.released
    for pair in range(16):
        row = memory.contacts.gradients[count]
        gap = gradient(scene, frame, pair // 4, pair % 4, row)
        resting = may_rest(scene, memory, flight, limits, gap, rate_of(memory.state, row), resolution)
        if resting and not released & (1 << pair):
            memory.contacts.pairs[count] = pair
            count += 1
    return count


def settle(
    scene: SceneNumbers, memory: Workspace, piece: Piece, flight: Flight, horizon: float, tolerances: ContactTolerances,
    resolution: float,
) -> int:  # fmt: skip
    """Determine the feet at rest on walls, and project the state on their constraints.

    Args:
        scene: the scene.
        memory: with the state.
        piece: what acts on the box.
        flight: motion from this state on.
        horizon: how far the search for an impact went [s]; it bounds the rate of a foot at rest.
        tolerances: when feet touch.
        resolution: gap within which feet may rest [m].

    Returns:
        The pairs that are held, as bits. Their number is in ``held.holding``, and they are first in ``contacts.pairs``.
    """
    contacts = memory.contacts
    state = memory.state
    frame = frame_of(state)
    bounds = bounds_of(scene, flight, horizon, piece.max_angular_acceleration, piece.max_acceleration)
    limits = Limits(bounds.centre_curvature + bounds.foot_curvature, horizon, 0.5 * tolerances.tolerance)
    count = list_slow(scene, memory, flight, limits, frame, resolution)
    accelerations(scene, memory, piece, flight.since)
    while count > 0:
        memory.evaluations += 1.0
        list_contacts(scene, contacts, memory.state, count)
        # Weight the free accelerations and the gradients, and fill in the bias Jdot qdot.
        mass_scale(scene, contacts, count, memory.held.free)
        for number in range(count):
            turn = bias_acceleration(scene, state, frame, contacts.gradients[number], contacts.gaps[number])
            contacts.bias[number] = turn / contacts.lengths[number]
        chosen = active_set(contacts, count)
        # A foot that would bounce higher than the resolution is not at rest.
        bouncing = -1
        for index in range(3):
            number = chosen[index]
            if number >= 0:
                # The acceleration of the foot by this contact, were it the only one.
                pressed = contacts.best[index] * contacts.lengths[number]
                rate = rate_of(state, contacts.gradients[number])
                if rate * rate > 2.0 * resolution * pressed:
                    bouncing = number
        if bouncing < 0:
            return select_held(scene, memory, tolerances, resolution, count, chosen)
        count -= 1
        contacts.pairs[bouncing] = contacts.pairs[count]
    return 0


def active_set(contacts: Contacts, count: int) -> tuple[int, int, int]:
    """The largest admissible active set: no negative multiplier, and no gap that closes. Else what ``nearest`` returns.

    The last projection is that of this set.
    """
    for size in (3, 2, 1):
        for i in range(count if size > 2 else 1):
            for j in range(i + 1 if size > 2 else 0, count if size > 1 else 1):
                for k in range(j + 1 if size > 1 else 0, count):
                    if violation_of(contacts, count, size, k, j, i) <= _FAINT * contacts.multipliers[0]:
                        copy_numbers(3, contacts.multipliers, contacts.best)
                        return k, j if size > 1 else -1, i if size > 2 else -1
    one, two, three = nearest(contacts, count)
    if one >= 0:
        project(contacts, 1 if two < 0 else 2 if three < 0 else 3, one, two, three)
    return one, two, three


def select_held(
    scene: SceneNumbers,
    memory: Workspace,
    tolerances: ContactTolerances,
    resolution: float,
    count: int,
    chosen: tuple[int, int, int],
) -> int:
    """Select the contacts to hold, and project the state on them: the ``chosen``, of the last projection, and others.

    A degenerate contact (zero force, zero acceleration) is held too, so that the search can ignore it. If its wall
    would have to pull, it is released at once. A contact whose gradient is linearly dependent on held ones stays closed
    by itself.

    Returns:
        The pairs that are held, as bits.
    """
    contacts = memory.contacts
    size, strongest = 0, 0.0
    for index in range(3):
        number = chosen[index]
        if number >= 0:
            memory.held.order[size] = number
            strongest = max(strongest, contacts.best[index])
            size += 1
    if size == 0:
        return 0
    faint, held = _FAINT * strongest, 0
    for number in range(count):
        row = contacts.units[number]
        opening = dot(row, contacts.projected) + contacts.bias[number]
        rate = rate_of(memory.state, contacts.gradients[number]) / contacts.lengths[number]
        remainder = orthogonalized(contacts, size, row)
        if remainder < _DEPENDENT:
            held |= 1 << contacts.pairs[number]
        elif size < 3 and abs(opening) <= faint and rate * rate <= 2.0 * resolution * faint:
            length = math.sqrt(remainder)
            for index in range(6):
                contacts.basis[size, index] /= length
            memory.held.order[size] = number
            size += 1
            held |= 1 << contacts.pairs[number]
    outside = max(OUTSIDE * deepest(scene), _FAR_OUT * tolerances.resolution)
    for index in range(size):
        gap = contacts.gaps[memory.held.order[index]]
        memory.held.order[index] = contacts.pairs[memory.held.order[index]]
        nearer = math.copysign(max(abs(gap) - tolerances.resolution, 0.0), gap)
        memory.held.targets[index] = gap if gap < -outside else nearer
    for index in range(size):
        contacts.pairs[index] = memory.held.order[index]
    memory.held.holding = size
    project_state(scene, memory)
    return held


def orthogonalized(contacts: Contacts, size: int, row: Array) -> float:
    """Write the part of a unit row that is orthogonal to the first ``size`` rows of the basis as its next row.

    Returns its square.
    """
    part = contacts.basis[size]
    copy_numbers(6, row, part)
    for number in range(size):
        add_numbers(6, part, -dot(part, contacts.basis[number]), contacts.basis[number])
    return dot(part, part)


def project_state(scene: SceneNumbers, memory: Workspace) -> None:
    """Project the state: held gaps to their targets, their rates to 0, each by the smallest change in the norm of M.

    The gaps change by one Newton step, unless they are off by rounding only. The factors of the held rows stay in
    ``contacts.triangle``.
    """
    contacts, held = memory.contacts, memory.held
    state, count = memory.state, held.holding
    list_contacts(scene, contacts, state, count)
    off = 0.0
    for number in range(count):
        off = max(off, abs(contacts.gaps[number] - held.targets[number]))
    mass_scale(scene, contacts, count, state[RATES:])
    if off > _ROUNDED * scene.box_half_width:
        contacts.rates[:] = 0.0
        for number in range(count):
            contacts.bias[number] = (contacts.gaps[number] - held.targets[number]) / contacts.lengths[number]
        move_held(scene, memory, count, X_BOX)
        list_contacts(scene, contacts, state, count)
        mass_scale(scene, contacts, count, state[RATES:])
    contacts.bias[:] = 0.0
    move_held(scene, memory, count, RATES)


def move_held(scene: SceneNumbers, memory: Workspace, count: int, first: int) -> None:
    """Change the six numbers of the state from ``first`` on so that the held rows with their bias are 0."""
    contacts = memory.contacts
    project(contacts, count, 0, 1, 2)
    for number in range(count):
        impulse = contacts.multipliers[number] / contacts.lengths[number]
        kick(scene, memory.state[first:], contacts.gradients[number], impulse)


def advance_held(
    scene: SceneNumbers, memory: Workspace, log: Array, piece: Piece, tolerances: ContactTolerances, resolution: float,
    since: float, held: int,
) -> tuple[Status, float]:  # fmt: skip
    """Integrate the motion with held feet to the end of a stretch, an impact, or the first release.

    Args:
        scene: the scene.
        memory: with the state, the drive's polynomials and the pairs that are held.
        log: filled with impacts.
        piece: what acts on the box.
        tolerances: when feet touch.
        resolution: gap within which contacts are simultaneous [m].
        since: [s] after the piece's start.
        held: the pairs that are held, as bits.

    Returns:
        How it ended, and the time that passed [s]. Feet that are released at once are added to ``held.released``.
    """
    memory.nonsmooth = 1
    count, free = memory.held.holding, flight_of(scene, memory.state, piece, since)
    frame = box_frame(free.x, free.y, free.vx, free.vy, free.angle, free.omega)
    view = view_of(frame, free.jack_angle - free.angle, free.jack_omega - free.omega, 0.0)
    length = stretch(scene, memory, piece, since, view)
    if length == 0.0:
        return Status.TOO_MUCH_WORK, 0.0
    end, released = first_release(memory, count, length)
    if not since + end > since:
        end = 0.0
    flight = Flight(
        free.x, free.y, free.vx, free.vy, free.angle, free.omega, free.jack_angle, free.jack_omega, 0.0, 0.0, 0.0,
        length, True, True, held, free.speeds,
    )  # fmt: skip
    event = Event(NO_IMPACT, end, 0, 0)
    if count < 3:  # else the jack cannot move in the box
        limits = Limits(curvature_while_held(scene, memory.held.series, length), end, 0.5 * tolerances.tolerance)
        event = first_of_all(scene, memory, flight, view, ALL, event, limits, -math.inf)
        end = event.time
    if event.outcome == UNDECIDED or memory.evaluations > MOST_WORK:
        return why_undecided(memory), 0.0
    for contact in range(count):
        impulse = max(scaled_impulse(memory.held, contact, end / length) / length, 0.0)
        memory.held.resting[memory.contacts.pairs[contact]] += impulse
    carry(scene, memory, flight, free, end)
    memory.elapsed += end
    ended = Status.DONE
    if event.outcome == IMPACT:
        memory.evaluations += 1.0
        ended = resolve(scene, memory, log, resolution, event.wall, event.foot)
    elif released >= 0 and end == 0.0:
        memory.held.released += 1 << memory.contacts.pairs[released]
    if end > 0.0:
        memory.held.released = 0
    return ended, end


def first_release(memory: Workspace, count: int, length: float) -> tuple[float, int]:
    """When the first held foot is released [s], and its index; the stretch's ``length`` and -1 if none is."""
    end, released, peak = length, -1, 0.0
    for contact in range(count):
        for k in range(DEGREE + 1):
            peak = max(peak, abs(memory.held.series[FORCE + contact, k]))
    for contact in range(count):
        time = release_time(memory, contact, length, peak)
        if time < end:
            end, released = time, contact
    return end, released


def release_time(memory: Workspace, contact: int, length: float, peak: float) -> float:
    """When a held foot is released [s]: the first time at which its force is -``_PULL`` / 2 of the ``peak`` or less.

    Infinity if there is none in the stretch, and also if the step's gap evaluations are exhausted. A force near 0 that
    hardly changes is followed in at least 64ths of the stretch after ``_PATIENT`` evaluations.
    """
    powers = memory.held.series[FORCE + contact]
    curvature = 0.0
    for k in range(2, DEGREE + 1):
        curvature += k * (k - 1.0) * abs(powers[k])
    least = powers[0]
    for k in range(1, DEGREE + 1):
        least -= abs(powers[k])
    if least > 0.0:
        return math.inf
    margin, u, patient = _PULL * peak, 0.0, memory.evaluations + _PATIENT
    while memory.evaluations <= MOST_WORK:
        force, slope = powers[DEGREE], 0.0
        for k in range(DEGREE - 1, -1, -1):
            slope = force + u * slope
            force = powers[k] + u * force
        if force + margin <= 0.5 * margin:
            return u * length
        memory.evaluations += 1.0
        step = parabola_root(force + margin, slope, curvature)
        if memory.evaluations > patient:
            step = max(step, 1.0 / 64.0)
        u += step
        if not u <= 1.0:
            return math.inf
    return math.inf


def scaled_impulse(held: HeldFeet, contact: int, u: float) -> float:
    """Integral of a held foot's scaled force up to ``u``: its impulse times the stretch's length [N s^2]."""
    impulse = 0.0
    for k in range(DEGREE, -1, -1):
        impulse = RECIPROCALS[k] * held.series[FORCE + contact, k] + impulse * u
    return impulse * u
