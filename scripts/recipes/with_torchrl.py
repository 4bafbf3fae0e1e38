"""TorchRL: the native vector environment in its GymWrapper, stepped by a random policy."""

import argparse

import gymnasium as gym
from torchrl.envs.libs.gym import GymWrapper

import jackbox_env  # noqa: F401  # registers JackInBox-v0

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=10_000)
steps = parser.parse_args().steps

envs = gym.make_vec("JackInBox-v0", num_envs=16, fidelity="exact", autoreset_mode="DISABLED")
played = GymWrapper(envs).rollout(max(1, steps // 16), break_when_any_done=False)
print(f"{played.numel():,} steps, mean reward {played['next', 'reward'].mean().item():.3f}")
