"""Wrappers for environments of Stable-Baselines3, from :mod:`jackbox_env.planning.sb3_wrappers`."""

from jackbox_env.planning.sb3_wrappers import HoldingVecEnv, LandingControlVecEnv, LookaheadVecEnv

__all__ = ["HoldingVecEnv", "LandingControlVecEnv", "LookaheadVecEnv"]
