"""Models of Stable-Baselines3 that are loaded where there is no checkout of this project."""

from __future__ import annotations

import base64
import dataclasses
import json
import os
import subprocess
import sys
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.holding import HoldingPPO
from agents.models import make_ppo, make_vec_env
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


def saved(folder: Path, **settings: Any) -> HoldingPPO:
    """A model, saved as Stable-Baselines3 does."""
    given = dataclasses.replace(TINY, **settings)
    model = make_ppo(given, make_vec_env(given.env_settings, 2, 0))
    model.save(folder / "model.zip")
    return model


def loaded_elsewhere(folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run(
        [sys.executable, "-W", "error::UserWarning", "-c", LOADING], capture_output=True, text=True, cwd=folder,
        env=environment, check=False,
    )  # fmt: skip


def test_a_saved_model_loads_without_this_project(tmp_path: Path) -> None:
    model = saved(tmp_path, hold=4)
    done = loaded_elsewhere(tmp_path)
    assert done.returncode == 0, done.stderr
    wanted = actions_of(model)
    assert done.stdout.split(maxsplit=1) == [str(0.5 * TINY.learning_rate), f"{wanted}\n"]
    with zipfile.ZipFile(tmp_path / "model.zip") as archive:
        stored = json.loads(archive.read("data"))
    pickled = [base64.b64decode(value[":serialized:"]) for value in stored.values() if isinstance(value, dict) and
               ":serialized:" in value]  # fmt: skip
    assert len(pickled) > 3
    assert not any(b"agents" in part or b"jackbox" in part for part in pickled)


def actions_of(model: HoldingPPO) -> list[float]:
    """Of the model as it was saved, chosen anew at each step."""
    actions, _ = model.policy.predict(np.zeros((3, 10), np.float32), deterministic=True)
    return [float(action) for action in actions.ravel()]


def test_a_model_loaded_here_plays_as_it_did(tmp_path: Path) -> None:
    model = saved(tmp_path, hold=4)
    again = HoldingPPO.load(tmp_path / "model.zip", device="cpu")
    assert again.manner == model.manner
    assert again.manner.hold == 4
    assert again.trained_by == dataclasses.asdict(dataclasses.replace(TINY, hold=4))


@pytest.mark.parametrize("remaining", [1.0, 0.7, 0.25, 0.0])
def test_the_learning_rate_falls_to_zero(tmp_path: Path, remaining: float) -> None:
    model = saved(tmp_path)
    assert model.lr_schedule(remaining) == pytest.approx(TINY.learning_rate * remaining, abs=1e-18)
