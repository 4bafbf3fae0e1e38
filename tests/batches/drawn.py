"""Configurations of environments, drawn by hypothesis or by a seeded generator."""

from __future__ import annotations

import math
import random
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
from gymnasium.vector import AutoresetMode

from jackbox_env import Action, Chirp, Observation, Pixels, Scene, Task
from jackbox_env.model.action import most_decisions
from jackbox_env.model.tasks import sample_start
from tests.invariants.cases import draw_scene

# -- functions of a user, few, as each is compiled ---------------------------------------------------------------------


def terms(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, float, float]:
    turning = math.sqrt(0.5 * scene.jack_inertia) * abs(state[11])
    return (state[4] - state[1]) / scene.box_half_width, -abs(torque) / scene.torque_limit, turning + impulse


def struck(scene: Any, state: Any, torque: float, impulse: float) -> bool:
    return bool(impulse > 0.0)


def above(scene: Scene, rng: np.random.Generator) -> Any:
    """Starts that need a draw of 32 bits, of which numpy keeps a half for the next one."""
    state = sample_start(scene, rng)
    state[10] = 0.1 * scene.speed_scale * float(rng.integers(-2, 1, dtype=np.int32))
    return state


def seen(scene: Any, state: Any, time: float) -> tuple[float, float, float]:
    return (state.y_jack - state.y_box) / scene.box_half_width, math.sin(time), state.omega_jack


def servo(scene: Any, state: Any, action: tuple[float, float], time: float, dt: float) -> float:
    wanted = 30.0 * (action[0] + 0.01 * action[1] - state.theta_box) - 10.0 * state.omega_box
    return float(wanted * scene.box_inertia / scene.torque_limit)


def beat(scene: Any, state: Any, action: int, time: float, dt: float) -> float:
    return (action - 2) / 2 * math.cos(time)


FALL = Task(("height", "effort", "turning"), terms, struck, above)
SEEN = Observation(("height", "beat", "spin"), -1.0, [1.0, 0.5, 0.25], seen)
SERVO = Action(gym.spaces.Box(np.array([-0.5, -1.0], np.float32), np.array([0.3, 1.0], np.float32)), servo)
BEAT = Action(gym.spaces.Discrete(5), beat)
USERS = FALL, SEEN, SERVO, BEAT


def choosy(gravity: float, drive: Chirp, rng: np.random.Generator) -> dict[str, Any]:
    """Fields that depend on draws of 32 bits, of which numpy keeps a half for the next one."""
    drawn = gravity * int(rng.integers(1, 9, dtype=np.int32))
    return {"gravity": drawn, "drive": drive if rng.random() < 0.5 else None}


# -- configurations ----------------------------------------------------------------------------------------------------


def draw_setup(draw: random.Random, contact: str) -> dict[str, Any]:
    """Arguments of :class:`tests.batches.alike.Alike` for a contact model."""
    repeat: Any = draw.choice((1, 1, draw.randint(2, 7), "bounce"))
    dt = 10.0 ** draw.uniform(-1.5 if repeat == "bounce" else -2.5, -1.0)
    shown = draw.choice((None, None, None, None, "rgb_array"))
    in_blocks = contact == "exact" and not shown
    count = draw.choice((1, 2, 3, 5, 127, 128, 129, 300) if in_blocks else (1, 2, 3))
    scenes = [draw_scene(draw, dt) for _ in range(draw.choice((1, min(count, 3))))]
    shared = {
        "contact": contact, "control_dt": dt, "action_repeat": repeat, "render_mode": shown, "render_size": (40, 32),
        "task": draw.choice(("juggle", "spin", "rattle", FALL, FALL, FALL)),
        "observation": draw.choice(("state", "landing", SEEN, Pixels((20, 24), 3), "pixels-16x16x1")),
        "action": draw.choice(("torque", "torque", "landing", "discrete", SERVO, BEAT)),
        "torque": draw.choice(("agent", "agent", "agent", "chirp")),
        "episode_steps": draw.choice((None, draw.randint(3, 40))),
        "randomize": _draw_randomize(draw, scenes),
    }  # fmt: skip
    most = most_decisions(shared["episode_steps"], repeat)
    limits = [None, *(limit for limit in (1, 2, 5, 9) if limit <= most)]
    threads = draw.choice((None, 1, 2, 3)), draw.choice((None, 1, 2, 3))
    return {
        "shared": shared, "scenes": scenes, "count": count, "threads": threads,
        "rows": [0, 1, 2, 126, 127, 128, count - 1, draw.randint(0, count - 1)],
        "mode": draw.choice(list(AutoresetMode)), "limit": draw.choice(limits),
        "with_infos": draw.choice((True, False)),
    }  # fmt: skip


def _draw_randomize(draw: random.Random, scenes: list[Scene]) -> Any:
    kind, first = draw.choice(("nothing", "nothing", "ranges", "function")), scenes[0]
    if kind == "nothing":
        return None
    if kind == "function":
        return partial(choosy, 0.2 * max(scene.gravity for scene in scenes), Chirp(0.1 * first.torque_limit, 1.0, 0.0))
    length = max(scene.box_half_width for scene in scenes)
    ranges = {"box_half_width": (length, length * draw.uniform(1.0, 2.0))}
    for name in ("box_mass", "jack_mass", "gravity", "torque_limit") if len(scenes) == 1 else ():
        if draw.choice((True, False)):
            value = getattr(first, name)
            ranges[name] = value * draw.uniform(0.5, 1.0), value * draw.uniform(1.0, 2.0)
    if draw.choice((True, False)):
        ranges["restitution"] = draw.uniform(0.0, 0.5), draw.uniform(0.5, 1.0)
    return ranges
