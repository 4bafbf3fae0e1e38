"""The command lines."""

from __future__ import annotations

import csv
import json
import re
import shlex
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from agents.policies.registry import SCRIPTED
from tests.script import ROOT, script
from tests.states import load

SCRIPTS = {
    path.relative_to(ROOT / "scripts").with_suffix("").as_posix(): path.read_text(encoding="utf-8")
    for path in sorted((ROOT / "scripts").rglob("*.py"))
}
MEANINGS = {  # of options, in every command that has them
    "--folder": "new folder for",
    "--html": "also write",
    "--seed": "seed of",
    "--dt": "duration of a control step",
}
COMMANDS = [name for name, text in SCRIPTS.items() if "__main__" in text]


# -- command lines -----------------------------------------------------------------------------------------------------


def test_simulate_writes_states_impacts_and_four_plots(tmp_path: Path) -> None:
    done = script("simulate", "--seconds", "3", "--folder", "out", cwd=tmp_path)
    with (tmp_path / "out" / "impacts.csv").open() as file:
        times = [float(row["time [s]"]) for row in csv.DictReader(file)]
    np.testing.assert_allclose(times, [hit["time"] for hit in load("seed_scene")[0]["impacts"][:3]], atol=1e-9)
    assert "3 impacts by t = 3 s" in done.stdout
    plots = sorted(path.name for path in (tmp_path / "out").glob("*.png"))
    assert plots == [f"{body}_{what}.png" for body in ("box", "jack") for what in ("positions", "velocities")]


def test_simulate_writes_the_steps_before_the_jack_escapes(tmp_path: Path) -> None:
    arguments = ["--scene", '{"box_mass": 0.01}', "--seconds", "5", "--folder", "out", "--no-plots"]
    arguments += ["--fidelity", "balanced"]
    done = script("simulate", *arguments, cwd=tmp_path, status=2)
    assert "the jack would leave the box" in done.stderr
    assert (tmp_path / "out" / "states.csv").stat().st_size > 100


def test_evaluate_compares_policies_and_writes_json(tmp_path: Path, run: Path) -> None:
    arguments = ["--policy", "zero", "chirp", "ppo", str(run), "--episodes", "4", "--task", "spin"]
    arguments += ["--json", "out.json"]
    done = script("evaluate", *arguments, "--substeps", "2", cwd=tmp_path)
    stored = json.loads((tmp_path / "out.json").read_text())
    assert stored["env"]["task"] == "spin"
    assert [row["policy"] for row in stored["results"]] == ["zero", "chirp", "ppo", str(run)]
    assert all(len(row["returns"]) == row["episodes"] == 4 for row in stored["results"])
    assert f"{stored['results'][0]['mean']:.1f}" in done.stdout
    assert "4 episodes each, seed 0, task spin, fidelity coarse" in done.stdout
    for name, differing in ((str(run), "task juggle, fidelity exact"), ("ppo", "fidelity exact")):
        assert f"Note: {name} was trained in another environment ({differing})" in done.stderr
    same = script("evaluate", "--policy", str(run), "ppo", "--episodes", "2", "--contact", "exact", cwd=tmp_path)
    assert "Note:" not in same.stderr  # another word for the same


def test_a_single_field_of_the_scene_is_an_option_too(tmp_path: Path) -> None:
    few = ["--policy", "zero", "--episodes", "2"]
    single = script("evaluate", *few, "--jack-mass", "5", cwd=tmp_path).stdout
    assert single == script("evaluate", *few, "--scene", '{"jack_mass": 5.0}', cwd=tmp_path).stdout
    assert "scene {" in single


def test_train_prints_a_command_that_evaluates_in_the_same_environment(tmp_path: Path) -> None:
    small = "--num-envs 4 --rollout-steps 64 --batch-size 64 --eval-episodes 2 --total-steps 256 --no-progress"
    chosen = ["--task", "spin", "--contact", "exact", "--jack-mass", "5", "--control-dt", "0.025"]
    done = script("train", *chosen, *small.split(), "--folder", "a run's", cwd=tmp_path)
    (line,) = (line for line in done.stdout.splitlines() if "evaluate.py" in line)
    _, _, *options = shlex.split(line)
    again = script("evaluate", *options, "--episodes", "1", cwd=tmp_path)
    assert "Note:" not in again.stderr  # of a run that was trained elsewhere
    assert "task spin, fidelity exact, control_dt 0.025, scene {" in again.stdout
    assert "| a run's" in again.stdout


@pytest.mark.slow
def test_training_survives_ctrl_c_and_resumes_from_the_command_line(tmp_path: Path) -> None:
    small = "--num-envs 4 --rollout-steps 64 --batch-size 64 --checkpoint-steps 256 --eval-steps 8192 --epochs 1"
    command = [sys.executable, str(ROOT / "scripts" / "train.py"), "--folder", "run", "--no-progress", *small.split()]
    # A shell's background jobs ignore SIGINT, and so would all that they start.
    at_work = subprocess.Popen(
        [*command, "--total-steps", "4096"],
        cwd=tmp_path,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=lambda: signal.signal(signal.SIGINT, signal.SIG_DFL),
    )
    checkpoints = tmp_path / "run" / "checkpoints"
    while not list(checkpoints.glob("*.zip")) and at_work.poll() is None:
        time.sleep(0.05)
    at_work.send_signal(signal.SIGINT)
    _, errors = at_work.communicate(timeout=60)
    assert at_work.returncode == 130, errors
    assert "Continue with: python scripts/train.py --resume run" in errors
    assert not (tmp_path / "run" / "model.zip").exists()
    done = script("train", "--resume", "run", "--no-progress", cwd=tmp_path)
    assert "Continuing after" in done.stdout
    assert "Trained. Models, settings and evaluations: run" in done.stdout
    finished = script("train", "--resume", "run", cwd=tmp_path, status=2).stderr
    assert "is finished: it has a model.zip" in finished
    assert "resume it with more total steps" in finished
    fewer = script("train", "--resume", "run", "--total-steps", "4096", cwd=tmp_path, status=2).stderr
    assert "total_steps must be above the run's 4,096, got 4,096" in fewer
    done = script("train", "--resume", "run", "--total-steps", "8192", "--no-progress", cwd=tmp_path)
    assert re.search(r"The best model, after 8,192 steps, earns \d+\.\d ± \d+\.\d on juggle", done.stdout)


@pytest.mark.slow
def test_the_demo_runs_end_to_end_when_made_small(tmp_path: Path) -> None:
    done = script("demo", "--folder", "demo", "--total-steps", "2048", "--episodes", "2", cwd=tmp_path)
    for policy in (*SCRIPTED, "PPO"):
        assert f"| {policy}" in done.stdout
    for name in ("model.zip", "settings.json", "run.json", "results.json", "results.png", "film.gif"):
        assert (tmp_path / "demo" / name).stat().st_size > 100, name
    stored = json.loads((tmp_path / "demo" / "results.json").read_text())
    for fidelity in ("exact", "balanced"):
        assert [row["policy"] for row in stored["results"][fidelity]] == [*SCRIPTED, "PPO"]
    verdict = done.stdout.strip().splitlines()[-1]
    assert verdict.count("PPO's interval") == verdict.count("above level's") == 2


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_line_explains_itself(name: str, tmp_path: Path) -> None:
    out = re.sub(r"[│\s]+", " ", script(name, "--help", cwd=tmp_path).stdout).lower()
    assert "show this help message" in out
    assert not re.search(r"``|:\w+:`", out)  # marks of docstrings
    for option, meaning in MEANINGS.items():
        assert meaning in out or not re.search(rf"{option}\b", out), option


def test_the_help_of_training_shows_the_defaults_of_each_task(tmp_path: Path) -> None:
    out = script("train", "--task", "spin", "--help", cwd=tmp_path).stdout
    assert re.search(r"--action-repeat INT[^(]*\(default: 4\)", out)
