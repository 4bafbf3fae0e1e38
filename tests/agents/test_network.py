"""Trained policies as plain arrays: they act as the model does, and need numpy alone."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3.common.evaluation import evaluate_policy

from agents.evaluation import evaluate, find_policy, shipped_names
from agents.models import holding, make_ppo, make_vec_env
from agents.network import NetworkPolicy, layers_of, read_policy, write_policy
from agents.settings import EnvSettings, TrainSettings
from jackbox_env.storage import new_folder, write_json
from jackbox_env.tasks import TASKS
from tests.agents.small_run import TINY

KINDS = {
    "plain": replace(TINY, contact="exact"),
    "held, with the landing": replace(TINY, contact="exact", hold=5, preview=True, hidden_units=(8, 6, 4)),
    "looking ahead": replace(TINY, contact="exact", hold=5, lookahead=8),
}


def moving_model(settings: TrainSettings) -> Any:
    """An untrained model whose actions are not all near 0."""
    environments = holding(make_vec_env(settings.env_settings, 1, 0), settings.hold, settings.lookahead)
    model: Any = make_ppo(settings, environments)
    model.policy.action_net.weight.data.mul_(60.0)
    return model


@pytest.mark.parametrize("settings", KINDS.values(), ids=KINDS)
def test_it_plays_as_the_model_does(settings: TrainSettings, tmp_path: Path) -> None:
    model = moving_model(settings)
    layers = layers_of(model)
    folder = new_folder(tmp_path / "arrays", "export", lambda made: write_policy(made, settings, layers))
    policy = read_policy(folder)
    environments = make_vec_env(settings.env_settings, 3, 0)
    environments.seed(1)
    seen: Any = environments.reset()
    states: list[Any] = [None, None]
    start, moved = np.ones(3, dtype=bool), 0.0
    for _ in range(25):
        expected, states[0] = model.predict(seen, states[0], start, deterministic=True)
        actions, states[1] = policy.predict(seen, states[1], start)
        assert actions.dtype == np.float32
        np.testing.assert_allclose(actions, expected, atol=1e-4)
        moved += float(np.abs(actions).sum())
        seen, _, start, _ = environments.step(expected)
    assert moved > 5.0
    alone, _ = policy.predict(seen[0])
    assert alone.shape == (1,)
    returns, _ = evaluate_policy(policy, make_vec_env(settings.env_settings, 1, 0), 1, return_episode_rewards=True)  # type: ignore[arg-type]
    assert len(returns) == 1  # type: ignore[arg-type]


def test_it_plays_without_torch() -> None:
    code = (
        "import sys; sys.modules['torch'] = sys.modules['stable_baselines3'] = None\n"
        "from agents.network import SHIPPED, read_policy\n"
        "import gymnasium as gym, jackbox_env\n"
        "env, policy, state = gym.make('JackInBox-v0'), read_policy(SHIPPED / 'juggle-ppo'), None\n"
        "seen, _ = env.reset(seed=0)\n"
        "total = 0.0\n"
        "for _ in range(500):\n"
        "    action, state = policy.predict(seen, state)\n"
        "    seen, reward, *_ = env.step(action)\n"
        "    total += reward\n"
        "print(total)\n"
    )
    run = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert 150.0 < float(run.stdout) < 350.0


@pytest.mark.parametrize("task", TASKS)
def test_a_policy_is_shipped_for_each_task_and_does_better_than_the_level_box(task: str) -> None:
    assert "ppo" in shipped_names(task)
    settings = EnvSettings(task=task, contact="exact")
    ppo, level = (
        evaluate(name, find_policy(name, settings, 0).policy, settings.env_settings, 32, 3) for name in ("ppo", "level")
    )
    assert ppo.interval[0] > level.interval[1], (ppo.interval, level.interval)


def test_damage_and_misfits_are_told(tmp_path: Path) -> None:
    settings = KINDS["plain"]
    layers = layers_of(moving_model(settings))
    with pytest.raises(ValueError, match=r"the layers of these settings have shapes \[\(\(8, 10\), \(8,\)\)"):
        NetworkPolicy(replace(settings, hidden_units=(8,)), layers)
    with pytest.raises(ValueError, match="weights must be finite"):
        NetworkPolicy(settings, [(weight * np.nan, bias) for weight, bias in layers])
    folder = tmp_path / "arrays"
    with pytest.raises(FileNotFoundError, match="arrays is no run folder"):
        read_policy(folder)
    new_folder(folder, "export", lambda made: write_policy(made, settings, layers))
    (folder / "weights.npz").write_bytes((folder / "weights.npz").read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"weights.npz holds no weights of the settings beside it: "):
        read_policy(folder)
    (folder / "weights.npz").unlink()
    with pytest.raises(FileNotFoundError, match=r"holds no weights.npz"):
        read_policy(folder)
    write_json(folder / "settings.json", {"hold": 0})
    with pytest.raises(ValueError, match="holds no settings of a run"):
        read_policy(folder)
