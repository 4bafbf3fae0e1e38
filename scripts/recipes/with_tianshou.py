"""Tianshou: its collector on environments in one process, with a random policy."""

import argparse

import gymnasium as gym
from tianshou.env import DummyVectorEnv

import jackbox_env  # noqa: F401  # registers JackInBox-v0

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=4_000)
steps = parser.parse_args().steps

envs = DummyVectorEnv([lambda: gym.make("JackInBox-v0", fidelity="exact") for _ in range(8)])
envs.seed(list(range(8)))
envs.reset()
total = 0.0
for _ in range(max(1, steps // 8)):
    _, rewards, _, truncated, _ = envs.step([space.sample() for space in envs.action_space])
    total += float(rewards.sum())
    if truncated.any():
        envs.reset()
print(f"{steps:,} steps, mean reward {total / steps:.3f}")
