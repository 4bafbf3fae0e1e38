"""Bounds of what moves within a time: how far the jack gets, and how much a gap bends.

With upper bounds V, Omega, A, D of relative speed, |omega_box|, |alpha_box| and |r|, a gap bends by at most

    K = |d2 gap / dt2| = a + 2 Omega V + (Omega^2 + A) D + l (max |omega_jack - omega_box|^2 + A)

with a the relative acceleration of the centres. So gap(t + s) >= gap + gap' s - K s^2 / 2 over the whole time.
Where |r| + l < L throughout, nothing can be hit.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from jackbox_env.compiled.motion import BoxFrame, Flight, Piece, towards
from jackbox_env.scene import SceneNumbers

_SLACK = 1.0 + 1e-12  # on bounds, for their rounding


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


def parabola_root(gap: float, rate: float, curvature: float) -> float:
    """First s > 0 at which gap + rate s - curvature s^2 / 2 is 0, for gap >= 0; infinity if it never is."""
    root = math.sqrt(rate * rate + 2.0 * curvature * gap)
    if rate < 0.0:
        return 2.0 * gap / (root - rate)
    return (rate + root) / curvature if curvature > 0.0 else math.inf


def rounding(scene: SceneNumbers, flight: Flight, left: float) -> float:
    """Rounding of a gap's rate within ``left`` [s] [m/s]."""
    bound = 1e-15 * (abs(flight.vx) + abs(flight.vy) + flight.gravity * left)
    return bound + 1e-15 * (abs(flight.omega) * scene.box_half_width + scene.jack_arm * abs(flight.jack_omega))
