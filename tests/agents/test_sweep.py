"""Sweeps: the same table in this process, on cores, and after interruptions and kills; failures, refusals."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import time
from contextlib import closing
from dataclasses import asdict, replace
from functools import partial
from itertools import islice
from multiprocessing import active_children
from pathlib import Path
from typing import Any

import pytest
from stable_baselines3 import PPO

from agents import sweep
from agents.evaluation.returns import evaluate
from agents.policies.registry import find_policy
from agents.policies.scripted import PolicyWithEnv
from agents.runners import Results, Runner, Trials, Work, in_turn, on_cores
from agents.runs import FolderInUseError, locked
from agents.settings import INTERFACE, EnvSettings
from agents.sweep import (
    LOG,
    RUNS,
    TABLE,
    Code,
    carry_out,
    new_sweep,
    read_sweep,
)
from jackbox_env.sb3 import make_sb3_vec_env, save_model
from jackbox_env.tools import user_code
from tests.agents.small_run import TINY
from tests.agents.trials import GRID, fragile, shares
from tests.script import ROOT, script


def carried_out(folder: Path, work: Work = shares, runner: Runner = in_turn) -> bytes:
    """The table after a sweep that begins or goes on in a folder."""
    if not folder.exists():
        new_sweep(folder, GRID)
    carry_out(folder, GRID, work, runner, progress=False)
    return (folder / TABLE).read_bytes()


def rows_of(folder: Path) -> list[dict[str, str]]:
    with (folder / TABLE).open() as file:
        return list(csv.DictReader(file))


def test_a_row_for_each_trial_in_the_order_of_the_grid_whatever_finishes_first(tmp_path: Path) -> None:
    table = carried_out(tmp_path / "sweep")
    rows = rows_of(tmp_path / "sweep")
    assert list(rows[0]) == ["name", "number", "share", "list", "error"]
    assert [{"name": row["name"], "number": int(row["number"])} for row in rows] == GRID
    assert [float(row["share"]) for row in rows] == [shares(settings)["share"] for settings in GRID]  # every bit
    assert json.loads(rows[0]["list"]) == [1, "one"]
    assert table == carried_out(tmp_path / "other", runner=lambda trials, work: in_turn(list(trials)[::-1], work))


def test_finished_trials_are_not_run_again_and_lines_that_a_kill_cut_short_are(tmp_path: Path) -> None:
    asked, log = list[dict[str, Any]](), tmp_path / "cut" / LOG

    def interrupted(settings: dict[str, Any]) -> dict[str, Any]:
        asked.append(settings)
        if len(asked) == 7:
            raise KeyboardInterrupt
        return shares(settings)

    with pytest.raises(KeyboardInterrupt):
        carried_out(tmp_path / "cut", interrupted)
    assert len(rows_of(tmp_path / "cut")) == 6
    log.write_bytes(log.read_bytes()[:-3])
    assert carried_out(tmp_path / "cut", interrupted) == carried_out(tmp_path / "whole")
    assert asked == [*GRID[:7], *GRID[5:]]


def test_a_killed_process_and_a_failing_trial_stop_no_other_and_an_interruption_waits_for_none(tmp_path: Path) -> None:
    work, folder, before = partial(fragile, tmp_path), tmp_path / "sweep", active_children()

    def interrupted(trials: Trials, work: Work) -> Results:
        with closing(on_cores(2, trials, work)) as results:
            yield from islice(results, 9)
            assert len(active_children()) == len(before) + 2  # one of them hangs
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        carried_out(folder, work, interrupted)
    assert active_children() == before
    errors = [row["error"] for row in rows_of(folder)]
    assert errors[1].startswith("BrokenProcessPool")
    assert errors[6] == "ValueError: number must not be 2"
    assert errors.count("") == 7
    assert (folder / LOG).read_text().count("in fragile") == 1
    assert carried_out(folder, work) == carried_out(tmp_path / "whole")


def test_folders_are_not_shared_or_continued_by_other_code(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder, known = new_sweep(tmp_path / "sweep", GRID), sweep.made_with()
    assert read_sweep(folder) == (GRID, Code({}))
    with locked(folder), pytest.raises(FolderInUseError, match="is in use by another process"):
        carried_out(folder)
    monkeypatch.setattr(sweep, "made_with", lambda: {**known, "numpy": "1.0"})
    with pytest.raises(ValueError, match=rf"begun with other code \(numpy {known['numpy']}\)"):
        read_sweep(folder)


# -- the command -------------------------------------------------------------------------------------------------------


FEW = ["--policy", "chirp", "level", "--setting", "balanced", "exact", "--scene", "{}", '{"box_mass": 0.01}']

FEW += ["--seeds", "3", "--episodes", "2", "--no-progress"]


@pytest.mark.slow
def test_the_command_is_killed_and_interrupted_on_two_cores_and_goes_on_to_the_same_table(tmp_path: Path) -> None:
    log = tmp_path / "s" / LOG

    def stopped(after: int, number: int, *arguments: str) -> tuple[int, str]:
        """Exit status and standard error of the command, which gets a signal after so many lines of its log."""
        command = [sys.executable, str(ROOT / "scripts" / "sweep.py"), *arguments, "--workers", "2"]
        # In a new process group, as in a terminal. A shell's background jobs ignore SIGINT.
        terminal: Any = {"start_new_session": True, "preexec_fn": lambda: signal.signal(signal.SIGINT, signal.SIG_DFL)}
        at_work = subprocess.Popen(command, cwd=tmp_path, stderr=subprocess.PIPE, text=True, **terminal)
        while at_work.poll() is None and not (log.exists() and log.read_bytes().count(b"\n") >= after):
            time.sleep(0.01)
        (os.kill if number == signal.SIGKILL else os.killpg)(at_work.pid, number)
        _, errors = at_work.communicate(timeout=60)  # until its workers have let go of standard error
        return at_work.returncode, errors

    assert stopped(2, signal.SIGKILL, *FEW, "--folder", "s")[0] == -signal.SIGKILL
    finished, again = log.read_bytes().count(b"\n"), "python scripts/sweep.py --resume s\n"
    said = f"\nInterrupted. Continue with: {again}"
    assert stopped(finished + 4, signal.SIGINT, "--resume", "s", "--no-progress") == (130, said)
    assert finished < len(rows_of(tmp_path / "s")) < 24  # three may have failed and begun again
    said = (
        f"3 of 24 trials failed, marked in s/table.csv, with tracebacks in s/trials.jsonl. Try them again with: {again}"
    )
    assert script("sweep", "--resume", "s", "--no-progress", cwd=tmp_path, status=1) == (
        f"24 trials: s/{TABLE}\n",
        said,
    )
    script("sweep", *FEW, "--folder", "whole", cwd=tmp_path, status=1)
    assert (tmp_path / "s" / TABLE).read_bytes() == (tmp_path / "whole" / TABLE).read_bytes()
    row, exact = rows_of(tmp_path / "s")[19], EnvSettings(fidelity="exact")
    assert (row["policy"], row["scene"], row["seed"], row["error"]) == ("level", "{}", "1", "")
    assert float(row["mean"]) == evaluate("", find_policy("level", exact, 1), exact.env_settings, 2, 1).mean


MINE = """
import jackbox_env
from jackbox_env.model.tasks import TASKS


def low(scene, state, torque, impulse):
    return -state.y_jack - {value}


task = jackbox_env.Task(("low",), low)
angle = jackbox_env.Observation(("angle",), -9.0, 9.0, lambda scene, state, time: (state.theta_box,))


def back(observations):
    return -0.5 * observations


def level(observations):
    return -observations[:, 5:6]
"""

SMALL = asdict(replace(TINY, total_steps=512, eval_steps=256, checkpoint_steps=256))

FIXED = {*asdict(EnvSettings()), *INTERFACE, "seed", "torch_threads"}

SEEN = {"fidelity": "coarse", "observation": "mine.py:angle", "action_repeat": 5}

VARIED = {name: [value] for name, value in SMALL.items() if name not in FIXED}


@pytest.mark.parametrize("workers", [[], pytest.param(["--workers", "1"], marks=pytest.mark.slow)])
def test_users_objects_and_functions_run_and_resume_with_the_text_that_they_had(
    workers: list[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code, table = tmp_path / "mine.py", tmp_path / "s" / TABLE
    code.write_text(MINE.format(value=1.0))
    users = ["--task", "mine.py:task", "--setting", json.dumps(SEEN)]
    users += ["--episodes", "2", "--no-progress", "--folder", "s"]
    for grid in (["--train", json.dumps(VARIED)], ["--policy", "mine.py:back"]):
        script("sweep", *grid, *users, cwd=tmp_path)
        before, (row, *_) = table.read_bytes(), rows_of(tmp_path / "s")
        assert (row["task"], row["observation"], row["error"]) == ("mine.py:task", "mine.py:angle", "")
        code.write_text(MINE.format(value=2.0))
        (tmp_path / "s" / LOG).unlink()
        said = script("sweep", "--resume", "s", cwd=tmp_path, status=2).stderr
        assert "s runs code ('mine.py:" in said
        monkeypatch.setattr(user_code, "_loaded", {})  # as in a new process
        script("sweep", "--resume", "s", "--trust", "--no-progress", *workers, cwd=tmp_path)
        assert table.read_bytes() == before
        (tmp_path / "s").rename(tmp_path / f"{grid[0]} ended")
        code.write_text(MINE.format(value=1.0))


def test_a_model_plays_in_the_environment_of_its_row(tmp_path: Path) -> None:
    envs = make_sb3_vec_env(1, task="spin", action_repeat=4, episode_steps=50, max_episode_steps=9)
    save_model(PPO("MlpPolicy", envs), tmp_path / "model.zip")
    grid = ["--policy", "model.zip", "--trust", "--setting", "exact", "coarse", "--episodes", "2", "--no-progress"]
    script("sweep", *grid, "--folder", "s", cwd=tmp_path)
    policy = find_policy(str(tmp_path / "model.zip"), EnvSettings(), trust=True).policy
    for row, fidelity in zip(rows_of(tmp_path / "s"), ("exact", "coarse"), strict=True):
        returns = evaluate("", PolicyWithEnv(policy, {"action_repeat": 4}), {"fidelity": fidelity}, 2, 0)
        assert (row["task"], row["error"], float(row["mean"])) == ("juggle", "", returns.mean)


def test_a_training_that_was_cut_short_starts_over_to_the_same_row(tmp_path: Path) -> None:
    interface = json.dumps({"observation": "landing", "action": "discrete", "action_repeat": 10})
    varied = VARIED | {"total_steps": [768], "learning_rate": [1e-3, 5e-4]}
    grid = ["--train", json.dumps(varied), "--setting", interface, "--episodes", "2"]
    script("sweep", *grid, "--folder", "s", "--no-progress", cwd=tmp_path)
    table, rows = (tmp_path / "s" / TABLE).read_bytes(), rows_of(tmp_path / "s")
    assert [row["learning_rate"] for row in rows] == ["0.001", "0.0005"]
    assert (rows[0]["observation"], rows[0]["action"], rows[0]["action_repeat"]) == ("landing", "discrete", "10")
    assert rows[0]["mean"] != rows[1]["mean"]
    (tmp_path / "s" / LOG).unlink()
    for run in (tmp_path / "s" / RUNS).iterdir():
        _, *checkpoints = sorted((run / "checkpoints").iterdir(), key=lambda path: path.stat().st_mtime_ns)
        for path in (run / "model.zip", run / "best_model.zip", run / "evaluations.npz", *checkpoints):
            path.unlink()  # as a kill soon after its start leaves it
    script("sweep", "--resume", "s", "--no-progress", cwd=tmp_path)
    assert (tmp_path / "s" / TABLE).read_bytes() == table
