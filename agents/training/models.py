"""PPO models and their environments, made from settings."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
from stable_baselines3 import PPO
from stable_baselines3.common.utils import LinearSchedule
from stable_baselines3.common.vec_env import VecEnv

from agents.settings import TrainSettings
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.sb3.saved_models import make_model
from jackbox_env.tools import checks as check


def derived_seed(purpose: str, *numbers: int) -> int:
    """A seed below 2^31 from a purpose and numbers, so that training and evaluation do not share starts."""
    words = np.random.SeedSequence([*purpose.encode(), *numbers]).generate_state(1)
    return int(words[0] >> 1)


def make_vec_env(env_settings: dict[str, Any], num_envs: int, seed: int) -> VecEnv:
    """Environments; i starts from ``seed`` + i."""
    environments = make_sb3_vec_env(num_envs, **env_settings)
    environments.seed(seed)
    return environments


def try_out(settings: TrainSettings) -> None:
    """Make and reset an environment of a training, which raises for what cannot be trained."""
    environments = make_vec_env(settings.env_settings, 1, 0)
    space = environments.action_space
    if isinstance(space, gym.spaces.Box) and not space.is_bounded():
        raise ValueError(f"PPO needs an action within finite bounds, got {check.shown(space)}")
    environments.reset()
    environments.close()


def make_ppo(settings: TrainSettings, environments: VecEnv) -> PPO:
    """An untrained PPO model of these settings.

    A saved model loads without this project by ``stable_baselines3.PPO.load``.
    """
    schedule = LinearSchedule(settings.learning_rate, 0.0, 1.0)  # of SB3, so that the model loads anywhere
    return make_model(environments, settings.arguments, learning_rate=schedule, seed=settings.seed)
