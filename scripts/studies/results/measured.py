"""The measurements of docs/results.md: each is a trial of a sweep, so that an interrupted run resumes."""

from __future__ import annotations

import dataclasses
import json
import time
from itertools import product
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
from filelock import FileLock
from numpy.typing import NDArray
from scipy.stats import bootstrap, trim_mean

from agents.evaluation.returns import Returns, evaluate
from agents.policies.network import SHIPPED
from agents.policies.registry import find_policy
from agents.policies.scripted import PolicyWithEnv
from agents.runs import TIME, machine, read_settings, versions
from agents.settings import EPISODE_STEPS, EnvSettings, TrainSettings
from agents.training.best import read_evaluations
from agents.training.models import derived_seed
from agents.training.networks import run_of
from agents.training.ppo import trained_in
from jackbox_env import Chirp, JackInBoxVectorEnv, Scene
from jackbox_env.model.states import X_BOX, X_JACK, Y_BOX, Y_JACK, Array
from jackbox_env.tools.reading import read_json

SEED = 1  # decides the starts
RESAMPLES = 2000
CONTACTS = ("exact", "pymunk")
BARE = "bare ppo"  # PPO on the environment as it is: ten numbers, a torque in each control step
POLICIES = ("zero", "level", "chirp", "best chirp", BARE, "ppo", "distilled", "planner-fast", "planner")
TIMED = 0.1  # [s] of an episode that computing times refer to

# Chirps that are tried: amplitudes over the torque's limit, Hz, Hz/s; and starts of each, not the evaluation's.
AMPLITUDES = tuple(sign * share for share in (0.1, 0.2, 0.4, 0.7, 1.0) for sign in (1.0, -1.0))
FREQUENCIES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0)
RATES = (0.0, 0.03, 0.1, 0.3, 0.9)
STARTS = 32

SEEDS = (0, 1, 2, 3, 4)  # of trainings
BARE_STEPS = 2_000_000  # control steps of a bare training
PIXELS = "pixel ppo"  # PPO on pictures of juggle
PICTURES = TrainSettings.suited(observation="pixels-48x48x4")

# Scenes that two trainings are tried in: the shipped one on the default scene, and one on scenes that vary.
RESTITUTIONS = (1.0, 0.9, 0.8, 0.7)
MASSES = (2.0, 4.0, 8.0, 16.0)  # of the jack [kg]
RANGES = {"jack_mass": [MASSES[0], MASSES[-1]], "restitution": [RESTITUTIONS[-1], RESTITUTIONS[0]]}
VARIED = TrainSettings(randomize=json.dumps(RANGES))


def _evaluated(name: str, acting: PolicyWithEnv, env_settings: dict[str, Any], episodes: int) -> dict[str, Any]:
    """The stored figures of an evaluation."""
    row = evaluate(name, acting, env_settings, episodes, SEED).as_json()
    return {key: value for key, value in row.items() if key != "returns"}


def learning(runs: str, task: str, seed: int, episodes: int) -> dict[str, Any]:
    """Returns of a training, while it learns and at its end."""
    settings = dataclasses.replace(read_settings(SHIPPED / f"{task}-ppo"), seed=seed)
    run = run_of(Path(runs), task, seed)
    trained_in(run, settings, progress=False)
    curve, seconds = read_evaluations(run, settings.eval_episodes), read_json(run / TIME)["processor_seconds"]
    return {
        "task": task,
        "seed": seed,
        **_evaluated("ppo", find_policy(str(run), settings), settings.env_settings, episodes),
        # Updates take equally long all along.
        "seconds": [seconds * int(steps) / settings.total_steps for steps in curve.timesteps],
        "curve": np.mean(curve.results, axis=1).tolist(),
        "settings": dataclasses.asdict(settings),
    }


def trained_once(run: Path, settings: TrainSettings) -> Path:
    """The run folder of a finished training; of several workers one trains, and the others wait for it."""
    with FileLock(run.with_suffix(".lock")):
        trained_in(run, settings, progress=False)
    return run


def bare(runs: str, env: EnvSettings, episodes: int) -> dict[str, Any]:
    """The mean of five trainings on the environment as it is, with Student's interval, and their computing time."""
    means, spent = [], []
    for seed in SEEDS:
        settings = TrainSettings.suited(
            task=env.task, observation="state", action="torque", action_repeat=1, total_steps=BARE_STEPS, seed=seed
        )
        acting = find_policy(str(trained_once(Path(runs) / f"bare-{env.task}-{seed}", settings)), settings)
        means.append(_evaluated(BARE, acting, env.env_settings, episodes)["mean"])
        spent.append(milliseconds(acting, env))
    returns = Returns(BARE, tuple(means))
    figures = {"policy": BARE, "mean": returns.mean, "interval_95": returns.interval, "episodes": episodes * len(SEEDS)}
    return figures | {"milliseconds": float(np.mean(spent)), "drive": None}


def policy_row(runs: str, task: str, contact: str, policy: str, episodes: int) -> dict[str, Any]:
    """Returns of a policy on a task, and its computing time."""
    settings = EnvSettings(task=task, contact=contact)
    figures = bare(runs, settings, episodes) if policy == BARE else played(policy, settings, episodes)
    return {"task": task, "contact": contact, **figures, "commit": versions()["commit"], "machine": machine()}


def of_pixels(runs: str, contact: str, episodes: int) -> dict[str, Any]:
    """Returns on juggle of one training that observes pictures, its computing time, and the seconds it took."""
    run = trained_once(Path(runs) / "pixels-juggle", PICTURES)
    settings = EnvSettings(contact=contact)
    acting = find_policy(str(run), settings)
    figures = _evaluated(PIXELS, acting, settings.env_settings, episodes)
    figures |= {"milliseconds": milliseconds(acting, settings), "drive": None, **read_json(run / TIME)}
    of = {"task": PICTURES.task, "contact": contact}
    return {**of, **figures, "commit": versions()["commit"], "machine": machine()}


def played(policy: str, settings: EnvSettings, episodes: int) -> dict[str, Any]:
    """Returns of a policy that is there already, its computing time, and the best chirp's drive."""
    acting = find_policy("chirp" if policy == "best chirp" else policy, settings, SEED)
    drive = best_chirp(settings.task) if policy == "best chirp" else None
    if drive is not None:
        acting = acting._replace(keywords={**acting.keywords, "scene": {"drive": drive}})
    figures = _evaluated(policy, acting, settings.env_settings, episodes)
    return figures | {"milliseconds": milliseconds(acting, settings), "drive": drive}


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


def interquartile_mean(returns: Array, axis: int = -1) -> Any:
    """Mean of the middle half."""
    return trim_mean(returns, 0.25, axis=axis)


def curve_of(rows: list[dict[str, Any]]) -> tuple[Array, Array, Array]:
    """Learning curve of several trainings: seconds, shape (n,), interquartile mean of the returns, (n,), and the ends
    of its 95 % interval by bootstrap over the trainings, (2, n)."""
    curves = np.array([row["curve"] for row in rows])
    interval = bootstrap(
        (curves,), interquartile_mean, axis=0, n_resamples=RESAMPLES, method="percentile", rng=np.random.default_rng(0)
    )
    return (
        np.mean([row["seconds"] for row in rows], axis=0),
        interquartile_mean(curves, 0),
        np.array(interval.confidence_interval),
    )


def in_scene(runs: str, scene: dict[str, float], episodes: int) -> dict[str, Any]:
    """Returns of the level box and of both trainings in a scene."""
    settings, varied = EnvSettings(scene=json.dumps(scene)), trained_once(Path(runs) / "varied-scenes", VARIED)
    names = {"level": "level", "one scene": "ppo", "varied scenes": str(varied)}
    earned = {
        policy: _evaluated(policy, find_policy(name, settings, SEED), settings.env_settings, episodes)
        for policy, name in names.items()
    }
    return {"scene": scene, "earned": earned}


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
