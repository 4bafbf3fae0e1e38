"""What can be had on each task at most, as far as it can be worked out."""

from __future__ import annotations

import math

import numpy as np

from agents.settings import EPISODE_STEPS, EnvSettings
from agents.training.models import derived_seed
from jackbox_env import JackInBoxVectorEnv, Scene
from jackbox_env.states import Array


def unpaid_steps(states: Array) -> Array:
    """How many steps spin cannot pay for, whatever the torque, from states at rest, shape (n, 12): shape (n,).

    A jack at rest does not turn before its first impact. That comes, at the earliest, when the jack has fallen until
    its centre is L - l from the box's centre.
    """
    scene = Scene()
    place = states[:, 3:5] - states[:, 0:2]  # [m] from the box's centre
    room = scene.box_half_width - scene.jack_arm
    fall = place[:, 1] + np.sqrt(room**2 - place[:, 0] ** 2)  # [m] until then
    steps: Array = np.floor(np.sqrt(2.0 * fall / scene.gravity) / EnvSettings().control_dt)
    return steps


def spin_bound(episodes: int, seed: int) -> float:
    """The most that spin can earn from the evaluation's starts, in the mean: 1 in each step that can be paid."""
    env = JackInBoxVectorEnv(episodes, contact="exact", task="spin")
    env.reset(seed=derived_seed("evaluation", seed))
    return float(np.mean(EPISODE_STEPS - unpaid_steps(env.states)))


def rattle_at(speed: float) -> float:
    """What a jack earns in an episode that flies to and fro at a speed [m/s], straight at the walls of a calm box.

    It knocks every 2 (L - l) / v, and each knock is min(1, v / (2 v0)).
    """
    scene = Scene()
    seconds = EPISODE_STEPS * EnvSettings().control_dt
    knocks = seconds * speed / (2.0 * (scene.box_half_width - scene.jack_arm))
    return knocks * min(1.0, speed / (2.0 * scene.speed_scale))


def texts(bound: float, planner: dict[str, float]) -> dict[str, str]:
    """A paragraph for each task.

    Args:
        bound: of spin, as :func:`spin_bound` gives it.
        planner: what the planner earns on each task, on the exact model.
    """
    fast = 2.0 * Scene().speed_scale
    return {
        "juggle": "A jack that bounces upright without spin, its highest point h above the box's middle, earns on "
        "average 500 (1 - (4 h / 3 sqrt(h / D) - h + D / 3) / 5) with D = h + 5: 333 at h = 0, 347 at best.",
        "spin": "At most 1 is paid in each of the 500 steps, and nothing before the first impact, for the jack starts "
        "at rest. It has to fall until its centre is L - l from the box's centre. From these starts that leaves at "
        f"most {bound:.0f} in the mean, of which the planner earns {planner['spin'] / bound:.0%}.",
        "rattle": "A jack that flies to and fro at v, straight at the walls of a calm box, knocks every 2 (L - l) / v, "
        f"each time min(1, v / (2 v0)). It earns {rattle_at(0.5 * fast):.1f} at v0 = {0.5 * fast:.1f} m/s and "
        f"{rattle_at(fast):.1f} at 2 v0. Beyond that the return is the speed in m/s. The planner's "
        f"{planner['rattle']:.0f} points are what a jack at a constant {speed_of(planner['rattle']):.0f} m/s would "
        "earn. A knock is at most 1, so 500 is the only bound we know.",
    }


def speed_of(earned: float) -> float:
    """The speed [m/s] at which a jack earns so much by :func:`rattle_at`: bisection."""
    low, high = 0.0, 1e3
    while high - low > 1e-6:
        middle = 0.5 * (low + high)
        low, high = (middle, high) if rattle_at(middle) < earned else (low, middle)
    return math.fsum((low, high)) / 2.0
