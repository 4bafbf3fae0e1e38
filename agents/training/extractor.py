"""The landing features as a features extractor of Stable-Baselines3."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import torch
from stable_baselines3.common.torch_layers import BaseFeaturesExtractor

from agents.policies.landing_features import FEATURES, LandingNumbers, columns_by
from jackbox_env.observation import BOUNDS


class WithPreview(BaseFeaturesExtractor):
    """Appends the landing features to observations of ten or more numbers. It has no parameters."""

    def __init__(self, observation_space: gym.Space[Any], flight: LandingNumbers) -> None:
        super().__init__(observation_space, features_dim=gym.spaces.utils.flatdim(observation_space) + len(FEATURES))
        self._numbers = LandingNumbers(*flight)

    def forward(self, observations: torch.Tensor) -> torch.Tensor:
        """Features, shape (n, k + 11), of observations of shape (n, k), k at least 10."""
        features = columns_by(torch)(self._numbers, observations[:, : len(BOUNDS)].unbind(1))
        return torch.cat((observations, torch.stack(features, dim=1)), dim=1)
