"""The sweep of speed against accuracy: its cases, its command, its interruptions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from jackbox_env import FIDELITIES
from scripts import referee
from scripts.studies.accuracy import benchmark, measured

FEW = ("--quick", "--cases", "2", "--rounds", "1", "--seconds", "0.001", "--no-progress")


def test_the_referee_scores_an_engine_of_the_study() -> None:
    (pymunk,) = (one for one in measured.contenders(quick=True) if one.name == measured.DEFAULT)
    record = measured.refereed(pymunk, referee.reference()["bounce"])
    assert record["kind"] == measured.REFERENCE
    assert record["prefix"] == record["correct"] == 1
    assert 0.0 < record["errors"][0] < 0.005
    values = {quantity.name: quantity.values([record]) for quantity in measured.REFEREED}
    assert values["first_1"] == values["impact_1"] == record["errors"]
    assert values["first_3"] == values["impact_2"] == []
    assert values["lacking"] == [0]


def test_an_interrupted_sweep_continues_to_the_results_of_an_uninterrupted_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of_all, few, one_case, cases = measured.settings, dict(list(referee.reference().items())[:2]), measured.measured, []
    names = {measured.THRESHOLD, measured.pymunk(4, 1).name, measured.BATCH, *map(measured.of_fidelity, FIDELITIES)}
    monkeypatch.setattr(measured, "settings", lambda quick: [one for one in of_all(quick) if one.name in names])
    monkeypatch.setattr(referee, "reference", lambda: few)
    monkeypatch.setattr(measured, "STEPS", 150)
    monkeypatch.setattr(measured, "TOGETHER", 2)
    for name in ("draw", "draw_impacts"):  # test_accuracy_page draws
        monkeypatch.setattr(benchmark, name, lambda *arguments: None)
    monkeypatch.setattr(benchmark, "claims", lambda records: [])  # cases are too short for some

    def counted(*arguments: Any) -> Any:
        cases.append(arguments[0].name)
        if len(cases) == 20:
            raise KeyboardInterrupt
        return one_case(*arguments)

    def run(folder: Path) -> measured.Results:
        monkeypatch.setattr(sys, "argv", ["benchmark.py", *FEW, "--runs", str(folder)])
        benchmark.main()
        return measured.Results.load(folder / benchmark.BESIDE)

    monkeypatch.setattr(measured, "measured", counted)
    with pytest.raises(SystemExit) as stopped:
        run(tmp_path / "cut")
    assert stopped.value.code == 130
    cut = run(tmp_path / "cut")
    assert len(cases) == 20 + 3 * 6 * 2 - 2 * 9  # the tenth trial is lost
    whole = run(tmp_path / "whole")
    assert len(whole.rows) > 300
    for key, row in whole.rows.items():
        if not row.quantity.startswith("cost"):
            assert repr(cut.rows[key]) == repr(row)  # NaN equals NaN
    assert benchmark.fidelity_table(whole) in (tmp_path / "whole" / benchmark.PAGE).read_text()
