"""Record one episode of a policy, as a motion or as an animated page; ``scripts/evaluate.py --html`` uses it."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple, cast

import gymnasium as gym
import numpy as np

from agents.policies.scripted import PolicyWithEnv
from agents.settings import setting_of
from agents.training.models import derived_seed
from jackbox_env import JackInBoxEnv
from jackbox_env.recording.motion import Motion
from jackbox_env.recording.page import model_facts, write_page
from jackbox_env.recording.recorder import stepped_record
from jackbox_env.simulators.plain_functions import ControlStep

_LONGEST_NAME = 80  # letters of a file's name


class Episode(NamedTuple):
    """An episode's motion and its return."""

    motion: Motion
    earned: float


def control_steps(env: gym.Env[Any, Any], acting: PolicyWithEnv, observation: Any) -> Iterator[ControlStep]:
    """Let a policy act from the start that was observed until the episode's end; yields each control step."""
    memory, first, done, inner = None, True, False, cast(JackInBoxEnv, env.unwrapped)
    inner.stored_steps = None
    while not done:
        action, memory = acting.policy.predict(observation, memory, np.array([first]), deterministic=True)
        observation, _, terminated, truncated, _ = env.step(action)
        yield from inner.control_steps
        first, done = False, terminated or truncated


def record_episode(acting: PolicyWithEnv, env_settings: dict[str, Any], seed: int) -> Episode:
    """Record an episode of a policy in its environment.

    Args:
        acting: the policy and its keywords of the environment.
        env_settings: keyword arguments for ``gymnasium.make("JackInBox-v0", ...)``.
        seed: of the start.

    Raises:
        JackLostError: the jack would leave the box, or cannot be followed.
    """
    env = gym.make("JackInBox-v0", **{**env_settings, **acting.keywords})
    observation, info = env.reset(seed=seed)
    inner = cast(JackInBoxEnv, env.unwrapped)
    steps = list(control_steps(env, acting, observation))
    driven = inner.torque == "chirp"
    record = stepped_record(inner.scene, inner.control_dt, info["state"], info["time"], steps, driven)
    env.close()
    return Episode(Motion(record), sum(step.reward for step in steps))


def page_of_episode(path: Path, name: str, acting: PolicyWithEnv, env_settings: dict[str, Any], seed: int) -> float:
    """Write an episode of the policy of this name as a page to a new file; return the sum of its rewards."""
    motion, earned = record_episode(acting, env_settings, seed)
    task = env_settings["task"] if isinstance(env_settings["task"], str) else " + ".join(env_settings["task"].terms)
    facts = [*model_facts(setting_of(env_settings)), ("policy", name), ("task", task), ("return", f"{earned:.1f}")]
    write_page(path, motion, f"{name} on {task}, return {earned:.1f}", facts)
    return earned


def page_names(names: Iterable[str]) -> dict[str, str]:
    """A short file name for each of several policies; no two are equal in any file system."""
    files = dict[str, str]()
    for name in names:
        stem = re.sub(r"[^A-Za-z0-9_.-]+", "_", Path(name).name)[:_LONGEST_NAME].strip("._-") or "policy"
        candidates = chain([stem], (f"{stem}-{number}" for number in count(2)))
        used = {file.lower() for file in files.values()}
        files[name] = next(f"{one}.html" for one in candidates if f"{one}.html".lower() not in used)
    return files


def write_pages(
    folder: Path, acts: dict[str, PolicyWithEnv], env_settings: dict[str, Any], seed: int
) -> dict[str, float]:
    """Write a page of an episode of each policy, from the first start that ``seed`` decides; return the returns."""
    start = derived_seed("evaluation", seed)
    return {
        file: page_of_episode(folder / file, name, acts[name], env_settings, start)
        for name, file in page_names(acts).items()
    }
