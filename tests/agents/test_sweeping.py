"""Sweeps in this process: the table, interruptions, failures, refusals, the command."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable, Iterable, Iterator
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from agents.evaluation.returns import evaluate
from agents.files import FolderInUseError, locked
from agents.policies.registry import find_policy
from agents.settings import EnvSettings
from agents.sweeps import results_log, trials
from agents.sweeps.in_process import Finished, InTurn, Trial, Work, nothing
from agents.sweeps.on_ray import OnRay
from agents.sweeps.results_log import LOG, SWEEP, TABLE, TIMES, carry_out, new_sweep, read_sweep
from tests.agents.small_run import TINY
from tests.agents.test_commands import script

GRID = [Trial({"name": name, "number": number}) for name in ("one", "other") for number in range(5)]


def shares(settings: dict[str, Any]) -> dict[str, Any]:
    """A work that takes no time, with floats that need all their digits."""
    return {"share": (settings["number"] + len(settings["name"])) / 7.0, "list": [1, settings["name"]]}


class Backwards:
    """Finishes trials in the other order, as workers might."""

    def run(self, trials: Iterable[Trial], work: Work, look: Callable[[], None] = nothing) -> Iterator[Finished]:
        yield from InTurn().run(list(trials)[::-1], work, look)


def carried_out(path: Path, work: Work = shares, runner: Any = None) -> Path:
    folder = path if path.exists() else new_sweep(path, {}, GRID)
    carry_out(folder, GRID, work, runner or InTurn(), progress=False)
    return folder


def rows_of(folder: Path, name: str = TABLE) -> list[dict[str, str]]:
    with (folder / name).open() as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(("workers", "address"), [(0, None), (2.5, None), (2, "auto")])
def test_a_runner_on_ray_refuses_workers_in_one_sentence(workers: Any, address: str | None) -> None:
    with pytest.raises((TypeError, ValueError), match=f"^workers must .* got {workers}$"):
        OnRay(workers, address)


# -- the table ---------------------------------------------------------------------------------------------------------


def test_a_row_for_each_trial_in_the_order_of_the_grid(tmp_path: Path) -> None:
    rows = rows_of(carried_out(tmp_path / "sweep"))
    assert list(rows[0]) == ["name", "number", "share", "list", "error"]
    assert [(row["name"], int(row["number"])) for row in rows] == [tuple(trial.settings.values()) for trial in GRID]
    assert [float(row["share"]) for row in rows] == [shares(trial.settings)["share"] for trial in GRID]  # every bit
    assert json.loads(rows[0]["list"]) == [1, "one"]
    times = rows_of(tmp_path / "sweep", TIMES)
    assert [row["trial"] for row in times] == [trial.key for trial in GRID]
    assert all(float(row["seconds"]) >= 0.0 for row in times)


@pytest.mark.parametrize("runner", [Backwards(), InTurn()])
def test_the_table_does_not_depend_on_the_order_in_which_trials_finish(
    tmp_path: Path, runner: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("agents.sweeps.in_process.LOOK_AGAIN", 0.01)
    table = (carried_out(tmp_path / "in turn") / TABLE).read_bytes()
    assert (carried_out(tmp_path / "other", runner=runner) / TABLE).read_bytes() == table


# -- interruptions, kills and failures ---------------------------------------------------------------------------------


def test_an_interrupted_sweep_goes_on_without_what_has_finished(tmp_path: Path) -> None:
    table = (carried_out(tmp_path / "whole") / TABLE).read_bytes()
    asked: list[tuple[str, int]] = []

    def interrupted(settings: dict[str, Any]) -> dict[str, Any]:
        asked.append((settings["name"], settings["number"]))
        if len(asked) == 7:
            raise KeyboardInterrupt
        return shares(settings)

    with pytest.raises(KeyboardInterrupt):
        carried_out(tmp_path / "cut", interrupted)
    assert len(rows_of(tmp_path / "cut")) == 6
    carried_out(tmp_path / "cut", interrupted)
    assert len(asked) == 11  # the one that was interrupted began twice
    assert len(set(asked)) == 10
    assert (tmp_path / "cut" / TABLE).read_bytes() == table
    carried_out(tmp_path / "cut", interrupted)
    assert len(asked) == 11


@pytest.mark.parametrize("left", [1, 40, 100000])
def test_a_line_that_a_kill_cut_short_is_run_again(
    tmp_path: Path, left: int, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = carried_out(tmp_path / "sweep")
    table = (folder / TABLE).read_bytes()
    path, asked = folder / LOG, []
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(b"".join(lines[:-1]) + lines[-1][: min(left, len(lines[-1]) - 1)])

    def noted(settings: dict[str, Any]) -> dict[str, Any]:
        asked.append(settings)
        return shares(settings)

    carried_out(folder, noted)
    assert asked == [GRID[-1].settings]
    assert (folder / TABLE).read_bytes() == table
    assert [json.loads(line)["key"] for line in path.read_bytes().splitlines()] == [trial.key for trial in GRID]


def test_a_failing_trial_is_reported_with_its_settings_and_tried_again(tmp_path: Path) -> None:
    broken, asked = [True], list[dict[str, Any]]()

    def failing(settings: dict[str, Any]) -> dict[str, Any]:
        asked.append(settings)
        if broken[0] and settings["number"] == 3:
            raise ValueError(f"number must not be 3\nin {settings['name']}")
        return shares(settings)

    folder = new_sweep(tmp_path / "sweep", {}, GRID)
    outcome = carry_out(folder, GRID, failing, InTurn(), progress=False)
    assert [trial.settings for trial in outcome.failed] == [{"name": name, "number": 3} for name in ("one", "other")]
    assert outcome.finished == len(asked) == 10
    rows = rows_of(folder)
    assert [row["error"] for row in rows if row["number"] == "3"] == ["ValueError: number must not be 3"] * 2
    assert all(bool(row["error"]) == (row["share"] == "") for row in rows)
    lines = [json.loads(line) for line in (folder / LOG).read_text().splitlines()]
    assert "test_sweeping.py" in next(line["details"] for line in lines if line["error"])
    broken[0] = False
    assert not carry_out(folder, GRID, failing, InTurn(), progress=False).failed
    assert len(asked) == 12
    assert (folder / TABLE).read_bytes() == (carried_out(tmp_path / "whole") / TABLE).read_bytes()


# -- refusals ----------------------------------------------------------------------------------------------------------


def test_folders_are_not_shared_overwritten_or_continued_by_other_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder = carried_out(tmp_path / "sweep")
    assert read_sweep(folder) == ({}, GRID)
    with pytest.raises(FileExistsError, match="sweep exists, and is never overwritten"):
        new_sweep(folder, {}, GRID)
    with pytest.raises(FileNotFoundError, match="is no sweep: it has no sweep.json"):
        read_sweep(tmp_path)
    with locked(folder), pytest.raises(FolderInUseError, match="is in use by another process"):
        carried_out(folder)
    known = results_log.made_with()
    monkeypatch.setattr(results_log, "made_with", lambda: {**known, "numpy": "1.0"})
    with pytest.raises(ValueError, match=rf"begun with other code \(numpy {known['numpy']} there and 1.0 here\)"):
        read_sweep(folder)
    (folder / SWEEP).write_text("{")
    with pytest.raises(ValueError, match="sweep.json is damaged"):
        read_sweep(folder)
    for grid, said in (([], "at least one trial, got none"), ([*GRID, GRID[3]], "got twice")):
        with pytest.raises(ValueError, match=said):
            new_sweep(tmp_path / "new", {}, grid)
    assert not (tmp_path / "new").exists()


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ("--policy nobody", "policy"),
        ("--setting fast", "got 'fast'"),
        ("""--scene {"gravity":-1}""", "gravity"),
        ("--episodes 1", "episodes must be a whole number >= 2, got 1"),
        ("--setting exact exact", "got twice"),
        ("--workers 2 --address auto", "workers"),
        ("""--train {"hold":4}""", "got 4 for hold"),
        ("""--train {"hold":[3]}""", "hold"),
        ("""--train {} --policy zero""", "--policy"),
        ("--resume nowhere", "nowhere"),
        ("--resume nowhere --seeds 3", "--resume"),
    ],
)
def test_the_command_refuses_in_one_sentence_before_it_makes_a_folder(
    tmp_path: Path, arguments: str, sentence: str
) -> None:
    done = script("sweep", *arguments.split(), cwd=tmp_path, status=2)
    assert sentence in done.stderr
    assert len(done.stderr.strip().splitlines()) == 1
    assert not list(tmp_path.iterdir())


# -- the command -------------------------------------------------------------------------------------------------------

FEW = ["--policy", "zero", "level", "--setting", "exact", '{"contact": "pymunk", "substeps": 2}', "--episodes", "2"]


def test_the_command_gives_what_evaluating_gives(tmp_path: Path) -> None:
    done = script("sweep", *FEW, "--seeds", "2", "--scene", "{}", '{"gravity": 1.62}', "--folder", "s", cwd=tmp_path)
    assert done.stdout.startswith(f"16 trials: {Path('s') / TABLE}")
    rows = rows_of(tmp_path / "s")
    assert len(rows) == 16
    row = next(row for row in rows if (row["policy"], row["substeps"], row["seed"]) == ("level", "2", "1"))
    given = EnvSettings(contact="pymunk", substeps=2)
    policy, _ = find_policy("level", given, 1)
    assert float(row["mean"]) == evaluate("level", policy, given.env_settings, 2, 1).mean
    assert "never overwritten" in script("sweep", *FEW, "--folder", "s", cwd=tmp_path, status=2).stderr
    assert script("sweep", "--resume", "s", cwd=tmp_path).stdout == done.stdout


def test_the_command_is_interrupted_fails_and_goes_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    evaluated, asked, ends = trials.evaluated, [], [KeyboardInterrupt(), RuntimeError("the jack would leave the box")]

    def ending(settings: dict[str, Any]) -> dict[str, Any]:
        asked.append(settings)
        if len(asked) in (2, 4):
            raise ends.pop(0)
        return evaluated(settings)

    monkeypatch.setattr(trials, "evaluated", ending)
    command = "python scripts/sweep.py --resume s"
    done = script("sweep", *FEW, "--folder", "s", "--no-progress", cwd=tmp_path, status=130)
    assert done.stderr == f"\nInterrupted. Go on with: {command}\n"
    done = script("sweep", "--resume", "s", "--no-progress", cwd=tmp_path, status=1)
    said = "1 of 4 trials failed: s/table.csv says which, s/trials.jsonl where. Try them again with:"
    assert done.stderr == f"{said} {command}\n"
    assert [row["error"] for row in rows_of(tmp_path / "s")].count("RuntimeError: the jack would leave the box") == 1
    assert script("sweep", "--resume", "s", cwd=tmp_path).stdout == f"4 trials: {Path('s') / TABLE}\n"
    assert len(asked) == 6


# -- trainings ---------------------------------------------------------------------------------------------------------

SMALL = replace(TINY, contact="exact", total_steps=768, eval_steps=256, checkpoint_steps=256)


def test_a_training_that_was_cut_short_starts_over_to_the_same_row(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    names = [name for name in asdict(SMALL) if name not in ("seed", "torch_threads", *asdict(EnvSettings()))]
    varied = {name: [asdict(SMALL)[name]] for name in names} | {"learning_rate": [1e-3, 5e-4]}
    grid = trials.training_trials(varied, [EnvSettings(contact="exact")], 1, 2)
    assert [trial.settings["learning_rate"] for trial in grid] == [1e-3, 5e-4]
    folder = new_sweep(tmp_path / "sweep", {}, grid)
    carry_out(folder, grid, partial(trials.run_trial, folder), InTurn(), progress=False)
    rows = rows_of(folder)
    assert rows[0]["mean"] != rows[1]["mean"]
    run = folder / trials.RUNS / grid[0].key
    checkpoints = sorted((run / "checkpoints").iterdir(), key=lambda path: path.stat().st_mtime_ns)
    assert len(checkpoints) > 1
    for path in (run / "model.zip", run / "best_model.zip", run / "evaluations.npz", *checkpoints[1:]):
        path.unlink()  # as a kill soon after its start leaves it
    again = trials.trained(folder, grid[0].settings)
    assert repr(again["mean"]) == rows[0]["mean"]
    with pytest.raises(FileNotFoundError, match="must be on a disk that all machines share"):
        trials.trained(tmp_path / "elsewhere", grid[0].settings)
