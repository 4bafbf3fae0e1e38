"""Trainings that are killed at random moments, or before any operation on the disk, finish when they are resumed.

``JACKBOX_KILLS=200`` kills 200 times instead of three, and before each operation.
"""

from __future__ import annotations

import re
import shutil
import time
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from agents.runs import locked
from jackbox_env.tools.model_files import MODEL
from tests.agents import killing
from tests.agents.killing import KILLS, check_finished, check_whole, ended, start

pytestmark = pytest.mark.timeout(300 + 30 * KILLS)
KILLED = -9


class Uninterrupted(NamedTuple):
    """An undisturbed training."""

    folder: Path
    seconds: float  # that it took
    operations: int  # on the disk


@pytest.fixture(scope="module", autouse=True)
def _compiled(tmp_path_factory: pytest.TempPathFactory) -> None:
    """Compiling would count as time and operations on the disk, and write large files."""
    folder = tmp_path_factory.mktemp("compiled")
    assert ended(start(killing.train, folder / "run", folder / "out.txt", 0)) == 0


@pytest.fixture(scope="module")
def uninterrupted(tmp_path_factory: pytest.TempPathFactory) -> Uninterrupted:
    folder, began = tmp_path_factory.mktemp("uninterrupted"), time.monotonic()
    assert ended(start(killing.train, folder / "run", folder / "out.txt", 0)) == 0
    seconds = time.monotonic() - began
    check_finished(folder / "run")
    (count,) = re.findall(r"(\d+) operations", (folder / "out.txt").read_text())
    return Uninterrupted(folder / "run", seconds, int(count))


@pytest.mark.slow
def test_a_training_killed_at_random_moments_comes_to_its_end(tmp_path: Path, uninterrupted: Uninterrupted) -> None:
    rng, folder, output = np.random.default_rng(0), tmp_path / "run", tmp_path / "out.txt"
    for number in range(KILLS):
        process = start(killing.train, folder, output)
        process.join(rng.uniform(0.0, uninterrupted.seconds))
        process.kill()
        assert ended(process) in (0, KILLED), f"after {number} kills: {output.read_text()}"
        if (folder / MODEL).exists():
            check_finished(folder)
            folder = tmp_path / f"run-{number}"
        elif folder.exists():
            check_whole(folder)
    assert ended(start(killing.train, folder, output)) == 0, output.read_text()
    check_finished(folder)


@pytest.mark.slow
def test_a_training_killed_before_any_operation_on_the_disk_comes_to_its_end(
    tmp_path: Path, uninterrupted: Uninterrupted
) -> None:
    rng, count = np.random.default_rng(1), uninterrupted.operations
    assert count > 50
    for point in np.unique(np.linspace(1, count, min(KILLS, count)).round()).astype(int).tolist():
        folder, output = tmp_path / f"run-{point}", tmp_path / f"out-{point}.txt"
        assert ended(start(killing.train, folder, output, point)) == KILLED
        for kill_at in (int(rng.integers(1, count)), None):  # once more while it is resumed
            if folder.exists():
                check_whole(folder)
            if (folder / MODEL).exists():  # it has ended, or all that was left to do was to end
                break
            status = ended(start(killing.train, folder, output, kill_at))
            assert status == 0 or (kill_at and status == KILLED), output.read_text()
        check_finished(folder)


def test_a_full_disk_is_reported_and_the_run_goes_on_when_there_is_room(tmp_path: Path) -> None:
    folder, output = tmp_path / "run", tmp_path / "out.txt"
    assert ended(start(killing.train, folder, output, None, 20_000)) == 2
    said = r"Training on .*\nStarting from the beginning\n.*/checkpoints/ppo_16.zip cannot be used: File too large"
    assert re.fullmatch(said, output.read_text().strip())
    check_whole(folder)
    assert not list(folder.rglob("*.partial*"))
    assert ended(start(killing.train, folder, output)) == 0
    check_finished(folder)


def test_a_resume_beside_another_is_refused_and_leaves_the_run_whole(tmp_path: Path) -> None:
    folder, output = tmp_path / "run", tmp_path / "out.txt"
    assert ended(start(killing.train, folder, output, None, 20_000)) == 2
    refused = tmp_path / "refused.txt"
    with locked(folder):
        assert ended(start(killing.train, folder, refused)) == 2
    said = refused.read_text().splitlines()
    assert said[-1] == f"{folder} is in use by another process: wait until it ends, or end it"
    assert ended(start(killing.train, folder, output)) == 0, output.read_text()
    check_finished(folder)


@pytest.mark.parametrize("name", ["evaluations.npz", "checkpoints/ppo_80.zip", "best_model.zip", "run.json"])
def test_a_file_cut_short_would_be_seen(name: str, tmp_path: Path, uninterrupted: Uninterrupted) -> None:
    folder = Path(shutil.copytree(uninterrupted.folder, tmp_path / "run"))
    check_whole(folder)
    (folder / name).write_bytes((folder / name).read_bytes()[:-20])
    with pytest.raises((AssertionError, ValueError)):
        check_whole(folder)
