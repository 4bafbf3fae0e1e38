"""The observation: ten numbers of order one, from the state alone.

====  ======================================================  ===========  =====
 #    quantity                                                unit         bound
====  ======================================================  ===========  =====
0, 1  jack's centre in the box frame                          L            1
2, 3  its velocity relative to the box's centre, on box axes  v0           10
4, 5  cosine and sine of theta_box                                         1
6     omega_box                                               v0 / L       10
7, 8  cosine and sine of 4 (theta_jack - theta_box)                        1
9     omega_jack                                              v0 / l       10
====  ======================================================  ===========  =====

with v0 = sqrt(2 * 9.81 * L). The cross repeats every quarter turn, hence the 4. Values are clipped to their bounds.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jackbox_env.scene import Scene, SceneNumbers
from jackbox_env.states import Array, Numbers, State

BOUNDS = np.array([1, 1, 10, 10, 1, 1, 10, 1, 1, 10], dtype=np.float32)


def observe(scene: Scene, state: Sequence[float]) -> NDArray[np.float32]:
    """Return the observation of a state of 12 numbers: a fresh float32 array, shape (10,), within ``BOUNDS``.

    The C library's cosines differ between machines in the last place of float64, which float32 hides all but once in
    1e12 numbers.
    """
    named = State(*state)
    angle, relative = named.theta_box, 4.0 * (named.theta_jack - named.theta_box)
    angles = math.cos(angle), math.sin(angle), math.cos(relative), math.sin(relative)
    return np.array(components(scene, named, *angles), dtype=np.float32)


def components(
    scene: Scene | SceneNumbers, state: Numbers, cosine: float, sine: float, cosine_4: float, sine_4: float
) -> tuple[float, float, float, float, float, float, float, float, float, float]:
    """The ten numbers, from cosine and sine of theta_box and of 4 (theta_jack - theta_box)."""
    # By index: a batch reads its rows in place, and naming all twelve numbers first takes about 2 % longer.
    x, y = state[3] - state[0], state[4] - state[1]
    vx, vy = state[9] - state[6], state[10] - state[7]
    per_length = 1.0 / scene.box_half_width
    per_speed = 1.0 / scene.speed_scale
    return (
        _clip((cosine * x + sine * y) * per_length, 1.0),
        _clip((cosine * y - sine * x) * per_length, 1.0),
        _clip((cosine * vx + sine * vy) * per_speed, 10.0),
        _clip((cosine * vy - sine * vx) * per_speed, 10.0),
        cosine,
        sine,
        _clip(state[8] * scene.box_half_width * per_speed, 10.0),
        cosine_4,
        sine_4,
        _clip(state[11] * scene.jack_arm * per_speed, 10.0),
    )


def state_of(scene: Scene, observation: Sequence[float]) -> Array:
    """Return a state, shape (12,), with this observation: the box at the origin, its centre at rest.

    Only the motion relative to the box's centre is observed, which without side forces depends on nothing else.
    """
    x, y, vx, vy, cosine, sine, omega, cosine_4, sine_4, jack_omega = observation
    length, speed, angle = scene.box_half_width, scene.speed_scale, math.atan2(sine, cosine)
    c, s = math.cos(angle), math.sin(angle)
    return np.array([
        0.0, 0.0, angle,
        length * (c * x - s * y), length * (s * x + c * y), angle + 0.25 * math.atan2(sine_4, cosine_4),
        0.0, 0.0, omega * speed / length,
        speed * (c * vx - s * vy), speed * (s * vx + c * vy), jack_omega * speed / scene.jack_arm,
    ])  # fmt: skip


def _clip(value: float, bound: float) -> float:
    return bound if value > bound else -bound if value < -bound else value
