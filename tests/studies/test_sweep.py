"""The sweep of speed against accuracy: its cases and settings, its command, and that it survives interruptions."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jackbox_env import FIDELITIES
from scripts.studies.accuracy import benchmark, cases, claims, page, pictures, results, settings, sweep

DOCS = Path(__file__).parents[2] / "docs"
FEW = ("--quick", "--cases", "2", "--rounds", "1", "--seconds", "0.001", "--no-progress")
Command = Callable[..., None]


@pytest.fixture
def command(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Command:
    """The command line in an empty folder, on few settings and short cases."""
    of_all, references = settings.settings, cases.with_references
    names = {settings.USUAL, settings.pymunk(4, 1).name, settings.BATCH, *map(settings.of_fidelity, FIDELITIES)}
    monkeypatch.setattr(sweep, "settings", lambda quick: [one for one in of_all(quick) if one.name in names])
    monkeypatch.setattr(cases, "with_references", lambda kind, count: references(kind, count)[:2])
    monkeypatch.setattr(cases, "STEPS", 150)
    monkeypatch.setattr(sweep, "TOGETHER", 2)
    monkeypatch.setattr(pictures, "draw", lambda results, path: None)  # test_accuracy_page draws
    monkeypatch.setattr(pictures, "draw_loss", lambda results, path: None)
    monkeypatch.setattr(pictures, "interactive", lambda results, path: None)
    monkeypatch.chdir(tmp_path)

    def run(*given: str) -> None:
        monkeypatch.setattr(sys, "argv", ["benchmark.py", *given])
        benchmark.main()

    return run


def test_the_trajectories_known_to_60_digits_are_all_there() -> None:
    known = cases.with_references(cases.DIGITS, 0)
    assert len(known) == 10
    assert sum(reference.sure for _, reference in known) == 73
    default = next(reference for case, reference in known if case.steps == 500)
    assert default.impacts[0].time == pytest.approx(1.0205739846186, abs=1e-13)


def test_only_an_unfinished_sweep_of_the_same_code_and_arguments_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = {"quick": True, "cases": 2}
    first = sweep.open_folder("benchmark", asked, None)
    assert sweep.open_folder("benchmark", asked, None) == first
    with pytest.raises(FileExistsError):
        sweep.open_folder("benchmark", {**asked, "cases": 3}, first)
    with monkeypatch.context() as patch:
        patch.setattr(sweep, "digest", lambda asked: "other code")
        with pytest.raises(FileExistsError):
            sweep.open_folder("benchmark", asked, first)
    (first / sweep.BESIDE).mkdir()
    (first / sweep.BESIDE / results.ABOUT).write_text("{}")  # finished
    with pytest.raises(FileExistsError):
        sweep.open_folder("benchmark", asked, first)


def test_an_interrupted_sweep_continues_to_the_results_of_an_uninterrupted_one(
    command: Command, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(claims, "claims", lambda found: [])  # cases are too short for some
    measured, taken = sweep.measured, list[str]()

    def counted(*given: Any) -> Any:
        taken.append(given[0].name)
        if len(taken) == 20:
            raise KeyboardInterrupt
        return measured(*given)

    monkeypatch.setattr(sweep, "measured", counted)
    with pytest.raises(SystemExit) as stopped:
        command(*FEW)
    assert stopped.value.code == 130
    assert "the same command continues" in capsys.readouterr().err
    (folder,) = (tmp_path / "runs").iterdir()
    assert len(list((folder / sweep.RECORDS).iterdir())) == 9  # of two cases; the tenth is lost
    command(*FEW)
    assert len(taken) == 20 + (4 * 6 + 5) * 2 - 2 * 9  # the usual way takes no loss
    cut = results.Results.load(folder / sweep.BESIDE)
    folder.rename(tmp_path / "cut")
    command(*FEW)
    (folder,) = (tmp_path / "runs").iterdir()
    whole = results.Results.load(folder / sweep.BESIDE)
    assert len(whole.rows) > 300
    for key, row in whole.rows.items():
        if not row.quantity.startswith("cost"):
            assert repr(cut.rows[key]) == repr(row)  # NaN equals NaN
    assert page.fidelity_table(whole) in (folder / sweep.PAGE).read_text()
