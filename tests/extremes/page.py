"""The page of extremes: the finding of each case, as a row of docs/trust.md.

A case measures a contact model and returns a :class:`Finding`. The tests measure with few steps and assert;
``python -m tests.extremes`` measures with all and writes the page.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import NamedTuple

from jackbox_env.simulators import CONTACT_MODELS

HOLDS, REFUSED, FAILS = "holds", "refused", "FAILS"


class Finding(NamedTuple):
    """The result of a case."""

    seen: str
    verdict: str


Findings = Mapping[tuple[str, str], Finding]  # by case and contact model
Measure = Callable[[str], Finding]


class Case(NamedTuple):
    """A row of the page: what is simulated, and its measurement."""

    what: str
    measure: Measure


CASES: list[Case] = []


def case(what: str) -> Callable[[Measure], Measure]:
    """Give a decorator that makes a measurement a row of the table."""

    def add(measure: Measure) -> Measure:
        CASES.append(Case(what, measure))
        return measure

    return add


class Bound(NamedTuple):
    """One measured number and its upper bound."""

    what: str
    seen: float
    most: float
    unit: str = ""


def two_digits(number: float) -> str:
    """A number as the page shows it."""
    return re.sub(r"e([+-])0*", r"e\1", f"{number:.2g}").replace("e+", "e")


def within(*bounds: Bound, note: str = "") -> Finding:
    """The finding of numbers that must not exceed their bounds; NaN does."""
    seen = (f"{one.what} {two_digits(one.seen)} of {two_digits(one.most)} {one.unit}".strip() for one in bounds)
    return Finding("; ".join(seen) + note, HOLDS if all(one.seen <= one.most for one in bounds) else FAILS)


def refuses(call: Callable[[], object], match: str) -> Finding:
    """The finding of a call that must be refused with a sentence that has ``match`` in it."""
    try:
        call()
    except (TypeError, ValueError, RuntimeError) as refusal:
        seen, verdict = str(refusal), REFUSED if re.search(match, str(refusal)) else FAILS
        return Finding(seen if len(seen) <= 150 else seen[:147] + "...", verdict)
    return Finding("no error", FAILS)


def shares(finding: Finding) -> dict[str, float]:
    """Each result of a finding, over its bound."""
    found = ((result, re.search(r" ([-\d.e]+) of ([-\d.e]+)", result)) for result in finding.seen.split("; "))
    return {result: float(numbers[1]) / float(numbers[2]) for result, numbers in found if numbers}


def closest(finding: Finding) -> str:
    """The cell of a finding: of results within their bounds, the one closest to its bound; of an error, its start."""
    if finding.verdict != HOLDS:
        return f"{finding.verdict}: {finding.seen.split(':')[0] if finding.verdict == REFUSED else finding.seen}"
    found = shares(finding)
    return max(found, key=found.__getitem__)


# -- the record and the page -------------------------------------------------------------------------------------------


def read(path: Path) -> dict[tuple[str, str], Finding]:
    """What was recorded in a file."""
    rows = map(json.loads, path.read_text(encoding="utf-8").splitlines())
    return {(what, contact): Finding(*finding) for what, contact, *finding in rows}


def recorded(findings: Findings) -> str:
    """The lines of a record in the order of the page."""
    rows = ((case.what, contact) for case in CASES for contact in CONTACT_MODELS)
    return "".join(json.dumps([*row, *findings[row]]) + "\n" for row in rows if row in findings)


def answer(findings: Findings) -> str:
    """The page in three sentences."""
    verdicts = [finding.verdict for finding in findings.values()]
    return (
        f"Of {len(verdicts)} runs {verdicts.count(HOLDS)} stayed within their bounds, {verdicts.count(REFUSED)} were "
        f"refused with a message, {verdicts.count(FAILS) or 'none'} failed. `exact` follows the laws to rounding and "
        "keeps every foot inside to 1e-9 m, for all masses, speeds, spins and steps tried. `pymunk` conserves momentum "
        "and energy as well, but a foot may be up to 1 m in a wall at the end of a step; a step in which it would move "
        "further raises an error."
    )


def page(findings: Findings) -> str:
    """The part of docs/trust.md on extremes: the rows in which a result exceeds a tenth of its bound."""
    lines = [answer(findings), "", f"| what | {' | '.join(CONTACT_MODELS)} |", "|---|" + "---|" * len(CONTACT_MODELS)]
    for case in CASES:
        row = [findings.get((case.what, contact), Finding("", "not measured")) for contact in CONTACT_MODELS]
        if any(one.verdict != HOLDS or max(shares(one).values()) > 0.1 for one in row):
            cells = [case.what, *(closest(one) for one in row)]
            lines.append("| " + " | ".join(" ".join(cell.replace("|", "\\|").split()) for cell in cells) + " |")
    return "\n".join(lines)
