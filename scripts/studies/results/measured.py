"""What docs/results.md shows of policies: each number is a trial of a sweep, so that an interrupted run goes on."""

from __future__ import annotations

import dataclasses
import json
from collections.abc import Callable
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import bootstrap, trim_mean

from agents.evaluation.returns import evaluate
from agents.policies.playing import Playable, manner_of
from agents.policies.registry import find_policy
from agents.runs import TIME, machine, versions
from agents.settings import EPISODE_STEPS, EnvSettings, TrainSettings
from agents.sweeps.in_process import Trial
from agents.training.models import derived_seed, load_model
from agents.training.ppo import trained_in
from jackbox_env import Chirp, JackInBoxVectorEnv, Scene
from jackbox_env.states import Array
from jackbox_env.tasks import TASKS

SEED = 1  # decides the starts
RESAMPLES = 2000
CONTACTS = ("exact", "pymunk")
POLICIES = ("zero", "level", "chirp", "best chirp", "ppo", "distilled", "planner")

# Chirps that are tried: amplitudes over the torque's limit, Hz, Hz/s; and starts of each, others than the evaluation's.
AMPLITUDES = tuple(sign * share for share in (0.1, 0.2, 0.4, 0.7, 1.0) for sign in (1.0, -1.0))
FREQUENCIES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0)
RATES = (0.0, 0.03, 0.1, 0.3, 0.9)
STARTS = 32

# Scenes that two trainings are tried in: on one scene, and on scenes that vary.
RESTITUTIONS = (1.0, 0.9, 0.8, 0.7)
MASSES = (2.0, 4.0, 8.0, 16.0)  # of the jack [kg]
RANGES = {"jack_mass": [MASSES[0], MASSES[-1]], "restitution": [RESTITUTIONS[-1], RESTITUTIONS[0]]}
TRAININGS: dict[str, TrainSettings] = {
    "one scene": TrainSettings(),
    "varied scenes": TrainSettings(randomize=json.dumps(RANGES)),
}

# PPO that is shown a plan and corrects it.
SEEDS = (0, 1, 2, 3, 4)
AHEAD = TrainSettings.suited(
    lookahead=32, hold=5, preview=False, num_envs=64, rollout_steps=64, epochs=10, total_steps=204_800,
    learning_rate=1e-4, initial_log_std=-3.0, gae_lambda=0.9, hidden_units=(64, 64), checkpoint_steps=1_000_000,
    eval_steps=40_960, eval_episodes=64,
)  # fmt: skip


def trials(episodes: int, planner_episodes: int, across_episodes: int) -> list[Trial]:
    """All that the page shows."""
    asked: list[dict[str, Any]] = []
    for task, contact, policy in product(TASKS, CONTACTS, POLICIES):
        if policy != "distilled" or task == "juggle":
            count = planner_episodes if policy == "planner" else episodes
            asked.append({"part": "rows", "task": task, "contact": contact, "policy": policy, "episodes": count})
    for restitution, mass, policy in product(RESTITUTIONS, MASSES, ("level", *TRAININGS)):
        scene = {"restitution": restitution, "jack_mass": mass}
        asked.append({"part": "across", "scene": scene, "policy": policy, "episodes": across_episodes})
    asked += [{"part": "ahead", "seed": seed, "episodes": episodes} for seed in (*SEEDS, None)]
    return [Trial(settings) for settings in asked]


def measured(folder: Path, asked: dict[str, Any]) -> dict[str, Any]:
    """The work of a trial; trainings have their run folders in ``folder``."""
    parts: dict[str, Callable[..., dict[str, Any]]]
    parts = {"rows": policy_row, "across": in_scene, "ahead": looking_ahead}
    own = {name: value for name, value in asked.items() if name != "part"}
    return {"row": parts[asked["part"]](folder, **own)}


def _evaluated(name: str, policy: Any, env_settings: dict[str, Any], episodes: int) -> tuple[dict[str, Any], Array]:
    """What is stored of an evaluation, and its returns."""
    row = evaluate(name, policy, env_settings, episodes, SEED).as_json()
    return row, np.array(row.pop("returns"))


def policy_row(folder: Path, task: str, contact: str, policy: str, episodes: int) -> dict[str, Any]:
    """What a policy earns on a task, with the interquartile mean and its bootstrap interval."""
    settings = EnvSettings(task=task, contact=contact)
    acting, more = find_policy("chirp" if policy == "best chirp" else policy, settings, SEED)
    drive = best_chirp(task) if policy == "best chirp" else None
    if drive is not None:
        more = {**more, "scene": {"drive": drive}}
    row, returns = _evaluated(policy, acting, {**settings.env_settings, **more}, episodes)
    found = bootstrap(
        (returns,), interquartile_mean, n_resamples=RESAMPLES, method="percentile", rng=np.random.default_rng(0)
    )
    return {
        "task": task,
        "contact": contact,
        **row,
        "iqm": float(interquartile_mean(returns)),
        "iqm_interval_95": [float(end) for end in found.confidence_interval],
        "drive": drive,
        "commit": versions()["commit"],
        "machine": machine(),
    }


def interquartile_mean(returns: Array, axis: int = -1) -> Any:
    """Mean of the middle half."""
    return trim_mean(returns, 0.25, axis=axis)


def in_scene(folder: Path, scene: dict[str, float], policy: str, episodes: int) -> dict[str, Any]:
    """What a level box or one of the trainings earns in a scene."""
    settings = EnvSettings(scene=json.dumps(scene))
    if policy in TRAININGS:
        run = folder / f"trained-on-{policy.replace(' ', '-')}"
        trained_in(run, TRAININGS[policy], progress=False)
        acting: Any = load_model(run)
    else:
        acting = find_policy(policy, settings, SEED).policy
    return _evaluated(policy, acting, settings.env_settings, episodes)[0]


def looking_ahead(folder: Path, seed: int | None, episodes: int) -> dict[str, Any]:
    """What a training earns that corrects a plan, and its times; None: what the plan earns that nobody corrects."""
    if seed is None:
        return _evaluated("plan alone", PlanAlone(), AHEAD.env_settings, episodes)[0]
    run = folder / f"lookahead-{seed}"
    trained_in(run, dataclasses.replace(AHEAD, seed=seed), progress=False)
    row, _ = _evaluated(f"lookahead {seed}", load_model(run), AHEAD.env_settings, episodes)
    return {"seed": seed, **row, "time": json.loads((run / TIME).read_text())}


class PlanAlone(Playable):
    """A policy that follows the plan that `Lookahead` shows, and corrects nothing."""

    def __init__(self) -> None:
        self.manner = manner_of(AHEAD)

    def act(self, seen: NDArray[Any]) -> NDArray[np.float32]:
        """No correction, see :class:`Playable`."""
        return np.zeros((len(seen), 1), np.float32)


# -- chirps ------------------------------------------------------------------------------------------------------------


def chirps() -> list[dict[str, float]]:
    """The fields of all chirps that are tried."""
    limit = Scene().torque_limit
    return [
        {"amplitude": share * limit, "start_frequency": frequency, "rate": rate}
        for share, frequency, rate in product(AMPLITUDES, FREQUENCIES, RATES)
    ]


def returns_of(task: str, tried: list[dict[str, float]], starts: int, seed: int) -> NDArray[np.float64]:
    """What chirps earn on the exact model, shape (chirps, starts), all from the same starts."""
    scenes = [Scene(drive=Chirp(**fields)) for fields in tried for _ in range(starts)]
    env = JackInBoxVectorEnv(len(scenes), scene=scenes, contact="exact", task=task, torque="chirp")
    env.reset(seed=[seed + start for _ in tried for start in range(starts)])
    total = np.zeros(len(scenes))
    for _ in range(EPISODE_STEPS):
        total += env.step(None)[1]
    return total.reshape(len(tried), starts)


def best_chirp(task: str) -> dict[str, float]:
    """The chirp that earns most on a task."""
    tried = chirps()
    return tried[int(returns_of(task, tried, STARTS, derived_seed("chirps", SEED)).mean(axis=1).argmax())]


# -- upper bounds ------------------------------------------------------------------------------------------------------


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


def spin_bound(episodes: int) -> float:
    """The most that spin can earn from the evaluation's starts, in the mean: 1 in each step that can be paid."""
    env = JackInBoxVectorEnv(episodes, contact="exact", task="spin")
    env.reset(seed=derived_seed("evaluation", SEED))
    return float(np.mean(EPISODE_STEPS - unpaid_steps(env.states)))


def rattle_at(speed: float) -> float:
    """What a jack earns in an episode that flies to and fro at a speed [m/s], straight at the walls of a calm box.

    It knocks every 2 (L - l) / v, and each knock is min(1, v / (2 v0)).
    """
    scene = Scene()
    seconds = EPISODE_STEPS * EnvSettings().control_dt
    knocks = seconds * speed / (2.0 * (scene.box_half_width - scene.jack_arm))
    return knocks * min(1.0, speed / (2.0 * scene.speed_scale))
