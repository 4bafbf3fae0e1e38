"""Sums up a sweep: medians and worst, long-run means with intervals, orders of convergence; stored as one CSV."""

from __future__ import annotations

import csv
import math
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy import stats

from agents.files import read_json
from jackbox_env.recording.files import replacing, write_json
from scripts.studies.accuracy.cases import DIGITS, DT, KINDS, LOSS
from scripts.studies.accuracy.settings import BATCH, EXACT, PYMUNK, Setting

ALL = "all seeds"
PREDICTABLE = 14  # impacts that float64 can predict
SPREAD, LEAST, MEAN, TOTAL = "median and worst", "median and least", "mean with interval", "total"
TABLE, ABOUT = "results.csv", "results.json"
_TOLD_BY_SEEDS = ("prefix", "sure", "depth", "imbalance", "escaped", "rate", "speed", "fast", "impulse")
_ELASTIC = ("imbalance",)  # what loss takes is no error

Record = dict[str, Any]  # of one setting on one case


class Quantity(NamedTuple):
    """Something that is measured; the page says what."""

    name: str
    unit: str
    summed: str = SPREAD
    of: Callable[[Record], list[float]] | None = None  # its values in a record; None: the entry of its name

    def values(self, records: Iterable[Record]) -> list[float]:
        """Its values over some cases."""
        of = self.of or (lambda record: [float(record[self.name])])
        return [value for record in records for value in of(record)]


def over_first(count: int) -> Quantity:
    """The largest time error of the first impacts, in the cases that match so many."""
    name = f"first_{count}"
    return Quantity(name, "s", SPREAD, lambda one: [max(one["errors"][:count])] if one["prefix"] >= count else [])


QUANTITIES = (
    Quantity("flight", "m"),
    *map(over_first, (1, 3, 5, 10)),
    Quantity("prefix", "impacts", LEAST),
    Quantity("sure", "impacts"),
    Quantity("lacking", "impacts", SPREAD, lambda one: [min(one["sure"], PREDICTABLE) - one["prefix"]]),
    Quantity("local", "m", SPREAD, lambda one: one["local"]),
    Quantity("imbalance", "1"),
    Quantity("depth", "m"),
    Quantity("wrong", "runs", TOTAL, lambda one: [float(one["prefix"] == 0)] if one["sure"] else []),
    Quantity("escaped", "runs", TOTAL),
    *(Quantity(name, "impacts", TOTAL) for name in ("expected", "missed", "extra")),
    *(Quantity(name, unit, MEAN) for name, unit in (("rate", "1/s"), ("speed", "m/s"), ("fast", "m/s"))),
    Quantity("impulse", "N s", MEAN),
)


class Row(NamedTuple):
    """A quantity of a setting over the cases of a kind; NaN where it is summed up otherwise."""

    setting: str
    family: str
    substeps: int | None
    kind: str
    quantity: str
    unit: str
    n: int
    median: float = math.nan
    worst: float = math.nan
    mean: float = math.nan
    half_width: float = math.nan  # of the mean's 95 % interval
    total: float = math.nan


def summed_up(values: Iterable[float], summed: str = SPREAD) -> dict[str, Any]:
    """Numbers as a row has them, NaN left out."""
    known = np.array([value for value in values if not math.isnan(value)])
    n = len(known)
    if summed == TOTAL or n == 0:
        return {"n": n} | ({"total": known.sum()} if summed == TOTAL else {})
    if summed == MEAN:
        half_width = stats.t.ppf(0.975, n - 1) * stats.sem(known) if n > 1 else math.inf
        return {"n": n, "mean": known.mean(), "half_width": half_width}
    return {"n": n, "median": np.median(known), "worst": known.min() if summed == LEAST else known.max()}


def rows_of(setting: Setting, records: list[Record], cost: list[float], over_default: list[float]) -> list[Row]:
    """A setting's costs, and every quantity over each kind of cases and over all seeded ones."""
    head = setting[:3]
    rows = [Row(*head, "", "cost", "us/s", **summed_up(cost))]
    rows.append(Row(*head, "", "cost_over_default", "1", **summed_up(over_default)))
    return rows + rows_of_kinds(setting, records)


def rows_of_kinds(setting: Setting, records: list[Record]) -> list[Row]:
    """Every quantity of a setting over each kind of cases, and over all seeded ones if there are any."""
    parts: dict[str, list[Record]] = {}
    for record in records:
        for kind in (record["kind"], *([ALL] if record["kind"] in KINDS else [])):
            parts.setdefault(kind, []).append(record)
    return [
        Row(*setting[:3], kind, quantity.name, quantity.unit, **summed_up(quantity.values(part), quantity.summed))
        for kind, part in parts.items()
        for quantity in QUANTITIES
        if kind != LOSS or quantity.name not in _ELASTIC
    ]


def order_of(steps: list[float], errors: list[float]) -> tuple[float, float, float]:
    """Exponent p in error ~ step^p with its 95 % interval: least squares in logarithms."""
    fit = stats.linregress(np.log(steps), np.log(errors))
    half_width = stats.t.ppf(0.975, len(steps) - 2) * fit.stderr
    return fit.slope, fit.slope - half_width, fit.slope + half_width


class Results:
    """A summed up sweep: rows, and what they were measured with."""

    def __init__(self, rows: Iterable[Row], about: dict[str, Any]) -> None:
        """Keep the rows by setting, kind and quantity."""
        self.rows = {(row.setting, row.kind, row.quantity): row for row in rows}
        self.about = about
        self.settings = list(dict.fromkeys(row.setting for row in self.rows.values()))

    def of(self, setting: str, quantity: str, kind: str | None = None) -> Row:
        """A quantity of a setting, over a kind of cases or, with None, over those that tell most.

        The exact model is the reference over the seeds, so its own errors are taken from the 60-digit trajectories.
        """
        if quantity.startswith("cost"):
            return self.rows[setting, "", quantity]
        setting = EXACT if setting == BATCH else setting
        telling = DIGITS if setting == EXACT and quantity not in _TOLD_BY_SEEDS else ALL
        return self.rows[setting, kind or telling, quantity]

    def some(self, setting: str, *quantities: str) -> list[Row]:
        """Several quantities of a setting."""
        return [self.of(setting, quantity) for quantity in quantities]

    def order(self, quantity: str) -> tuple[float, float, float]:
        """Order of convergence of pymunk's medians, with its 95 % interval."""
        rows = [row for row in self.rows.values() if (row.family, row.kind, row.quantity) == (PYMUNK, ALL, quantity)]
        return order_of([DT / (row.substeps or 1) for row in rows], [row.median for row in rows])

    def save(self, folder: Path) -> None:
        """Write both files."""
        with replacing(folder / TABLE) as partial, partial.open("w", newline="") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(Row._fields)
            for row in self.rows.values():
                numbers = ("" if math.isnan(number) else f"{number:.6g}" for number in row[7:])
                writer.writerow([*row[:7], *numbers])
        write_json(folder / ABOUT, self.about)

    @classmethod
    def load(cls, folder: Path) -> Results:
        """Read what :meth:`save` wrote."""
        with (folder / TABLE).open(newline="") as file:
            _, *lines = csv.reader(file)
        return cls(map(_row, lines), read_json(folder / ABOUT))


def _row(line: list[str]) -> Row:
    setting, family, substeps, kind, quantity, unit, n, *numbers = line
    values = [float(number or "nan") for number in numbers]
    return Row(setting, family, int(substeps) if substeps else None, kind, quantity, unit, int(n), *values)
