"""Policies that observe pictures: a convolutional network of Stable-Baselines3, rebuilt without unpickling anything."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from agents.policies.scripted import PolicyWithEnv
from agents.settings import TrainSettings
from jackbox_env import JackInBoxEnv


def picture_policy(settings: TrainSettings, parameters: Mapping[str, Any]) -> PolicyWithEnv:
    """The policy with these parameters of a training, in its environment.

    Raises:
        RuntimeError: they are not those of such a network.
    """
    from gymnasium.spaces import Box
    from stable_baselines3.common.policies import ActorCriticCnnPolicy

    env = JackInBoxEnv(**settings.env_settings)
    height, width, stack = env.observation_space.shape or ()
    space = Box(0, 255, (stack, height, width), np.uint8)  # as torch has it; predict transposes
    policy = ActorCriticCnnPolicy(space, env.action_space, lambda _: 0.0, **settings.arguments["policy_kwargs"])
    policy.load_state_dict(dict(parameters))
    policy.set_training_mode(False)
    policy.settings = settings  # type: ignore[assignment]
    return PolicyWithEnv(policy, settings.nouns)
