"""One episode of a policy as a trajectory, and as an animated page."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np

from agents.models import derived_seed
from agents.policies import Baseline
from agents.settings import EnvSettings
from jackbox_env import Scene
from jackbox_env.report import model_facts, write_page
from jackbox_env.trajectory import Recording, Trajectory


def record_episode(act: Baseline, env_settings: dict[str, Any], seed: int) -> tuple[Trajectory, float]:
    """Let a policy act from a start until the time limit; return what happened, and what it earned.

    Args:
        act: the policy and what it needs of the environment.
        env_settings: keyword arguments for ``gymnasium.make("JackInBox-v0", ...)``.
        seed: of the start.

    Raises:
        JackLostError: the jack would leave the box, or cannot be followed.
    """
    env = gym.make("JackInBox-v0", **{**env_settings, **act.env_settings})
    inner: Any = env.unwrapped
    observation, info = env.reset(seed=seed)
    recording = Recording(info["state"], info["time"], driven=act.env_settings.get("torque") == "chirp")
    earned, memory, first, done = 0.0, None, True, False
    while not done:
        action, memory = act.policy.predict(observation, memory, np.array([first]), deterministic=True)
        observation, reward, terminated, truncated, info = env.step(action)
        recording.add(info["state"], info["time"], info["torque"], inner.impacts)
        earned, first, done = earned + float(reward), False, terminated or truncated
    env.close()
    return recording.trajectory(), earned


def page_of_episode(path: Path, name: str, act: Baseline, settings: EnvSettings, seed: int) -> float:
    """Write an episode of the policy of this name as a page to a new file, and return what it earned."""
    trajectory, earned = record_episode(act, settings.env_settings, seed)
    facts = [*model_facts(settings.setting), ("policy", name), ("task", settings.task), ("return", f"{earned:.1f}")]
    title = f"{name} on {settings.task}, return {earned:.1f}"
    scene = Scene.of(settings.scene_fields)
    write_page(path, scene, trajectory, title, facts)
    return earned


def write_pages(folder: Path, acts: dict[str, Baseline], settings: EnvSettings, seed: int) -> dict[Path, float]:
    """Write a page of an episode of each policy, from the first start that ``seed`` decides; say what each earned."""
    start, earned = derived_seed("evaluation", seed), {}
    for name, act in acts.items():
        page = folder / (re.sub(r"[^\w.-]+", "_", name) + ".html")
        earned[page] = page_of_episode(page, name, act, settings, start)
    return earned
