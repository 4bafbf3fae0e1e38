"""The results of a sweep: statistics, claims, the page's table."""

from __future__ import annotations

import math
import shutil
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from scripts.studies import study
from scripts.studies.accuracy import accuracy, measured

DOCS = Path(__file__).parents[2] / "docs"


@pytest.fixture(scope="module")
def stored() -> measured.Results:
    return measured.Results.of_record(accuracy.STUDY.read(DOCS))


# -- statistics --------------------------------------------------------------------------------------------------------


def test_medians_worst_means_and_totals_of_known_numbers() -> None:
    assert measured.summed_up([3.0, 1.0, math.nan, 2.0]) == {"n": 3, "median": 2.0, "worst": 3.0}
    assert measured.summed_up([1.0, 4.0], measured.TOTAL) == {"n": 2, "total": 5.0}
    # 1, 2, 3: standard deviation 1; Student's t for 2 degrees of freedom, two sides of 95 %: 4.3027
    summary = measured.summed_up([1.0, 2.0, 3.0, math.nan], measured.MEAN)
    assert summary == pytest.approx({"n": 3, "mean": 2.0, "half_width": 4.3026527 / math.sqrt(3.0)})


@pytest.mark.parametrize("order", [0.5, 1.0, 2.0])
def test_a_planted_order_of_convergence_is_estimated_within_its_interval(order: float) -> None:
    rng = np.random.default_rng(0)
    steps = [0.02 / 2**number for number in range(9)]
    estimate, low, high = measured.order_of(steps, [3.0 * h**order * math.exp(0.1 * rng.normal()) for h in steps])
    assert estimate == pytest.approx(order, abs=0.08)
    assert low < order < high
    assert high - low < 0.2


# -- claims ------------------------------------------------------------------------------------------------------------


def test_claims_hold_in_the_stored_results_and_each_fails_where_it_is_broken(stored: measured.Results) -> None:
    assert [claim.what for claim in accuracy.claims(stored) if not claim.holds] == []
    exact, coarse, proven, seeds = measured.EXACT, measured.pymunk(2).name, measured.REFERENCE, measured.ALL
    breakages: list[tuple[str, str, str, dict[str, Any]]] = [
        (exact, proven, "first_1", {"worst": 1e-10}),
        (exact, proven, "first_5", {"worst": 1e-9}),
        (exact, proven, "first_5", {"worst": math.nan, "n": 0}),
        (exact, proven, "lacking", {"worst": 1.0}),
        (exact, proven, "depth", {"worst": 1e-6}),
        (exact, proven, "prefix", {"total": 50.0}),
        (measured.THRESHOLD, proven, "prefix", {"total": 60.0}),
        (exact, seeds, "depth", {"worst": 1e-6}),
        (coarse, seeds, "first_1", {"worst": 0.011}),
        (coarse, seeds, "wrong", {"total": 1.0}),
        (coarse, seeds, "escaped", {"total": 1.0}),
        (measured.pymunk(256).name, seeds, "first_1", {"median": 1e-9}),
    ]
    broken = set()
    for *key, change in breakages:
        rows = dict(stored.rows)
        rows[key[0], key[1], key[2]] = rows[key[0], key[1], key[2]]._replace(**change)
        failed = [claim.what for claim in accuracy.claims(measured.Results(rows.values())) if not claim.holds]
        assert len(failed) == 1
        broken.update(failed)
    assert broken == {claim.what for claim in accuracy.claims(stored)}


# -- the page ----------------------------------------------------------------------------------------------------------


def test_the_command_writes_the_page_again_from_the_stored_results(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copy(DOCS / "accuracy.json", tmp_path)
    monkeypatch.setattr(sys, "argv", ["accuracy.py", "--render", "--out", str(tmp_path)])
    study.main(accuracy.STUDY, "")
    assert (tmp_path / "accuracy.md").read_text() == (DOCS / "accuracy.md").read_text()
    assert "ring-0" in (tmp_path / "accuracy" / "work_precision.svg").read_text()
    assert (tmp_path / "accuracy" / "impacts.png").stat().st_size > 10_000
    assert capsys.readouterr().out.count("\nholds: ") == 8


# -- the sweep ---------------------------------------------------------------------------------------------------------
