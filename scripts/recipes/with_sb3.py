"""PPO of Stable-Baselines3 on 64 environments in one compiled loop."""

import argparse

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from jackbox_env.sb3 import make_sb3_vec_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=500_000)
steps = parser.parse_args().steps

torch.set_num_threads(1)  # small networks are fastest on one thread
envs = make_sb3_vec_env(64, fidelity="exact", task="juggle", action_repeat=4)  # an action lasts for 4 control steps
model = PPO("MlpPolicy", envs, n_steps=64, batch_size=512, learning_rate=1e-3, gae_lambda=0.9, seed=0, device="cpu")
model.learn(steps, progress_bar=True)
mean, deviation = evaluate_policy(model, envs, n_eval_episodes=64)
print(f"after {steps:,} steps: {mean:.0f} +- {deviation:.0f}")
