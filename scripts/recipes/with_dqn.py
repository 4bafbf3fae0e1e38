"""DQN of Stable-Baselines3: full torque to one side, none, or full torque to the other."""

import argparse

import torch
from stable_baselines3 import DQN
from stable_baselines3.common.evaluation import evaluate_policy

from jackbox_env.sb3 import make_sb3_vec_env

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("--steps", type=int, default=60_000)
steps = parser.parse_args().steps

torch.set_num_threads(1)  # small networks are fastest on one thread
envs = make_sb3_vec_env(16, fidelity="exact", task="spin", observation="landing", action="discrete", action_repeat=5)
model = DQN(
    "MlpPolicy", envs, learning_rate=1e-3, gamma=0.95, train_freq=1, gradient_steps=2, target_update_interval=400,
    seed=0, device="cpu",
)  # fmt: skip
model.learn(steps, progress_bar=True)
mean, deviation = evaluate_policy(model, envs, n_eval_episodes=64)
print(f"after {steps:,} steps: {mean:.0f} +- {deviation:.0f}")
