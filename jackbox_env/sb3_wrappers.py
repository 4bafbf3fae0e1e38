"""Wrappers for environments of Stable-Baselines3, from :mod:`jackbox_env.planning.sb3_wrappers`."""

from jackbox_env.planning.sb3_wrappers import HoldingVecEnv, LookaheadVecEnv

__all__ = ["HoldingVecEnv", "LookaheadVecEnv"]
