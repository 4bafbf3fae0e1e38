"""Environments and saved models for Stable-Baselines3, and PPO with discounts by elapsed time."""

from jackbox_env.envs.durations import DurationBuffer, Durations
from jackbox_env.envs.saved_models import save_model
from jackbox_env.envs.stable_baselines import EnvView, JackInBoxVecEnv, make_sb3_vec_env

__all__ = ["DurationBuffer", "Durations", "EnvView", "JackInBoxVecEnv", "make_sb3_vec_env", "save_model"]
