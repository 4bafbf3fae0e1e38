"""Record one episode of a policy, as a trajectory or as an animated page; ``scripts/evaluate.py --html`` uses it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from itertools import chain, count
from pathlib import Path
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np

from agents.policies.scripted import Baseline
from agents.settings import EnvSettings
from agents.training.models import derived_seed
from jackbox_env import Scene
from jackbox_env.recording.page import model_facts, write_page
from jackbox_env.recording.trajectory import Trajectory, TrajectoryRecorder

_LONGEST_NAME = 80  # letters of a file's name


class Episode(NamedTuple):
    """An episode's trajectory, its scene and its return."""

    trajectory: Trajectory
    scene: Scene
    earned: float


def record_episode(act: Baseline, env_settings: dict[str, Any], seed: int) -> Episode:
    """Let a policy act from a start until the time limit.

    Args:
        act: the policy and its settings of the environment.
        env_settings: keyword arguments for ``gymnasium.make("JackInBox-v0", ...)``.
        seed: of the start.

    Raises:
        JackLostError: the jack would leave the box, or cannot be followed.
    """
    env = gym.make("JackInBox-v0", **{**env_settings, **act.env_settings})
    inner: Any = env.unwrapped
    observation, info = env.reset(seed=seed)
    scene = inner.scene  # as it was drawn
    recorder = TrajectoryRecorder(info["state"], info["time"], driven=act.env_settings.get("torque") == "chirp")
    earned, memory, first, done = 0.0, None, True, False
    while not done:
        action, memory = act.policy.predict(observation, memory, np.array([first]), deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        recorder.add(info["state"], info["time"], info["torque"], inner.impacts)
        earned, first, done = earned + float(reward), False, terminated or truncated
    env.close()
    return Episode(recorder.trajectory(), scene, earned)


def page_of_episode(path: Path, name: str, act: Baseline, settings: EnvSettings, seed: int) -> float:
    """Write an episode of the policy of this name as a page to a new file; return the sum of its rewards."""
    trajectory, scene, earned = record_episode(act, settings.env_settings, seed)
    facts = [*model_facts(settings.setting), ("policy", name), ("task", settings.task), ("return", f"{earned:.1f}")]
    title = f"{name} on {settings.task}, return {earned:.1f}"
    write_page(path, scene, trajectory, title, facts)
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


def write_pages(folder: Path, acts: dict[str, Baseline], settings: EnvSettings, seed: int) -> dict[str, float]:
    """Write a page of an episode of each policy, from the first start that ``seed`` decides; return the returns."""
    start = derived_seed("evaluation", seed)
    return {
        file: page_of_episode(folder / file, name, acts[name], settings, start)
        for name, file in page_names(acts).items()
    }
