"""The sweep of speed against accuracy: its cases and settings, its command, and that it survives interruptions."""

from __future__ import annotations

import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from jackbox_env import FIDELITIES, Scene
from jackbox_env.simulators.pymunk import PymunkSimulator
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


def test_seeded_cases_are_the_same_every_time_and_differ_by_seed_and_kind() -> None:
    for kind in cases.KINDS:
        one, again, other = cases.seeded(kind, 1), cases.seeded(kind, 1), cases.seeded(kind, 2)
        np.testing.assert_array_equal(one.state, again.state)
        assert one.torques == again.torques
        assert np.abs(one.state - other.state).max() > 1e-3
    assert cases.seeded("chirp", 0).torques is None
    held = cases.seeded("held", 0).torques
    assert held is not None
    assert len(held) == 500
    assert max(map(abs, held)) > 0.9 * Scene().torque_limit
    assert cases.seeded("weightless", 0).scene == Scene(gravity=0.0, drive=None)


def test_the_trajectories_known_to_60_digits_are_all_there() -> None:
    known = cases.with_references(cases.DIGITS, 0)
    assert len(known) == 10
    assert sum(reference.sure for _, reference in known) == 73
    default = next(reference for case, reference in known if case.steps == 500)
    assert default.impacts[0].time == pytest.approx(1.0205739846186, abs=1e-13)


def test_the_trajectories_with_loss_are_all_there_for_those_that_take_loss() -> None:
    known = cases.with_references(cases.LOSS, 0)
    assert len(known) == 10
    assert sum(reference.sure for _, reference in known) == 41
    assert {case.scene.restitution for case, _ in known} == {0.95, 0.9, 0.8, 0.7, 0.6}
    taken = {one.family.split(",")[0] for one in settings.settings(quick=False) if one.takes_loss}
    assert {"exact", "pymunk"} <= taken <= {"exact", "pymunk", "box2d"}


def test_the_full_sweep_covers_substeps_iterations_and_both_models() -> None:
    names = [setting.name for setting in settings.settings(quick=False)]
    assert len(names) == len(set(names))
    for substeps in (1, 2, 4, 8, 16, 32, 64, 128, 256):
        assert f"pymunk, {substeps} substep{'s' * (substeps > 1)}" in names
    for iterations in (1, 2, 5, 10, 20):
        assert f"pymunk, 4 substeps, {iterations} iteration{'s' * (iterations > 1)}" in names
    assert {"exact", "exact, 1,024 at once", "usual way, RK4 at 0.01 s"} < set(names)
    quick = [setting.name for setting in settings.settings(quick=True)]
    assert {*map(settings.of_fidelity, FIDELITIES)} < set(quick)


def test_the_solvers_iterations_are_those_asked_for() -> None:
    for asked, used in ((2, 2), (None, 64)):
        make = settings.pymunk(4, asked).make
        assert make is not None
        simulator = make(Scene())
        assert isinstance(simulator, PymunkSimulator)
        assert (simulator.substeps, simulator.iterations) == (4, used)


def test_only_an_unfinished_sweep_of_the_same_code_and_arguments_continues(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = {"quick": True, "cases": 2}
    first = sweep.open_folder("benchmark", asked, None)
    assert sweep.open_folder("benchmark", asked, None) == first
    assert sweep.open_folder("benchmark", asked, first) == first
    for change in ({**asked, "cases": 3}, {**asked, "quick": False}):
        with pytest.raises(FileExistsError, match="runs are never overwritten"):
            sweep.open_folder("benchmark", change, first)
    with monkeypatch.context() as patch:
        patch.setattr(sweep, "digest", lambda asked: "other code")
        with pytest.raises(FileExistsError, match="runs are never overwritten"):
            sweep.open_folder("benchmark", asked, first)
    (first / sweep.BESIDE).mkdir()
    (first / sweep.BESIDE / results.ABOUT).write_text("{}")  # finished
    with pytest.raises(FileExistsError, match="runs are never overwritten"):
        sweep.open_folder("benchmark", asked, first)
    assert sweep.open_folder("benchmark", asked, Path("another")) == Path("another")


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
