"""Starts that the tests of the environment share."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import pytest

Env = gym.Env[Any, Any]


def make(**settings: Any) -> Env:
    return gym.make("JackInBox-v0", **settings)


@pytest.fixture
def env() -> Env:
    return make()
