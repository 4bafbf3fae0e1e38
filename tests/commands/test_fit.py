"""The fit command recovers the scene of files by simulate, and refuses other files in one sentence."""

from __future__ import annotations

import csv
import json
import math
import re
import shlex
from pathlib import Path

import numpy as np
import pytest

from jackbox_env import Chirp, Fit, Recording, Scene, rollout, simulate
from jackbox_env.commands import fit, fit_page
from jackbox_env.model.states import STATE_NAMES
from jackbox_env.recording.files import write_csv
from jackbox_env.tools.files import write_json
from tests.script import jackbox

pytest.importorskip("scipy")
camera = pytest.importorskip("scripts.studies.fitting.camera")

ROOT = Path(__file__).parents[2]
TRUE = Scene(jack_mass=4.5, restitution=0.8)
START = '{"restitution": 0.9}'
NOISE = 0.005


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files of a simulation of 4 s, and noisy.csv, whose states have noise."""
    made = tmp_path_factory.mktemp("recorded")
    rng = np.random.default_rng(0)
    motion = simulate(TRUE, [0.0] * 5 + [math.pi / 4.0] + [0.0] * 6, 4.0)
    write_json(made / "scene.json", TRUE.as_dict())
    with write_csv(motion.tables(), made / "states.csv", made / "impacts.csv")[0].open() as file:
        head, *rows = csv.reader(file)
    noisy = [[row[0], *(float(cell) + NOISE * rng.standard_normal() for cell in row[1:13]), row[13]] for row in rows]
    with (made / "noisy.csv").open("w", newline="") as file:
        csv.writer(file).writerows([head, *noisy])
    return made


def test_a_noisy_recording_identifies_mass_and_restitution_and_the_page_shows_them(folder: Path) -> None:
    fields = "--fields", "jack_mass", "restitution"
    more = "--scene", START, "--impacts", "impacts.csv", "--noise", '{"impacts": 0.001}', "--html", "--folder", "out"
    out, err = jackbox("fit", "noisy.csv", *fields, *more, cwd=folder)
    table = [re.split(r"  +", line) for line in out.splitlines()[:3]]
    assert table[0] == ["field", "fitted", "95 % interval", "start"]
    assert [(row[0], row[3]) for row in table[1:]] == [("jack_mass", "4"), ("restitution", "0.9")]
    assert float(table[1][1]) == pytest.approx(4.5, abs=0.05)
    assert float(table[2][1]) == pytest.approx(0.8, abs=0.002)
    assert "Converged" in out
    assert re.search(r"x_jack 0\.00[45]\d* m,", out)  # noise
    assert "Left out of " in out
    assert err.startswith(
        "The scene's drive turns the box, a chirp of up to 90,000 N m; --torque none if nothing does.\n"
    )
    assert "\nFitting jack_mass, restitution to 200 steps ...\n" in err
    assert re.search(r"\.\.\. took [\d.]+ s\n$", err)
    page = (folder / "out" / "fit.html").read_text()
    assert all(f"<td>{cell}</td>" in page for row in table[1:] for cell in row)
    assert page.count("<svg") == 2
    assert not re.search(r"(src|href)=.https?:|url\(.?https?:", page)  # nothing is fetched


def test_a_row_that_is_far_off_sets_no_scale_of_the_residuals() -> None:
    pytest.importorskip("matplotlib")
    states = np.zeros((2, 12))
    states[1, 3] = 1e6
    result = Fit(Scene(), {}, np.zeros(0), (), dict.fromkeys(STATE_NAMES, 1.0))
    figure = fit_page._residuals(result, Recording(states, None, dt=0.1), np.zeros((2, 12)), [])
    assert figure.axes[0].get_ylim()[1] < 20.0


def test_the_search_starts_at_the_scene_that_simulate_has_written(folder: Path) -> None:
    out, err = jackbox("fit", "noisy.csv", "--fields", "jack_mass", cwd=folder)
    assert "The search starts at the scene of scene.json." in err
    assert re.split(r"  +", out.splitlines()[1])[3] == "4.5"


def test_nothing_turns_the_box_under_torque_none(tmp_path: Path) -> None:
    states = rollout(Scene(drive=None), 0.3 * np.eye(12)[5], np.zeros(100), 0.02)[0][:, :6]
    rows = np.column_stack([0.02 * np.arange(101), states])
    np.savetxt(tmp_path / "calm.csv", rows, delimiter=",", header=",".join(("time", *STATE_NAMES[:6])), comments="")
    options = "--torque", "none", "--gravity", "9", "--fields", "gravity"
    out, err = jackbox("fit", "calm.csv", *options, cwd=tmp_path)
    assert float(re.split(r"  +", out.splitlines()[1])[1]) == pytest.approx(9.81, rel=1e-6)
    assert "turns the box" not in err
    (tmp_path / "scene.json").write_text('{"drive": null, "gravity": 9.0}')  # of which an option changes one field
    out, _ = jackbox("fit", "calm.csv", "--jack-mass", "5", "--fields", "gravity", cwd=tmp_path)
    assert float(re.split(r"  +", out.splitlines()[1])[1]) == pytest.approx(9.81, rel=1e-6)


@pytest.mark.parametrize("drive", [Chirp(), None])
def test_an_npz_file_of_simulate_brings_its_scene(drive: Chirp | None, tmp_path: Path) -> None:
    scene = json.dumps({"gravity": 3.7, "jack_mass": 6.0, "drive": drive and {"amplitude": 5e4}})
    start = ["--state", '{"x_jack": 0.3, "theta_jack": 0.2, "vx_jack": 1}', "--scene", scene, "--folder", "run"]
    jackbox("simulate", "--format", "npz", "--no-plots", "--seconds", "5", *start, cwd=tmp_path)
    out, err = jackbox("fit", "run/trajectory.npz", "--fields", "gravity", cwd=tmp_path)
    assert "The search starts at the scene of run/trajectory.npz." in err
    name, fitted, _, begun = re.split(r"  +", out.splitlines()[1])
    assert (name, begun) == ("gravity", "3.7")
    assert float(fitted) == pytest.approx(3.7, rel=1e-6)
    assert "Converged" in out
    file = tmp_path / "run" / "trajectory.npz"
    with np.load(file) as arrays:
        recording = Recording.from_frame(arrays, impacts=arrays["impact_time"])
        np.testing.assert_array_equal(recording.states, arrays["state"])
    again = fit.read_recording(file, Scene.of(json.loads(scene)), file)
    assert (recording.torques is None) == (again.torques is None) == (drive is not None)
    assert recording.impacts is not None
    np.testing.assert_array_equal(recording.impacts, again.impacts)


def test_the_documented_command_converges(tmp_path: Path) -> None:
    page = (ROOT / "docs" / "fitting.md").read_text().replace("\\\n", "")
    (options,) = re.findall(r"^jackbox fit ([^#\n]*)", page, re.M)
    (tmp_path / "docs").mkdir()
    camera.write_camera_file(tmp_path / camera.FILE)
    assert (tmp_path / camera.FILE).read_bytes() == (ROOT / camera.FILE).read_bytes()
    out, err = jackbox("fit", *shlex.split(options), cwd=tmp_path)
    assert "Converged: the search ended" in out
    low, high = map(float, re.findall(r"jack_mass +[\d.]+ +([\d.]+) to ([\d.]+)", out)[0])
    assert low < camera.TRUE["jack_mass"] < high < low + 0.05
    assert re.search(r"^docs/cam\.csv: \d+ of \d+ frames are missing, and left open\.$", err, re.M)
    assert "fitting:" not in err  # no bar, as this is no terminal
