"""The exact contact model's physics: one piece of a step, cut at every impact.

It reads detect -> evolve -> resolve: :func:`first_impact` finds the next impact or proves that there is none,
:func:`evolve` flies there, ``impacts.resolve`` applies the law and records. All of it is plain Python of scalars,
compiled as it stands (:mod:`jackbox_env.compiled.compiler`); the head of ``exact.py`` states order, cost and limits.

Law of flight: the jack falls with g and keeps its spin, the box keeps its velocity but for side forces, and its angle
is the double integral of torque / J_b.

Guarantee: with |d2 gap / dt2| <= K over what is left of the piece, gap(t + s) >= gap + gap' s - K s^2 / 2, so walking
to the first positive root of that parabola never passes an impact; where a foot arrives at speed it converges
quadratically. K follows from upper bounds V, Omega, A, D of relative speed, |omega_box|, |alpha_box| and |r|:

    K = a + 2 Omega V + (Omega^2 + A) D + l (max |omega_jack - omega_box|^2 + A)

with a the relative acceleration of the centres. Where |r| + l < L throughout, nothing can be hit and no gap is
evaluated.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.drives import DEGREE, PUSH_X, PUSH_Y, TURN, horner
from jackbox_env.compiled.impacts import quarter, resolve
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.trigonometry import cos_sin
from jackbox_env.compiled.workspace import ELAPSED, HITS, IMPULSE, PIECE, STATE, TALLY, WORK, Workspace
from jackbox_env.scene import SceneNumbers

Array = NDArray[np.float64]

# In place of 4 * wall + foot: no impact, none to be found by reasonable work, or a foot may be at rest now.
NONE, ENDLESS, AT_REST = -1, -2, -3
HELD_AXES = 3  # accelerations of box and jack while feet are held, counted from PIECE: six, then three forces
MOST_WORK = 1_000_000  # gaps evaluated in one step
_RESTLESS = 65_536  # gaps evaluated before a step may count as one at rest
GLANCE = 2.0**-12  # of a piece: how far a step at rest looks ahead
_SLACK = 1.0 + 1e-12  # on bounds, for their rounding
STEEPEST = 1e40  # K [m/s^2] and alpha [rad/s^2] beyond which squares overflow


_GROWN = 64 * 11  # gaps evaluated until ``sink`` has reached its bound, see search()


def _growth() -> list[float]:
    """2^(k / 64) for k up to ``_GROWN``, rounded from integer roots: the last place of an exp2 is the C library's."""
    roots = []
    for k in range(64):
        root = 1 << (k + 64 * 80)
        for _ in range(6):
            root = math.isqrt(root)
        roots.append(root / (1 << 80))
    return [math.ldexp(roots[k % 64], k // 64) for k in range(_GROWN + 1)]


_GROWTH = np.array(_growth())


class Piece(NamedTuple):
    """What acts on the box during one piece of a step."""

    length: float  # [s]
    alpha: float  # angular acceleration, where it is constant [rad/s^2]
    curved: bool  # whether the accelerations are polynomials
    pushed: bool  # whether the box's centre is accelerated too
    spin_up: float  # bound of the angular acceleration [rad/s^2]
    push: float  # bound of the centre's acceleration [m/s^2]


class Touch(NamedTuple):
    """When feet touch."""

    tolerance: float  # gap at which a foot touches [m]
    together: float  # gap within which others touch at the same moment [m]


class Approach(NamedTuple):
    """A foot on its way to a wall."""

    wall: int
    foot: int
    gap: float  # [m] now
    rate: float  # [m/s]


class Limits(NamedTuple):
    """What a search for an impact may rely on."""

    curvature: float  # bound of a gap's second derivative [m/s^2]
    end: float  # until when it holds, since the flight's start [s]
    tolerance: float  # gap at which a foot touches [m]


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
    held: int  # feet that walls hold, bit 4 * wall + foot of each
    speeds: float  # of box and jack, all together, whose rounding a gap's rate has [m/s]


class Pose(NamedTuple):
    """Relative motion at one moment."""

    x: float
    y: float
    vx: float
    vy: float
    angle: float
    omega: float
    jack_angle: float
    jack_omega: float


def excursion(work: Workspace, axis: int, flight: Flight, s: float) -> tuple[float, float]:
    """Change of a coordinate and of its rate in ``s`` [s] that the polynomial acceleration brings."""
    end = (flight.since + s) / flight.half - 1.0
    moved, rate = (
        horner(work[PIECE + 3 * axis + 2], DEGREE + 2, end),
        horner(work[PIECE + 3 * axis + 1], DEGREE + 1, end),
    )
    if flight.since == 0.0:
        return moved, rate
    start = flight.since / flight.half - 1.0
    before = horner(work[PIECE + 3 * axis + 1], DEGREE + 1, start)
    return moved - horner(work[PIECE + 3 * axis + 2], DEGREE + 2, start) - before * s, rate - before


def held_piece(length: float, alpha: float) -> Piece:
    """A piece of ``length`` [s] under a constant angular acceleration [rad/s^2]."""
    return Piece(length, alpha, False, False, abs(alpha), 0.0)


def curved_piece(work: Workspace, length: float, pushed: bool) -> Piece:
    """A piece of ``length`` [s] under the polynomial accelerations in ``work``."""
    push = largest(work, PUSH_X) + largest(work, PUSH_Y) if pushed else 0.0
    return Piece(length, 0.0, True, pushed, largest(work, TURN), push)


def flight_of(scene: SceneNumbers, state: Array, piece: Piece, since: float) -> Flight:
    """The relative motion of a state ``since`` [s] after the start of a piece."""
    return Flight(
        state[3] - state[0], state[4] - state[1], state[9] - state[6], state[10] - state[7], state[2], state[8],
        state[5], state[11], scene.gravity, piece.alpha, since, 0.5 * piece.length, piece.curved, piece.pushed, 0,
        abs(state[6]) + abs(state[7]) + abs(state[9]) + abs(state[10]),
    )  # fmt: skip


def pose_at(flight: Flight, work: Workspace, s: float) -> Pose:
    """The relative motion ``s`` [s] into the flight."""
    if flight.held:
        return held_pose_at(flight, work, s)
    x = flight.x + flight.vx * s
    y = flight.y + (flight.vy - 0.5 * flight.gravity * s) * s
    vx, vy = flight.vx, flight.vy - flight.gravity * s
    turned, spun = 0.5 * flight.alpha * s * s, flight.alpha * s
    if flight.curved:
        turned, spun = excursion(work, TURN, flight, s)
        if flight.pushed:
            moved, pushed = excursion(work, PUSH_X, flight, s)
            x, vx = x - moved, vx - pushed
            moved, pushed = excursion(work, PUSH_Y, flight, s)
            y, vy = y - moved, vy - pushed
    angle = flight.angle + (flight.omega * s + turned)
    jack_angle = flight.jack_angle + flight.jack_omega * s
    return Pose(x, y, vx, vy, angle, flight.omega + spun, jack_angle, flight.jack_omega)


def held_pose_at(flight: Flight, work: Workspace, s: float) -> Pose:
    """The relative motion ``s`` [s] into a flight with held feet, on which all six accelerations are polynomials."""
    box_x, box_vx = excursion(work, HELD_AXES, flight, s)
    box_y, box_vy = excursion(work, HELD_AXES + 1, flight, s)
    turned, spun = excursion(work, HELD_AXES + 2, flight, s)
    x, vx = excursion(work, HELD_AXES + 3, flight, s)
    y, vy = excursion(work, HELD_AXES + 4, flight, s)
    jack_turned, jack_spun = excursion(work, HELD_AXES + 5, flight, s)
    return Pose(
        flight.x + (flight.vx * s + (x - box_x)), flight.y + (flight.vy * s + (y - box_y)),
        flight.vx + (vx - box_vx), flight.vy + (vy - box_vy),
        flight.angle + (flight.omega * s + turned), flight.omega + spun,
        flight.jack_angle + (flight.jack_omega * s + jack_turned), flight.jack_omega + jack_spun,
    )  # fmt: skip


def evolve(work: Workspace, flight: Flight, s: float) -> None:
    """Fly for ``s`` [s]: move the state."""
    state = work[STATE]
    if flight.held:
        for place in range(6):
            moved, rate = excursion(work, HELD_AXES + place, flight, s)
            state[place] += state[6 + place] * s + moved
            state[6 + place] += rate
        return
    turned, spun = 0.5 * flight.alpha * s * s, flight.alpha * s
    if flight.curved:
        turned, spun = excursion(work, TURN, flight, s)
    state[0] += state[6] * s
    state[1] += state[7] * s
    if flight.pushed:
        moved, pushed = excursion(work, PUSH_X, flight, s)
        state[0], state[6] = state[0] + moved, state[6] + pushed
        moved, pushed = excursion(work, PUSH_Y, flight, s)
        state[1], state[7] = state[1] + moved, state[7] + pushed
    state[2] += state[8] * s + turned
    state[8] += spun
    state[3] += state[9] * s
    state[4] += (state[10] - 0.5 * flight.gravity * s) * s
    state[10] -= flight.gravity * s
    state[5] += state[11] * s


def largest(work: Workspace, axis: int) -> float:
    """Bound of a polynomial acceleration over its piece."""
    bound = 0.0
    for k in range(DEGREE + 1):
        bound += abs(work[PIECE + 3 * axis, k])
    return bound


class Bounds(NamedTuple):
    """What the motion can not exceed within a time."""

    far: float  # distance of the centres [m]
    bend: float  # second derivative of a centre's distance from a wall [m/s^2]
    swing: float  # that of a foot's distance from the jack's centre, along a wall's normal [m/s^2]


def reach_of(scene: SceneNumbers, flight: Flight, left: float, push: float) -> float:
    """Bound of the distance of the centres within ``left`` [s] [m]."""
    x, y = flight.x + flight.vx * left, flight.y + (flight.vy - 0.5 * scene.gravity * left) * left
    # A chord's ends, and a bent path's distance from it.
    far = math.sqrt(max(flight.x * flight.x + flight.y * flight.y, x * x + y * y))
    return (far + (0.125 * scene.gravity + 0.5 * push) * left * left) * _SLACK


def bounds_of(scene: SceneNumbers, flight: Flight, left: float, spin_up: float, push: float) -> Bounds:
    """Bounds within ``left`` [s]; the box's angular and linear acceleration stay below ``spin_up`` and ``push``."""
    far = reach_of(scene, flight, left, push)
    pull = scene.gravity + push
    speed = math.sqrt(flight.vx * flight.vx + flight.vy * flight.vy) + pull * left
    omega = abs(flight.omega) + spin_up * left
    spin = abs(flight.jack_omega - flight.omega) + spin_up * left
    bend = (pull + 2.0 * omega * speed + (omega * omega + spin_up) * far) * _SLACK
    return Bounds(far, bend, scene.jack_arm * (spin * spin + spin_up) * _SLACK)


def curvature_of(scene: SceneNumbers, flight: Flight, left: float, piece: Piece) -> float:
    """Bound of a gap's second derivative within ``left`` [s] [m/s^2]."""
    bounds = bounds_of(scene, flight, left, piece.spin_up, piece.push)
    return bounds.bend + bounds.swing


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


def walls_in_reach(scene: SceneNumbers, frame: BoxFrame, left: float, bend: float) -> int:
    """Walls that the circle through the jack's feet may touch within ``left`` [s], as bits."""
    reach = 0.5 * bend * left * left
    walls = 0
    for wall in range(4):
        ahead, speed = towards(frame, wall)
        room = scene.box_half_width - scene.jack_arm - ahead
        if not (room > 0.0 and room - speed * left - reach > 0.0):
            walls |= 1 << wall
    return walls


def contact_tolerance(scene: SceneNumbers) -> float:
    """Gap at which a foot touches [m]: 1e-13, less in boxes below 1 m, never below what rounding leaves of a gap."""
    return max(1e-13 * min(1.0, scene.box_half_width), 3.6e-15 * scene.box_half_width)


def deepest(scene: SceneNumbers) -> float:
    """How deep a foot at rest may be in a wall [m]: 1e-10, less in boxes below 1 m."""
    return 1e-10 * min(1.0, scene.box_half_width)


def rests(scene: SceneNumbers, work: Workspace) -> bool:
    """Whether the jack is at rest, judged by the step's work: many gaps evaluated, for impacts of next to no impulse.

    Such a step looks ahead only as far as its next impacts are. Otherwise it would search all the rest of the step
    after each of thousands of impacts.
    """
    if work[TALLY, WORK] <= _RESTLESS:
        return False
    return bool(work[TALLY, IMPULSE] <= 1e-3 * scene.jack_mass * scene.speed_scale * work[TALLY, HITS])


def parabola_root(gap: float, rate: float, curvature: float) -> float:
    """First s > 0 at which gap + rate s - curvature s^2 / 2 is 0, for gap >= 0; infinity if it never is."""
    root = math.sqrt(rate * rate + 2.0 * curvature * gap)
    if rate < 0.0:
        return 2.0 * gap / (root - rate)
    return (rate + root) / curvature if curvature > 0.0 else math.inf


def foot_gap(
    scene: SceneNumbers, ahead: float, speed: float, cosine: float, sine: float, spin: float, turn: int
) -> tuple[float, float]:
    """Gap between a wall and a foot [m], and its rate [m/s].

    Args:
        scene: the scene.
        ahead: how far the jack's centre is on the way to the wall [m].
        speed: the rate of that [m/s].
        cosine: of the jack's angle relative to the box.
        sine: of the same.
        spin: rate of that angle [rad/s].
        turn: number of the foot less that of the wall.
    """
    along, across = quarter(cosine, sine, turn)
    return scene.box_half_width - ahead - scene.jack_arm * along, scene.jack_arm * across * spin - speed


def gap_at(scene: SceneNumbers, flight: Flight, work: Workspace, wall: int, foot: int, s: float) -> tuple[float, float]:
    """Gap between a wall and a foot ``s`` [s] into the flight [m], and its rate [m/s]."""
    work[TALLY, WORK] += 1.0
    pose = pose_at(flight, work, s)
    ahead, speed = towards(box_frame(pose.x, pose.y, pose.vx, pose.vy, pose.angle, pose.omega), wall)
    cosine, sine = cos_sin(pose.jack_angle - pose.angle)
    return foot_gap(scene, ahead, speed, cosine, sine, pose.jack_omega - pose.omega, foot - wall)


def first_impact(
    scene: SceneNumbers, work: Workspace, flight: Flight, piece: Piece, left: float, tolerance: float, rest: float
) -> tuple[float, int]:
    """Find the first impact of a flight within ``left`` [s], which is at most what is left of its piece.

    Args:
        scene: the scene.
        work: memory with the polynomial accelerations.
        flight: what moves.
        piece: what acts on the box.
        left: [s].
        tolerance: gap at which a foot touches [m].
        rest: gap within which a slow foot may be at rest [m]; -inf: nobody asks.

    Returns:
        Its time since the flight's start [s] and 4 * wall + foot; ``NONE`` if there is none, ``ENDLESS`` if it can not
        be told, ``AT_REST`` if a foot may be at rest now.
    """
    if reach_of(scene, flight, left, piece.push) + scene.jack_arm < scene.box_half_width:
        return left, NONE
    bounds = bounds_of(scene, flight, left, piece.spin_up, piece.push)
    frame = box_frame(flight.x, flight.y, flight.vx, flight.vy, flight.angle, flight.omega)
    walls = walls_in_reach(scene, frame, left, bounds.bend)
    if walls == 0:
        return left, NONE
    curvature = bounds.bend + bounds.swing
    if not curvature < STEEPEST:
        return left, ENDLESS
    # Half of it, so that rounding does not part what the search has found from what touches.
    return first_of_all(scene, work, flight, frame, walls, Limits(curvature, left, 0.5 * tolerance), rest)


def first_of_all(
    scene: SceneNumbers, work: Workspace, flight: Flight, frame: BoxFrame, walls: int, limits: Limits,
    rest: float,
) -> tuple[float, int]:  # fmt: skip
    """The first impact of any foot on any of these ``walls`` (as bits): see :func:`first_impact`."""
    best, found = limits.end, NONE
    curvature, tolerance = limits.curvature, limits.tolerance
    cosine, sine = cos_sin(flight.jack_angle - flight.angle)
    spin = flight.jack_omega - flight.omega
    longest = scene.jack_arm * max(abs(cosine), abs(sine))
    for wall in range(4):
        if not walls & (1 << wall):
            continue
        ahead, speed = towards(frame, wall)
        nearest = scene.box_half_width - ahead - longest  # of the feet, now; none comes nearer faster than this
        fall = max(speed, 0.0) + scene.jack_arm * abs(spin) + 0.5 * curvature * best
        if nearest > tolerance and nearest - fall * best > 0.0:
            continue
        for foot in range(4):
            gap, rate = foot_gap(scene, ahead, speed, cosine, sine, spin, foot - wall)
            if gap > tolerance and gap + (rate - 0.5 * curvature * best) * best > 0.0:
                continue
            if flight.held & (1 << (4 * wall + foot)):
                continue
            if gap <= rest and abs(rate) <= slowest(scene, flight, limits, rest):
                return 0.0, AT_REST
            time = search(scene, work, flight, Approach(wall, foot, gap, rate), Limits(curvature, best, tolerance))
            if time < best or (time == best and found == NONE):
                best, found = time, 4 * wall + foot
    return best, ENDLESS if work[TALLY, WORK] > MOST_WORK else found


def rounding(scene: SceneNumbers, flight: Flight, left: float) -> float:
    """Rounding of a gap's rate within ``left`` [s] [m/s]."""
    bound = 1e-15 * (abs(flight.vx) + abs(flight.vy) + flight.gravity * left)
    return bound + 1e-15 * (abs(flight.omega) * scene.box_half_width + scene.jack_arm * abs(flight.jack_omega))


def slowest(scene: SceneNumbers, flight: Flight, limits: Limits, rest: float) -> float:
    """The rate up to which a foot that touches may be at rest [m/s].

    With loss a foot rests that would rise by ``rest`` [m] at most. Without loss nothing comes to rest, but a foot whose
    rate is rounding does not bounce.
    """
    if scene.restitution < 1.0:
        return math.sqrt(2.0 * limits.curvature * rest)
    return rounding(scene, flight, limits.end) + 1e-15 * flight.speeds


def search(scene: SceneNumbers, work: Workspace, flight: Flight, approach: Approach, limits: Limits) -> float:
    """First time within ``limits.end`` [s] at which a foot touches a wall and approaches; infinity if there is none.

    A foot that touches and does not approach stays within ``sink`` until the parabola through its present gap does.
    Without that depth the time would not advance while a foot rests on a wall. ``sink`` is the tolerance at first. It
    doubles with every 64 gaps that a step evaluates, up to 1e-10 m. So a jack that rests on a wall or slides along it
    costs thousands of gap evaluations and impacts, and not millions. A step at rest grants that depth to a foot near
    the wall too.
    """
    still = rounding(scene, flight, limits.end)
    if flight.held:
        still += 1e-15 * flight.speeds
    tolerance, gap, rate = limits.tolerance, approach.gap, approach.rate
    s = 0.0
    while True:
        if gap > tolerance:
            granted = deepest(scene) if rests(scene, work) else 0.0
            after = s + parabola_root(gap + granted, rate, limits.curvature)
        elif rate < -still:
            return s
        else:
            sink = tolerance
            if scene.restitution == 1.0:
                sink = min(deepest(scene), tolerance * _GROWTH[min(int(work[TALLY, WORK]), _GROWN)])
            after = s + parabola_root(max(gap + sink, 0.1 * tolerance), max(rate, 0.0), limits.curvature)
        if not after <= limits.end or work[TALLY, WORK] > MOST_WORK:
            return math.inf
        if after == s:
            if rate < 0.0:  # float64 does not resolve the time to the wall
                return s
            after = s + 2.3e-16 * s
        s = after
        gap, rate = gap_at(scene, flight, work, approach.wall, approach.foot, s)


def strike(scene: SceneNumbers, work: Workspace, flight: Flight, time: float, pair: int, together: float) -> None:
    """Fly for ``time`` [s] to an impact of ``pair`` = 4 * wall + foot, and apply the law to all that touch there."""
    evolve(work, flight, time)
    work[TALLY, ELAPSED] += time
    work[TALLY, WORK] += 1.0
    resolve(scene, work, together, pair // 4, pair % 4)


def why_endless(work: Workspace) -> Status:
    """Why no impact could be told."""
    return Status.TOO_MUCH_WORK if work[TALLY, WORK] > MOST_WORK else Status.TOO_FAST
