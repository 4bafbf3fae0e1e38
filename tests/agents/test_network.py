"""Trained policies as plain arrays: they act as the model does, and need numpy alone."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.evaluation.returns import evaluate
from agents.policies.network import TRAINED, layers_of, read_policy, write_with_layers
from agents.policies.registry import find_policy
from agents.settings import EnvSettings, TrainSettings
from agents.training.models import make_ppo, make_vec_env
from tests.agents.small_run import TINY

KINDS = {
    "plain": replace(TINY, contact="exact"),
    "repeated": replace(TINY, contact="exact", action_repeat=5, observation="landing", hidden_units=(8, 6, 4)),
    "landing": replace(TINY, contact="exact", action_repeat="bounce", observation="landing", action="landing"),
    "discrete": replace(TINY, contact="exact", action_repeat=4, action="discrete"),
}


def moving_model(settings: TrainSettings) -> Any:
    """An untrained model whose actions are not all near 0."""
    model: Any = make_ppo(settings, make_vec_env(settings.env_settings, 1, 0))
    model.policy.action_net.weight.data.mul_(60.0)
    return model


@pytest.mark.parametrize("settings", KINDS.values(), ids=KINDS)
def test_it_acts_as_the_model_does(settings: TrainSettings, tmp_path: Path) -> None:
    model = moving_model(settings)
    write_with_layers(tmp_path, "settings.json", settings, layers_of(model.get_parameters()["policy"]))
    policy, keywords = read_policy(tmp_path).in_env
    environments, moved = make_vec_env({**settings.env_settings, **keywords}, 3, 1), 0.0
    seen: Any = environments.reset()
    for _ in range(20):
        actions, _ = policy.predict(seen)
        np.testing.assert_allclose(actions, model.predict(seen, deterministic=True)[0], atol=1e-5)
        moved += float(np.ptp(actions, axis=0).sum())
        seen = environments.step(actions)[0]
    assert moved > 2.0
    alone = policy.predict(seen[0])[0]
    np.testing.assert_allclose(alone, policy.predict(seen)[0][0], atol=1e-6)
    assert alone.shape == environments.action_space.shape


def test_it_plays_without_torch() -> None:
    code = (
        "import sys; sys.modules['torch'] = sys.modules['stable_baselines3'] = None\n"
        "from agents.policies.network import SHIPPED, read_policy\n"
        "from agents.policies.one_bounce import read_landing\n"
        "import gymnasium as gym, jackbox_env\n"
        "policy, keywords = read_policy(SHIPPED / 'juggle-ppo').in_env\n"
        "env, total, done = gym.make('JackInBox-v0', **keywords), 0.0, False\n"
        "seen, _ = env.reset(seed=0)\n"
        "while not done:\n"
        "    seen, reward, _, done, _ = env.step(policy.predict(seen)[0])\n"
        "    total += reward\n"
        "print(total)\n"
    )
    assert 150.0 < float(subprocess.check_output([sys.executable, "-c", code])) < 350.0


@pytest.mark.parametrize("task", TRAINED)
def test_a_shipped_policy_does_better_than_the_level_box(task: str) -> None:
    settings = EnvSettings(task=task, contact="exact")
    ppo, level = (
        evaluate(name, find_policy(name, settings, 0), settings.env_settings, 64, 3) for name in ("ppo", "level")
    )
    assert ppo.interval[0] > level.interval[1], (ppo.interval, level.interval)
