"""The measurements of docs/learners.md: each is a trial of a sweep, so that an interrupted run resumes."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.evaluation.returns import evaluate
from agents.files import read_json
from agents.policies.network import SHIPPED
from agents.policies.planner import FAST_SEARCHES, planner_for
from agents.policies.registry import find_policy
from agents.runs import RUN, TIME, read_settings
from agents.settings import EnvSettings
from agents.training.best import read_evaluations
from agents.training.checkpoints import checkpoint_path, steps_of_checkpoints
from agents.training.ppo import trained_in
from jackbox_env import JackInBoxEnv, Scene
from jackbox_env.model.states import Array

SEED = 1  # decides the starts
JUDGES = ("coarse", "balanced", "exact")  # fidelities in which each agent is evaluated
DECISIONS = {"juggle": 400_000, "spin": 1_000_000, "rattle": 1_000_000}  # of a training
CURVE_EPISODES = 64  # of each checkpoint, on exact


def trained(runs: str, task: str, fidelity: str, seed: int, episodes: int) -> dict[str, Any]:
    """Train PPO by the shipped settings on a fidelity; what it earns on each judge, and meanwhile on exact."""
    shipped = read_settings(SHIPPED / f"{task}-ppo")
    settings = replace(
        shipped, fidelity=fidelity, seed=seed, total_steps=DECISIONS[task], eval_steps=DECISIONS[task] // 8
    )
    run = Path(runs) / f"{task}-{fidelity}-{seed}"
    trained_in(run, settings, progress=False)

    def earned(name: Path, judge: str, count: int) -> float:
        on = EnvSettings(task=task, fidelity=judge)
        return evaluate(name.stem, find_policy(str(name), on), on.env_settings, count, SEED).mean

    steps = evaluated_steps(run, settings.eval_episodes)
    timed, made = read_json(run / TIME), read_json(run / RUN)  # the first is of the process that finished the run
    spent = timed["processor_seconds"] / timed["steps"] * DECISIONS[task]
    return {
        "task": task,
        "fidelity": fidelity,
        "seed": seed,
        "episodes": episodes,
        "earned": {judge: earned(run, judge, episodes) for judge in JUDGES},
        "curve": [earned(checkpoint_path(run, one), "exact", CURVE_EPISODES) for one in steps],
        "seconds": [spent * one / DECISIONS[task] for one in steps],  # updates take equally long all along
        "processor_seconds": spent,
        "commit": made["versions"]["commit"],
        "machine": made["machine"],
    }


def evaluated_steps(run: Path, episodes: int) -> list[int]:
    """Steps of the checkpoints that a training evaluated, of so many episodes each.

    An evaluation is of the checkpoint before it. A training that was interrupted has more checkpoints than evaluations.
    """
    stored = steps_of_checkpoints(run)
    return [max(one for one in stored if one <= at) for at in read_evaluations(run, episodes).timesteps]


def untrained(task: str, episodes: int) -> dict[str, Any]:
    """What zero torque earns on exact."""
    on = EnvSettings(task=task)
    return {"task": task, "zero": evaluate("zero", find_policy("zero", on), on.env_settings, episodes, SEED).mean}


def planned(model: str, episodes: int) -> dict[str, Any]:
    """What planner-fast earns on rattle on exact, if it simulates its plans by a contact model."""
    on = EnvSettings(task="rattle")
    planner = planner_for(on.env_settings, SEED, FAST_SEARCHES)
    if model == "pymunk":
        env = JackInBoxEnv(contact="pymunk", task="rattle", action_repeat=planner.repeat, episode_steps=1_000_000)
        planner.search.evaluate = partial(by_environment, env)  # type: ignore[method-assign]
    row = evaluate(model, planner.in_env, on.env_settings, episodes, SEED)
    return {"model": model, "mean": row.mean, "interval_95": row.interval, "episodes": episodes}


def by_environment(env: JackInBoxEnv, scene: Scene, states: Array, plans: Array) -> tuple[Array, Array]:
    """As :meth:`jackbox_env.planning.icem.PlanSearch.evaluate`, by an environment of that scene."""
    env.reset(seed=0)
    returns, ends = np.zeros(plans.shape[:2]), np.zeros((*plans.shape[:2], 12))
    for row, number in np.ndindex(*returns.shape):
        env.set_state(states[row])
        returns[row, number] = sum(float(env.step(torque)[1]) for torque in plans[row, number][:, None])
        ends[row, number] = env.state
    return returns, ends
