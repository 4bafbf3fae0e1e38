"""Every public callable, argument by argument: hostile values are refused in one sentence, and change nothing."""

from __future__ import annotations

import functools
import inspect
import math
import re
from typing import Any

import numpy as np
import pytest

import jackbox_env
from jackbox_env import (
    JackInBoxEnv,
    JackInBoxVectorEnv,
    Motion,
    mechanics,
)
from jackbox_env.simulators import Simulator
from tests.refusals.kinds import Hostile, out, real
from tests.refusals.motions import ROWS
from tests.refusals.sentences import Refusal, Subject, assert_refused, flat, simulator
from tests.refusals.table import TABLE as OTHERS
from tests.refusals.table import Row

TABLE = [*OTHERS, *ROWS]


@functools.cache
def made(row: int) -> Any:
    return TABLE[row].subject.make()


@functools.cache
def expected(row: int, argument: str) -> list[Any]:
    """The result of the good call."""
    return result(TABLE[row], made(row), argument, TABLE[row].arguments[argument].good)


def result(row: Row, one: Any, argument: str, value: Any) -> list[Any]:
    row.subject.start(one)
    returned = row.call(one, **{argument: value})
    return flat([returned, row.subject.shown(one)])


def refusal(row: Row, one: Any, argument: str, hostile: Hostile) -> None:
    """Assert that a call with a hostile value raises the promised error and changes nothing."""
    row.subject.start(one)
    before = flat(row.subject.shown(one))
    with pytest.raises(hostile.error) as refused:
        row.call(one, **{argument: hostile.value})
    sentence = str(refused.value)
    assert refused.type is hostile.error
    assert len(sentence) < 300
    assert "\n" not in sentence
    named = hostile.named or row.arguments[argument].named or argument.rpartition(".")[2]
    assert [word for word in (named, *hostile.mentioned) if word not in sentence] == [], sentence
    assert flat(row.subject.shown(one)) == before, "changed by what it refused"


CALLS = [
    pytest.param(number, argument, id=f"{row.name}({argument}){row.contact}")
    for number, row in enumerate(TABLE)
    for argument in row.arguments
]


@pytest.mark.parametrize(("row", "argument"), CALLS)
def test_hostile_values_are_refused_in_one_sentence_and_change_nothing(row: int, argument: str) -> None:
    one, good, kind = made(row), expected(row, argument), TABLE[row].arguments[argument]
    for hostile in kind.refused.values():
        refusal(TABLE[row], one, argument, hostile)
        if one is not None:
            assert result(TABLE[row], one, argument, kind.good) == good


@pytest.mark.parametrize(("row", "argument"), CALLS)
def test_other_forms_give_the_same_bits_and_the_ends_of_a_range_are_accepted(row: int, argument: str) -> None:
    kind = TABLE[row].arguments[argument]
    for value in kind.alike.values():
        assert result(TABLE[row], made(row), argument, value) == expected(row, argument)
    for value in kind.accepted:
        result(TABLE[row], made(row), argument, value)


ARRAYS = [
    pytest.param(number, argument, id=f"{row.name}({argument}){row.contact}")
    for number, row in enumerate(TABLE)
    for argument, kind in row.arguments.items()
    if isinstance(kind.good, np.ndarray)
]


@pytest.mark.parametrize(("number", "argument"), ARRAYS)
def test_an_array_that_was_passed_may_change_later(number: int, argument: str) -> None:
    row, one = TABLE[number], made(number)
    passed = row.arguments[argument].good.copy()
    row.subject.start(one)
    returned = row.call(one, **{argument: passed})
    before = flat([returned, row.subject.shown(one)])
    passed[...] = 0
    assert flat([returned, row.subject.shown(one)]) == before


# -- that nothing is left out, and that the checks can fail ------------------------------------------------------------

# Records and errors; a protocol; checked where it is used.
WITHOUT_ARGUMENTS = {
    "Impact", "Fit", "Linearization", "Rollout", "State", "StepResult", "JackLostError", "Motion", "Simulator", "Task",
    "TaskError", "Recording", "fit",  # tests/measuring/test_fitting.py
}  # fmt: skip
# These check nothing, for speed: their caller has checked the arguments.
UNCHECKED = {
    "Action", "JackInBoxVectorEnv.set_attr", "Observation", "Simulator.restore", "Simulator.step_checked",
    "Simulator.stepped", "contacts_of",
    "impact_maps", "energy_of", "clearance", "deepest_restored", "start_tolerance", "refuse_no_scene",
}  # fmt: skip
# Gymnasium checks it, or there is no end to what is right.
ELSEWHERE = {
    "JackInBoxEnv.reset": {"seed"}, "Motion.save": {"path"}, "Motion.to_frame": {"table"}, "rollout": {"device"},
}  # fmt: skip


def parameters(function: Any) -> set[str]:
    kinds = (inspect.Parameter.VAR_KEYWORD, inspect.Parameter.VAR_POSITIONAL)
    return {name for name, one in inspect.signature(function).parameters.items() if one.kind not in kinds} - {"self"}


def test_every_public_callable_and_each_of_its_parameters_is_in_the_table() -> None:
    rows = {row.name: {name.partition(".")[0] for name in row.arguments} for row in TABLE}
    public = {name: getattr(jackbox_env, name) for name in set(jackbox_env.__all__) - WITHOUT_ARGUMENTS}
    for owner in (mechanics, Simulator, JackInBoxEnv, JackInBoxVectorEnv, Motion):
        for name, one in inspect.getmembers(owner, inspect.isfunction):
            qualified = f"{owner.__name__}.{name}" if inspect.isclass(owner) else name
            if one.__module__ == getattr(owner, "__module__", owner.__name__) and one.__qualname__ == qualified:
                public[qualified] = one
    checked = {name: one for name, one in public.items() if callable(one) and not re.search(r"(^|\.)_", name)}
    assert len(checked) > 20
    missing = {name: parameters(one) - rows.get(name, set()) for name, one in checked.items() if name not in UNCHECKED}
    assert {name: names for name, names in missing.items() if names} == ELSEWHERE


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda one, dt: None, "DID NOT RAISE"),
        (lambda one, dt: one.reset({}), "state must"),
        (lambda one, dt: one.step(-1.0), "nan"),
        (lambda one, dt: (one.step(0.02), one.step(dt)), "changed by what it refused"),
    ],
)
def test_a_bad_answer_would_be_seen(call: Any, complaint: str) -> None:
    row = Row("control", lambda one: lambda dt: call(one, dt), {"dt": real(0.5, above=0.0)}, simulator("exact"))
    with pytest.raises((AssertionError, TypeError, pytest.fail.Exception), match=complaint):
        refusal(row, row.subject.make(), "dt", out(math.nan, "nan", "0"))


def raising(sentence: str, change: Any = None) -> Any:
    def call(seen: list[Any]) -> None:
        seen.append(change) if change else None
        raise ValueError(sentence)

    return call


@pytest.mark.parametrize(
    ("call", "complaint"),
    [
        (lambda seen: None, "DID NOT RAISE"),
        (raising("got 2"), "got 2"),
        (raising("got 1 2"), "got 1 2"),
        (raising("got 1", "something"), "changed by what it refused"),
    ],
)
def test_a_refusal_in_other_words_would_be_seen(call: Any, complaint: str) -> None:
    seen: list[Any] = []
    row = Refusal(call, ValueError, "got 1", Subject(lambda: seen, lambda seen: seen.clear(), list))
    with pytest.raises((AssertionError, pytest.fail.Exception), match=complaint):
        assert_refused(row)
