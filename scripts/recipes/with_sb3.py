"""Algorithms of Stable-Baselines3 and sb3-contrib: ten numbers observed, a torque for 0.08 s."""

import argparse
from collections.abc import Iterator
from typing import Any

import torch
from sb3_contrib import TQC, RecurrentPPO
from stable_baselines3 import DQN, PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy

from jackbox_env.sb3 import make_sb3_vec_env

# 125 actions are an episode.
ON_POLICY = {"n_steps": 125, "batch_size": 1000, "learning_rate": 1e-3}
RECURRENT = {"n_steps": 64, "batch_size": 512, "n_epochs": 5, "learning_rate": 1e-3}
MEMORY = {"gae_lambda": 0.9, "policy_kwargs": {"lstm_hidden_size": 64}}
OFF_POLICY = {  # for TQC the best of ten trials of Optuna, of three minutes each, on spin
    "learning_rate": 2.5e-3,
    "batch_size": 128,
    "gradient_steps": 16,
    "learning_starts": 4000,
    "gamma": 0.98,
    "tau": 0.02,
    "policy_kwargs": {"net_arch": [128, 128]},
}
Q_LEARNING = {
    "learning_rate": 1e-3,
    "batch_size": 256,
    "train_freq": 1,
    "tau": 0.04,
    "target_update_interval": 64,  # once a step of all environments
    "exploration_initial_eps": 0.1,
}
ALGORITHMS: dict[str, Any] = {  # class, network, environments, actions to train for, settings
    "PPO": (PPO, "MlpPolicy", 64, 500_000, ON_POLICY),
    "RecurrentPPO": (RecurrentPPO, "MlpLstmPolicy", 64, 150_000, RECURRENT | MEMORY),
    "SAC": (SAC, "MlpPolicy", 64, 100_000, OFF_POLICY),
    "TQC": (TQC, "MlpPolicy", 64, 100_000, OFF_POLICY),
    "DQN": (DQN, "MlpPolicy", 64, 200_000, OFF_POLICY | Q_LEARNING),
}


def train(
    task: str,
    seed: int = 0,
    *,
    algorithm: str = "PPO",
    steps: int | None = None,
    points: int = 1,
    **keywords: Any,
) -> Iterator[Any]:
    """Train for ``steps`` actions. Yield the model and what it does, ``points`` times."""
    kind, network, num_envs, most, settings = ALGORITHMS[algorithm]
    action = "discrete" if kind is DQN else "torque"  # discrete: full torque, none, or the reverse
    chosen = {"action": action, "action_repeat": 4}
    envs = make_sb3_vec_env(num_envs, fidelity="exact", task=task, **chosen, **keywords)
    model = kind(network, envs, **settings, seed=seed, device="cpu")
    for _ in range(points):
        model.learn((steps or most) // points, reset_num_timesteps=False, progress_bar=points == 1)
        yield model, chosen


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("algorithm", nargs="?", choices=ALGORITHMS, default="PPO")
    parser.add_argument("--task", default="juggle")
    parser.add_argument("--steps", type=int, help="actions to train for")
    arguments = parser.parse_args()
    torch.set_num_threads(1)  # small networks are fastest on one thread
    ((model, _),) = train(**vars(arguments))
    envs = model.get_env()
    envs.seed(1_000_000)  # starts that the training has not seen
    print("return {:.1f}, deviation {:.1f}".format(*evaluate_policy(model, envs, 256)))
