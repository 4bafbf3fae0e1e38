"""What the functions of the law refuse."""

from __future__ import annotations

import math
import re
from typing import Any

import numpy as np
import pytest

from jackbox_env.mechanics import energy, gap_jacobian, gaps, impact_map, simultaneous_impact_map
from jackbox_env.scene import Scene
from jackbox_env.states import STATE_NAMES, as_state
from tests.guarantees.poses import approaching

OF_STATES = {
    "as_state": lambda state: as_state(state),
    "gaps": lambda state: gaps(Scene(), state),
    "gap_jacobian": lambda state: gap_jacobian(Scene(), state, 0, 0),
    "impact_map": lambda state: impact_map(Scene(), state, 0, 0),
    "simultaneous_impact_map": lambda state: simultaneous_impact_map(Scene(), state, [(0, 0)]),
    "energy": lambda state: energy(Scene(), state),
}


OF_PAIRS = {
    "gap_jacobian": lambda wall, foot: gap_jacobian(Scene(), np.zeros(12), wall, foot),
    "impact_map": lambda wall, foot: impact_map(Scene(), np.zeros(12), wall, foot),
    "simultaneous_impact_map": lambda wall, foot: simultaneous_impact_map(Scene(), np.zeros(12), [(wall, foot)]),
}


@pytest.mark.parametrize("place", range(12))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("function", OF_STATES)
def test_states_that_are_not_finite_are_refused_by_name(function: str, value: float, place: int) -> None:
    state = [0.0] * 12
    state[place] = value
    with pytest.raises(ValueError, match=rf"^state must be finite, got {STATE_NAMES[place]} = {value}$"):
        OF_STATES[function](state)


@pytest.mark.parametrize("shape", [(), (6,), (11,), (13,), (1, 12), (12, 1), (0,)])
@pytest.mark.parametrize("function", OF_STATES)
def test_states_of_another_shape_are_refused(function: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=rf"^state must have shape \(12,\), got shape {re.escape(str(shape))}$"):
        OF_STATES[function](np.zeros(shape))


NOT_NUMBERS: dict[str, Any] = {
    "words": ["up"] * 12,
    "digits in quotes": ["1.0"] * 12,
    "truths": [True] * 12,
    "a word": "state",
    "a mapping": dict.fromkeys(STATE_NAMES, 0.0),
    "ragged": [[0.0], [0.0, 1.0]],
    "complex list": [1j] * 12,
    "complex array": np.zeros(12, dtype=complex),
    "dates": np.array(["2020-01-01"] * 12, dtype="datetime64[D]"),
}


@pytest.mark.parametrize("given", NOT_NUMBERS)
def test_states_without_numbers_are_refused(given: str) -> None:
    with pytest.raises(TypeError, match=r"^state must hold 12 numbers, got "):
        as_state(NOT_NUMBERS[given])


def test_state_of_numbers_beyond_floats_is_refused() -> None:
    with pytest.raises((TypeError, ValueError), match=r"^state must"):
        as_state([10**400] * 12)


@pytest.mark.parametrize("given", [list(range(12)), tuple(range(12)), np.arange(12), np.arange(12, dtype=np.float32)])
def test_states_of_numbers_become_fresh_float64(given: Any) -> None:
    found = as_state(given)
    assert found.dtype == np.float64
    assert np.array_equal(found, np.arange(12.0))
    double = np.arange(12.0)
    assert not np.shares_memory(as_state(double), double)


@pytest.mark.parametrize("value", [4, -1, 2**70, np.int64(4)])
@pytest.mark.parametrize("part", ["wall", "foot"])
@pytest.mark.parametrize("function", OF_PAIRS)
def test_walls_and_feet_out_of_range_are_refused(function: str, part: str, value: Any) -> None:
    given = {"wall": 0, "foot": 0, part: value}
    with pytest.raises(ValueError, match=f"^{part} must be a whole number from 0 to 3, got {re.escape(repr(value))}$"):
        OF_PAIRS[function](**given)


@pytest.mark.parametrize("value", [True, np.True_, 2.0, np.float64(2.0), "2", None, math.nan, [1]])
@pytest.mark.parametrize("part", ["wall", "foot"])
@pytest.mark.parametrize("function", OF_PAIRS)
def test_walls_and_feet_that_are_no_whole_numbers_are_refused(function: str, part: str, value: Any) -> None:
    given = {"wall": 0, "foot": 0, part: value}
    with pytest.raises(TypeError, match=f"^{part} must be a whole number from 0 to 3, got {re.escape(repr(value))}$"):
        OF_PAIRS[function](**given)


@pytest.mark.parametrize("integer", [np.int64, np.uint8, np.array])
def test_numpy_integers_name_walls_and_feet(integer: Any) -> None:
    state = approaching(Scene(), np.random.default_rng(20), 1, 2)
    expected, impulse = impact_map(Scene(), state, 1, 2)
    after, same = impact_map(Scene(), state, integer(1), integer(2))
    assert same == impulse
    assert np.array_equal(after, expected)


@pytest.mark.parametrize("contact", [5, None, (1,), (1, 2, 3), (), 1.5])
def test_contacts_that_are_no_pairs_are_refused(contact: Any) -> None:
    with pytest.raises(TypeError, match=rf"^a contact must be a pair \(wall, foot\), got {re.escape(repr(contact))}$"):
        simultaneous_impact_map(Scene(), np.zeros(12), [(0, 0), contact])


@pytest.mark.parametrize("contacts", [5, None, 1.5])
def test_contacts_that_are_no_list_are_refused(contacts: Any) -> None:
    with pytest.raises(TypeError, match=f"^contacts must .*, got {re.escape(repr(contacts))}$"):
        simultaneous_impact_map(Scene(), np.zeros(12), contacts)


def test_repeated_contacts_are_refused() -> None:
    contacts: list[Any] = [(2, 3), (0, 1), (np.int64(2), np.int64(3))]  # also where the integers differ in type
    with pytest.raises(ValueError, match=r"^contacts must be distinct \(wall, foot\) pairs, got .*\(2, 3\)"):
        simultaneous_impact_map(Scene(), np.zeros(12), contacts)
