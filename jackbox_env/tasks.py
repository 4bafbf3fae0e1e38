"""What is asked of the agent: starts, and rewards as small pure functions of the state.

A task's function takes (scene, state after the step, mean torque over the step [N m], impulse of the step's impacts
[N s]) and returns the values of the task's named terms; the reward is their sum. Every reward lies in [-1, 1]. The
functions are plain arithmetic: the vector environment compiles them as they stand.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from jackbox_env.scene import Scene, SceneNumbers
from jackbox_env.states import Array, Numbers

AnyScene = Scene | SceneNumbers


class Task(NamedTuple):
    """What is rewarded: the names of the reward's terms, and the function that gives their values."""

    terms: tuple[str, ...]
    values: Callable[[AnyScene, Numbers, float, float], tuple[float, ...]]


EFFORT_COST = 0.01  # of a step at the torque limit, in knocks


def sample_start(scene: Scene, rng: np.random.Generator) -> Array:
    """Draw a start, shape (12,): box at rest at the origin, jack at rest near the middle.

    The jack's centre is uniform in +-min(1 m, (L - l)/5) on both axes, its angle uniform in +-0.5 rad. A jack that
    fits only near 45 degrees (L <= l < sqrt(2) L) starts in the middle at 45 degrees.
    """
    state = np.zeros(12)
    x, y, angle = rng.uniform(-1.0, 1.0, size=3)
    state[3:6] = start_pose(scene, x, y, angle)
    return state


def start_pose(scene: AnyScene, x: float, y: float, angle: float) -> tuple[float, float, float]:
    """The jack's place [m] and angle [rad] at the start, from three draws that are uniform in [-1, 1]."""
    room = scene.box_half_width - scene.jack_arm
    if room <= 0.0:
        return 0.0, 0.0, math.pi / 4.0
    spread = min(1.0, room / 5.0)
    return spread * x, spread * y, 0.5 * angle


def juggle(scene: AnyScene, state: Numbers, torque: float, impulse: float) -> tuple[float]:
    """Keep the jack near the middle of the box: ``centre`` = 1 - |r| / max(L - l, L / 6), at least 0."""
    half_width = scene.box_half_width
    x, y = state[3] - state[0], state[4] - state[1]
    return (max(0.0, 1.0 - math.sqrt(x * x + y * y) / max(half_width - scene.jack_arm, half_width / 6.0)),)


def spin(scene: AnyScene, state: Numbers, torque: float, impulse: float) -> tuple[float]:
    """Spin the jack counter-clockwise while the box keeps calm.

    ``spin`` = omega_jack l / v0, clipped to [-1, 1], times calm = 1 - |omega_box| L / v0, at least 0. Spinning the
    other way costs as much as it earns, so luck averages out; spinning the box up ends all pay.
    """
    rate = state[11] * scene.jack_arm / scene.speed_scale
    return (max(-1.0, min(1.0, rate)) * _calm(scene, state, 1.0),)


def rattle(scene: AnyScene, state: Numbers, torque: float, impulse: float) -> tuple[float, float]:
    """Knock hard at little torque.

    ``knock`` = impulse / (4 m_j v0), at most 1, times 1 - |omega_box| L / (2 v0), at least 0: a jack turned back at v0
    makes a knock of 1/2. ``effort`` = -0.01 (torque / torque limit)^2, the torque clipped to its limit.
    """
    knock = min(1.0, impulse / (4.0 * scene.jack_mass * scene.speed_scale))
    effort = min(1.0, abs(torque) / scene.torque_limit)
    return knock * _calm(scene, state, 2.0), -EFFORT_COST * effort * effort


def _calm(scene: AnyScene, state: Numbers, limit: float) -> float:
    """1 at a box at rest, falling linearly to 0 where its rate reaches ``limit`` v0 / L."""
    return float(max(0.0, 1.0 - abs(state[8]) * scene.box_half_width / (limit * scene.speed_scale)))


TASKS = {
    "juggle": Task(("centre",), juggle),
    "spin": Task(("spin",), spin),
    "rattle": Task(("knock", "effort"), rattle),
}
