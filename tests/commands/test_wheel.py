"""The wheel alone: no extras, no checkout, in an empty folder. An editable install would hide what it lacks."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.commands.core_site import build_wheel, make_core_site


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    make_core_site(folder, build_wheel(tmp_path_factory.mktemp("wheel")))
    return folder


def jackbox(site: Path, cwd: Path, *arguments: str, status: int = 0) -> subprocess.CompletedProcess[str]:
    """Run the command that the wheel installs; -S leaves this environment's own packages out."""
    env = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "-S", str(site / "bin" / "jackbox"), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=env, timeout=250, check=False)
    assert done.returncode == status, done.stderr
    return done


def test_simulate_writes_files_and_says_why_there_are_no_plots(site: Path, tmp_path: Path) -> None:
    done = jackbox(site, tmp_path, "simulate", "--seconds", "2", "--html", "--folder", "out")
    names = sorted(path.name for path in (tmp_path / "out").iterdir())
    assert names == ["impacts.csv", "states.csv", "trajectory.html"]
    assert "No plots: matplotlib is not installed" in done.stderr
    assert "trajectory.html" in done.stdout
    refused = jackbox(site, tmp_path, "simulate", "--plots", status=2)
    assert refused.stderr == "plots need matplotlib: pip install matplotlib, or leave --plots out\n"
    jackbox(site, tmp_path, "simulate", "--seconds", "1", "--format", "npz", "--folder", "arrays")
    assert [path.name for path in (tmp_path / "arrays").iterdir()] == ["trajectory.npz"]


@pytest.mark.slow  # compiles anew
def test_check_finds_that_it_works_and_which_extras_are_missing(site: Path, tmp_path: Path) -> None:
    out = jackbox(site, tmp_path, "check").stdout
    assert out.count("ok      ") == 4
    assert out.endswith("This installation works.\n")
    assert re.search(r'extra render: not installed; to get it: pip install "pygame-ce>=2.5"', out)
    assert re.search(r'extra train: not installed; to get it: pip install .*"torch', out)
    assert re.search(r"exact model: ready after \d+\.\d s", out)
    assert not list(tmp_path.iterdir())


def test_what_it_lacks_is_said_in_one_sentence(site: Path, tmp_path: Path) -> None:
    play = jackbox(site, tmp_path, "play", status=2).stderr
    assert play == "play needs the render extra, which is not installed: pip install 'pygame-ce>=2.5'\n"
    for name in ("demo", "train", "evaluate"):
        sentence = jackbox(site, tmp_path, name, "--help", status=2).stderr
        assert sentence.startswith(f"jackbox {name} needs a checkout: git clone")
        assert len(sentence.splitlines()) == 1
