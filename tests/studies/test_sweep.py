"""The sweep of speed against accuracy: its cases, its command, its interruptions."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest

from jackbox_env import FIDELITIES
from scripts.studies.accuracy import benchmark, measured

FEW = ("--quick", "--cases", "2", "--rounds", "1", "--seconds", "0.001", "--no-progress")


def test_the_trajectories_known_to_60_digits_are_all_there() -> None:
    known = measured.with_references(measured.DIGITS, 0)
    assert len(known) == 10
    assert sum(reference.sure for _, reference in known) == 73
    default = next(reference for case, reference in known if case.steps == 500)
    assert default.impacts[0].time == pytest.approx(1.0205739846186, abs=1e-13)


def test_an_interrupted_sweep_continues_to_the_results_of_an_uninterrupted_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    of_all, references, one_case, cases = measured.settings, measured.with_references, measured.measured, list[str]()
    names = {measured.USUAL, measured.pymunk(4, 1).name, measured.BATCH, *map(measured.of_fidelity, FIDELITIES)}
    monkeypatch.setattr(measured, "settings", lambda quick: [one for one in of_all(quick) if one.name in names])
    monkeypatch.setattr(measured, "with_references", lambda kind, count: references(kind, count)[:2])
    monkeypatch.setattr(measured, "STEPS", 150)
    monkeypatch.setattr(measured, "TOGETHER", 2)
    monkeypatch.setattr(benchmark, "draw", lambda results, path: None)  # test_accuracy_page draws
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
    assert len(cases) == 20 + (4 * 6 + 5) * 2 - 2 * 9  # the tenth trial is lost; the usual way takes no loss
    whole = run(tmp_path / "whole")
    assert len(whole.rows) > 300
    for key, row in whole.rows.items():
        if not row.quantity.startswith("cost"):
            assert repr(cut.rows[key]) == repr(row)  # NaN equals NaN
    assert benchmark.fidelity_table(whole) in (tmp_path / "whole" / benchmark.PAGE).read_text()
