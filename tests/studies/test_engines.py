"""Engines that people use, on the proven motions: the adapters, the search, and results that stay as stored."""

from __future__ import annotations

import copy
from pathlib import Path
from typing import Any

import pytest

from jackbox_env import cheapest
from scripts.studies.accuracy import accuracy, engines, measured
from scripts.studies.baselines import javascript

RECORD = accuracy.STUDY.read(Path(__file__).parents[2] / "docs")
RESULTS = measured.Results.of_record(RECORD)
FINEST = [(name, engine.points[-1]) for name, engine in engines.ENGINES.items()]


def installed(name: str) -> engines.Engine:
    """The engine; skips the test if it is not installed."""
    engine = engines.ENGINES[name]
    return engine if engine.version else pytest.skip("an engine is missing: see engines in the Makefile")


@pytest.mark.parametrize(("name", "point"), FINEST)
def test_an_adapter_plays_a_bounce_and_cases_with_loss_torque_and_chirp(name: str, point: float) -> None:
    cases = "bounce", "held-e0.95", "chirp-e0.9", "heavy-jack"
    scores = {one.case: one for one in engines.scores_of(name, point, installed(name).best, cases=cases)}
    assert scores.keys() == {*cases}
    assert all(one.complete and not one.escaped for one in scores.values())
    assert max(one.pose or 0.0 for one in scores.values()) < 0.2
    assert scores["bounce"].errors is not None
    assert scores["bounce"].errors[0] < (1e-10 if name == "Drake" else 0.02 / point)
    assert (scores["bounce"].imbalance or 0.0) < 1e-3


def test_an_adapter_that_fails_says_why_and_a_package_that_is_missing_has_no_version() -> None:
    assert javascript.version("no-such-package-of-jackbox") == ""
    installed("matter.js")
    with pytest.raises(RuntimeError, match="SyntaxError"):
        javascript.play("matter", {"substeps": float("nan")})


# -- the search --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("stored", RECORD["search"], ids=lambda stored: str(stored["setting"][0]))
def test_an_engine_has_the_best_settings_of_the_stored_search(stored: dict[str, Any]) -> None:
    engine = engines.ENGINES[stored["setting"][0]]
    assert engine.best == stored["best"]
    assert engine.best.keys() == engine.tried.keys()
    assert all(engine.best[name] in values for name, values in engine.tried.items())


# -- results -----------------------------------------------------------------------------------------------------------


def test_results_of_engines_that_are_not_installed_stay_as_stored_and_the_page_says_so() -> None:
    assert "not installed here" not in accuracy.STUDY.page(RECORD)
    new = {
        part: [one for one in copy.deepcopy(RECORD[part]) if one["setting"][1] != "Rapier"] for part in engines.PARTS
    }
    merged = engines.with_stored(new, RECORD)
    for part in ("engines", "engine_costs"):
        stored = {one["setting"][0]: one["rows"] for one in RECORD[part]}
        assert {one["setting"][0]: one["rows"] for one in merged[part]} == stored
        assert {one["setting"][1] for one in merged[part] if "kept" in one} == {"Rapier"}
    page = accuracy.STUDY.page(RECORD | merged)
    assert page.count("Rapier is not installed here: its results are of an earlier run.") == 1
    assert page.count("not installed here") == 1


@pytest.mark.parametrize("bound", [0.005, 0.001])
def test_cheapest_chooses_what_the_page_answers(bound: float) -> None:
    late = {n: RESULTS.of(measured.pymunk(n).name, "first_1").worst for n in measured.SUBSTEPS}
    swept = next(n for n, worst in late.items() if worst <= bound)
    assert cheapest(first_impact_error=bound, contact="pymunk").setting.substeps == swept
    assert cheapest(first_impact_error=bound, cases=4).setting.contact == measured.EXACT
