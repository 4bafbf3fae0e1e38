"""What all tests share: the compiled code is ready before several workers ask for it at once."""

from __future__ import annotations

import os

import gymnasium as gym
import numpy as np

os.environ.setdefault("SDL_VIDEODRIVER", "dummy")  # pictures need no display

import jackbox_env


def pytest_xdist_setupnodes() -> None:
    """Compile what is kept on disk, once, before the workers start."""
    jackbox_env.make_simulator(contact="exact").step(0.02)
    envs = gym.make_vec("JackInBox-v0", num_envs=2, vectorization_mode="vector_entry_point", contact="exact")
    envs.reset(seed=0)
    envs.step(np.zeros((2, 1)))
    envs.close()
    env = gym.make("JackInBox-v0", contact="exact")
    env.reset(seed=0)
    env.close()
    jackbox_env.rollout(None, np.zeros(12), np.zeros((2, 3)), 0.02)
