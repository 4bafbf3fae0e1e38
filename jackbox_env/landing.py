"""The time to the jack's landing, and the torque that turns the box to a target angle and rate by then.

The jack lands when its centre is L - l below the box's centre: there a foot pointing down touches the floor of a level
box. Between impacts the jack flies freely, so the time follows from the state in closed form. Walls on the way are
ignored.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jackbox_env.states import OMEGA_BOX, THETA_BOX, VY_BOX, VY_JACK, Y_BOX, Y_JACK, Array

LONGEST = 8.0  # [L / v0] the greatest time to the landing: twice the flight from the floor at v0 up and back on Earth
QUARTER = 0.5 * math.pi
_TINY = float(np.finfo(np.float32).tiny)
WEAKEST = 1e-30  # gravity in place of 0, to divide by


def fall_time(gravity: Any, height: Any, rise: Any, longest: Any, library: Any = np) -> Any:
    """Time until a body at ``height`` >= 0 with upward speed ``rise`` is at height 0, at most ``longest``.

    Arrays of ``library`` (numpy or torch), in consistent units. Of the two forms of the root, the one without
    cancellation is used.
    """
    impact = library.sqrt(rise * rise + 2.0 * gravity * height)
    down = 2.0 * height / library.clip(impact - rise, _TINY, None)
    up = (impact + rise) / gravity
    return library.clip(library.where(rise > 0.0, up, down), None, longest)


def landing_times(scene: Any, states: Array) -> Array:
    """Times to the landing [s], shape (n,), from states, shape (n, 12); the scene's fields may be arrays (n,)."""
    depth = scene.box_half_width - scene.jack_arm
    height = np.maximum(states[:, Y_JACK] - states[:, Y_BOX] + depth, 0.0)
    longest = LONGEST * scene.box_half_width / scene.speed_scale
    with np.errstate(over="ignore"):
        gravity, rise = np.maximum(scene.gravity, WEAKEST), states[:, VY_JACK] - states[:, VY_BOX]
        times: Array = fall_time(gravity, height, rise, longest)
    return times


def upright(states: Array) -> Array:
    """The states with the box turned back by whole quarter turns, to within an eighth: the motion is the same."""
    turned = states.copy()
    turned[:, THETA_BOX] -= QUARTER * np.round(turned[:, THETA_BOX] / QUARTER)
    return turned


def torques(scene: Any, states: Array, times: Array, targets: Array, duration: float) -> Array:
    """Torques, in units of the limit, that move boxes to targets in the times to the landing, shape (n,).

    The box's angle follows the cubic in time that begins at its angle and rate and ends at the target's.

    Args:
        scene: its torque limit and its box's inertia.
        states: shape (n, 12).
        times: to the landing [s], shape (n,); raised to ``duration`` if less.
        targets: angle [rad] and rate [rad/s] at the landing, shape (n, 2).
        duration: of each constant torque [s], which is the cubic's mean over that time.
    """
    remaining, rate, target_rate = np.maximum(times, duration), states[:, OMEGA_BOX], targets[:, 1]
    missing = targets[:, 0] - states[:, THETA_BOX]
    first = 6.0 * missing / remaining**2 - (4.0 * rate + 2.0 * target_rate) / remaining  # [rad/s^2]
    growth = -12.0 * missing / remaining**3 + 6.0 * (rate + target_rate) / remaining**2  # [rad/s^3]
    shares: Array = (first + 0.5 * duration * growth) * scene.box_inertia / scene.torque_limit
    return np.clip(shares, -1.0, 1.0)
