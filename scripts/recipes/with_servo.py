"""An action of one's own: a servo turns the box towards the angle that PPO has chosen."""

import sys
from typing import Any

import gymnasium as gym
import torch
from stable_baselines3 import PPO
from stable_baselines3.common.evaluation import evaluate_policy

from jackbox_env import Action
from jackbox_env.sb3 import Durations, make_sb3_vec_env


def towards(scene: Any, state: Any, action: Any, time: float, dt: float) -> Any:
    """A PD controller to 0.4 rad times the action, of 6 rad/s with critical damping."""
    wanted = 36.0 * (0.4 * action[0] - state.theta_box) - 12.0 * state.omega_box  # [rad/s^2]
    return wanted * scene.box_inertia / scene.torque_limit


torch.set_num_threads(1)  # small networks are fastest on one thread
servo = Action(gym.spaces.Box(-1.0, 1.0, (1,)), towards)
envs = make_sb3_vec_env(
    256, fidelity="exact", observation="landing", action=servo, action_repeat="bounce"
)
ppo: dict[str, Any] = {"n_steps": 12, "batch_size": 1024, "gamma": 0.7}
ppo["policy_kwargs"] = {"log_std_init": -1.0}  # small actions at first
model = PPO("MlpPolicy", envs, 2e-3, **ppo, seed=0, device="cpu")
model.learn(int(sys.argv[1]) if sys.argv[1:] else 100_000, callback=Durations(), progress_bar=True)
print("return {:.0f}, deviation {:.0f}".format(*evaluate_policy(model, envs, n_eval_episodes=64)))
