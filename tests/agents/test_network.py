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
from agents.policies.network import TRAINED, NetworkPolicy, layers_of, read_policy, write_with_layers
from agents.policies.one_bounce import LandingSettings, read_landing
from agents.policies.registry import find_policy
from agents.policies.value import read_value
from agents.settings import EnvSettings, TrainSettings
from agents.training.models import make_ppo, make_vec_env
from jackbox_env.tools.files import write_json
from tests.agents.small_run import TINY
from tests.agents.untrained import layers_for

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
    with pytest.raises(ValueError, match=rf"observation must have shape \(n, {seen.shape[1]}\) or .*, got \(9,\)"):
        policy.predict(seen[0, :9])
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


def test_unfit_layers_are_errors() -> None:
    settings = KINDS["plain"]
    layers = layers_of(moving_model(settings).get_parameters()["policy"])
    with pytest.raises(ValueError, match=r"have shapes \[\(\(8, 10\), \(8,\)\).* got \[\(\(16, 10\)"):
        NetworkPolicy(replace(settings, hidden_units=(8,)), layers)
    with pytest.raises(ValueError, match="finite"):
        NetworkPolicy(settings, [(weight * np.nan, bias) for weight, bias in layers])


FILES: dict[str, tuple[Any, Any, str]] = {  # how they are read and written, and what they have
    "settings.json": (read_policy, KINDS["plain"], "policy"),
    "landing.json": (read_landing, LandingSettings(angles=(-0.3, 0.3), rates=(0.0,)), "policy of landings"),
    "value.json": (read_value, EnvSettings(contact="exact"), "value"),
}


@pytest.mark.parametrize("name", FILES)
def test_damaged_and_missing_files_are_errors(name: str, tmp_path: Path) -> None:
    read, settings, what = FILES[name]
    layers = layers_of(moving_model(settings).get_parameters()["policy"]) if name == "settings.json" else layers_for()
    write_with_layers(tmp_path, name, settings, layers)
    assert read(tmp_path)
    weights = tmp_path / "weights.npz"
    weights.write_bytes(weights.read_bytes()[:-100])
    with pytest.raises(ValueError, match=f"has no {what}: File is not a zip file"):
        read(tmp_path)
    for missing in ("weights.npz", name):
        (tmp_path / missing).unlink()
        with pytest.raises(FileNotFoundError, match=f"has no {missing}"):
            read(tmp_path)


@pytest.mark.parametrize(
    ("name", "content", "sentence"),
    [
        ("landing.json", {"action_repeat": 0}, "action_repeat must .* got 0"),
        ("landing.json", {"angles": []}, r"angles must .* got \[\]"),
        ("landing.json", {"angles": [0.0] * 40, "rates": [0.0] * 40}, "1,000 pairs, got 1,600"),
        ("landing.json", {"angles": [3.0]}, "angles must .* got 3.0"),
        ("landing.json", {"rates": ["fast"]}, "rates must .* got 'fast'"),
        ("landing.json", {"speed": 1}, "'speed'"),
        ("value.json", {"gravity": 3.0}, "'gravity'"),
        ("value.json", {"scene": 3}, "scene must .* got 3"),
        ("value.json", [], r"got \[\]"),
        ("value.json", {"task": "dance"}, "task must .* got 'dance'"),
        ("value.json", {"contact": "pymunk", "substeps": -1}, "substeps must .* got -1"),
    ],
)
def test_unfit_settings_in_files_are_errors(name: str, content: Any, sentence: str, tmp_path: Path) -> None:
    read, settings, what = FILES[name]
    write_with_layers(tmp_path, name, settings, layers_for())
    write_json(tmp_path / name, content)
    with pytest.raises(ValueError, match=f"has no {what}: .*{sentence}"):
        read(tmp_path)
