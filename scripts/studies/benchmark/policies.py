"""Policies of docs/benchmark.md that are there already, the best chirp among them, and limits of returns."""

from __future__ import annotations

import time
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from agents.evaluation.returns import evaluate
from agents.policies.registry import find_policy
from agents.policies.scripted import PolicyWithEnv
from agents.runs import machine, versions
from agents.settings import EPISODE_STEPS, EnvSettings
from agents.training.models import derived_seed
from jackbox_env import Chirp, JackInBoxVectorEnv, Scene
from jackbox_env.model.states import X_BOX, X_JACK, Y_BOX, Y_JACK, Array
from scripts.studies.benchmark.trainings import SEED, SETTINGS

CONTACTS = ("exact", "pymunk")
POLICIES = ("zero", "level", "chirp", "best chirp", "ppo", "distilled", "planner-fast", "planner")
TIMED = 0.1  # [s] of an episode that computing times refer to

# Chirps that are tried: amplitudes over the torque's limit, Hz, Hz/s; and starts of each, not the evaluation's.
AMPLITUDES = tuple(sign * share for share in (0.1, 0.2, 0.4, 0.7, 1.0) for sign in (1.0, -1.0))
FREQUENCIES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0)
RATES = (0.0, 0.03, 0.1, 0.3, 0.9)
STARTS = 32


def policy_row(task: str, contact: str, policy: str, episodes: int, setting: str = "default") -> dict[str, Any]:
    """Returns of a policy on a task, its computing time, and the best chirp's drive."""
    settings = EnvSettings(task=task, contact=contact)
    acting = find_policy("chirp" if policy == "best chirp" else policy, settings, SEED)
    drive = best_chirp(task) if policy == "best chirp" else None
    if drive is not None:
        acting = acting._replace(keywords={**acting.keywords, "scene": {"drive": drive}})
    row = evaluate(policy, acting, settings.env_settings | SETTINGS[setting], episodes, SEED)
    return {
        "task": task, "contact": contact, "setting": setting, "policy": policy, "mean": row.mean,
        "interval_95": row.interval, "episodes": episodes, "milliseconds": milliseconds(acting, settings),
        "drive": drive, "commit": versions()["commit"], "machine": machine(),
    }  # fmt: skip


def milliseconds(acting: PolicyWithEnv, settings: EnvSettings) -> float:
    """Processor time [ms] of a policy for 0.1 s of an episode, in one environment."""
    env = gym.make("JackInBox-v0", **{**settings.env_settings, **acting.keywords})
    (observation, _), memory, first, done, spent = env.reset(seed=SEED), None, True, False, 0.0
    while not done:
        began = time.process_time()
        action, memory = acting.policy.predict(observation, memory, np.array([first]), deterministic=True)
        spent += time.process_time() - began
        observation, _, _, done, _ = env.step(action)
        first = False
    return 1e3 * spent * TIMED / (EPISODE_STEPS * settings.control_dt)


# -- chirps ------------------------------------------------------------------------------------------------------------


def chirps() -> list[dict[str, float]]:
    """The fields of all chirps that are tried."""
    limit = Scene().torque_limit
    return [
        {"amplitude": share * limit, "start_frequency": frequency, "rate": rate}
        for share, frequency, rate in product(AMPLITUDES, FREQUENCIES, RATES)
    ]


def returns_of(task: str, tried: list[dict[str, float]], starts: int, seed: int) -> NDArray[np.float64]:
    """Returns of chirps on the exact model, shape (chirps, starts), all from the same starts."""
    scenes = [Scene(drive=Chirp(**fields)) for fields in tried for _ in range(starts)]
    env = JackInBoxVectorEnv(len(scenes), scene=scenes, contact="exact", task=task, torque="chirp")
    env.reset(seed=[seed + start for _ in tried for start in range(starts)])
    total = np.zeros(len(scenes))
    for _ in range(EPISODE_STEPS):
        total += env.step(None)[1]
    return total.reshape(len(tried), starts)


def best_chirp(task: str) -> dict[str, float]:
    """The chirp with the largest mean return on a task."""
    tried = chirps()
    return tried[int(returns_of(task, tried, STARTS, derived_seed("chirps", SEED)).mean(axis=1).argmax())]


# -- upper bounds ------------------------------------------------------------------------------------------------------


def unpaid_steps(states: Array) -> Array:
    """Steps that earn nothing on spin, whatever the torque, from states at rest, shape (n, 12): shape (n,).

    A jack at rest does not turn before its first impact. At the earliest it happens when the jack has fallen until
    its centre is L - l from the box's centre.
    """
    scene = Scene()
    x, y = states[:, X_JACK] - states[:, X_BOX], states[:, Y_JACK] - states[:, Y_BOX]  # [m]
    room = scene.box_half_width - scene.jack_arm
    fall = y + np.sqrt(room**2 - x**2)  # [m] until then
    steps: Array = np.floor(np.sqrt(2.0 * fall / scene.gravity) / EnvSettings().control_dt)
    return steps


def spin_bound(episodes: int) -> float:
    """Upper bound of the mean return on spin from the evaluation's starts: 1 in each step that can earn anything."""
    env = JackInBoxVectorEnv(episodes, contact="exact", task="spin")
    env.reset(seed=derived_seed("evaluation", SEED))
    return float(np.mean(EPISODE_STEPS - unpaid_steps(env.states)))


def best_upright() -> float:
    """The most that a jack earns on juggle, in the mean, that bounces upright in a level box, by its highest point."""
    height = np.linspace(0.0, 1.0, 1001)  # over the box's middle [m]
    drop = height + Scene().box_half_width - Scene().jack_arm
    distance = 4.0 / 3.0 * height * np.sqrt(height / drop) - height + drop / 3.0  # mean, to the middle
    return float(EPISODE_STEPS * (1.0 - distance / 5.0).max())


def rattle_at(speed: float) -> float:
    """Return on rattle of a jack that flies to and fro at a speed [m/s], straight at the walls of a box at rest.

    It knocks every 2 (L - l) / v, and each knock is min(1, v / (2 v0)).
    """
    scene = Scene()
    seconds = EPISODE_STEPS * EnvSettings().control_dt
    knocks = seconds * speed / (2.0 * (scene.box_half_width - scene.jack_arm))
    return knocks * min(1.0, speed / (2.0 * scene.speed_scale))
