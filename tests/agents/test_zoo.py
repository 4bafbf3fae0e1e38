"""The same training by RL Baselines3 Zoo."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import torch
from stable_baselines3 import PPO

from agents.settings import TrainSettings
from agents.training.models import make_ppo, make_vec_env
from agents.training.zoo import zoo_settings

SMALL = replace(TrainSettings(), num_envs=2, rollout_steps=64, batch_size=128)
OF_THE_ZOO = {"env_kwargs", "n_envs", "n_timesteps", "policy", "learning_rate"}


def test_the_zoo_makes_the_same_model() -> None:
    environments = make_vec_env(SMALL.env_settings, 2, 0)
    options: dict[str, Any] = {name: value for name, value in zoo_settings(SMALL).items() if name not in OF_THE_ZOO}
    ours, zoos = make_ppo(SMALL, environments), PPO("MlpPolicy", environments, seed=SMALL.seed, device="cpu", **options)
    assert zoos.gamma == SMALL.gamma**0.8  # of a decision, where ours is of a second
    for name in ("n_steps", "batch_size", "n_epochs", "gae_lambda", "ent_coef"):
        assert getattr(ours, name) == getattr(zoos, name), name
    assert ours.clip_range(1.0) == zoos.clip_range(1.0)  # type: ignore[operator]
    torch.testing.assert_close(zoos.policy.state_dict(), ours.policy.state_dict(), rtol=0.0, atol=0.0)
