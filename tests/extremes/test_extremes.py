"""Every case of the extremes in docs/trust.md against both contact models, and the page against its record."""

from __future__ import annotations

import math
from pathlib import Path

import pytest

from jackbox_env.simulators import CONTACT_MODELS
from tests.extremes.cases import CASES
from tests.extremes.page import FAILS, HOLDS, REFUSED, Bound, Case, page, read, recorded, refuses, within

DOCS = Path(__file__).parents[2] / "docs"


@pytest.mark.parametrize("contact", CONTACT_MODELS)
@pytest.mark.parametrize("case", CASES, ids=lambda case: case.what)
def test_the_answer_to_an_extreme_is_within_its_bounds_or_a_refusal(case: Case, contact: str) -> None:
    finding = case.measure(contact)
    assert finding.verdict in (HOLDS, REFUSED), finding


@pytest.mark.parametrize("seen", [2e-12, math.nan, math.inf])
def test_a_number_over_its_bound_and_a_refusal_for_another_reason_would_fail(seen: float) -> None:
    assert within(Bound("error", 1e-12, 1e-12, "m")).verdict == HOLDS
    assert within(Bound("error", 1e-15, 1e-12, "m"), Bound("error", seen, 1e-12, "m")).verdict == FAILS
    assert refuses(lambda: float("x"), "could not convert").verdict == REFUSED
    assert refuses(lambda: float("x"), "mass must be").verdict == FAILS
    assert refuses(lambda: float("1"), "").verdict == FAILS


def test_the_page_is_that_of_the_record() -> None:
    findings = read(DOCS / "extremes.jsonl")
    assert {what for what, _ in findings} == {case.what for case in CASES}
    assert (DOCS / "extremes.jsonl").read_text() == recorded(findings)
    assert page(findings) in (DOCS / "trust.md").read_text()
