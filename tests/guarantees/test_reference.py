"""The published reference: the same bytes again, its schema, and the independent references of tests/data."""

from __future__ import annotations

import copy
import json
from collections.abc import Callable
from typing import Any

import jsonschema
import numpy as np
import pytest
from flint import arb, ctx

from tests import reference
from tests.proof import UndecidedError
from tests.states import load

TEXT = (reference.FOLDER / "cases.json").read_text()
SCHEMA = json.loads((reference.FOLDER / "schema.json").read_text())
CASES: dict[str, Any] = {case["name"]: case for case in json.loads(TEXT)["cases"]}


def test_the_cases_are_proven_with_the_same_bytes(cases: Callable[[int], int]) -> None:
    every = [*reference.cases()]
    for case in every[:: len(every) // cases(len(every))]:
        assert json.dumps(reference.completed(case)) in TEXT, "make reference"
    assert reference.text_of([CASES[case["name"]] for case in every]) == TEXT
    assert len(TEXT) <= 1_000_000
    assert len(CASES) == 40


def test_the_file_has_the_form_of_its_schema() -> None:
    jsonschema.validate(json.loads(TEXT), SCHEMA)
    case = copy.deepcopy(CASES["bounce"])
    case["impacts"][0]["wall"] = 4
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate(json.loads(TEXT) | {"cases": [case]}, SCHEMA)


def test_the_derivatives_are_those_computed_with_60_digits() -> None:
    for number, record in enumerate(load("derivatives")):
        by_start = np.array(CASES[f"derivatives-{number}"]["derivatives"]).T
        known = np.array(record["by_start"])
        assert np.abs(by_start - known).max() <= 1e-11 * np.abs(known).max()


def test_a_motion_that_cannot_be_proven_is_an_error() -> None:
    case = copy.deepcopy(CASES["bounce"])
    case["scene"]["restitution"] = 0.0
    with pytest.raises(UndecidedError, match="bounce: an impact without restitution"):
        reference.proven(case)


def test_digits_and_float64_that_a_ball_leaves_open_are_errors() -> None:
    with ctx.workprec(256):
        assert reference.digits(arb("1.25", "1e-60")) == "1.25" + 27 * "0"
        assert reference.nearest(arb("0.1", "1e-60")) == 0.1
        assert reference.nearest(arb(0, "1e-40")) == 0.0
        with pytest.raises(UndecidedError, match="30 digits"):
            reference.digits(arb("1.25", "1e-25"))
        with pytest.raises(UndecidedError, match="float64 next to 0.1"):
            reference.nearest(arb("0.1", "1e-17"))
