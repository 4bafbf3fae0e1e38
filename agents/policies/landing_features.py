"""Landing features: time, position, speed and angles at the jack's next landing, in closed form.

Networks use them in addition to the ten numbers (the setting ``preview``).

Between impacts the jack flies freely, and without a torque the box turns at a constant rate. The landing is the moment
at which the jack's centre is L - l below the box's centre: a foot that points down touches the floor of a level box.
The observation determines this moment, and position, speed and angles at it.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env import Scene
from jackbox_env.landing import LONGEST

WEAKEST = 1e-30  # gravity in place of 0, to divide by
_ROUNDING = 1e-5  # [v0] changes of velocity up to this are rounding of float32
_TINY = float(np.finfo(np.float32).tiny)


class LandingNumbers(NamedTuple):
    """The numbers of a scene that the features depend on, in units of L, v0 = sqrt(2 * 9.81 * L) and L / v0."""

    gravity: float  # g L / v0^2, 1/2 on Earth
    floor: float  # (L - l) / L, depth of the landing under the box's centre
    spin: float  # L / l, factor from omega_jack in units of v0 / l to units of v0 / L


Flight = LandingNumbers  # its name in models that earlier versions saved

# Beyond these float32 would overflow on the way.
_MOST_GRAVITY, _MOST_SPIN = 1e20, 1e6

FEATURES = (
    "time",  # to the landing, in units of a fall of L on Earth, 2 L / v0
    "cosine_4",  # of 4 (theta_jack - theta_box) at the landing
    "sine_4",
    "cosine_8",  # of twice that
    "sine_8",
    "cosine_world",  # of 4 theta_jack at the landing
    "sine_world",
    "place",  # x of the jack's centre from the box's centre, along the world's x [L], within +-2
    "speed",  # downwards [v0], at most 10
    "spin",  # angle that the jack turns by until then, in quarter turns, within +-10
    "box_angle",  # theta_box then, from its present value within half a turn [rad], within +-10
)


def landing_numbers(scene: Scene) -> LandingNumbers:
    """The numbers of a scene that the features depend on; those too large for float32 are clipped."""
    length = scene.box_half_width
    return LandingNumbers(
        gravity=min(_MOST_GRAVITY, scene.gravity / (2.0 * 9.81)),
        floor=(length - scene.jack_arm) / length,
        spin=min(_MOST_SPIN, length / scene.jack_arm),
    )


def preview(numbers: LandingNumbers, observations: NDArray[np.float32]) -> NDArray[np.float32]:
    """The features of ``FEATURES``, float32, shape (n, 11), for observations, float32, shape (n, 10).

    The box is assumed not to move, and to turn at its present rate. Walls on the way are ignored. Without gravity a
    jack that does not fall lands after ``LONGEST``.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):  # clipped or not selected, see ``columns_by``
        return np.stack(columns_by(np)(numbers, observations.T), axis=1)


@cache
def columns_by(library: Any) -> Callable[[LandingNumbers, Any], tuple[Any, ...]]:
    """A function that computes the features from ten numbers, by the functions of numpy, of torch, or of one number.

    It returns an array for each feature, from the ten numbers of observations, an array each. The time to the landing
    is :func:`jackbox_env.landing.landing_time`, in units of L / v0.
    """
    clip, where, sqrt = library.clip, library.where, library.sqrt
    cos, sin, atan2 = library.cos, library.sin, library.arctan2

    def columns(numbers: LandingNumbers, observed: Any) -> tuple[Any, ...]:
        x, y, vx, vy, cosine, sine, omega_box, cosine_4, sine_4, omega_jack = observed
        gravity, height = max(numbers.gravity, WEAKEST), clip(sine * x + cosine * y + numbers.floor, 0.0, None)
        rise = sine * vx + cosine * vy
        speed = sqrt(rise * rise + 2.0 * gravity * height)
        down = 2.0 * height / clip(speed - rise, _TINY, None)  # of the two forms the one without cancellation
        time = clip(where(rise > 0.0, (speed + rise) / gravity, down), None, LONGEST)
        offset = cosine * x - sine * y + (cosine * vx - sine * vy) * time
        theta = atan2(sine, cosine)
        turned, spun = omega_box * time, numbers.spin * omega_jack * time
        relative = atan2(sine_4, cosine_4) + 4.0 * (spun - turned)
        world = relative + 4.0 * (theta + turned)
        return (
            0.5 * time,
            cos(relative),
            sin(relative),
            cos(2.0 * relative),
            sin(2.0 * relative),
            cos(world),
            sin(world),
            clip(offset, -2.0, 2.0),
            clip(numbers.gravity * time - rise, -10.0, 10.0),
            clip(spun / (0.5 * math.pi), -10.0, 10.0),
            clip(theta + turned, -10.0, 10.0),
        )

    return columns


def struck(scene: Scene, control_dt: float, before: NDArray[Any], after: NDArray[Any]) -> NDArray[np.bool_]:
    """Whether an impact came between observations, shape (n, 10), a control step apart, shape (n,).

    Between impacts the jack's velocity, seen from the box's centre, changes by gravity alone.
    """
    change = _velocity(after) - _velocity(before)
    change[1] += scene.gravity * control_dt / scene.speed_scale
    return np.asarray(np.hypot(*change) > _ROUNDING)


def _velocity(observations: NDArray[Any]) -> NDArray[np.float64]:
    """The jack's velocity on axes that do not turn, over v0, shape (2, n)."""
    _, _, u, w, cosine, sine, *_ = observations.T.astype(np.float64)
    return np.stack([cosine * u - sine * w, sine * u + cosine * w])
