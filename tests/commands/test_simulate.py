"""The simulate command: no folder without files, and continued runs."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from jackbox_env import Chirp, make_simulator
from jackbox_env.commands import simulate
from jackbox_env.recording import trajectory as trajectories


def run(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, *arguments: str) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["jackbox simulate", "--no-plots", *arguments])
    simulate.main()


def test_ctrl_c_leaves_no_folder_and_prints_a_message(tmp_path: Path) -> None:
    pytest.importorskip("tqdm")  # shows the progress that is awaited
    command = [sys.executable, "-m", "jackbox_env", "simulate", "--seconds", "1e5"]
    at_work = subprocess.Popen(
        command, cwd=tmp_path, stderr=subprocess.PIPE, preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)
    )
    assert at_work.stderr is not None
    seen = b""
    while b"step/s" not in seen:  # its progress
        seen += os.read(at_work.stderr.fileno(), 4096)
    at_work.send_signal(signal.SIGINT)
    seen += at_work.stderr.read()
    assert at_work.wait(timeout=60) == 130
    at_work.stderr.close()
    assert b"nothing was written" in seen
    assert not list(tmp_path.iterdir())


def test_an_error_while_files_are_written_leaves_no_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from jackbox_env.recording import page as report

    def full(*arguments: object) -> None:
        raise OSError(28, "No space left on device", "trajectory.html")

    monkeypatch.setattr(report, "write_page", full)
    with pytest.raises(SystemExit):
        run(monkeypatch, tmp_path, "--seconds", "1", "--html", "--folder", "out")
    assert "trajectory.html cannot be used: No space left on device" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


def test_it_goes_on_from_its_last_row_with_a_foot_in_a_wall(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = ["--scene", '{"restitution": 0.3, "drive": null}', "--fidelity", "balanced"]
    run(monkeypatch, tmp_path, "--seconds", "2", *scene, "--folder", "out")
    with (tmp_path / "out" / "states.csv").open() as file:
        rows = [[float(cell) for cell in row[:13]] for row in list(csv.reader(file))[1:]]
    deep = next(row for row in rows if row[5] - row[2] < -5.0 - 1e-8)  # a foot is outside
    run(monkeypatch, tmp_path, "--seconds", "1", "--state", json.dumps(deep[1:]), "--time", str(deep[0]))
    (again,) = (tmp_path / "runs").glob("simulate-*/states.csv")
    with again.open() as file:
        assert [float(cell) for cell in list(csv.reader(file))[1][:13]] == deep


@pytest.mark.parametrize("contact", ["exact", "pymunk"])
def test_the_files_hold_each_steps_torque(tmp_path: Path, contact: str) -> None:
    simulator = make_simulator(contact=contact)
    trajectory = trajectories.simulate(simulator, 0.5, 0.02, progress=False)
    (states, _), (arrays,) = trajectories.write_csv(trajectory, tmp_path), trajectories.write_npz(trajectory, tmp_path)
    with states.open() as file:
        *rows, last = csv.DictReader(file)
    assert last["torque [N m]"] == ""
    torques = [float(row["torque [N m]"]) for row in rows]
    assert torques == np.load(arrays)["torque"].tolist()
    means = [0.5 * sum(Chirp().torque_means(0.02 * step, 0.02)) for step in range(25)]
    np.testing.assert_allclose(torques, means, rtol=1e-6)


def test_a_page_of_too_many_steps_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with pytest.raises(SystemExit):
        run(monkeypatch, tmp_path, "--seconds", "1e4", "--html", "--folder", "more")
    assert "html takes at most 20,000 steps, got seconds / dt = 500000" in capsys.readouterr().err
