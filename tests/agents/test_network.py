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
from agents.training.models import make_ppo, make_vec_env, wrapped
from jackbox_env.files import write_json
from tests.agents.small_run import TINY
from tests.agents.untrained import layers_for

KINDS = {
    "plain": replace(TINY, contact="exact"),
    "held, with the landing": replace(TINY, contact="exact", repeat=5, preview=True, hidden_units=(8, 6, 4)),
    "aiming": replace(TINY, contact="exact", repeat=20, landing=True),
    "aiming until an impact": replace(TINY, contact="exact", repeat="bounce", landing=True),
    "looking ahead": replace(TINY, contact="exact", repeat=5, lookahead=8),
}


def moving_model(settings: TrainSettings) -> Any:
    """An untrained model whose actions are not all near 0."""
    environments = wrapped(make_vec_env(settings.env_settings, 1, 0), settings)
    model: Any = make_ppo(settings, environments)
    model.policy.action_net.weight.data.mul_(60.0)
    return model


@pytest.mark.parametrize("settings", KINDS.values(), ids=KINDS)
def test_it_plays_in_the_ordinary_environment_as_the_model_does_in_that_of_its_settings(
    settings: TrainSettings, tmp_path: Path
) -> None:
    model = moving_model(settings)
    write_with_layers(tmp_path, "settings.json", settings, layers_of(model.get_parameters()["policy"]))
    policy = read_policy(tmp_path)
    plain, inner = (make_vec_env(settings.env_settings, 1, 1) for _ in range(2))
    environments = wrapped(inner, settings)
    observed: Any = environments.reset()
    seen: Any = plain.reset()
    state: Any = None
    moved = 0.0
    for _ in range(2 if settings.repeat == "bounce" else 5):  # 3 s: impacts multiply roundings
        observed, rewards, _, infos = environments.step(model.predict(observed, deterministic=True)[0])
        total = np.zeros(1)
        for _ in range(round(infos[0]["duration"] / 0.02) if settings.landing else settings.longest):
            actions, state = policy.predict(seen, state)
            assert actions.dtype == np.float32
            moved += float(np.abs(actions).sum())
            seen, earned, _, _ = plain.step(actions)
            total += earned
        np.testing.assert_allclose(total, rewards, rtol=1e-3)
        np.testing.assert_allclose(seen, observed[:, :10], atol=1e-3)
    assert moved > 2.0
    assert policy.predict(seen[0])[0].shape == (1,)


def test_it_plays_without_torch() -> None:
    code = (
        "import sys; sys.modules['torch'] = sys.modules['stable_baselines3'] = None\n"
        "from agents.policies.network import SHIPPED, read_policy\n"
        "from agents.policies.one_bounce import read_landing\n"
        "import gymnasium as gym, jackbox_env\n"
        "env, policy, state, total = gym.make('JackInBox-v0'), read_policy(SHIPPED / 'juggle-ppo'), None, 0.0\n"
        "seen, _ = env.reset(seed=0)\n"
        "for _ in range(500):\n"
        "    action, state = policy.predict(seen, state)\n"
        "    seen, reward, *_ = env.step(action)\n"
        "    total += reward\n"
        "print(total)\n"
    )
    assert 150.0 < float(subprocess.check_output([sys.executable, "-c", code])) < 350.0


@pytest.mark.parametrize("task", TRAINED)
def test_a_shipped_policy_does_better_than_the_level_box(task: str) -> None:
    settings = EnvSettings(task=task, contact="exact")
    ppo, level = (
        evaluate(name, find_policy(name, settings, 0).policy, settings.env_settings, 64, 3) for name in ("ppo", "level")
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
        ("landing.json", {"repeat": 0}, "repeat must .* got 0"),
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
