"""The soak command: a bounded report, the same whether interrupted or not, that says which law was broken."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import pytest

from agents.storage import held
from jackbox_env.simulators.exact import ExactSimulator
from scripts.studies.laws import soak
from scripts.studies.laws.laws import Examination, examine
from scripts.studies.laws.random_cases import Case, SeededDraw, draw_case

MEASURED = {"seconds", "spent", "memory_at_start", "memory_at_end", "sittings"}


def run(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> int:
    """The command's exit status."""
    monkeypatch.setattr(sys, "argv", ["soak.py", "--no-progress", *arguments])
    with pytest.raises(SystemExit) as ended:
        soak.main()
    return int(ended.value.code or 0)


def found_in(folder: Path) -> dict[str, Any]:
    """What a report says, but for how long it took."""
    report = asdict(soak.read_report(folder))
    return {name: value for name, value in report.items() if name not in MEASURED}


def test_an_interrupted_soak_goes_on_to_the_report_of_one_that_was_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    whole, parted = tmp_path / "whole", tmp_path / "parted"
    settings = ("--cases", "6", "--seed", "3")
    assert run(monkeypatch, *settings, "--out", str(whole)) == 0
    assert "finished: 6 cases of pymunk, exact" in (whole / "report.txt").read_text()
    calls = 0

    def interrupted(case: Case) -> Examination:
        nonlocal calls
        calls += 1
        if calls in (6, 9):  # within a seed: one of the two models is done
            raise KeyboardInterrupt
        return examine(case)

    monkeypatch.setattr(soak, "examine", interrupted)
    assert run(monkeypatch, *settings, "--out", str(parted)) == 130
    assert "interrupted: 2 cases" in (parted / "report.txt").read_text()
    assert run(monkeypatch, "--resume", str(parted)) == 130
    assert run(monkeypatch, "--resume", str(parted)) == 0
    assert f"Go on with: python scripts/studies/laws/soak.py --resume {parted}" in capsys.readouterr().err
    assert found_in(parted) == found_in(whole)
    assert soak.read_report(parted).sittings == 3
    assert run(monkeypatch, *settings, "--out", str(whole)) == 2  # never overwritten
    assert "runs are never overwritten" in capsys.readouterr().err


def test_a_soak_under_way_is_not_joined_and_a_damaged_report_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "soak"
    folder.mkdir()
    soak.write_report(soak.Report(0, ["exact"], None, 1), folder)
    with held(folder):
        assert run(monkeypatch, "--resume", str(folder)) == 2
    assert capsys.readouterr().err.startswith(f"{folder} is in use by process {os.getpid()}")
    assert soak.read_report(folder).done == 0
    report = (folder / "report.json").read_bytes()
    (folder / "report.json").write_bytes(report[: len(report) // 2])
    assert run(monkeypatch, "--resume", str(folder)) == 2
    assert capsys.readouterr().err.startswith(f"{folder / 'report.json'} is damaged (")
    (folder / "report.json").write_bytes(report)
    assert run(monkeypatch, "--resume", str(folder)) == 0


def test_a_broken_law_is_reported_kept_and_replayed_and_the_report_stays_small(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    step = ExactSimulator.step

    def gains(self: ExactSimulator, dt: float, torque: float | None = None) -> None:
        step(self, dt, torque)
        state = self.state
        state[8] += 1e-3
        self._present = self._present._replace(state=state)

    monkeypatch.setattr(ExactSimulator, "step", gains)
    assert run(monkeypatch, "--cases", "15", "--contact", "exact", "--out", str(tmp_path / "broken")) == 1
    report = soak.read_report(tmp_path / "broken")
    assert report.failures == 15
    assert report.broken["energy"] > 5
    assert len(report.kept) == 10
    first = report.kept[0]
    assert first["replay"] == "python scripts/studies/laws/soak.py --replay 0 --contact exact"
    assert first["case"] == json.loads(json.dumps(draw_case(SeededDraw(0), "exact").as_json()))
    assert first["replay"] in (tmp_path / "broken" / "report.txt").read_text()
    assert sum(path.stat().st_size for path in (tmp_path / "broken").iterdir()) < 100_000
    capsys.readouterr()
    assert run(monkeypatch, "--replay", "0", "--contact", "exact") == 1
    assert first["found"] in capsys.readouterr().out
    monkeypatch.setattr(ExactSimulator, "step", step)
    assert run(monkeypatch, "--replay", "0", "--contact", "exact") == 0
    assert "all laws hold" in capsys.readouterr().out


def test_a_soak_by_time_ends_in_time_and_the_report_does_not_grow(tmp_path: Path) -> None:
    report = soak.soak(soak.Report(0, ["pymunk"], 1.0, None), tmp_path, progress=False)
    assert report.finished
    assert 1.0 <= report.spent < 10.0
    assert report.done >= 1
    for number in range(1000):
        found = Examination(refused=f"for the reason {'abcdefgh'[number % 8]}{chr(200 + number)} {number}")
        found.measure("energy", float(number), 1.0)
        report.enter("pymunk", number, draw_case(SeededDraw(number), "pymunk", steps=2), found)
    assert report.worst["pymunk"]["energy"]["value"] == 999.0
    assert report.worst["pymunk"]["energy"]["seed"] == 999
    assert len(report.refused) <= 21
    assert sum(report.refused.values()) >= 1000
    assert len(json.dumps(asdict(report))) < 100_000


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ([], "say how long by --hours and --minutes, or how many by --cases"),
        (["--cases", "3", "--hours", "1"], "say how long"),
        (["--minutes", "nan"], "minutes must be a finite number"),
        (["--cases", "0"], "cases must be a whole number from 1"),
        (["--resume", "nowhere"], "nowhere is no folder of a soak"),
        (["--resume", "nowhere", "--seed", "1"], "give no other setting beside it"),
    ],
)
def test_what_can_not_be_soaked_is_refused(
    arguments: list[str], sentence: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    assert run(monkeypatch, *arguments) == 2
    assert sentence in capsys.readouterr().err


def test_the_command_stands_alone() -> None:
    root = Path(__file__).parents[1]
    command = [sys.executable, "scripts/studies/laws/soak.py", "--replay", "1", "--contact", "pymunk"]
    ran = subprocess.run(command, cwd=root, capture_output=True, text=True, check=True)
    assert "pymunk: all laws hold" in ran.stdout
