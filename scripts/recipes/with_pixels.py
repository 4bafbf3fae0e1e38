"""PPO from pictures of 48 x 48 pixels, of the last four control steps, instead of numbers."""

import argparse

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from jackbox_env import Pixels
from jackbox_env.sb3 import make_sb3_vec_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=20_000)
steps = parser.parse_args().steps

torch.set_num_threads(1)  # small networks are fastest on one thread
pixels = Pixels(size=(48, 48), stack=4)
envs = make_sb3_vec_env(
    32, fidelity="exact", observation=pixels, action="landing", action_repeat=20
)
print(f"observations {envs.observation_space.shape} {envs.observation_space.dtype}")
model = PPO(
    "CnnPolicy", envs, n_steps=32, batch_size=256, n_epochs=3, gamma=0.905, seed=0, device="cpu"
)
model.learn(steps, progress_bar=True)
print("return {:.0f}, deviation {:.0f}".format(*evaluate_policy(model, envs, n_eval_episodes=64)))
