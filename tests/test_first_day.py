"""Four first tries, as a person makes them: in an empty home and a folder of their own, by commands alone."""

from __future__ import annotations

import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

from tests.test_package import blocks

ROOT = Path(__file__).parents[1]
camera = pytest.importorskip("scripts.studies.fitting.camera")
pytest.importorskip("stable_baselines3")


@pytest.mark.slow
def test_four_first_tries_succeed_without_a_traceback(tmp_path: Path) -> None:
    (tmp_path / "home").mkdir()
    environment = {**os.environ, "HOME": str(tmp_path / "home"), "USERPROFILE": str(tmp_path / "home")}

    def python(*words: str) -> str:
        ended = subprocess.run(
            [sys.executable, *words], cwd=tmp_path, env=environment, capture_output=True, text=True, check=False
        )
        assert ended.returncode == 0, ended.stderr
        assert "Traceback" not in ended.stderr
        return ended.stdout

    def jackbox(command: str) -> str:
        return python("-m", "jackbox_env", *command.split())

    # A camera's file gives the mass.
    camera.write_camera_file(tmp_path / "cam.csv", seconds=6.0)
    fitted = python("-m", "jackbox_env", "fit", "cam.csv", *camera.OPTIONS)
    low, high = map(float, re.findall(r"jack_mass +[\d.]+ +([\d.]+) to ([\d.]+)", fitted)[0])
    assert low < camera.TRUE["jack_mass"] < high

    # Another world becomes a CSV file and plots, and the fit of that file gives its gravity.
    jackbox("simulate --gravity 3.7 --torque none --state omega_jack=3,vx_jack=2 --folder mars")
    assert json.loads((tmp_path / "mars" / "scene.json").read_text())["gravity"] == 3.7
    assert len(list((tmp_path / "mars").glob("*.png"))) == 4
    assert re.search(r"^gravity +3\.7\d* ", jackbox("fit mars/states.csv --fields gravity"), re.MULTILINE)

    # The README's training saves a model, which is evaluated and filmed.
    python("-c", blocks(ROOT / "README.md")[0].replace("learn(500_000,", "learn(20_000,"))
    (evaluate,) = re.findall(r"^jackbox (evaluate .*?)  #", (ROOT / "README.md").read_text(), re.MULTILINE)
    assert "juggler.zip" in jackbox(f"{evaluate} --episodes 2")
    assert (tmp_path / "juggler.gif").stat().st_size > 100_000

    # A reward of their own trains a policy.
    trained = python(str(ROOT / "scripts" / "examples" / "own_task.py"), "--total-steps", "8192")
    assert len(re.findall(r"trained: \d+ of 64 through the window", trained)) == 2
