"""Bounds of the motion within a horizon: what ``search.py`` relies on.

With upper bounds a, V, D of the centres' relative acceleration, speed and distance |r|, and Omega, A, S of
|omega_box|, |alpha_box| and |omega_jack - omega_box|, the second derivative of the gap obeys

    |gap''| <= K = a + 2 Omega V + (Omega^2 + A) D + l (S^2 + A).
"""

from __future__ import annotations

import math
from typing import NamedTuple

from jackbox_env.exact.flight import Flight
from jackbox_env.exact.geometry import BoxFrame, towards
from jackbox_env.model.scene import SceneNumbers

_SLACK = 1.0 + 1e-12  # for the rounding of bounds


_MARGIN = 1e-9  # of L: more than a contact tolerance, also at angles of 1e6 rad


class Bounds(NamedTuple):
    """Upper bounds of the motion until a horizon."""

    far: float  # distance of the centres [m]
    centre_curvature: float  # of |(n . r)''|, along a wall's normal [m/s^2]
    foot_curvature: float  # of |(n . o)''| [m/s^2]


def reach_of(scene: SceneNumbers, flight: Flight, horizon: float, max_acceleration: float) -> float:
    """Bound of the distance of the centres within ``horizon`` [s] [m]."""
    return farthest(flight.x, flight.y, flight.vx, flight.vy, scene.gravity, max_acceleration, horizon)


def farthest(
    x: float, y: float, vx: float, vy: float, gravity: float, max_acceleration: float, horizon: float
) -> float:
    """Bound of the distance of the centres within ``horizon`` [s] [m], from their relative position and velocity."""
    end_x, end_y = x + vx * horizon, y + (vy - 0.5 * gravity * horizon) * horizon
    # The farther end of the chord, and the distance of the bent path from the chord.
    far = math.sqrt(max(x * x + y * y, end_x * end_x + end_y * end_y))
    return (far + (0.125 * gravity + 0.5 * max_acceleration) * horizon * horizon) * _SLACK


def bounds_of(
    scene: SceneNumbers, flight: Flight, horizon: float, max_angular_acceleration: float, max_acceleration: float
) -> Bounds:
    """Bounds within ``horizon`` [s], if the accelerations of the box stay below these."""
    far = reach_of(scene, flight, horizon, max_acceleration)
    spin = abs(flight.jack_omega - flight.omega) + max_angular_acceleration * horizon
    centre_curvature = centre_curvature_of(
        flight.vx, flight.vy, flight.omega, far, scene.gravity + max_acceleration, max_angular_acceleration, horizon
    )
    return Bounds(far, centre_curvature, foot_curvature_of(scene.jack_arm, spin, max_angular_acceleration))


def foot_curvature_of(arm: float, spin: float, max_angular_acceleration: float) -> float:
    """Bound of the second derivative of n . o, along a wall's normal [m/s^2]; ``spin`` [rad/s] bounds the jack's."""
    return arm * (spin * spin + max_angular_acceleration) * _SLACK


def centre_curvature_of(
    vx: float, vy: float, omega: float, far: float, pull: float, max_angular_acceleration: float, horizon: float
) -> float:
    """Bound of the second derivative of n . r, along a wall's normal, within ``horizon`` [s] [m/s^2].

    The centres are at most ``far`` [m] apart, and accelerate relative to each other by ``pull`` [m/s^2] at most.
    """
    speed = math.sqrt(vx * vx + vy * vy) + pull * horizon
    fastest = abs(omega) + max_angular_acceleration * horizon
    return (pull + 2.0 * fastest * speed + (fastest * fastest + max_angular_acceleration) * far) * _SLACK


def curvature_to_impact(
    scene: SceneNumbers,
    flight: Flight,
    horizon: float,
    max_angular_acceleration: float,
    max_acceleration: float,
    outermost: float,
) -> float:
    """Bound K of a gap's second derivative within ``horizon`` [s], until a foot first touches a wall [m/s^2].

    Until then a foot is in the box, sqrt(2) L from its centre at most. Feet that are in a wall now get no deeper
    without touching: ``outermost`` [m], the largest coordinate of a foot on the box's axes now, replaces L if it is
    larger. With p the foot's position from the box's centre and n the wall's normal, gap = L - n . p, so
    |gap''| <= |p''| + 2 |n'| |p'| + |n''| |p|; p does not depend on the box's rotation.
    """
    arm, spin = scene.jack_arm, abs(flight.jack_omega)
    pull = scene.gravity + max_acceleration
    omega = abs(flight.omega) + max_angular_acceleration * horizon
    speed = math.sqrt(flight.vx * flight.vx + flight.vy * flight.vy) + pull * horizon + arm * spin
    away = 1.4142136 * max(scene.box_half_width, outermost)
    return (pull + arm * spin * spin + 2.0 * omega * speed + (omega * omega + max_angular_acceleration) * away) * _SLACK


def inside(scene: SceneNumbers, flight: Flight, horizon: float, max_acceleration: float) -> tuple[float, float]:
    """Times [s] between which no foot can touch, however fast the box turns; 0 and 0 if there are none.

    They may lie outside [0, ``horizon``], where they prove nothing. A foot touches a wall only if its distance from the
    box's centre is L or more. With r and v the relative position and velocity of the centres, and a bound a of their
    acceleration, |r + v s| + a s^2 / 2 < L - l holds while |r + v s| < R = L - l - a horizon^2 / 2.
    """
    pull = scene.gravity + max_acceleration
    room = (scene.box_half_width - scene.jack_arm - 0.5 * pull * horizon * horizon) * (1.0 - 1e-12)
    square = flight.vx * flight.vx + flight.vy * flight.vy
    linear = flight.x * flight.vx + flight.y * flight.vy
    beyond = flight.x * flight.x + flight.y * flight.y - room * room
    root = linear * linear - square * beyond
    if not (room > 0.0 and root > 0.0 and square > 0.0):
        return 0.0, 0.0
    root = math.sqrt(root) * (1.0 - 1e-9)
    return (-linear - root) / square, (root - linear) / square


def walls_in_reach(scene: SceneNumbers, frame: BoxFrame, horizon: float, centre_curvature: float) -> int:
    """Walls that the circle through the jack's feet may touch within ``horizon`` [s], as bits."""
    reach = 0.5 * centre_curvature * horizon * horizon  # by which its path bends at most
    walls = 0
    for wall in range(4):
        ahead, speed = towards(frame, wall)
        room = scene.box_half_width - scene.jack_arm - ahead  # between circle and wall, now
        if not ((room > 0.0) & (room - speed * horizon - reach > 0.0)):
            walls |= 1 << wall
    return walls


def clearance_of_all(
    room: float, arm: float, ahead: float, aside: float, ahead_rate: float, aside_rate: float, cosine: float,
    sine: float, spin: float, centre_curvature: float, foot_curvature: float, horizon: float,
) -> float:  # fmt: skip
    """A number [m] that is positive only if no foot touches a wall for ``horizon`` [s].

    It is the larger of two lower bounds, for all walls and feet at once: of the room of the circle through the feet, as
    :func:`walls_in_reach` tests it, and of gap + gap' s - K s^2 / 2, as :func:`first_of_all` does. Opposite walls, and
    opposite feet, have opposite signs, so two maxima are enough. A margin covers rounding and every contact tolerance.

    Args:
        room: distance of the centres at which the jack's feet reach a wall [m].
        arm: of the jack [m].
        ahead: coordinate of the jack's centre along one axis of the box [m]; then along the other, and both rates.
        cosine: of the jack's angle relative to the box; then its sine, and the angle's rate ``spin`` [rad/s].
        centre_curvature: bound of |(n . r)''| [m/s^2]; then ``foot_curvature`` of |(n . o)''|.
        horizon: [s].
    """
    bend, turned = 0.5 * horizon * horizon, spin * horizon
    now = max(abs(ahead), abs(aside))
    later = max(abs(ahead + ahead_rate * horizon), abs(aside + aside_rate * horizon)) + bend * centre_curvature
    reach = max(abs(cosine), abs(sine))
    later_reach = max(abs(cosine - sine * turned), abs(sine + cosine * turned))
    circle = room - max(now, later)
    feet = room + arm - max(now + arm * reach, later + arm * later_reach + bend * foot_curvature)
    return max(circle, feet) - _MARGIN * (room + arm)


def rounding(scene: SceneNumbers, flight: Flight, horizon: float) -> float:
    """Rounding of a gap's rate within ``horizon`` [s] [m/s]."""
    bound = 1e-15 * (abs(flight.vx) + abs(flight.vy) + flight.gravity * horizon)
    bound += 1e-15 * (abs(flight.omega) * scene.box_half_width + scene.jack_arm * abs(flight.jack_omega))
    return bound + 1e-15 * flight.speeds
