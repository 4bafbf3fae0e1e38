"""The sweep of speed against accuracy: what it sums up, what it claims, and that it survives interruptions."""

from __future__ import annotations

import copy
import csv
import json
import math
import os
import re
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.storage import held
from jackbox_env import FIDELITIES, JackInBoxEnv, Scene
from jackbox_env.simulators.pymunk import PymunkSimulator
from scripts.studies.accuracy import benchmark, cases, page, pictures, records, settings, summary

ROOT = Path(__file__).parents[1]
STORED = ROOT / "docs" / "accuracy" / "results.json"


@pytest.fixture(scope="module")
def stored() -> dict[str, Any]:
    found: dict[str, Any] = json.loads(STORED.read_text())
    return found


# -- cases and settings ------------------------------------------------------------------------------------------------


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
    known = cases.known_to_60_digits()
    assert len(known) == 10
    assert sum(reference.sure for _, reference in known) == 73
    default = next(reference for case, reference in known if case.steps == 500)
    assert default.impacts[0].time == pytest.approx(1.0205739846186, abs=1e-13)


def test_the_full_sweep_covers_substeps_iterations_and_both_models() -> None:
    names = [setting.name for setting in settings.settings(quick=False)]
    assert len(names) == len(set(names))
    for substeps in (1, 2, 4, 8, 16, 32, 64, 128, 256):
        assert f"pymunk, {substeps} substep{'s' * (substeps > 1)}" in names
    for iterations in (1, 2, 5, 10, 20):
        assert f"pymunk, 4 substeps, {iterations} iteration{'s' * (iterations > 1)}" in names
    assert {"exact", "exact, 1,024 at once", "usual way, RK4 at 0.01 s"} < set(names)
    quick = [setting.name for setting in settings.settings(quick=True)]
    for fidelity in FIDELITIES:
        assert page.setting_of(fidelity) in quick


def test_the_solvers_iterations_are_those_asked_for() -> None:
    for asked, used in ((2, 2), (None, 64)):
        made = settings.pymunk(4, asked).make
        assert made is not None
        simulator = made(Scene())
        assert isinstance(simulator, PymunkSimulator)
        assert (simulator.substeps, simulator.iterations) == (4, used)


# -- summing up --------------------------------------------------------------------------------------------------------


def test_medians_worst_and_means_of_known_numbers() -> None:
    assert summary.Spread.of([3.0, 1.0, math.nan, 2.0]) == (2.0, 3.0, 3)
    assert summary.Spread.of([3.0, 1.0, 2.0], least=True) == (2.0, 1.0, 3)
    assert summary.Spread.of([math.nan]).n == 0
    # 1, 2, 3: standard deviation 1
    assert tuple(summary.Mean.of([1.0, 2.0, 3.0, math.nan])) == pytest.approx((2.0, 1.96 / math.sqrt(3.0), 3))
    assert summary.Mean.of([5.0]).half_width == math.inf


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0])
def test_a_planted_order_of_convergence_is_found_within_its_interval(order: float) -> None:
    rng = np.random.default_rng(0)
    steps = [0.02 / 2**number for number in range(7)]
    errors = {h: {f"case {n}": 3.0 * h**order * math.exp(0.3 * rng.normal()) for n in range(60)} for h in steps}
    found = summary.order_of(errors)
    assert found.order == pytest.approx(order, abs=0.08)
    assert found.low < order < found.high
    assert found.high - found.low < 0.3


def test_errors_over_the_first_impacts_need_so_many() -> None:
    found = [{"errors": [1.0, 3.0, 2.0], "prefix": 3}, {"errors": [5.0], "prefix": 1}]
    assert summary.over_first(found, 1) == [1.0, 5.0]
    assert summary.over_first(found, 3) == [3.0]


def test_claims_hold_in_the_stored_results_and_each_fails_where_it_is_broken(stored: dict[str, Any]) -> None:
    assert [claim.what for claim in summary.claims(stored) if not claim.holds] == []
    digits, seeds = cases.DIGITS, summary.ALL

    def broken(change: Any) -> list[str]:
        results = copy.deepcopy(stored)
        change(results["settings"], results)
        return [claim.what for claim in summary.claims(results) if not claim.holds]

    exact, coarse = "exact", "pymunk, 2 substeps"
    breakages = [
        lambda s, r: s[exact]["kinds"][digits]["first_1"].update(worst=1e-10),
        lambda s, r: s[exact]["kinds"][digits]["first_5"].update(worst=1e-9),
        lambda s, r: s[exact]["kinds"][digits].update(lacking=1),
        lambda s, r: s[exact]["kinds"][digits]["flight"].update(worst=1e-9),
        lambda s, r: s[exact]["kinds"][seeds]["depth"].update(worst=1e-6),
        lambda s, r: s[coarse]["kinds"][seeds]["first_1"].update(worst=0.011),
        lambda s, r: s[coarse]["kinds"][seeds].update(with_impacts=10**6),
        lambda s, r: r["orders"]["first_1"].update(order=0.5),
        lambda s, r: s[coarse]["kinds"][seeds].update(escaped=1),
    ]
    assert [len(broken(change)) for change in breakages] == [1] * len(breakages)
    assert len({broken(change)[0] for change in breakages}) == len(summary.claims(stored))


# -- records -----------------------------------------------------------------------------------------------------------


def test_what_is_measured_is_kept_line_by_line_also_after_a_cut(tmp_path: Path) -> None:
    one, other = {"setting": "a", "case": "x", "depth": 1.0}, {"setting": "a", "case": "y", "depth": None}
    records.append(tmp_path, one)
    with (tmp_path / records.RECORDS).open("a") as file:
        file.write('{"setting": "a", "ca')  # interrupted in the middle of a line
    records.append(tmp_path, other)
    with (tmp_path / records.RECORDS).open("ab") as file:
        file.write(b"\x00\xff\n[1, 2]\n{}\n")
    assert records.read(tmp_path) == {("a", "x"): one, ("a", "y"): other}


def test_only_an_unfinished_sweep_of_the_same_code_and_arguments_is_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    asked = {"quick": True, "cases": 2}
    first = records.open_folder(asked, None, "benchmark")
    assert records.open_folder(asked, None, "benchmark") == first
    assert records.open_folder(asked, first, "benchmark") == first
    for change in ({**asked, "cases": 3}, {**asked, "quick": False}):
        with pytest.raises(FileExistsError, match="runs are never overwritten"):
            records.open_folder(change, first, "benchmark")
    with monkeypatch.context() as patch:
        patch.setattr(records, "digest", lambda: "other code")
        with pytest.raises(FileExistsError, match="runs are never overwritten"):
            records.open_folder(asked, first, "benchmark")
    (first / records.RESULTS).write_text("{")  # cut short
    assert records.open_folder(asked, first, "benchmark") == first
    assert f"Skipped: {first / records.RESULTS} is damaged" in capsys.readouterr().err
    (first / records.RESULTS).write_text("{}")
    with pytest.raises(FileExistsError, match="is finished"):
        records.open_folder(asked, first, "benchmark")
    second = records.open_folder(asked, Path("another"), "benchmark")
    assert second == Path("another")
    assert (second / records.ARGUMENTS).is_file()


# -- the command -------------------------------------------------------------------------------------------------------

FEW = ["--quick", "--cases", "2", "--rounds", "1", "--seconds", "0.001", "--no-progress"]


def few_settings(quick: bool) -> list[settings.Setting]:
    names = ("exact", "exact, 1,024 at once", "pymunk, 2 substeps", "pymunk, 4 substeps", "pymunk, 64 substeps")
    return [setting for setting in settings_of(quick) if setting.name in names]


settings_of = settings.settings


def test_a_folder_whose_arguments_were_cut_short_is_not_gone_on_with(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    broken = tmp_path / "runs" / "benchmark-0"
    broken.mkdir(parents=True)
    (broken / records.ARGUMENTS).write_text('{"quick": tr')
    assert records.open_folder({"quick": True}, None, "benchmark") != broken


def test_a_sweep_under_way_is_not_joined_by_another(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    folder = records.open_folder({"quick": True, "cases": 2}, None, "benchmark-quick")
    monkeypatch.setattr(sys, "argv", ["benchmark.py", *FEW])
    with held(folder), pytest.raises(SystemExit):
        benchmark.main()
    assert capsys.readouterr().err.startswith(f"{folder} is in use by process {os.getpid()}")
    assert {path.name for path in folder.iterdir()} == {records.ARGUMENTS, "lock"}


def test_what_draws_the_pictures_is_asked_for_before_the_sweep(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setitem(sys.modules, "bokeh", None)
    monkeypatch.setattr(sys, "argv", ["benchmark.py", "--quick"])
    with pytest.raises(SystemExit):
        benchmark.main()
    assert "this command needs more packages" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_an_interrupted_sweep_goes_on_to_the_records_of_an_uninterrupted_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(settings, "settings", few_settings)
    monkeypatch.setattr(settings, "TOGETHER", 2)
    monkeypatch.setattr(cases, "STEPS", 150)
    whole, cut = tmp_path / "whole", tmp_path / "cut"
    measured, done = records.measured, [0]

    def stops(*given: Any) -> dict[str, Any]:
        done[0] += 1
        if done[0] == 30:
            raise KeyboardInterrupt
        return measured(*given)

    monkeypatch.setattr(sys, "argv", ["benchmark.py", *FEW, "--folder", str(cut)])
    with monkeypatch.context() as patch:
        patch.setattr(records, "measured", stops)
        with pytest.raises(SystemExit) as stopped:
            benchmark.main()
    assert stopped.value.code == 130
    assert "the same command goes on" in capsys.readouterr().err
    assert len(records.read(cut)) == 29
    assert not (cut / records.RESULTS).exists()
    for folder in (cut, whole):
        monkeypatch.setattr(sys, "argv", ["benchmark.py", *FEW, "--folder", str(folder)])
        benchmark.main()
    assert len((cut / records.RECORDS).read_text().splitlines()) == 4 * (10 + 3 * 2)
    assert records.read(cut) == records.read(whole)
    said = capsys.readouterr().out
    assert said.count("holds: exact: the first impact of every 60-digit trajectory") == 2
    check_outputs(whole)


def check_outputs(folder: Path) -> None:
    results = json.loads((folder / records.RESULTS).read_text())
    written = (folder / benchmark.PAGE).read_text()
    for line in page.fidelity_table(results):
        assert line in written
    rows = list(csv.DictReader((folder / benchmark.TABLE).read_text().splitlines()))
    row = next(
        row for row in rows if (row["setting"], row["kind"], row["quantity"]) == ("exact", "60 digits", "first_1")
    )
    assert float(row["worst"]) == pytest.approx(results["settings"]["exact"]["kinds"]["60 digits"]["first_1"]["worst"])
    assert (folder / benchmark.PICTURE).read_bytes().startswith(b"\x89PNG")
    interactive = (folder / benchmark.INTERACTIVE).read_text()
    assert "pymunk, 64 substeps" in interactive
    assert not re.search(r"<(script|link)[^>]+(src|href)=", interactive)  # it needs nothing from elsewhere


def test_claims_that_do_not_hold_fail_the_command_and_show_on_the_page(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(settings, "settings", few_settings)
    monkeypatch.setattr(settings, "TOGETHER", 2)
    monkeypatch.setattr(cases, "STEPS", 150)
    monkeypatch.setattr(summary, "claims", lambda results: [summary.Claim("two is three", "2", False)])
    monkeypatch.setattr(sys, "argv", ["benchmark.py", *FEW, "--folder", str(tmp_path / "run")])
    with pytest.raises(SystemExit) as failed:
        benchmark.main()
    assert failed.value.code == 2
    assert "claims do not hold: two is three" in capsys.readouterr().err
    assert "| two is three | 2 | FAILS |" in (tmp_path / "run" / benchmark.PAGE).read_text()


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        (["--cases", "1"], "cases must be a whole number >= 2, got 1"),
        (["--rounds", "0"], "rounds must be a whole number >= 1, got 0"),
        (["--seconds", "0"], "seconds must be a finite number above 0, got 0.0"),
        (["--out", "nowhere"], "nowhere is no folder to write a page in"),
    ],
)
def test_bad_arguments_are_refused_before_anything_is_made(
    given: list[str], sentence: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "argv", ["benchmark.py", *given])
    with pytest.raises(SystemExit) as refused:
        benchmark.main()
    assert refused.value.code == 2
    assert sentence in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


# -- what is stored ----------------------------------------------------------------------------------------------------


def test_the_environments_docstring_holds_the_measured_table(stored: dict[str, Any]) -> None:
    doc = " ".join((JackInBoxEnv.__doc__ or "").split())
    for line in page.fidelity_table(stored):
        assert " ".join(line.split()) in doc, "copy the table of docs/accuracy.md into JackInBoxEnv's docstring"


def test_the_stored_sweep_is_a_full_one_and_the_page_is_made_from_it(stored: dict[str, Any]) -> None:
    assert stored["arguments"]["quick"] is False
    assert stored["arguments"]["cases"] * len(cases.KINDS) >= 100
    assert set(stored["settings"]) >= {setting.name for setting in settings.settings(quick=False)}
    files = [f"[{name}](accuracy/{name})" for name in (records.RESULTS, benchmark.TABLE)]
    made = page.page(stored, f"accuracy/{benchmark.PICTURE}", f"accuracy/{benchmark.INTERACTIVE}", files)
    assert made == (ROOT / "docs" / "accuracy.md").read_text()


def test_the_readme_holds_the_verdicts_and_the_table(stored: dict[str, Any]) -> None:
    readme = (ROOT / "README.md").read_text()
    assert page.for_the_readme(stored) in readme, "make readme"


def test_the_readme_and_the_docstring_say_over_how_many_scenes(stored: dict[str, Any]) -> None:
    count = stored["settings"][page.DEFAULT]["kinds"][summary.ALL]["cases"]
    for text in ((ROOT / "README.md").read_text(), JackInBoxEnv.__doc__ or ""):
        assert f"over {count} seeded scenes of 10 s" in " ".join(text.split())


def test_wording_does_not_throw_a_sweep_away_but_code_does(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    sweep = tmp_path / "scripts" / "sweep"
    sweep.mkdir(parents=True)
    monkeypatch.setattr(records, "ROOT", tmp_path)
    (sweep / "page.py").write_text("one")
    (sweep / "cases.py").write_text("one")
    first = records.digest()
    (sweep / "page.py").write_text("other")
    assert records.digest() == first
    (sweep / "cases.py").write_text("other")
    assert records.digest() != first


def test_pictures_show_every_setting_that_has_a_value(stored: dict[str, Any]) -> None:
    shown = {point.name for line in pictures.points(stored, pictures.PANELS[0]).values() for point in line}
    assert shown == set(stored["settings"])


def test_numbers_in_tables_are_short_and_say_what_they_mean() -> None:
    wanted = {0.0: "0", 1234.5: "1,234", 12.34: "12", 0.001234: "0.0012", 1.234e-5: "1.2e-05", 3.0: "3"}
    assert {value: page.figure(value) for value in wanted} == wanted
    assert page.figure(math.nan) == "-"
    assert page.figure(math.inf) == "lost"
