"""When the jack will land, and the torque that turns the box so that it meets the jack as asked.

Between impacts the jack flies freely. So the moment at which its centre comes to the height -(L - l) under the box's
centre, where a foot pointing down touches the floor of a level box, follows from the state in closed form. Walls on the
way do not count.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jackbox_env.states import OMEGA_BOX, THETA_BOX, VY_BOX, VY_JACK, Y_BOX, Y_JACK, Array

LONGEST = 8.0  # [L / v0] a time to the landing is cut there: twice the flight from the floor at v0 up and back on Earth
QUARTER = 0.5 * math.pi
_TINY = float(np.finfo(np.float32).tiny)
WEAKEST = 1e-30  # gravity that stands for none


def fall_time(gravity: Any, height: Any, rise: Any, longest: Any, library: Any = np) -> Any:
    """When something at ``height`` >= 0 that is thrown up at ``rise`` is at height 0, at most ``longest``.

    Arrays of numpy or torch, as ``library`` says, in any units that fit together. Of the two forms of the root this
    takes the one without cancellation.
    """
    impact = library.sqrt(rise * rise + 2.0 * gravity * height)
    down = 2.0 * height / library.clip(impact - rise, _TINY, None)
    up = (impact + rise) / gravity
    return library.clip(library.where(rise > 0.0, up, down), None, longest)


def landing_times(scene: Any, states: Array) -> Array:
    """When the jack lands [s], shape (n,), from states, shape (n, 12), in a scene or in one whose fields are arrays."""
    depth = scene.box_half_width - scene.jack_arm
    height = np.maximum(states[:, Y_JACK] - states[:, Y_BOX] + depth, 0.0)
    longest = LONGEST * scene.box_half_width / scene.speed_scale
    with np.errstate(over="ignore"):
        found: Array = fall_time(
            np.maximum(scene.gravity, WEAKEST), height, states[:, VY_JACK] - states[:, VY_BOX], longest
        )  # fmt: skip
    return found


def upright(states: Array) -> Array:
    """The states with the box turned back by whole quarter turns, to within an eighth: it looks and acts the same."""
    found = states.copy()
    found[:, THETA_BOX] -= QUARTER * np.round(found[:, THETA_BOX] / QUARTER)
    return found


def torques(scene: Any, states: Array, times: Array, targets: Array, held: float) -> Array:
    """Torques, in units of the limit, that move boxes to targets in the times to the landing, shape (n,).

    The box's angle follows the cubic in time that begins at its angle and rate and ends at the target's.

    Args:
        scene: its torque limit and its box's inertia.
        states: shape (n, 12).
        times: to the landing [s], shape (n,); at least ``held`` is taken.
        targets: angle [rad] and rate [rad/s] there, shape (n, 2).
        held: how long each torque is held [s]; it is the cubic's mean over that time.
    """
    left, rate, wanted = np.maximum(times, held), states[:, OMEGA_BOX], targets[:, 1]
    missing = targets[:, 0] - states[:, THETA_BOX]
    first = 6.0 * missing / left**2 - (4.0 * rate + 2.0 * wanted) / left  # [rad/s^2]
    growth = -12.0 * missing / left**3 + 6.0 * (rate + wanted) / left**2  # [rad/s^3]
    found: Array = (first + 0.5 * held * growth) * scene.box_inertia / scene.torque_limit
    return np.clip(found, -1.0, 1.0)
