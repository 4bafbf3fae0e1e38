"""The simulate command: no folder without files, and continued runs."""

from __future__ import annotations

import csv
import itertools
import json
from pathlib import Path

import numpy as np
import pytest

from jackbox_env import Scene
from jackbox_env.commands import simulate
from tests.script import Done, jackbox


def run(tmp_path: Path, *arguments: str, status: int = 0) -> Done:
    return jackbox("simulate", "--no-plots", *arguments, cwd=tmp_path, status=status)


def test_ctrl_c_leaves_no_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(folder: Path, *_: object) -> None:
        (folder / "states.csv").touch()
        raise KeyboardInterrupt

    monkeypatch.setattr(simulate, "_write", interrupted)
    run(tmp_path, "--folder", "out", status=130)
    assert not list(tmp_path.iterdir())


def test_it_goes_on_from_its_last_row_with_a_foot_in_a_wall(tmp_path: Path) -> None:
    scene = ["--scene", '{"restitution": 0.3, "drive": null}', "--fidelity", "balanced"]
    run(tmp_path, "--seconds", "2", *scene, "--folder", "out")
    with (tmp_path / "out" / "states.csv").open() as file:
        rows = [[float(cell) for cell in row[:13]] for row in list(csv.reader(file))[1:]]
    deep = next(row for row in rows if row[5] - row[2] < -5.0 - 1e-8)  # a foot is outside
    run(tmp_path, "--seconds", "1", "--state", f" {json.dumps(deep[1:])}")
    (again,) = (tmp_path / "runs").glob("simulate-*/states.csv")
    with again.open() as file:
        assert [float(cell) for cell in list(csv.reader(file))[1][1:13]] == deep[1:]


@pytest.mark.filterwarnings("ignore::ResourceWarning")  # of imageio
def test_a_film_shows_the_motion_at_any_step(tmp_path: Path) -> None:
    imageio = pytest.importorskip("imageio.v3")
    options = ["--seconds", "0.6", "--dt", "0.3", "--state", '{"y_jack": -4.5}', "--folder", "out"]
    out, err = run(tmp_path, *options, "--film", "run.mp4")
    frames = imageio.imread(tmp_path / "run.mp4")
    assert len(frames) == 16  # at 0, 0.04, ... 0.6 s; an impact is at 0.32 s
    assert all((one != other).any() for one, other in itertools.pairwise(frames))  # it never stands still
    assert "  run.mp4" in out.splitlines()
    assert "frame" not in err  # no bar, as this is no terminal


def test_the_scene_is_written_beside_the_states_and_makes_the_same_scene(tmp_path: Path) -> None:
    options = [
        "--seconds",
        "0.1",
        "--scene",
        '{"drive": null, "jack_inertia": 3}',
        "--jack-mass",
        "5",
        "--box-mass",
        "9",
    ]
    run(tmp_path, *options, "--folder", "csv")
    run(tmp_path, *options, "--folder", "npz", "--format", "npz")
    scene = Scene(drive=None, jack_inertia=3.0, jack_mass=5.0, box_mass=9.0)
    fields = json.loads((tmp_path / "csv" / "scene.json").read_text())
    assert fields == json.loads(np.load(tmp_path / "npz" / "trajectory.npz")["scene"].item())
    assert Scene.of(fields) == scene
    assert Scene.of(fields).changed(box_mass=1.0).box_inertia == 36.0  # it still follows the mass
    assert "box_inertia" not in fields


def test_a_state_has_names_and_a_scene_without_a_drive_no_torque(tmp_path: Path) -> None:
    start = ["--state", '{"x_jack": 1, "vy_jack": -9}', "--dt", "0.05", "--scene", '{"drive": null}']
    run(tmp_path, *start, "--format", "npz", "--folder", "calm", "--html")
    calm = np.load(tmp_path / "calm" / "trajectory.npz")
    assert len(calm["torque"]) == 200
    assert not calm["torque"].any()
    assert calm["state"][0].tolist() == [0.0, 0.0, 0.0, 1.0] + [0.0] * 6 + [-9.0, 0.0]
    assert "No torque" in (tmp_path / "calm" / "trajectory.html").read_text()
