"""Write Minari datasets of each task on the exact model, played by random torques, the shipped PPO and the planner.

They are called jackbox/juggle-random-v0 and so on. The infos hold state, time, torque, count and impulse of the impacts
and the reward's terms, the metadata each episode's seed and the versions. Minari, in an environment of its own, loads
each dataset, and every episode is replayed: the bits must be the same. An existing dataset is not replaced. The card of
all datasets is jackbox/README.md.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import warnings
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.policies.network import SHIPPED, TRAINED, read_policy
from agents.policies.planner import planner_for
from agents.policies.scripted import PLAIN, Policy, PolicyWithEnv, RandomPolicy
from agents.runs import versions
from agents.settings import EnvSettings
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import ROOT, command_line
from jackbox_env.tools.files import write_text

PACKAGES = ("jackbox", "gymnasium", "numpy", "numba", "pymunk", "minari")
TEXT = """The jack in a box, task {}, policy {}: episodes of 10 s on the exact contact model. infos/state holds x, y and
angle of the box and of the jack, then their rates, float64, SI units. An episode's seed and actions reproduce it."""


@dataclass(frozen=True)
class Arguments:
    """Write all datasets."""

    steps: int = 100_000
    """Control steps of random and ppo on each task; the planner plays a tenth of it."""


def policies(task: str) -> dict[str, PolicyWithEnv]:
    """The policies by name, made without the registry, which needs torch."""
    planner, network = (
        planner_for(EnvSettings(task=task).env_settings),
        read_policy(SHIPPED / f"{task}-ppo"),
    )
    return {"random": PolicyWithEnv(RandomPolicy(0), PLAIN), "ppo": network.in_env, "planner": planner.in_env}


def record(env: gym.Env[Any, Any], policy: Policy, episodes: int) -> None:
    """Play episodes from the seeds 0, 1, 2 and so on."""
    for seed in range(episodes):
        (observation, _), memory, first, done = env.reset(seed=seed), None, True, False
        while not done:
            action, memory = policy.predict(observation, memory, np.array([first]), deterministic=True)
            observation, _, terminated, truncated, _ = env.step(action)
            first, done = False, terminated or truncated


def replay(env: Any, seed: int, episode: Any) -> None:
    """Play an episode's actions from its seed, and from the state at its middle those of its second half but the last,
    which the episode's end may have cut.

    Raises:
        RuntimeError: a state, an observation or a reward has other bits.
    """
    stored = episode.infos["state"], episode.observations, episode.rewards
    count = len(episode.actions)
    for first, last in ((0, count), (count // 2, count - 1)):
        env.reset(seed=seed)
        if first:
            env.set_state(stored[0][first], episode.infos["time"][first])
        state, observation = env.state, env.observation
        steps = [(env.state, *outcome[:2]) for outcome in map(env.step, episode.actions[first:last])]
        states, observations, rewards = zip(*steps, strict=True)
        replayed = (state, *states), (observation, *observations), rewards
        for again, original in zip(replayed, stored, strict=True):
            if np.array(again).tobytes() != original[first : first + len(again)].tobytes():
                raise RuntimeError(f"episode {episode.id} has other bits when it is played from step {first}")


def write(task: str, name: str, acting: PolicyWithEnv, episodes: int) -> tuple[str, int, int, float]:
    """Write one dataset, load and replay it, and print its mean return.

    Returns:
        Its name, its numbers of episodes and steps, and its mean return.
    """
    import minari

    dataset_id, author = f"jackbox/{task}-{name}-v0", "The jackbox developers"
    made = gym.make("JackInBox-v0", task=task, fidelity="exact", **acting.keywords)
    env = minari.DataCollector(made, record_infos=True)
    record(env, acting.policy, episodes)
    written = env.create_dataset(dataset_id, algorithm_name=name, author=author, description=TEXT.format(task, name))
    written.storage.update_metadata({"versions": json.dumps(versions(PACKAGES))})
    dataset = minari.load_dataset(dataset_id)
    inner, earned = dataset.recover_environment().unwrapped, []
    for episode in dataset.iterate_episodes():
        (about,) = dataset.storage.get_episode_metadata([episode.id])
        replay(inner, about["seed"], episode)
        earned.append(episode.rewards.sum())
    print(f"{dataset_id}: {len(earned)} episodes replayed bit for bit, mean return {np.mean(earned):.1f}", flush=True)
    return dataset_id, len(earned), int(dataset.total_steps), float(np.mean(earned))


def datasets_card(rows: Iterable[tuple[str, int, int, float]], versions: Mapping[str, str]) -> str:
    """The card of datasets: name, episodes, steps and mean return of each; ``versions`` that they were made with."""
    listed = list(rows)
    lines = "".join(f"| `{name}` | {count} | {steps:,} | {mean:.1f} |\n" for name, count, steps, mean in listed)
    made = ", ".join(f"{name} {version}" for name, version in versions.items())
    page = Path(__file__).with_name("datasets_card.md").read_text()
    return page.format(rows=lines, first=listed[0][0], versions=made)


@command_line
def main() -> None:
    """Parse, continue in Minari's environment, write all datasets."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    episodes = check.whole("steps", arguments.steps, at_least=500) // 500
    if find_spec("minari") is None:
        from scripts.recipes.run import RECIPES, python_for

        python = python_for(RECIPES["minari"], ROOT / "runs" / "recipes" / "minari")
        sys.exit(subprocess.run([python, *sys.argv], check=False).returncode)
    os.environ.setdefault("MINARI_DATASETS_PATH", str(ROOT / "runs" / "dataset"))  # before it is imported
    warnings.filterwarnings("ignore", "`(code_permalink|author_email|eval_env)` is set to None")
    rows = [
        write(task, name, acting, max(1, episodes // 10) if name == "planner" else episodes)
        for task in TRAINED
        for name, acting in policies(task).items()
    ]
    write_text(
        Path(os.environ["MINARI_DATASETS_PATH"]) / "jackbox" / "README.md", datasets_card(rows, versions(PACKAGES))
    )


if __name__ == "__main__":
    main()
