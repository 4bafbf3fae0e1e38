"""When the jack will land, and the torque that brings the box to a chosen angle and rate at that moment.

Between impacts the jack flies freely. The landing is the moment at which its centre is L - l below the box's centre,
where a foot that points down touches the floor of a level box. The state determines it in closed form; walls on the way
are ignored. The functions here are of one state; the exact model's loop compiles them as they stand.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.scene import Scene, SceneNumbers
from jackbox_env.states import Array, State

QUARTER = 0.5 * math.pi
LONGEST = 8.0  # [L / v0] a time to the landing is cut there: twice the flight from the floor at v0 up and back on Earth
ANGLE, RATE = 0.5, 2.5  # [rad], [rad/s] of an action of 1
DECISION = 2.0  # [s] the longest until an impact
RESTING = 0.4  # [s] the longest while every step has an impact


def steps_until_impact(control_dt: float) -> tuple[int, int]:
    """Control steps of ``control_dt`` [s] in a decision that an impact ends: at most, and at most at rest."""
    return max(1, round(DECISION / control_dt)), max(1, round(RESTING / control_dt))


class Landings(NamedTuple):
    """Targets of landings for N environments, and how long they hold."""

    targets: Array  # (N, 2) angles [rad] and rates [rad/s]
    steps: int  # control steps at most
    resting: int  # control steps after which an impact ends a decision anyway; 0: impacts do not end it


def landing_time(scene: Scene | SceneNumbers, state: State) -> float:
    """When the jack lands [s], at most ``LONGEST``."""
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
    turned = abs(angle) % QUARTER
    if turned > 0.5 * QUARTER:
        turned -= QUARTER
    return turned if angle > 0.0 else -turned


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


def is_over(steps: Any, freed: Any, struck: Any, resting: int) -> Any:
    """Whether an impact ends a decision after so many steps; of one decision, or of arrays.

    Args:
        steps: that it has lasted.
        freed: whether one of them had no impact.
        struck: whether the last one had an impact.
        resting: steps after which an impact ends it even if all had one, as while a foot rests; 0: no impact ends it.
    """
    return struck & (resting > 0) & (freed | (steps >= resting))


class Played(NamedTuple):
    """A decision's outcome: the last step's results with the sum of the rewards, and the number of control steps."""

    observation: Any
    reward: float
    terminated: bool
    truncated: bool
    info: dict[str, Any]
    steps: int


def play(step: Callable[[Any], tuple[Any, ...]], choose: Callable[[], Any], most: int, resting: int) -> Played:
    """Step a single environment ``most`` times, or until an impact or the episode's end ends a decision.

    Args:
        step: of the environment, or of wrappers around it.
        choose: returns the action of the next control step.
        most: control steps.
        resting: see :func:`is_over`.
    """
    total, freed = 0.0, False
    for steps in range(1, most + 1):
        observation, reward, terminated, truncated, info = step(choose())
        total += float(reward)
        struck = resting > 0 and info["impacts"] > 0
        if terminated or truncated or is_over(steps, freed, struck, resting):
            break
        freed = freed or not struck
    return Played(observation, total, terminated, truncated, info, steps)


def always(action: Any) -> Callable[[], Any]:
    """A function that returns the same action in each control step."""
    return lambda: action


def aiming(env: Any, target: Sequence[float]) -> Callable[[], Array]:
    """A function that returns the action of a single environment that aims at an angle [rad] and a rate [rad/s]."""
    return lambda: np.array([aim(env.scene, State(*env.state.tolist()), target[0], target[1], env.control_dt)])


def torques(scene: Scene, states: Array, targets: Array, duration: float) -> Array:
    """:func:`aim` from states, shape (n, 12), at angles [rad] and rates [rad/s], shape (n, 2): shape (n,)."""
    rows = zip(states.tolist(), targets.tolist(), strict=True)
    return np.array([aim(scene, State(*row), angle, rate, duration) for row, (angle, rate) in rows])
