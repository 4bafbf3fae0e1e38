"""The exact contact model's physics: one piece of a step, cut at every impact.

It reads detect -> evolve -> resolve: :func:`next_impact` finds the next impact or proves that there is none,
:func:`evolve` flies there, ``impacts.resolve`` applies the law and records. All of it is plain Python of scalars,
compiled as it stands (:mod:`jackbox_env._compiled`); the head of ``exact.py`` states order, cost and limits.

Law of flight: the jack falls with g and keeps its spin, the box keeps its velocity but for side forces, and its angle
is the double integral of torque / J_b.

Guarantee: with |d2 gap / dt2| <= K over what is left of the piece, gap(t + s) >= gap + gap' s - K s^2 / 2, so walking
to the first positive root of that parabola never passes an impact; where a foot arrives at speed it converges
quadratically. K follows from upper bounds V, Omega, A, D of relative speed, |omega_box|, |alpha_box| and |r|:

    K = a + 2 Omega V + (Omega^2 + A) D + l (max |omega_jack - omega_box|^2 + A)

with a the relative acceleration of the centres. Where |r| + l < L throughout, nothing can be hit and nothing is asked.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.scene import SceneNumbers
from jackbox_env.simulators.drives import ALPHA, DEGREE, PUSH_X, PUSH_Y, horner
from jackbox_env.simulators.impacts import quarter, resolve
from jackbox_env.simulators.workspace import ELAPSED, HITS, IMPULSE, PIECE, STATE, TALLY, WORK, Workspace
from jackbox_env.trigonometry import cos_sin

Array = NDArray[np.float64]

# How a step ended.
DONE, TOO_MUCH_WORK, TOO_FAST = range(3)
# In place of 4 * wall + foot: no impact, none looked for yet, none to be found by reasonable work.
NONE, NOT_KNOWN, ENDLESS = -1, -2, -3
MOST_WORK = 1_000_000  # gaps evaluated in one step
_RESTLESS = 65_536  # gaps evaluated up to which no step is taken for one at rest
_GLANCE = 2.0**-12  # of a piece: how far a step at rest looks ahead
_SLACK = 1.0 + 1e-12  # on bounds, for their rounding
STEEPEST = 1e40  # K [m/s^2] and alpha [rad/s^2] beyond which squares overflow


class Flight(NamedTuple):
    """Relative motion from a moment on: the jack's centre as seen from the box's, and both angles."""

    x: float  # [m]
    y: float
    vx: float  # [m/s]
    vy: float
    angle: float  # of the box [rad]
    omega: float  # [rad/s]
    jack_angle: float
    jack_omega: float
    gravity: float  # [m/s^2]
    alpha: float  # of the box, where it is constant [rad/s^2]
    since: float  # the moment, since the piece's start [s]
    half: float  # half the piece's length [s]
    curved: bool  # whether the accelerations are polynomials
    pushed: bool  # whether the box's centre is accelerated too


class Pose(NamedTuple):
    """Relative motion at one moment."""

    x: float
    y: float
    vx: float
    vy: float
    angle: float
    omega: float
    jack_angle: float


def excursion(w: Workspace, axis: int, flight: Flight, s: float) -> tuple[float, float]:
    """Change of a coordinate and of its rate in ``s`` [s] that the polynomial acceleration brings."""
    end = (flight.since + s) / flight.half - 1.0
    moved, rate = horner(w[PIECE + 3 * axis + 2], DEGREE + 2, end), horner(w[PIECE + 3 * axis + 1], DEGREE + 1, end)
    if flight.since == 0.0:
        return moved, rate
    start = flight.since / flight.half - 1.0
    before = horner(w[PIECE + 3 * axis + 1], DEGREE + 1, start)
    return moved - horner(w[PIECE + 3 * axis + 2], DEGREE + 2, start) - before * s, rate - before


def pose_at(flight: Flight, w: Workspace, s: float) -> Pose:
    """The relative motion ``s`` [s] into the flight."""
    x = flight.x + flight.vx * s
    y = flight.y + (flight.vy - 0.5 * flight.gravity * s) * s
    vx, vy = flight.vx, flight.vy - flight.gravity * s
    turned, spun = 0.5 * flight.alpha * s * s, flight.alpha * s
    if flight.curved:
        turned, spun = excursion(w, ALPHA, flight, s)
        if flight.pushed:
            moved, pushed = excursion(w, PUSH_X, flight, s)
            x, vx = x - moved, vx - pushed
            moved, pushed = excursion(w, PUSH_Y, flight, s)
            y, vy = y - moved, vy - pushed
    angle = flight.angle + (flight.omega * s + turned)
    return Pose(x, y, vx, vy, angle, flight.omega + spun, flight.jack_angle + flight.jack_omega * s)


def evolve(w: Workspace, flight: Flight, s: float) -> None:
    """Fly for ``s`` [s]: move the state."""
    m = w[STATE]
    turned, spun = 0.5 * flight.alpha * s * s, flight.alpha * s
    if flight.curved:
        turned, spun = excursion(w, ALPHA, flight, s)
    m[0] += m[6] * s
    m[1] += m[7] * s
    if flight.pushed:
        moved, pushed = excursion(w, PUSH_X, flight, s)
        m[0], m[6] = m[0] + moved, m[6] + pushed
        moved, pushed = excursion(w, PUSH_Y, flight, s)
        m[1], m[7] = m[1] + moved, m[7] + pushed
    m[2] += m[8] * s + turned
    m[8] += spun
    m[3] += m[9] * s
    m[4] += (m[10] - 0.5 * flight.gravity * s) * s
    m[10] -= flight.gravity * s
    m[5] += m[11] * s


def largest(w: Workspace, axis: int) -> float:
    """Bound of a polynomial acceleration over its piece."""
    bound = 0.0
    for k in range(DEGREE + 1):
        bound += abs(w[PIECE + 3 * axis, k])
    return bound


class Bounds(NamedTuple):
    """What the motion can not exceed within a time."""

    far: float  # distance of the centres [m]
    bend: float  # second derivative of a centre's distance from a wall [m/s^2]
    swing: float  # that of a foot's distance from the jack's centre, along a wall's normal [m/s^2]


def reach_of(n: SceneNumbers, flight: Flight, left: float, push: float) -> float:
    """Bound of the distance of the centres within ``left`` [s] [m]."""
    x, y = flight.x + flight.vx * left, flight.y + (flight.vy - 0.5 * n.gravity * left) * left
    # A chord's ends, and a bent path's distance from it.
    far = math.sqrt(max(flight.x * flight.x + flight.y * flight.y, x * x + y * y))
    return (far + (0.125 * n.gravity + 0.5 * push) * left * left) * _SLACK


def bounds_of(n: SceneNumbers, flight: Flight, left: float, spin_up: float, push: float) -> Bounds:
    """Bounds within ``left`` [s]; the box's angular and linear acceleration stay below ``spin_up`` and ``push``."""
    far = reach_of(n, flight, left, push)
    pull = n.gravity + push
    speed = math.sqrt(flight.vx * flight.vx + flight.vy * flight.vy) + pull * left
    omega = abs(flight.omega) + spin_up * left
    spin = abs(flight.jack_omega - flight.omega) + spin_up * left
    bend = (pull + 2.0 * omega * speed + (omega * omega + spin_up) * far) * _SLACK
    return Bounds(far, bend, n.jack_arm * (spin * spin + spin_up) * _SLACK)


class BoxFrame(NamedTuple):
    """The jack's centre on the box's axes, as it is seen turning with the box."""

    x: float  # [m]
    y: float
    vx: float  # [m/s]
    vy: float


def box_frame(x: float, y: float, vx: float, vy: float, angle: float, omega: float) -> BoxFrame:
    """Take relative place and velocity to the axes of a box at ``angle`` that turns with ``omega``."""
    c, s = cos_sin(angle)
    ahead, aside = c * x + s * y, c * y - s * x
    return BoxFrame(ahead, aside, c * vx + s * vy + omega * aside, c * vy - s * vx - omega * ahead)


def towards(frame: BoxFrame, wall: int) -> tuple[float, float]:
    """How far the centre is on the way to a wall [m], and its rate [m/s]."""
    if wall == 0:
        return frame.x, frame.vx
    if wall == 1:
        return frame.y, frame.vy
    if wall == 2:
        return -frame.x, -frame.vx
    return -frame.y, -frame.vy


def walls_in_reach(n: SceneNumbers, frame: BoxFrame, left: float, bend: float) -> int:
    """Walls that the circle through the jack's feet may touch within ``left`` [s], as bits."""
    reach = 0.5 * bend * left * left
    walls = 0
    for wall in range(4):
        ahead, speed = towards(frame, wall)
        room = n.box_half_width - n.jack_arm - ahead
        if not (room > 0.0 and room - speed * left - reach > 0.0):
            walls |= 1 << wall
    return walls


def contact_tolerance(n: SceneNumbers) -> float:
    """Gap at which a foot touches [m]: 1e-13, less in boxes below 1 m, never below what rounding leaves of a gap."""
    return max(1e-13 * min(1.0, n.box_half_width), 3.6e-15 * n.box_half_width)


def rests(n: SceneNumbers, w: Workspace) -> bool:
    """Whether the work of a step tells of a jack at rest: much of it, for impacts of next to no impulse.

    After each of its thousands of bounces the search would look through all that is left of the step. A step at rest
    looks ahead only as far as some bounces take, and a foot that comes to another wall meanwhile may be 1e-10 m deep
    when it bounces.
    """
    if w[TALLY, WORK] <= _RESTLESS:
        return False
    return bool(w[TALLY, IMPULSE] <= 1e-3 * n.jack_mass * n.speed_scale * w[TALLY, HITS])


def parabola_root(gap: float, rate: float, curvature: float) -> float:
    """First s > 0 at which gap + rate s - curvature s^2 / 2 is 0, for gap >= 0; infinity if it never is."""
    root = math.sqrt(rate * rate + 2.0 * curvature * gap)
    if rate < 0.0:
        return 2.0 * gap / (root - rate)
    return (rate + root) / curvature if curvature > 0.0 else math.inf


def foot_gap(
    n: SceneNumbers, ahead: float, speed: float, cosine: float, sine: float, spin: float, turn: int
) -> tuple[float, float]:
    """Gap between a wall and a foot [m], and its rate [m/s].

    Args:
        n: the scene.
        ahead: how far the jack's centre is on the way to the wall [m].
        speed: the rate of that [m/s].
        cosine: of the jack's angle relative to the box.
        sine: of the same.
        spin: rate of that angle [rad/s].
        turn: number of the foot less that of the wall.
    """
    along, across = quarter(cosine, sine, turn)
    return n.box_half_width - ahead - n.jack_arm * along, n.jack_arm * across * spin - speed


def gap_at(n: SceneNumbers, flight: Flight, w: Workspace, wall: int, foot: int, s: float) -> tuple[float, float]:
    """Gap between a wall and a foot ``s`` [s] into the flight [m], and its rate [m/s]."""
    w[TALLY, WORK] += 1.0
    pose = pose_at(flight, w, s)
    ahead, speed = towards(box_frame(pose.x, pose.y, pose.vx, pose.vy, pose.angle, pose.omega), wall)
    cosine, sine = cos_sin(pose.jack_angle - pose.angle)
    return foot_gap(n, ahead, speed, cosine, sine, flight.jack_omega - pose.omega, foot - wall)


def next_impact(
    n: SceneNumbers, flight: Flight, frame: BoxFrame, walls: int, w: Workspace, left: float, bounds: Bounds,
    tolerance: float,
) -> tuple[float, int]:  # fmt: skip
    """Find the first impact within ``left`` [s].

    Args:
        n: the scene.
        flight: what moves.
        frame: the jack's centre in the box.
        walls: those in reach, as bits.
        w: memory with the polynomial accelerations.
        left: [s].
        bounds: of the motion within that time.
        tolerance: gap at which a foot touches [m].

    Returns:
        Its time [s] and 4 * wall + foot; ``NONE`` if there is none, ``ENDLESS`` if it can not be told.
    """
    tolerance *= 0.5  # so that rounding does not part what the search has found from what touches
    best, found = left, NONE
    curvature = bounds.bend + bounds.swing
    if not curvature < STEEPEST:
        return best, ENDLESS
    cosine, sine = cos_sin(flight.jack_angle - flight.angle)
    spin = flight.jack_omega - flight.omega
    longest = n.jack_arm * max(abs(cosine), abs(sine))
    for wall in range(4):
        if not walls & (1 << wall):
            continue
        ahead, speed = towards(frame, wall)
        nearest = n.box_half_width - ahead - longest  # of the feet, now; none comes nearer faster than this
        fall = max(speed, 0.0) + n.jack_arm * abs(spin) + 0.5 * curvature * best
        if nearest > tolerance and nearest - fall * best > 0.0:
            continue
        for foot in range(4):
            gap, rate = foot_gap(n, ahead, speed, cosine, sine, spin, foot - wall)
            if gap > tolerance and gap + (rate - 0.5 * curvature * best) * best > 0.0:
                continue
            time = search(n, flight, w, wall, foot, gap, rate, curvature, best, tolerance)
            if time < best or (time == best and found == NONE):
                best, found = time, 4 * wall + foot
    return best, ENDLESS if w[TALLY, WORK] > MOST_WORK else found


def search(
    n: SceneNumbers, flight: Flight, w: Workspace, wall: int, foot: int, gap: float, rate: float, curvature: float,
    end: float, tolerance: float,
) -> float:  # fmt: skip
    """First time up to ``end`` [s] at which this foot touches this wall and approaches; infinity if there is none.

    A foot at the wall that does not approach can not be deeper than ``sink`` before the parabola from where it is is:
    without that depth a foot at rest on a wall would never get off the spot. It is the tolerance, and grows to 1e-10 m
    with the work of a step, so that a jack that rests on a wall or slides along it costs thousands of looks and impacts
    and not millions.
    """
    still = 1e-15 * (abs(flight.vx) + abs(flight.vy) + flight.gravity * end)
    still += 1e-15 * (abs(flight.omega) * n.box_half_width + n.jack_arm * abs(flight.jack_omega))
    s = 0.0
    while True:
        if gap > tolerance:
            grazed = 1e-10 * min(1.0, n.box_half_width) if rests(n, w) else 0.0
            after = s + parabola_root(gap + grazed, rate, curvature)
        elif rate < -still:
            return s
        else:
            sink = min(1e-10 * min(1.0, n.box_half_width), tolerance * 2.0 ** min(w[TALLY, WORK] / 64.0, 60.0))
            after = s + parabola_root(max(gap + sink, 0.1 * tolerance), max(rate, 0.0), curvature)
        if not after <= end or w[TALLY, WORK] > MOST_WORK:
            return math.inf
        if after == s:
            if rate < 0.0:  # the wall is nearer than time can tell
                return s
            after = s + 2.3e-16 * s
        s = after
        gap, rate = gap_at(n, flight, w, wall, foot, s)


def advance(
    n: SceneNumbers, w: Workspace, length: float, curved: bool, pushed: bool, alpha: float, tolerance: float,
    together: float, time: float, pair: int,
) -> int:  # fmt: skip
    """Advance the state ``w[STATE]`` through one piece of a step; return how it ended.

    Args:
        n: the scene.
        w: memory with the state in a frame near the box, and the polynomial accelerations.
        length: of the piece [s].
        curved: whether the box's accelerations are polynomials.
        pushed: whether side forces are among them.
        alpha: the box's angular acceleration where it is constant [rad/s^2].
        tolerance: gap at which a foot touches [m].
        together: gap within which others touch at the same moment [m].
        time: of the first impact if it is known [s].
        pair: 4 * wall + foot of the first impact if it is known, else ``NOT_KNOWN``.
    """
    m, tally = w[STATE], w[TALLY]
    since = 0.0
    spin_up, push = (largest(w, ALPHA), 0.0) if curved else (abs(alpha), 0.0)
    if pushed:
        push = largest(w, PUSH_X) + largest(w, PUSH_Y)
    while True:
        remaining = length - since
        left = min(remaining, _GLANCE * length) if rests(n, w) else remaining
        flight = Flight(
            m[3] - m[0], m[4] - m[1], m[9] - m[6], m[10] - m[7], m[2], m[8], m[5], m[11],
            n.gravity, alpha, since, 0.5 * length, curved, pushed,
        )  # fmt: skip
        if pair == NOT_KNOWN:
            pair = NONE
            if not reach_of(n, flight, left, push) + n.jack_arm < n.box_half_width:
                bounds = bounds_of(n, flight, left, spin_up, push)
                frame = box_frame(flight.x, flight.y, flight.vx, flight.vy, flight.angle, flight.omega)
                walls = walls_in_reach(n, frame, left, bounds.bend)
                if walls:
                    time, pair = next_impact(n, flight, frame, walls, w, left, bounds, tolerance)
        if pair == ENDLESS:
            return TOO_MUCH_WORK if tally[WORK] > MOST_WORK else TOO_FAST
        if pair == NONE:
            evolve(w, flight, left)
            tally[ELAPSED] += left
            if left == remaining:
                return DONE
            since += left
            pair = NOT_KNOWN
            continue
        evolve(w, flight, time)
        tally[ELAPSED] += time
        tally[WORK] += 1.0
        resolve(n, w, together, pair // 4, pair % 4)
        since += time
        if since >= length:
            return DONE
        pair = NOT_KNOWN
