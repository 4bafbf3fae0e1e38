"""Observations of many states at once, as the environments return them up to rounding; for values and studies."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jackbox_env import Scene
from jackbox_env.observation import BOUNDS
from jackbox_env.states import OMEGA_BOX, OMEGA_JACK, THETA_BOX, THETA_JACK, VX_BOX, VX_JACK, X_BOX, X_JACK, Array

# Components that change sign if left and right are exchanged.
_MIRRORED = np.array([X_BOX, THETA_BOX, X_JACK, THETA_JACK, VX_BOX, OMEGA_BOX, VX_JACK, OMEGA_JACK])


def observations(scene: Scene, states: Array) -> NDArray[np.float32]:
    """Observations of states, shape (n, 12): float32, shape (n, 10), see :mod:`jackbox_env.observation`.

    Cosines are numpy's, so a number may differ in its last place from the environments'.
    """
    x_box, y_box, theta, x_jack, y_jack, theta_jack, vx_box, vy_box, omega, vx_jack, vy_jack, omega_jack = states.T
    cosine, sine, relative = np.cos(theta), np.sin(theta), 4.0 * (theta_jack - theta)
    x, y, vx, vy = x_jack - x_box, y_jack - y_box, vx_jack - vx_box, vy_jack - vy_box
    length, speed = scene.box_half_width, scene.speed_scale
    columns = [
        (cosine * x + sine * y) / length,
        (cosine * y - sine * x) / length,
        (cosine * vx + sine * vy) / speed,
        (cosine * vy - sine * vx) / speed,
        cosine,
        sine,
        omega * length / speed,
        np.cos(relative),
        np.sin(relative),
        omega_jack * scene.jack_arm / speed,
    ]
    clipped: NDArray[np.float32] = np.clip(np.stack(columns, axis=1), -BOUNDS, BOUNDS).astype(np.float32)
    return clipped


def mirrored(states: Array) -> Array:
    """The states with left and right exchanged, shape (n, 12): their motion is mirrored too, under opposite torques."""
    other = states.copy()
    other[:, _MIRRORED] *= -1.0
    return other
