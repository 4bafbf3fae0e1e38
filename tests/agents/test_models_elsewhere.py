"""Models of Stable-Baselines3 that are saved here, and loaded where there is no checkout of this project."""

from __future__ import annotations

import dataclasses
import os
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from stable_baselines3 import PPO

from agents.settings import TrainSettings
from agents.training.models import make_ppo, make_vec_env
from tests.agents.small_run import TINY

LOADING = """
import sys
class Refused:
    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] in ("agents", "jackbox_env", "scripts", "tests"):
            raise ModuleNotFoundError(f"No module named {name!r}")
sys.meta_path.insert(0, Refused())
import numpy as np
from stable_baselines3 import PPO
model = PPO.load("model.zip")
print(model.lr_schedule(0.5), model.predict(np.zeros((3, 10), np.float32), deterministic=True)[0].ravel().tolist())
"""


def test_a_saved_model_loads_without_this_project_and_stores_its_settings(tmp_path: Path) -> None:
    settings = dataclasses.replace(TINY, repeat=4)
    model = make_ppo(settings, make_vec_env(settings.env_settings, 2, 0))
    model.save(tmp_path / "model.zip")
    actions, _ = model.policy.predict(np.zeros((3, 10), np.float32), deterministic=True)
    command = [sys.executable, "-W", "error::UserWarning", "-c", LOADING]
    out = subprocess.check_output(command, cwd=tmp_path, env={**os.environ, "PYTHONPATH": ""}, text=True)
    assert out == f"{0.5 * TINY.learning_rate} {actions.ravel().tolist()}\n"
    again: Any = PPO.load(tmp_path / "model.zip", device="cpu")
    assert TrainSettings.of(again.trained_by) == settings
    for remaining in (1.0, 0.25, 0.0):  # it falls to 0
        assert model.lr_schedule(remaining) == pytest.approx(TINY.learning_rate * remaining, abs=1e-18)
