"""What the page says of the models, and whether a sweep bears it out."""

from __future__ import annotations

from typing import NamedTuple

from scripts.studies.accuracy.cases import DIGITS, DT, LOSS
from scripts.studies.accuracy.results import ALL, PREDICTABLE, Results, Row
from scripts.studies.accuracy.settings import EXACT, PYMUNK


class Claim(NamedTuple):
    """Something that must hold in every sweep, however short."""

    what: str
    seen: str
    holds: bool


def claims(results: Results) -> list[Claim]:
    """All claims; the command fails where one does not hold."""
    first, fifth, flight, right, lacking, depth = (
        results.of(EXACT, name, DIGITS) for name in ("first_1", "first_5", "flight", "prefix", "lacking", "depth")
    )
    lossy_first, lossy_right, lossy_lacking = (
        results.of(EXACT, name, LOSS) for name in ("first_1", "prefix", "lacking")
    )
    deep = max(depth.worst, results.of(EXACT, "depth", ALL).worst)
    swept = {key[0]: row.substeps or 1 for key, row in results.rows.items() if row.family == PYMUNK}
    late = max(results.of(name, "first_1").worst * substeps / DT for name, substeps in swept.items())
    wrong, lost = (sum(results.of(name, it, ALL).total for name in (EXACT, *swept)) for it in ("wrong", "escaped"))
    order = results.order("first_1")
    right_time = first.worst <= 1e-12 and first.n == right.n
    return [
        Claim(
            "exact: the first impact of every 60-digit trajectory is right to 1e-12 s", _worst(first, "s"), right_time
        ),
        Claim("exact: the first 5 impacts are right to 1e-11 s", _worst(fifth, "s"), fifth.worst <= 1e-11),
        Claim(
            f"exact: the first {PREDICTABLE} impacts of each, or all it has, have the right wall and foot",
            f"{lacking.worst:g} lacking, n = {lacking.n}",
            lacking.worst <= 0,
        ),
        Claim(
            "exact: with loss the first impact of every 60-digit trajectory is right to 1e-12 s",
            _worst(lossy_first, "s"),
            lossy_first.worst <= 1e-12 and lossy_first.n == lossy_right.n,
        ),
        Claim(
            "exact: with loss every impact has the right wall and foot",
            f"{lossy_lacking.worst:g} lacking, n = {lossy_lacking.n}",
            lossy_lacking.worst <= 0,
        ),
        Claim("exact: flight is right to 1e-13 m", _worst(flight, "m"), flight.worst <= 1e-13),
        Claim("exact: no foot is deeper in a wall than 1e-9 m", f"{deep:.1e} m", deep <= 1e-9),
        Claim(
            "pymunk: the first impact is the right one, and late by at most one substep",
            f"{wrong:g} wrong, {late:.3f} substeps",
            wrong == 0 and late <= 1.0 + 1e-6,
        ),
        Claim(
            "pymunk: the time of the first impact is of first order in the substep",
            "{:.2f} ({:.2f} to {:.2f})".format(*order),
            0.8 <= order[0] <= 1.2,
        ),
        Claim("exact and pymunk lose no jack", f"{lost:g} lost", lost == 0),
    ]


def _worst(row: Row, unit: str) -> str:
    return f"{row.worst:.1e} {unit}, n = {row.n}"
