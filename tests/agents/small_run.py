"""A small training run."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.runs import describe
from agents.settings import TrainSettings
from jackbox_env.files import new_folder

# Seconds instead of minutes: an update every 64 steps of 4 environments.
TINY = TrainSettings(
    total_steps=2048,
    num_envs=4,
    rollout_steps=64,
    batch_size=64,
    epochs=2,
    checkpoint_steps=512,
    eval_steps=1024,
    eval_episodes=4,
    hidden_units=(16,),
    repeat=1,
    preview=False,
    landing=False,
)


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of training."""
    from agents.training import ppo as training  # conftest.py imports this module where PyTorch is missing too

    folder = new_folder(tmp_path_factory.mktemp("runs") / "run", "test")
    describe(folder, TINY)
    training.train(TINY, folder, progress=False)
    return folder
