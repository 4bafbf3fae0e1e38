"""Evolve: the motion of box and jack between impacts, in one piece of a step, and the gaps between feet and walls.

``search.py`` evaluates gaps and rates here, and ``step.py`` moves the state with :func:`evolve`.
Law of flight: the jack falls with g and keeps its spin. The box keeps its velocity except for side forces, and its
angle is the double integral of torque / J_b. While feet are held, power series describe the relative motion
(``constrained.py``).
"""

from __future__ import annotations

from typing import NamedTuple

from jackbox_env.exact.contact import gap_and_lever, quarter
from jackbox_env.exact.drives import DEGREE, PUSH_X, PUSH_Y, TURN, horner
from jackbox_env.exact.trigonometry import cos_sin
from jackbox_env.exact.workspace import POSITION_X, POSITION_Y, PSI, RATE_X, RATE_Y, SPIN, Workspace
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    THETA_BOX,
    THETA_JACK,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
)


class Piece(NamedTuple):
    """The accelerations of the box by the drive in one piece of a step."""

    length: float  # [s]
    alpha: float  # angular acceleration if it is constant [rad/s^2]
    curved: bool  # whether the accelerations are polynomials
    pushed: bool  # whether the box's centre is accelerated too
    spin_up: float  # bound of the angular acceleration [rad/s^2]
    push: float  # bound of the centre's acceleration [m/s^2]


class Flight(NamedTuple):
    """Relative motion from a moment on: the jack's centre relative to the box's, and both angles."""

    x: float  # [m]
    y: float
    vx: float  # [m/s]
    vy: float
    angle: float  # of the box [rad]
    omega: float  # [rad/s]
    jack_angle: float
    jack_omega: float
    gravity: float  # [m/s^2]
    alpha: float  # of the box if it is constant [rad/s^2]
    since: float  # the moment, since the piece's start [s]
    half: float  # half the piece's length; while feet are held, the stretch's length [s]
    curved: bool  # whether the accelerations are polynomials
    pushed: bool  # whether the box's centre is accelerated too
    held: int  # feet at rest on walls, bit 4 * wall + foot of each
    speeds: float  # sum of the speeds of box and jack, to bound the rounding of a gap's rate [m/s]


def constant_piece(length: float, alpha: float) -> Piece:
    """A piece of ``length`` [s] under a constant angular acceleration [rad/s^2]."""
    return Piece(length, alpha, False, False, abs(alpha), 0.0)


def curved_piece(memory: Workspace, length: float, pushed: bool) -> Piece:
    """A piece of ``length`` [s] under the polynomial accelerations in ``memory``."""
    push = largest(memory, PUSH_X) + largest(memory, PUSH_Y) if pushed else 0.0
    return Piece(length, 0.0, True, pushed, largest(memory, TURN), push)


def largest(memory: Workspace, axis: int) -> float:
    """Bound of a polynomial acceleration over its piece."""
    bound = 0.0
    for k in range(DEGREE + 1):
        bound += abs(memory.powers[3 * axis, k])
    return bound


def flight_of(scene: SceneNumbers, state: Array, piece: Piece, since: float) -> Flight:
    """The relative motion of a state ``since`` [s] after the start of a piece."""
    return Flight(
        state[X_JACK] - state[X_BOX], state[Y_JACK] - state[Y_BOX],
        state[VX_JACK] - state[VX_BOX], state[VY_JACK] - state[VY_BOX],
        state[THETA_BOX], state[OMEGA_BOX], state[THETA_JACK], state[OMEGA_JACK],
        scene.gravity, piece.alpha, since, 0.5 * piece.length, piece.curved, piece.pushed, 0,
        abs(state[VX_BOX]) + abs(state[VY_BOX]) + abs(state[VX_JACK]) + abs(state[VY_JACK]),
    )  # fmt: skip


def excursion(memory: Workspace, axis: int, flight: Flight, s: float) -> tuple[float, float]:
    """Change of a coordinate and of its rate in ``s`` [s] by the polynomial acceleration."""
    end = (flight.since + s) / flight.half - 1.0
    moved, rate = (
        horner(memory.powers[3 * axis + 2], DEGREE + 2, end),
        horner(memory.powers[3 * axis + 1], DEGREE + 1, end),
    )
    if flight.since == 0.0:
        return moved, rate
    start = flight.since / flight.half - 1.0
    before = horner(memory.powers[3 * axis + 1], DEGREE + 1, start)
    return moved - horner(memory.powers[3 * axis + 2], DEGREE + 2, start) - before * s, rate - before


def driven_at(flight: Flight, memory: Workspace, s: float) -> tuple[float, float, float]:
    """Accelerations of the box by the drive ``s`` [s] into the flight: angular, along x and along y."""
    u = (flight.since + s) / flight.half - 1.0
    turn = horner(memory.powers[3 * TURN], DEGREE, u) if flight.curved else flight.alpha
    if not flight.pushed:
        return turn, 0.0, 0.0
    return turn, horner(memory.powers[3 * PUSH_X], DEGREE, u), horner(memory.powers[3 * PUSH_Y], DEGREE, u)


def view_at(flight: Flight, memory: Workspace, s: float) -> View:
    """The jack relative to the box ``s`` [s] into the flight."""
    x = flight.x + flight.vx * s
    y = flight.y + (flight.vy - 0.5 * flight.gravity * s) * s
    vx, vy = flight.vx, flight.vy - flight.gravity * s
    turned, spun = 0.5 * flight.alpha * s * s, flight.alpha * s
    if flight.curved:
        turned, spun = excursion(memory, TURN, flight, s)
        if flight.pushed:
            moved, pushed = excursion(memory, PUSH_X, flight, s)
            x, vx = x - moved, vx - pushed
            moved, pushed = excursion(memory, PUSH_Y, flight, s)
            y, vy = y - moved, vy - pushed
    angle, omega = flight.angle + (flight.omega * s + turned), flight.omega + spun
    jack_angle = flight.jack_angle + flight.jack_omega * s
    return view_of(box_frame(x, y, vx, vy, angle, omega), jack_angle - angle, flight.jack_omega - omega, s)


def evolve(memory: Workspace, flight: Flight, s: float) -> None:
    """Fly for ``s`` [s]: move the state."""
    state = memory.state
    turned, spun = 0.5 * flight.alpha * s * s, flight.alpha * s
    if flight.curved:
        turned, spun = excursion(memory, TURN, flight, s)
    state[X_BOX] += state[VX_BOX] * s
    state[Y_BOX] += state[VY_BOX] * s
    if flight.pushed:
        moved, pushed = excursion(memory, PUSH_X, flight, s)
        state[X_BOX], state[VX_BOX] = state[X_BOX] + moved, state[VX_BOX] + pushed
        moved, pushed = excursion(memory, PUSH_Y, flight, s)
        state[Y_BOX], state[VY_BOX] = state[Y_BOX] + moved, state[VY_BOX] + pushed
    state[THETA_BOX] += state[OMEGA_BOX] * s + turned
    state[OMEGA_BOX] += spun
    state[X_JACK] += state[VX_JACK] * s
    state[Y_JACK] += (state[VY_JACK] - 0.5 * flight.gravity * s) * s
    state[VY_JACK] -= flight.gravity * s
    state[THETA_JACK] += state[OMEGA_JACK] * s


def stays_clear(x: float, y: float, vx: float, vy: float, fall: float, dt: float, clear: float) -> bool:
    """Whether both ends of the jack's path are so near the box's centre that no foot can touch a wall on the way.

    ``clear`` is the square of that distance, see ``step.Plan``.
    """
    end_x, end_y = moved(x, vx, dt), fallen(y, vy, fall, dt)
    return bool((x * x + y * y < clear) & (end_x * end_x + end_y * end_y < clear))


def moved(position: float, rate: float, dt: float) -> float:
    """A coordinate after ``dt`` [s] at a constant velocity."""
    return position + rate * dt


def fallen(height: float, rate: float, fall: float, dt: float) -> float:
    """A height after ``dt`` [s], in which gravity reduces its velocity by ``fall`` [m/s]."""
    return height + (rate - 0.5 * fall) * dt


def turned(angle: float, omega: float, alpha: float, dt: float) -> float:
    """An angle after ``dt`` [s] at a constant angular acceleration."""
    return angle + (omega + 0.5 * alpha * dt) * dt


def free_flight(before: Array, after: Array, fall: float, dt: float, alpha: float) -> None:
    """Fly for ``dt`` [s] without a search for impacts; gravity reduces the jack's velocity by ``fall`` [m/s]."""
    after[X_BOX] = moved(before[X_BOX], before[VX_BOX], dt)
    after[Y_BOX] = moved(before[Y_BOX], before[VY_BOX], dt)
    after[THETA_BOX] = turned(before[THETA_BOX], before[OMEGA_BOX], alpha, dt)
    after[X_JACK] = moved(before[X_JACK], before[VX_JACK], dt)
    after[Y_JACK] = fallen(before[Y_JACK], before[VY_JACK], fall, dt)
    after[THETA_JACK] = moved(before[THETA_JACK], before[OMEGA_JACK], dt)
    after[VX_BOX] = before[VX_BOX]
    after[VY_BOX] = before[VY_BOX]
    after[OMEGA_BOX] = before[OMEGA_BOX] + alpha * dt
    after[VX_JACK] = before[VX_JACK]
    after[VY_JACK] = before[VY_JACK] - fall
    after[OMEGA_JACK] = before[OMEGA_JACK]


class BoxFrame(NamedTuple):
    """Position and velocity of the jack's centre in the rotating frame of the box."""

    x: float  # [m]
    y: float
    vx: float  # [m/s]
    vy: float


def box_frame(x: float, y: float, vx: float, vy: float, angle: float, omega: float) -> BoxFrame:
    """Transform relative position and velocity to the frame of a box at ``angle`` [rad], rate ``omega`` [rad/s]."""
    c, s = cos_sin(angle)
    ahead, aside = on_axes(c, s, x, y)
    forward, sideways = on_axes(c, s, vx, vy)
    return BoxFrame(ahead, aside, forward + omega * aside, sideways - omega * ahead)


def on_axes(cosine: float, sine: float, x: float, y: float) -> tuple[float, float]:
    """Components of a vector on the axes of a box whose angle has this cosine and sine."""
    return cosine * x + sine * y, cosine * y - sine * x


class View(NamedTuple):
    """The jack relative to the box at one moment."""

    frame: BoxFrame
    cosine: float  # of the jack's angle relative to the box
    sine: float
    spin: float  # rate of that angle [rad/s]
    time: float  # the moment, since the flight's start [s]


def view_of(frame: BoxFrame, angle: float, spin: float, time: float) -> View:
    """The jack at an ``angle`` and ``spin`` relative to the box, at a ``time`` [s]."""
    cosine, sine = cos_sin(angle)
    return View(frame, cosine, sine, spin, time)


def towards(frame: BoxFrame, wall: int) -> tuple[float, float]:
    """Coordinate of the jack's centre along a wall's normal [m], and its rate [m/s]."""
    return quarter(frame.x, -frame.y, wall)[0], quarter(frame.vx, -frame.vy, wall)[0]


def foot_gap(
    scene: SceneNumbers, ahead: float, speed: float, cosine: float, sine: float, spin: float, turn: int
) -> tuple[float, float]:
    """Gap between a wall and a foot [m], and its rate [m/s]: see :func:`contact.gap_and_lever`.

    ``ahead`` grows at the rate ``speed`` [m/s], the angle at the rate ``spin`` [rad/s].
    """
    gap, lever = gap_and_lever(scene, ahead, cosine, sine, turn)
    return gap, lever * spin - speed


def gap_at(
    scene: SceneNumbers, flight: Flight, memory: Workspace, wall: int, foot: int, s: float
) -> tuple[float, float]:
    """Gap between a wall and a foot ``s`` [s] into the flight [m], and its rate [m/s]."""
    memory.evaluations += 1.0
    view = held_view(flight, memory, s) if flight.held else view_at(flight, memory, s)
    ahead, speed = towards(view.frame, wall)
    return foot_gap(scene, ahead, speed, view.cosine, view.sine, view.spin, foot - wall)


def held_view(flight: Flight, memory: Workspace, s: float) -> View:
    """The jack relative to the box ``s`` [s] into a stretch with feet at rest."""
    length = flight.half
    u = s / length
    frame = BoxFrame(
        horner(memory.series[POSITION_X], DEGREE + 2, u), horner(memory.series[POSITION_Y], DEGREE + 2, u),
        horner(memory.series[RATE_X], DEGREE + 1, u) / length, horner(memory.series[RATE_Y], DEGREE + 1, u) / length,
    )  # fmt: skip
    spin = horner(memory.series[SPIN], DEGREE + 1, u) / length
    return view_of(frame, horner(memory.series[PSI], DEGREE + 2, u), spin, s)
