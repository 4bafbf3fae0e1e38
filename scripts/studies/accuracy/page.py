"""Fills page.md and which.md, the page of a sweep and its part for README, with the numbers of the sweep."""

from __future__ import annotations

import math
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from jackbox_env.simulators.fidelity import FIDELITIES
from scripts.studies.accuracy.cases import KINDS, LOSS
from scripts.studies.accuracy.claims import claims
from scripts.studies.accuracy.results import Results, Row
from scripts.studies.accuracy.settings import BATCH, EXACT, SUBSTEPS, USUAL, named, of_fidelity, pymunk

DEFAULT = of_fidelity("balanced")
_ENGINES = [named(engine, n) for engine in ("box2d", "mujoco") for n in (4, 64)]
TABLED = (EXACT, *(pymunk(n).name for n in (2, 4, 16, 64)), USUAL, *_ENGINES)
COLUMNS = {
    "impacts": {
        "µs per simulated s": "cost", "first impact [s]": "first_1", "first 3 [s]": "first_3", "first 5 [s]": "first_5",
        "right impacts": "prefix",
    },
    "motion": {
        "flight [m]": "flight", "restart [m]": "local", "energy": "imbalance", "deepest [m]": "depth",
        "lost": "escaped", "missed": "missed", "extra": "extra",
    },
    "loss": {
        "first impact [s]": "first_1", "first 3 [s]": "first_3", "restart [m]": "local", "right impacts": "prefix",
        "deepest [m]": "depth", "missed": "missed", "extra": "extra",
    },
    "long_run": {
        "impacts per s": "rate", "mean speed [m/s]": "speed", "90 % of the time below [m/s]": "fast",
        "mean impulse [N s]": "impulse",
    },
}  # fmt: skip
_HERE = Path(__file__).parent


def figure(value: float) -> str:
    """A number for a table: two digits, as a power of ten where it is small; a dash for none."""
    if not math.isfinite(value):
        return "-" if math.isnan(value) else "lost"
    if abs(value) >= 100.0:
        return f"{value:,.0f}"
    return f"{float(f'{value:.2g}'):g}" if value == 0.0 or abs(value) >= 1e-3 else f"{value:.1e}"


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table with aligned columns."""
    cells = [list(heads), *map(list, rows)]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    head, *lines = ["| " + " | ".join(map(str.ljust, row, widths)) + " |" for row in cells]
    return "\n".join([head, "|" + "|".join("-" * (width + 2) for width in widths) + "|", *lines])


def page(results: Results) -> str:
    """The whole page; its files are beside it in accuracy/."""
    fields = _words(results) | _tables(results) | {"which": _which(results), "fidelity_table": fidelity_table(results)}
    return (_HERE / "page.md").read_text().format(**fields)


def _which(results: Results) -> str:
    return (_HERE / "which.md").read_text().rstrip().format(**_words(results))


def fidelity_table(results: Results) -> str:
    """What the environment's docstring and README hold; tests compare them."""
    rows = []
    for name, (contact, substeps) in FIDELITIES.items():
        first, depth, right, cost = results.some(of_fidelity(name), "first_1", "depth", "prefix", "cost_over_default")
        late, deep = f"{figure(first.median)}, {figure(first.worst)} s", f"{figure(max(0.0, depth.worst))} m"
        stands = f"{contact}, {substeps} substeps" if substeps else contact
        rows.append((f'`"{name}"`', stands, late, deep, f"{right.median:g}", figure(1.0 / cost.median)))
    heads = ("`fidelity`", "stands for", "first impact late by", "deepest in a wall", "right impacts", "speed")
    return table(heads, rows)


# -- words -------------------------------------------------------------------------------------------------------------


def _words(results: Results) -> dict[str, Any]:
    about, single = results.about, pymunk(4, 1).name
    wrong, lost = results.some(USUAL, "imbalance", "escaped")
    alone, batch = results.of(EXACT, "cost").median, results.of(BATCH, "cost").median
    return {name: _of_setting(results, of_fidelity(name)) for name in FIDELITIES} | {
        "many": _times(alone / batch / results.of(EXACT, "cost_over_default").median),
        "within": _within(results),
        "usual_energy": figure(wrong.median),
        "usual_lost": f"{lost.total:g} of {lost.n}",
        "halving": f"{2.0 ** results.order('first_1')[0]:.1f}",
        "orders": ["{:.2f} ({:.2f} to {:.2f})".format(*results.order(quantity)) for quantity in ("first_1", "depth")],
        "single_cost": _percent(results.of(single, "cost_over_default").median),
        "single_energy": _percent(results.of(single, "imbalance").worst),
        "runs": results.of(DEFAULT, "depth").n,
        "sure": f"{results.of(DEFAULT, 'sure').median:g}",
        "expected": [f"{results.of(name, 'expected').total:,.0f}" for name in (DEFAULT, EXACT)],
        "known": results.of(EXACT, "flight").n,
        "kinds": ", ".join(KINDS),
        "lossy": results.of(EXACT, "depth", LOSS).n,
        "lossy_sure": f"{results.of(EXACT, 'expected', LOSS).total:g}",
        "loss_from": _loss_from(about),
        "about": about,
        "busy": _percent(about["busy"]),
        "versions": ", ".join(f"{name} {version}" for name, version in about["versions"].items()),
        "missing": "".join(f" {name}: {sentence}." for name, sentence in about["missing"].items()),
    }


def _of_setting(results: Results, setting: str) -> dict[str, str]:
    first, depth, cost = results.some(setting, "first_1", "depth", "cost_over_default")
    return {
        "late": f"{1e3 * first.median:.2g}",
        "worst": f"{1e3 * first.worst:.2g}",
        "worst_s": figure(first.worst),
        "deep": figure(depth.worst),
        "slower": _times(cost.median),
        "faster": _times(1.0 / cost.median),
        "saves": _percent(1.0 - cost.median),
    }


def _percent(value: float) -> str:
    return f"{100.0 * value:.0f} %"


def _loss_from(about: dict[str, Any]) -> str:
    """Where the figures with loss are from, if not from the sweep itself."""
    if "loss" not in about:
        return ""
    own = about["loss"]
    return (
        f" These trajectories were measured later, at commit {own['versions']['commit']}, by `{own['command']}`; the "
        "rest of this page is older."
    )


def _times(value: float) -> str:
    """How many times faster or slower, in two digits at most."""
    return f"{float(f'{value:.2g}'):.{0 if value > 5.0 else 1}f}"


def _within(results: Results) -> str:
    """The coarsest setting of pymunk whose first impact is never 1 ms late."""
    for substeps in SUBSTEPS:
        name = pymunk(substeps).name
        if name in results.settings and results.of(name, "first_1").worst <= 1e-3:
            slower = _of_setting(results, name)["slower"]
            return f" `substeps={substeps}` stays within 1 ms and is {slower} times slower."
    return ""


# -- tables ------------------------------------------------------------------------------------------------------------


def _tables(results: Results) -> dict[str, str]:
    seen = ((claim.what, claim.seen, "holds" if claim.holds else "FAILS") for claim in claims(results))
    runs = results.of(DEFAULT, "depth").n
    lossy = results.of(EXACT, "depth", LOSS).n
    tables = {"claims": table(("claim", "seen", ""), seen)}
    for field, columns in COLUMNS.items():
        kind, of = (LOSS, lossy) if field == "loss" else (None, runs)
        shown = [name for name in TABLED if (name, kind or "", "cost" if kind is None else "first_1") in results.rows]
        rows = (
            (name, *(_cell(results.of(name, quantity, kind), of) for quantity in columns.values())) for name in shown
        )
        tables[field] = table(("setting", *columns), rows)
    return tables


def _cell(row: Row, runs: int) -> str:
    if math.isfinite(row.total):
        return figure(row.total)
    if math.isfinite(row.mean):
        return f"{row.mean:.3g} ± {row.half_width:.2g}"
    note = "" if row.n == runs else f" ({row.n})"
    return f"{figure(row.median)} / {figure(row.worst)}{note}" if row.n else "-"
