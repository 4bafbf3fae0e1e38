"""Trainings of docs/benchmark.md: each is a trial of a sweep, so that an interrupted run resumes.

A training is a function of a task and a seed. It returns a model or yields it as it learns, alone or with the keywords
``observation``, ``action`` and ``action_repeat`` of its environment. A model has ``predict``, or is a function of
observations.
"""

from __future__ import annotations

import os
import secrets
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium as gym
import torch

from agents.evaluation.returns import evaluate
from agents.policies.models import ModelPolicy
from agents.policies.network import SHIPPED
from agents.policies.registry import find_policy
from agents.policies.scripted import PLAIN, PolicyWithEnv, StatelessPolicy
from agents.runs import RUN, TIME, machine, read_settings, versions
from agents.settings import INTERFACE, EnvSettings, TrainSettings
from agents.training.best import read_evaluations
from agents.training.checkpoints import checkpoint_path, steps_of_checkpoints
from agents.training.models import derived_seed
from agents.training.networks import run_of
from agents.training.ppo import trained_in
from jackbox_env import Observation
from jackbox_env.model.observation import state_values
from jackbox_env.tools import checks as check
from jackbox_env.tools.reading import read_json
from scripts.recipes.with_sb3 import train

SEED = 1  # decides the starts of policies, and of the trainings on each fidelity
JUDGES = ("coarse", "balanced", "exact")  # fidelities in which agents that were trained on one of them are evaluated
DECISIONS = {"juggle": 400_000, "spin": 1_000_000, "rattle": 1_000_000}  # of a training on a fidelity
EPISODES, CURVE_EPISODES, POINTS = 256, 64, 10  # of each model; of each point of a curve; of a training
SHIPPED_PPO = "jackbox train"  # PPO with the settings of the shipped networks
POSITIONS = ("x", "y", "cosine_box", "sine_box", "cosine_4", "sine_4")
ALGORITHMS = (SHIPPED_PPO, "PPO", "TQC", "SAC", "DQN")


def positions(scene: Any, state: Any, time: float) -> tuple[float, ...]:
    """The numbers of "state" that are no rates: the jack's place in the box's frame, and the angles of both."""
    x, y, _, _, cosine, sine, _, cosine_4, sine_4, _ = state_values(scene, state, time)
    return x, y, cosine, sine, cosine_4, sine_4


SETTINGS: dict[str, dict[str, Any]] = {  # keywords of the environment
    "default": {},
    "hidden scene": {"randomize": {"jack_mass": (2.0, 16.0), "restitution": (0.7, 1.0)}},
    "no rates": {"observation": Observation(POSITIONS, -1.0, 1.0, positions)},
}


def seconds() -> float:
    """Processor time [s] of this process and of those that it has waited for."""
    return sum(os.times()[:4])


def playing(trained: Any) -> PolicyWithEnv:
    """The policy that a training has returned or yielded, with the keywords of its environment.

    Raises:
        TypeError, ValueError: it is no model, or has other keywords.
    """
    policy, keywords = trained if isinstance(trained, tuple) and len(trained) == 2 else (trained, {})
    if not isinstance(keywords, dict):
        raise TypeError(f"train must return a model and a dict of keywords, got {check.shown(trained)}")
    check.known_keys("train's keywords", keywords, INTERFACE)
    if (normalized := getattr(policy, "get_vec_normalize_env", lambda: None)()) is not None:
        policy = ModelPolicy(policy, normalized.observation_space, [normalized])
    if not hasattr(policy, "predict"):
        if not callable(policy):
            raise TypeError(f"train must return a model with predict or a function, got {check.shown(policy)}")
        policy = StatelessPolicy(policy)
    return PolicyWithEnv(policy, keywords)


def measured(
    name: str, train: Callable[[str, int], Any], task: str, seed: int, episodes: int, setting: str = "default"
) -> dict[str, Any]:
    """Train, and evaluate on starts that are drawn afterwards, from a seed that the training cannot know."""
    torch.set_num_threads(1)  # small networks are fastest on one thread
    keywords = EnvSettings(task=task).env_settings | PLAIN | SETTINGS[setting]
    make_first = gym.make_vec("JackInBox-v0", 1, **keywords)  # compiles, which is no time of the training
    make_first.close()
    spent, points = -seconds(), list[tuple[Any, ...]]()
    made = train(task, seed)
    for trained in made if isinstance(made, Iterator) else [made]:
        spent += seconds()
        acting = playing(trained)
        steps = getattr(getattr(acting.policy, "model", acting.policy), "num_timesteps", None)
        points.append((steps, spent, evaluate(name, acting, keywords, CURVE_EPISODES, derived_seed("curve")).mean))
        spent -= seconds()
    if not points:
        raise ValueError("train must yield a model at least once")
    starts = secrets.randbits(32)
    row = evaluate(name, acting, keywords, episodes, starts)
    curve = dict(zip(("steps", "seconds", "curve"), map(list, zip(*points, strict=True)), strict=True))
    return {
        "algorithm": name, "setting": setting, "task": task, "seed": seed, "episodes": episodes, "starts": starts,
        "mean": row.mean, "keywords": {key: str(value) for key, value in acting.keywords.items()},
        **curve, "processor_seconds": points[-1][1], **_provenance(),
    }  # fmt: skip


def _provenance() -> dict[str, str]:
    made = versions(("stable-baselines3",))
    return {"commit": made["commit"], "machine": machine(), "stable-baselines3": made["stable-baselines3"]}


def training(runs: str, algorithm: str, setting: str, task: str, seed: int, episodes: int) -> dict[str, Any]:
    """One of ``ALGORITHMS``, in a setting."""
    if algorithm != SHIPPED_PPO:
        chosen = partial(train, algorithm=algorithm, points=POINTS, **SETTINGS[setting])
        return measured(algorithm, chosen, task, seed, episodes, setting)
    settings = replace(read_settings(SHIPPED / f"{task}-ppo"), seed=seed)
    row = by_settings(run_of(Path(runs), task, seed), settings, ("exact",), episodes, secrets.randbits(32))
    return {"algorithm": algorithm, "setting": setting, **row, "mean": row["earned"]["exact"]}


def on_fidelity(runs: str, task: str, fidelity: str, seed: int, episodes: int) -> dict[str, Any]:
    """Train PPO by the shipped settings on a fidelity; what it earns on each judge, and meanwhile on exact."""
    shipped, most = read_settings(SHIPPED / f"{task}-ppo"), DECISIONS[task]
    settings = replace(shipped, fidelity=fidelity, seed=seed, total_steps=most, eval_steps=most // 8)
    row = by_settings(Path(runs) / f"{task}-{fidelity}-{seed}", settings, JUDGES, episodes, SEED)
    return {"fidelity": fidelity, **row}


def by_settings(
    run: Path, settings: TrainSettings, judges: tuple[str, ...], episodes: int, starts: int
) -> dict[str, Any]:
    """Train PPO in a run folder: what its best model earns on each judge, and its checkpoints on exact."""
    trained_in(run, settings, progress=False)

    def earned(name: Path, judge: str, count: int) -> float:
        on = EnvSettings(task=settings.task, fidelity=judge)
        return evaluate(name.stem, find_policy(str(name), on), on.env_settings, count, starts).mean

    steps = evaluated_steps(run, settings.eval_episodes)
    timed, made = read_json(run / TIME), read_json(run / RUN)  # the first is of the process that finished the run
    spent = timed["processor_seconds"] / timed["steps"] * settings.total_steps
    return {
        "task": settings.task, "seed": settings.seed, "episodes": episodes, "starts": starts,
        "earned": {judge: earned(run, judge, episodes) for judge in judges},
        "curve": [earned(checkpoint_path(run, one), "exact", CURVE_EPISODES) for one in steps],
        "steps": steps,
        "seconds": [spent * one / settings.total_steps for one in steps],  # updates take equally long all along
        "processor_seconds": spent, **_provenance(), "commit": made["versions"]["commit"], "machine": made["machine"],
    }  # fmt: skip


def evaluated_steps(run: Path, episodes: int) -> list[int]:
    """Steps of the checkpoints that a training evaluated, of so many episodes each.

    An evaluation is of the checkpoint before it. A training that was interrupted has more checkpoints than evaluations.
    """
    stored = steps_of_checkpoints(run)
    return [max(one for one in stored if one <= at) for at in read_evaluations(run, episodes).timesteps]
