"""The jack's next landing, and the torque that brings the box to a chosen angle and rate at that moment.

Between impacts the jack flies freely. The landing is the moment at which its centre is L - l below the box's centre,
where a foot that points down touches the floor of a level box. The state determines it in closed form; walls on the way
are ignored. The functions here are of one state; the exact model's loop compiles them as they stand.
"""

from __future__ import annotations

import math
from typing import Any

from jackbox_env.model.scene import Scene, SceneNumbers, remainder
from jackbox_env.model.states import State

QUARTER = 0.5 * math.pi
LONGEST = 8.0  # [L / v0] a time to the landing is cut there: twice the flight from the floor at v0 up and back on Earth
ANGLE, RATE = 0.5, 2.5  # [rad], [rad/s] of an action of 1
DECISION = 2.0  # [s] the longest until an impact
RESTING = 0.4  # [s] the longest while every step has an impact


def landing_time(scene: Scene | SceneNumbers, state: State) -> float:
    """Time until the jack lands [s], at most ``LONGEST``."""
    height = max(state.y_jack - state.y_box + scene.box_half_width - scene.jack_arm, 0.0)
    rise = state.vy_jack - state.vy_box
    speed = math.sqrt(rise * rise + 2.0 * scene.gravity * height)
    longest = LONGEST * scene.box_half_width / scene.speed_scale
    # of the two forms of the root the one without cancellation
    if rise > 0.0:
        way, pace = speed + rise, scene.gravity
    else:
        way, pace = 2.0 * height, speed - rise
    return way / pace if way < longest * pace else (longest if way > 0.0 else 0.0)


def upright(angle: float) -> float:
    """An angle of the box [rad] turned back by whole quarter turns, to within an eighth: the box looks the same."""
    turned = less_quarters(abs(angle), QUARTER)
    if turned > 0.5 * QUARTER:
        turned -= QUARTER
    return turned if angle > 0.0 else -turned


def less_quarters(angle: float, quarter: float) -> float:
    """An angle of at least 0, less whole quarter turns [rad]."""
    return remainder(angle, quarter) if angle < 2.0**53 else angle % quarter


def aim(scene: Scene | SceneNumbers, state: State, angle: float, rate: float, duration: float) -> float:
    """The torque over its limit, within [-1, 1], that brings the box to an angle and a rate at the landing.

    The box's angle follows the cubic in time from its present angle and rate to these.

    Args:
        scene: its fall, its box's inertia and its torque limit.
        state: now.
        angle: of the box at the landing [rad], from the quarter turn that is nearest now.
        rate: of the box at the landing [rad/s].
        duration: for which the torque is held [s], > 0; it is the mean of the cubic's over that time.
    """
    left = max(landing_time(scene, state), duration)
    missing = angle - upright(state.theta_box)
    first = 6.0 * missing / (left * left) - (4.0 * state.omega_box + 2.0 * rate) / left  # [rad/s^2]
    growth = -12.0 * missing / (left * left * left) + 6.0 * (state.omega_box + rate) / (left * left)  # [rad/s^3]
    torque = (first + 0.5 * duration * growth) * scene.box_inertia
    if abs(torque) < scene.torque_limit:
        return torque / scene.torque_limit
    return 1.0 if torque > 0.0 else -1.0


FEATURES = (
    "time",  # to the landing, in units of a fall of L on Earth, 2 L / v0
    "cosine_4",  # of 4 (theta_jack - theta_box) at the landing
    "sine_4",
    "cosine_8",  # of twice that
    "sine_8",
    "cosine_world",  # of 4 theta_jack at the landing
    "sine_world",
    "place",  # x of the jack's centre from the box's centre, along the world's x [L]
    "speed",  # downwards [v0]
    "spin",  # angle that the jack turns by until then, in quarter turns
    "box_angle",  # theta_box then, from its present value within half a turn [rad]
)
FEATURE_BOUNDS = (
    (0.0, 0.5 * LONGEST), *[(-1.0, 1.0)] * 6, (-2.0, 2.0), (-10.0, 10.0), (-10.0, 10.0), (-10.0, 10.0),
)  # fmt: skip


def at_landing(scene: SceneNumbers, state: State) -> tuple[float, float, float]:
    """Time to the landing [s]; and there 4 (theta_jack - theta_box) and 4 theta_jack [rad], if no torque acts."""
    time = landing_time(scene, state)
    jack = state.theta_jack + state.omega_jack * time
    return time, 4.0 * (jack - (state.theta_box + state.omega_box * time)), 4.0 * jack


def landing_features(
    scene: SceneNumbers, state: State, time: float, angle: float, cosines: tuple[float, ...]
) -> tuple[float, ...]:
    """The numbers of ``FEATURES``, within ``FEATURE_BOUNDS``: the box moves and turns at its present rates.

    Args:
        scene: with its gravity.
        state: now.
        time: to the landing [s].
        angle: theta_box less whole turns [rad].
        cosines: and sines of the angles of :func:`at_landing`, six in the order of ``FEATURES``.
    """
    length, speed = scene.box_half_width, scene.speed_scale
    beside = (state.x_jack - state.x_box + (state.vx_jack - state.vx_box) * time) / length
    fall = (scene.gravity * time - (state.vy_jack - state.vy_box)) / speed
    return (
        clipped(0.5 * time * speed / length, 0.5 * LONGEST),
        *cosines,
        clipped(beside, 2.0),
        clipped(fall, 10.0),
        clipped(state.omega_jack * time / QUARTER, 10.0),
        clipped(angle + state.omega_box * time, 10.0),
    )  # fmt: skip


def clipped(value: float, bound: float) -> float:
    """A number within +-``bound``."""
    return bound if value > bound else -bound if value < -bound else value


def ends_decision(steps: Any, separated: Any, struck: Any, max_contact_steps: int) -> Any:
    """Whether an impact ends a decision after so many steps; of one decision, or of arrays.

    Args:
        steps: that it has lasted.
        separated: whether one of them had no impact.
        struck: whether the last one had an impact.
        max_contact_steps: steps after which an impact ends it even if all had one, as while a foot rests; 0: no impact
            ends it.
    """
    return struck & (max_contact_steps > 0) & (separated | (steps >= max_contact_steps))
