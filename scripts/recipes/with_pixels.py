"""PPO from pictures of 84 x 84 pixels, the last four at a time, instead of numbers."""

import argparse
from typing import Any

import gymnasium as gym
from gymnasium.wrappers import AddRenderObservation, GrayscaleObservation
from stable_baselines3 import PPO
from stable_baselines3.common.env_util import make_vec_env
from stable_baselines3.common.vec_env import VecFrameStack

import jackbox_env  # noqa: F401  # registers JackInBox-v0

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=20_000)
steps = parser.parse_args().steps


def make() -> gym.Env[Any, Any]:
    """One environment whose observation is its picture: box and jack, without ruler and readings."""
    picture: dict[str, Any] = {"render_mode": "rgb_array", "render_size": (84, 84), "render_overlay": False}
    env = gym.make("JackInBox-v0", fidelity="exact", control_dt=0.08, max_episode_steps=125, **picture)
    return GrayscaleObservation(AddRenderObservation(env, render_only=True), keep_dim=True)


envs = VecFrameStack(make_vec_env(make, n_envs=4), n_stack=4)
print(f"observations {envs.observation_space.shape} {envs.observation_space.dtype}")
model = PPO("CnnPolicy", envs, n_steps=128, batch_size=128, seed=0, device="cpu", verbose=1)
model.learn(steps)
