"""Fixtures of these tests."""

from __future__ import annotations

from pathlib import Path

import pytest

from agents.runs import describe
from jackbox_env.tools.files import new_folder
from tests.agents.small_run import TINY


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A finished run of training."""
    from agents.training import ppo as training  # this module is imported where PyTorch is missing too

    folder = new_folder(tmp_path_factory.mktemp("runs") / "run", "test")
    describe(folder, TINY)
    training.train(TINY, folder, progress=False)
    return folder
