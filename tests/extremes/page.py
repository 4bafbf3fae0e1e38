"""The page of extremes: what each case found, as a row of docs/extremes.md.

A case measures and returns a :class:`Finding`; :func:`extreme` makes it a test for every contact model, records the
finding where ``JACKBOX_EXTREMES_RECORD`` says and only then asserts, so that a row of a failing test reads FAILS.
``python -m tests.extremes`` runs the tests so and writes the page; the tests themselves write nothing else.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

import pytest

from jackbox_env import _validation as check
from jackbox_env.simulators import CONTACT_MODELS

HOLDS, REFUSED, FAILS = "holds", "refused", "FAILS"
RECORD = "JACKBOX_EXTREMES_RECORD"  # names a file to which findings are added, one a line
FULL = check.choice("JACKBOX_EXTREMES", os.environ.get("JACKBOX_EXTREMES", "quick"), ("quick", "full")) == "full"

# The rows in order; each stands once for every contact model.
TABLE = (
    "one impact, jack 1e-9 to 1e9 times as heavy as the box",
    "4 s of flight and impacts, jack 1e-9 to 1e9 times as heavy as the box",
    "one foot, two feet and corners, jack inertia a thousandth of m l^2",
    "4 s of flight and impacts, jack inertia a thousandth of m l^2",
    "jack spins at 3e4 rad/s among the walls, steps of 0.02 s",
    "jack spins at 3e4 rad/s among the walls, steps of 1 ms",
    "box spins at 3e4 rad/s around the jack, steps of 0.02 s",
    "box spins at 3e4 rad/s around the jack, steps of 0.1 ms",
    "jack at 7000 m/s straight to and fro for 1 s",
    "jack at 1000 to 7000 m/s in any direction for 0.2 s",
    "an impact amid five control steps of 1e-6 to 1 s",
    "arm from 0.001 of the half width to 1e-6 of it less than the half width, 4 s",
    "arm from the half width to its sqrt(2)-fold less 1e-4 m, 1 s",
    "a foot arrives at 1e-9 m/s",
    "two feet on a wall, on two walls, in a corner: at the same moment",
    "two feet on a wall, on two walls, in a corner: 1e-15 to 1e-3 s apart",
    "a foot exactly on the wall at reset: approaching",
    "a foot exactly on the wall at reset: leaving",
    "a foot exactly on the wall at reset: at rest without gravity",
    "two feet exactly on the floor at reset: at rest under gravity, 1 s",
    "a start with a foot outside",
    "a state with a foot up to 1 m outside, put back",
    "no gravity: bodies without forces for 200 s",
    "1000 g: 30 bounces on the floor",
    "torque of 1e9 N m, steps of 1 ms for 0.02 s",
    "torque of 1e9 N m for a step of 0.02 s with a foot near a wall",
    "the chirp at t = 1e6 s",
    "1e9 m from the origin",
    "angles of 1e6 to 4e12 rad: 4,000 states up to 1e-6 s after an impact",
    "episodes of 500 steps under random torque",
    "one weightless episode",
    "subnormal numbers in states, time steps and torques",
    "subnormal numbers in a scene",
    "jack of 1e-60 to 1e57 kg, half width of 1e-28 to 6 m, 10 s",
    "half width of 1e15 and 1e25 m, jack crosses it in seconds",
    "NaN and infinity in scenes and chirps",
    "NaN and infinity from a drive's functions",
    "NaN and infinity in states and times",
    "NaN and infinity in time steps and torques",
    "NaN and infinity in actions",
    "NaN and infinity in the options of a reset",
    "restitution 0 and 0.5: comes to rest",
    "restitution 0, 0.5 and 0.9: lies on a level, a tilted and a turning floor for 1000 s",
)

# The tables of the page, by the row that each begins with.
PARTS = {
    "one impact, jack 1e-9 to 1e9 times as heavy as the box": "Masses and inertias",
    "jack spins at 3e4 rad/s among the walls, steps of 0.02 s": "Spins and speeds",
    "an impact amid five control steps of 1e-6 to 1 s": "Steps and arms",
    "a foot arrives at 1e-9 m/s": "Slow impacts, and several at once",
    "a foot exactly on the wall at reset: approaching": "Feet that start on a wall or behind it",
    "no gravity: bodies without forces for 200 s": "Forces, times and places",
    "episodes of 500 steps under random torque": "Millions of steps",
    "subnormal numbers in states, time steps and torques": "Numbers too small, too large or not finite",
    "restitution 0 and 0.5: comes to rest": "Loss",
}

HEAD = """
*holds*: the result is within its bound. `0.22 of 1 m` means 0.22 m with a bound of 1 m. *refused*: the call raises an
error with that sentence and changes nothing. *FAILS*: neither; the row's test then fails too.

Errors of momentum, energy and rates (the six velocities) without a unit are relative to the largest of their kind. They
are differences from the law at the pose where an impact acts: the impact map, or the simultaneous law where feet touch
together.

`pymunk` lets an impact act at the end of its substep, which is a quarter of a step by default and less at speed. A foot
may then be as deep in a wall as it moves in a substep, 1 m at most. A foot that dips in and out again within a substep
is not seen. `exact` finds impacts to rounding. Angles are rounded too: at 1e6 rad their unit in the last place is
1.2e-10 rad. Beyond that a foot may be outside by up to 4 L times this unit: 5e-10 L at 1e6 rad, 5e-4 L at 1e12 rad.

Unless a row says otherwise, the box has the half width L = 6 m and 400 kg, the jack has arms of 1 m and 4 kg, both
start at some m/s and rad/s, and there is neither gravity nor torque.
"""


class Finding(NamedTuple):
    """What a case expected and saw."""

    expected: str
    seen: str
    verdict: str


Findings = Mapping[tuple[str, str], Finding]  # by case and contact model


class Bound(NamedTuple):
    """One measured number and its upper bound."""

    what: str
    seen: float
    most: float
    unit: str = ""

    @property
    def kept(self) -> bool:
        """NaN is not."""
        return self.seen <= self.most

    def __str__(self) -> str:
        return f"{self.what} {two_digits(self.seen)} of {two_digits(self.most)} {self.unit}".strip()


def two_digits(number: float) -> str:
    """A number as the page shows it."""
    return re.sub(r"e([+-])0*", r"e\1", f"{number:.2g}").replace("e+", "e")


def within(*bounds: Bound, note: str = "") -> Finding:
    """The finding of numbers that must not exceed their bounds."""
    expected = "; ".join(f"{bound.what} at most {two_digits(bound.most)} {bound.unit}".strip() for bound in bounds)
    seen = "; ".join(map(str, bounds))
    return Finding(expected + note, seen + note, HOLDS if all(bound.kept for bound in bounds) else FAILS)


def sentence_of(call: Callable[[], object]) -> str | None:
    """The sentence that a call is refused with, or None."""
    try:
        call()
    except (TypeError, ValueError, RuntimeError) as refusal:
        return str(refusal)
    return None


def matches(sentence: str | None, match: str) -> bool:
    return sentence is not None and re.search(match, sentence) is not None


def shortened(sentence: str | None, most: int = 150) -> str:
    """A refusal's sentence as the page shows it."""
    if sentence is None:
        return "taken without a word"
    return sentence if len(sentence) <= most else sentence[: most - 3] + "..."


def refuses(call: Callable[[], object], match: str) -> Finding:
    """The finding of a call that must be refused with a sentence that has ``match`` in it."""
    sentence = sentence_of(call)
    return Finding("refused in one sentence", shortened(sentence), REFUSED if matches(sentence, match) else FAILS)


def refuses_each(calls: dict[str, tuple[Callable[[], object], str]]) -> Finding:
    """The finding of several calls. Each must be refused with a sentence that contains its ``match``."""
    sentences = {name: sentence_of(call) for name, (call, _) in calls.items()}
    wrong = [name for name, (_, match) in calls.items() if not matches(sentences[name], match)]
    name = wrong[0] if wrong else next(iter(calls))
    seen = f"{len(calls) - len(wrong)} of {len(calls)}, e.g. {name}: {shortened(sentences[name])}"
    return Finding("each refused in one sentence", seen, FAILS if wrong else REFUSED)


def placed(what: str, table: tuple[str, ...]) -> str:
    """Return ``what`` if it has a row in the table.

    Raises:
        ValueError: it has none.
    """
    if what not in table:
        raise ValueError(f"{what!r} has no place in the table")
    return what


# -- records and the page ----------------------------------------------------------------------------------------------


def noted(what: str, contact: str, measure: Callable[[str], Finding]) -> None:
    """Measure, record the finding if asked to, and fail if it is not the expected one."""
    finding = Finding("an answer", "cut short", FAILS)
    try:
        finding = measure(contact)
    except Exception as error:
        finding = Finding("no error", shortened(f"{type(error).__name__}: {error}"), FAILS)
        raise
    finally:
        if RECORD in os.environ:
            with open(os.environ[RECORD], "a", encoding="utf-8") as file:
                file.write(json.dumps([what, contact, *finding]) + "\n")
    assert finding.verdict != FAILS, f"{what}, {contact}: expected {finding.expected}; seen {finding.seen}"


def read(path: Path) -> dict[tuple[str, str], Finding]:
    """What was recorded in a file, or nothing if there is none."""
    lines = path.read_text(encoding="utf-8").splitlines() if path.exists() else []
    rows = [json.loads(line) for line in lines]
    return {(what, contact): Finding(*finding) for what, contact, *finding in rows}


def recorded(findings: Findings, table: tuple[str, ...] = TABLE) -> str:
    """The lines of a record in the table's order."""
    rows = [(what, contact) for what in table for contact in CONTACT_MODELS if (what, contact) in findings]
    return "".join(json.dumps([*row, *findings[row]]) + "\n" for row in rows)


def missing(findings: Findings, table: tuple[str, ...] = TABLE) -> list[str]:
    """The rows of the table that not every contact model has a finding for."""
    return [what for what in table if any((what, contact) not in findings for contact in CONTACT_MODELS)]


def answer(findings: Findings) -> str:
    """The page in three sentences."""
    cases, verdicts = len({what for what, _ in findings}), [finding.verdict for finding in findings.values()]
    return (
        f"{cases} extremes were given to both contact models: {verdicts.count(HOLDS)} answers hold to their bounds, "
        f"{verdicts.count(REFUSED)} are refusals in one sentence, and {verdicts.count(FAILS) or 'none'} FAIL. `exact` "
        "keeps the laws to rounding and every foot inside to 1e-9 m, whatever masses, speeds, spins and steps were "
        "tried. `pymunk` keeps momentum and energy as well, but a foot may be up to 1 m in a wall at the end of a "
        "step, and a step in which one would move further is refused."
    )


def page(findings: Findings, table: tuple[str, ...] = TABLE) -> str:
    """docs/extremes.md, of the rows that are recorded."""
    lines, part = ["# Extremes", "", answer(findings), HEAD.rstrip()], ""
    for what in table:
        told = [findings.get((what, contact)) for contact in CONTACT_MODELS]
        if PARTS.get(what, part) != part or len(lines) == 4:
            part = PARTS.get(what, part)
            lines += ["", f"## {part}", "", "| what | " + " | ".join(CONTACT_MODELS) + " |"]
            lines.append("|---" * (1 + len(CONTACT_MODELS)) + "|")
        if any(told):
            cells = [what, *(f"{found.verdict}: {found.seen}" if found else "" for found in told)]
            lines.append("| " + " | ".join(" ".join(cell.replace("|", "\\|").split()) for cell in cells) + " |")
    return "\n".join(lines) + "\n"


Measure = Callable[[str], Finding]
Test = Callable[[str], None]


def extreme(what: str, timeout: float = 120.0) -> Callable[[Measure], Test]:
    """Turn a measurement of a contact model into the test of this row of the table, for every contact model."""
    placed(what, TABLE)

    def decorate(measure: Measure) -> Test:
        @pytest.mark.timeout(timeout)
        @pytest.mark.parametrize("contact", CONTACT_MODELS)
        def test(contact: str) -> None:
            noted(what, contact, measure)

        test.__name__, test.__doc__, test.__module__ = measure.__name__, measure.__doc__, measure.__module__
        return test

    return decorate
