"""Environments and saved models for Stable-Baselines3, and discounts by elapsed time."""

from jackbox_env.sb3.durations import Durations
from jackbox_env.sb3.saved_models import load_model, save_model
from jackbox_env.sb3.vec_env import EnvView, JackInBoxVecEnv, make_sb3_vec_env

__all__ = ["Durations", "EnvView", "JackInBoxVecEnv", "load_model", "make_sb3_vec_env", "save_model"]
