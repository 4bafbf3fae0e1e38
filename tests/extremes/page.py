"""The page of extremes: what each case found, as a row of docs/extremes.md that the test run itself writes.

A case measures and returns a :class:`Finding`; :func:`extreme` makes it a test for every contact model, notes the
finding in the run's :class:`Page` and only then asserts, so that a row of a failing test reads FAILS.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import pytest

from jackbox_env import _validation as check
from jackbox_env.simulators import CONTACT_MODELS

DOCS = Path(__file__).parents[2] / "docs"
HOLDS, REFUSED, FAILS = "holds", "refused", "FAILS"
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
)

HEAD = """# Extremes

What each contact model does at the extremes of what it is given. Written by the tests themselves: by `make extremes`,
and by `pytest tests/extremes`, which takes fewer steps in the long runs and leaves their two rows as they are while it
finds nothing wrong. *holds*: what was expected was seen, to the bound in the row; *refused*: the library declines with
that sentence and stays as it was; *FAILS*: neither, and so does the row's test.

Momentum, energy and rates (the six velocities) without a unit are errors relative to the largest of their kind, to
what the law says: the impact map, or where feet touch together the simultaneous law, at the pose where an impact acts.
`pymunk` lets an impact act at the end of its substep, a quarter of a step by default and less at speed: a foot may then
be as deep in a wall as it moves in a substep, 1 m at most, and one that dips in and out again in between is not seen.
`exact` finds impacts to rounding: also to that of the angles, whose unit in the last place is 1.2e-10 rad at 1e6 rad.
Beyond that a foot may be outside by up to 4 L times that unit, 5e-10 L at 1e6 rad and 5e-4 L at 1e12 rad. Where a row
says nothing else a box has the half width L = 6 m and 400 kg, a jack has arms of 1 m and 4 kg, both start at some m/s
and rad/s, and there is neither gravity nor torque.

| what | contact model | expected | seen | verdict |
|---|---|---|---|---|
"""


class Finding(NamedTuple):
    """What a case expected and saw."""

    expected: str
    seen: str
    verdict: str
    steps: int | None = None  # taken, of a run that ``make extremes`` makes longer


class Bound(NamedTuple):
    """One measured number and what it may be at most."""

    what: str
    seen: float
    most: float
    unit: str = ""

    @property
    def kept(self) -> bool:
        """NaN is not."""
        return self.seen <= self.most

    def worded(self, value: float) -> str:
        """A number with two digits and its unit."""
        number = re.sub(r"e([+-])0*", r"e\1", f"{value:.2g}").replace("e+", "e")
        return f"{number} {self.unit}".strip()


def within(*bounds: Bound, note: str = "") -> Finding:
    """The finding of numbers that must not exceed their bounds."""
    expected = "; ".join(f"{bound.what} at most {bound.worded(bound.most)}" for bound in bounds) + note
    names = [bound.what for bound in bounds] if len(bounds) > 1 else [""]
    seen = "; ".join(f"{name} {bound.worded(bound.seen)}".strip() for name, bound in zip(names, bounds, strict=True))
    return Finding(expected, seen, HOLDS if all(bound.kept for bound in bounds) else FAILS)


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
    """The finding of several calls, each to be refused with a sentence that has its ``match`` in it."""
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


class Page:
    """Findings of a run, and the page that shows them."""

    def __init__(self, table: tuple[str, ...] = TABLE) -> None:
        self.table = table
        self.findings: dict[tuple[str, str], Finding] = {}

    def note(self, what: str, contact: str, measure: Callable[[str], Finding]) -> None:
        """Measure, note what was found, and fail if it is not what was expected."""
        placed(what, self.table)
        self.findings[what, contact] = Finding("an answer", "cut short", FAILS)
        try:
            finding = measure(contact)
        except Exception as error:
            self.findings[what, contact] = Finding("no error", shortened(f"{type(error).__name__}: {error}"), FAILS)
            raise
        self.findings[what, contact] = finding
        assert finding.verdict != FAILS, f"{what}, {contact}: expected {finding.expected}; seen {finding.seen}"

    @property
    def complete(self) -> bool:
        """Whether every case of the table was noted for every contact model."""
        return set(self.findings) == {(what, contact) for what in self.table for contact in CONTACT_MODELS}

    def text(self, before: str = "", full: bool = FULL) -> str:
        """The page; ``before`` is what it was, of which rows of longer runs stay.

        A shorter run that holds says nothing about the longer one. One that fails does.
        """
        kept = {tuple(line.split(" | ")[:2]): line for line in before.splitlines() if line.startswith("| ")}
        rows = []
        for what in self.table:
            for contact in CONTACT_MODELS:
                finding = self.findings[what, contact]
                cells = [what, contact, finding.expected, finding.seen, finding.verdict]
                row = "| " + " | ".join(" ".join(cell.replace("|", "\\|").split()) for cell in cells) + " |"
                longer = (
                    None
                    if full or finding.steps is None or finding.verdict == FAILS
                    else kept.get((f"| {what}", contact))
                )
                rows.append(longer or row)
        return HEAD + "\n".join(rows) + "\n"

    def write(self, folder: Path = DOCS, full: bool = FULL) -> bool:
        """Write the page if the run was complete and there is something new; return whether it was written.

        Where the folder is missing or not to be written in (an installed copy of the tests), nothing is written.
        """
        if not (self.complete and folder.is_dir()):
            return False
        page, draft = folder / "extremes.md", folder / f".extremes.{os.getpid()}"
        try:
            before = page.read_text(encoding="utf-8") if page.exists() else ""
            text = self.text(before, full)
            if text != before:
                draft.write_text(text, encoding="utf-8")
                draft.replace(page)
        except OSError:
            draft.unlink(missing_ok=True)
            return False
        return text != before


Measure = Callable[[str], Finding]
Test = Callable[[str, Page], None]


def extreme(what: str, timeout: float = 120.0) -> Callable[[Measure], Test]:
    """Make a measurement, given a contact model, the test of that row of the table for every contact model."""
    placed(what, TABLE)

    def decorate(measure: Measure) -> Test:
        @pytest.mark.timeout(timeout)
        @pytest.mark.parametrize("contact", CONTACT_MODELS)
        def test(contact: str, extremes_page: Page) -> None:
            extremes_page.note(what, contact, measure)

        test.__name__, test.__doc__, test.__module__ = measure.__name__, measure.__doc__, measure.__module__
        return test

    return decorate
