"""TQC of sb3-contrib, which learns off-policy: few steps, many updates."""

import argparse

import torch
from sb3_contrib import TQC
from stable_baselines3.common.evaluation import evaluate_policy

from jackbox_env.sb3 import make_sb3_vec_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=50_000)
steps = parser.parse_args().steps

torch.set_num_threads(1)  # small networks are fastest on one thread
envs = make_sb3_vec_env(8, fidelity="exact", task="juggle", action_repeat=5)
model = TQC("MlpPolicy", envs, learning_starts=1000, gradient_steps=4, batch_size=256, seed=0, device="cpu")
model.learn(steps, progress_bar=True)
mean, deviation = evaluate_policy(model, envs, n_eval_episodes=16)
print(f"after {steps:,} steps: {mean:.0f} +- {deviation:.0f}")
