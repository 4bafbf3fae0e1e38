"""Speed against accuracy: sweep every contact model and setting over the same cases and write docs/accuracy.md."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from jackbox_env.simulators.fidelity import FIDELITIES
from jackbox_env.tools import checks as check
from scripts.studies import study
from scripts.studies.accuracy import answers, engines
from scripts.studies.accuracy import measured as these
from scripts.studies.accuracy.measured import (
    ALL,
    COST,
    DT,
    EXACT,
    PREDICTABLE,
    PYMUNK,
    REFERENCE,
    THRESHOLD,
    Results,
    Row,
    of_fidelity,
)
from scripts.studies.accuracy.picture import draw, draw_engines, draw_impacts
from scripts.studies.pages import table, two_digits


@dataclass(frozen=True)
class Arguments(study.Arguments):
    """Sweep, or write the page again."""

    quick: bool = False
    """Two minutes: fewer settings, cases and rounds."""
    cases: int | None = None
    """Seeded cases of each kind (chirp, held, weightless); None: 34, or 5 when quick."""
    rounds: int | None = None
    """Rounds in which the costs are measured; None: 7, or 3 when quick."""
    seconds: float = 0.3
    """Time per measurement of cost [s]."""


def trials(arguments: Arguments) -> study.Trials:
    """The errors of each setting, then the costs of all."""
    few = arguments.quick
    cases = check.whole("cases", (5 if few else 34) if arguments.cases is None else arguments.cases, at_least=2)
    rounds = check.whole("rounds", (3 if few else 7) if arguments.rounds is None else arguments.rounds, at_least=1)
    seconds = check.real("seconds", arguments.seconds, above=0.0)
    names = dict.fromkeys(one.name for one in these.settings(few) + these.contenders(few) if one.make)
    errors = [{"part": "errors", "name": name, "quick": few, "cases": cases} for name in names]
    costs = {"part": "costs", "quick": few, "cases": cases, "rounds": rounds, "seconds": seconds}
    return [*errors, costs, *([] if few else engines.trials(rounds, seconds))]


class Claim(NamedTuple):
    """A claim that must hold in every sweep, however short."""

    what: str
    measured: str
    holds: bool


def claims(results: Results) -> list[Claim]:
    """All claims; the command fails if one does not hold."""
    first, fifth, lacking, proven_depth = (
        results.of(EXACT, name, REFERENCE) for name in ("first_1", "first_5", "lacking", "depth")
    )
    deep = max(proven_depth.worst, results.of(EXACT, "depth", ALL).worst)
    best, *_, last = ranking(results)
    swept = {key[0]: row.substeps or 1 for key, row in results.rows.items() if row.family == PYMUNK and row.kind == ALL}
    late = max(results.of(name, "first_1").worst * substeps / DT for name, substeps in swept.items())
    wrong, lost = (sum(results.of(name, it, ALL).total for name in (EXACT, *swept)) for it in ("wrong", "escaped"))
    order = results.order("first_1")
    return [
        Claim(
            "exact: the first impact of every proven case is right to 1e-11 s", _worst(first, "s"), first.worst <= 1e-11
        ),
        Claim("exact: the first 5 impacts are right to 1e-10 s", _worst(fifth, "s"), fifth.worst <= 1e-10),
        Claim(
            f"exact: the first {PREDICTABLE} impacts of each case, or all, have the right wall and foot",
            f"{lacking.worst:g} lacking, n = {lacking.n}",
            lacking.worst <= 0,
        ),
        Claim(
            "exact has the most correct impacts of the proven cases, threshold detection the fewest",
            ", ".join(f"{name}: {results.of(name, 'prefix', REFERENCE).total:g}" for name in (best, last)),
            (best, last) == (EXACT, THRESHOLD),
        ),
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


# -- the page ----------------------------------------------------------------------------------------------------------


def ranking(results: Results) -> list[str]:
    """The settings that played the proven cases, the one with the most correct impacts first."""
    correct = {key[0]: row.total for key, row in results.rows.items() if key[1:] == (REFERENCE, "prefix")}
    return sorted(correct, key=lambda name: -correct[name])


def figure(value: float) -> str:
    """A number of two digits for a table; a dash for NaN, "lost" for infinity."""
    if not math.isfinite(value):
        return "-" if math.isnan(value) else "lost"
    return two_digits(value)


def filled(record: study.Record) -> dict[str, Any]:
    """The numbers of docs/accuracy.md."""
    results, about = Results.of_record(record), record["costs"]["about"]
    missing = "".join(f" {name}: {sentence}." for name, sentence in about["missing"].items())
    fields = {"fidelity_table": fidelity_table(results), "about": about, "missing": missing}
    return fields | {"answers": answers.words(record), "reference": reference_table(results)} | _words(results)


def fidelity_table(results: Results) -> str:
    """The table of fidelities."""
    rows = []
    for name, setting in FIDELITIES.items():
        first, depth, cost = results.some(of_fidelity(name), "first_1", "depth", "cost_over_default")
        late, depth_words = f"{figure(first.median)}, {figure(first.worst)} s", f"{figure(max(0.0, depth.worst))} m"
        contact = f"{setting.contact}, {setting.substeps} substeps" if setting.substeps else setting.contact
        rows.append((f'`"{name}"`', contact, late, depth_words, figure(1.0 / cost.median)))
    heads = ("`fidelity`", "stands for", "first impact late by", "penetration", "speed")
    return table(heads, rows)


# -- words -------------------------------------------------------------------------------------------------------------


def _words(results: Results) -> dict[str, Any]:
    wrong = results.of(THRESHOLD, "imbalance")
    return {name: _of_setting(results, of_fidelity(name)) for name in FIDELITIES} | {
        "threshold_energy": figure(wrong.median),
        "halving": f"{2.0 ** results.order('first_1')[0]:.1f}",
        "proven": f"{results.of(EXACT, 'known', REFERENCE).total:g}",
    }


def _of_setting(results: Results, setting: str) -> dict[str, str]:
    first, cost = results.some(setting, "first_1", "cost_over_default")
    return {
        "late": f"{1e3 * first.median:.2g}",
        "worst_s": figure(first.worst),
        "slower": _times(cost.median),
    }


def _times(value: float) -> str:
    """How many times faster or slower, in two digits at most."""
    return f"{float(f'{value:.2g}'):.{0 if value > 5.0 else 1}f}"


# -- tables ------------------------------------------------------------------------------------------------------------


def reference_table(results: Results) -> str:
    """The settings on the proven cases, by correct impacts."""
    rows, others = [], (", 2 substeps", ", 4 substeps", ", 16 substeps", "accuracy 1e-06")
    for name in (one for one in ranking(results) if not one.endswith(others)):
        correct, known, first, depth, cost = (
            results.rows.get((name, REFERENCE, quantity), Row(name, "", None, REFERENCE, quantity, "", 0))
            for quantity in ("prefix", "known", "first_1", "depth", COST)
        )
        count = f"{correct.total:g} of {known.total:g}"
        rows.append((name, count, _spread(first), figure(depth.worst), figure(cost.median)))
    return table(("setting", "correct impacts", "first impact [s]", "penetration [m]", "µs per simulated s"), rows)


def _spread(row: Row) -> str:
    return f"{figure(row.median)} / {figure(row.worst)}"


# -- the study ---------------------------------------------------------------------------------------------------------


def draw_all(record: study.Record, folder: Path) -> None:
    """Draw the pictures."""
    results, pictures = Results.of_record(record), folder / "accuracy"
    pictures.mkdir(exist_ok=True)
    draw(results, pictures / "work_precision.svg")
    ours = [name for name in ranking(results) if not name.startswith((*engines.ENGINES,))]
    draw_impacts(results, ours, pictures / "impacts.png")
    draw_engines(results, [one["setting"][0] for one in record.get("engine_costs", [])], pictures / "engines.png")


def report(record: study.Record) -> None:
    """Print the table of fidelities and the claims.

    Raises:
        RuntimeError: a claim does not hold.
    """
    results = Results.of_record(record)
    checked = claims(results)
    print(fidelity_table(results))
    print("\n".join(f"{'holds' if claim.holds else 'FAILS'}: {claim.what}: {claim.measured}" for claim in checked))
    failed = [claim.what for claim in checked if not claim.holds]
    if failed:
        raise RuntimeError(f"{len(failed)} claims do not hold: " + "; ".join(failed))


STUDY = study.Study(
    "accuracy",
    {"errors": these.errors_of, "costs": these.costs_of, **engines.PARTS},
    filled,
    Arguments,
    trials,
    single=frozenset({"costs", "engine_costs"}),
    alone=frozenset({"costs", "engine_costs"}),
    packages=("jackbox", "gymnasium", "numpy", "pymunk", "stable-baselines3", "numba", "mujoco", "box2d"),
    joined=engines.with_stored,
    draw=draw_all,
    report=report,
)

if __name__ == "__main__":
    study.main(STUDY, __doc__)
