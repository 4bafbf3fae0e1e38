"""Algorithms of Stable-Baselines3 and sb3-contrib: ten numbers observed, a torque for 0.08 s."""

import argparse
from typing import Any

import numpy as np
import torch
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import DQN, PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy

from jackbox_env.sb3 import make_sb3_vec_env

# 125 actions are an episode.
ON_POLICY = {"n_steps": 125, "batch_size": 1000, "learning_rate": 1e-3}
OFF_POLICY = {"learning_rate": 1e-3, "gradient_steps": 4, "learning_starts": 1000}
SMALL = {"policy_kwargs": {"net_arch": [64, 64]}}
RECURRENT = {"n_steps": 64, "batch_size": 512, "n_epochs": 5, "learning_rate": 1e-3}
MEMORY = {"gae_lambda": 0.9, "policy_kwargs": {"lstm_hidden_size": 64}}
Q_LEARNING = {"train_freq": 1, "gradient_steps": 2, "target_update_interval": 400}
ALGORITHMS: dict[str, Any] = {  # class, network, environments, actions to train for, settings
    "PPO": (PPO, "MlpPolicy", 64, 500_000, ON_POLICY),
    "RecurrentPPO": (RecurrentPPO, "MlpLstmPolicy", 64, 150_000, RECURRENT | MEMORY),
    "SAC": (SAC, "MlpPolicy", 8, 20_000, OFF_POLICY | SMALL),
    "TQC": (TQC, "MlpPolicy", 8, 10_000, OFF_POLICY | SMALL),
    "DQN": (DQN, "MlpPolicy", 16, 300_000, {"learning_rate": 1e-3, **Q_LEARNING}),
}

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument("algorithm", nargs="?", choices=ALGORITHMS, default="PPO")
parser.add_argument("--task", default="juggle")
parser.add_argument("--steps", type=int, help="actions to train for")
arguments = parser.parse_args()
algorithm, network, num_envs, steps, settings = ALGORITHMS[arguments.algorithm]
steps = arguments.steps or steps

torch.set_num_threads(1)  # small networks are fastest on one thread
action = "discrete" if algorithm is DQN else "torque"  # discrete: full torque, none, or the reverse
keywords = {"task": arguments.task, "action": action, "action_repeat": 4}
envs = make_sb3_vec_env(num_envs, fidelity="exact", **keywords)
model = algorithm(network, envs, **settings, seed=0, device="cpu")
model.learn(steps, progress_bar=True)
envs.seed(1_000_000)  # starts that the training has not seen
returns, _ = evaluate_policy(model, envs, n_eval_episodes=256, return_episode_rewards=True)
interval = 1.96 * np.std(returns) / 256**0.5
print(f"after {steps:,} actions: return {np.mean(returns):.1f} +- {interval:.1f}")
