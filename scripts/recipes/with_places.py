"""An observation of one's own, without velocities; PPO sees the last three."""

import sys
from math import cos, sin
from typing import Any

import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.vec_env import VecFrameStack

from jackbox_env import Observation
from jackbox_env.sb3 import make_sb3_vec_env


def places(scene: Any, s: Any, time: float) -> tuple[float, ...]:
    """The jack's centre from the box's [L]; both angles, the same after a quarter turn."""
    x = (s.x_jack - s.x_box) / scene.box_half_width
    y = (s.y_jack - s.y_box) / scene.box_half_width
    box, jack = 4.0 * s.theta_box, 4.0 * s.theta_jack
    return x, y, cos(box), sin(box), cos(jack), sin(jack)


torch.set_num_threads(1)  # small networks are fastest on one thread
names = "x", "y", "cosine_box", "sine_box", "cosine_jack", "sine_jack"
seen = Observation(names, -1.5, 1.5, places)
alone = make_sb3_vec_env(64, fidelity="exact", observation=seen, action_repeat=4)
envs = VecFrameStack(alone, n_stack=3)
model = PPO(
    "MlpPolicy", envs, 1e-3, n_steps=64, batch_size=512, gae_lambda=0.9, seed=0, device="cpu"
)
model.learn(int(sys.argv[1]) if sys.argv[1:] else 300_000, progress_bar=True)
print("return {:.0f}, deviation {:.0f}".format(*evaluate_policy(model, envs, n_eval_episodes=64)))
