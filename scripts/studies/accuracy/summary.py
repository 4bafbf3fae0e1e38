"""Sums up a sweep: medians and worst with the number of cases, orders of convergence, long-run means with intervals."""

from __future__ import annotations

import math
import statistics
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple

import numpy as np

from scripts.studies.accuracy.cases import DIGITS, DT
from scripts.studies.accuracy.settings import EXACT, PYMUNK, Setting

FIRST = (1, 3, 5, 10)  # impacts over which time errors are summed up
ALL = "all seeds"
PREDICTABLE = 14  # impacts that float64 can predict
_RESAMPLES = 1000

Record = dict[str, Any]


class Spread(NamedTuple):
    """Median and worst of a quantity over n cases that have it."""

    median: float
    worst: float
    n: int

    @classmethod
    def of(cls, values: Iterable[float], least: bool = False) -> Spread:
        """Of numbers, NaN left out; ``least``: the smallest is the worst."""
        known = [value for value in values if not math.isnan(value)]
        if not known:
            return cls(math.nan, math.nan, 0)
        return cls(statistics.median(known), (min if least else max)(known), len(known))


class Mean(NamedTuple):
    """Mean of a quantity over n cases, with the half width of its 95 % interval (1.96 standard errors)."""

    mean: float
    half_width: float
    n: int

    @classmethod
    def of(cls, values: Iterable[float]) -> Mean:
        """Of numbers, NaN left out."""
        known = [value for value in values if not math.isnan(value)]
        if len(known) < 2:
            return cls(known[0] if known else math.nan, math.inf, len(known))
        return cls(statistics.fmean(known), 1.96 * statistics.stdev(known) / math.sqrt(len(known)), len(known))


def number(value: Any) -> float:
    """A number as JSON had to write it."""
    return math.nan if value is None else math.inf if value == "inf" else float(value)


def _column(name: str) -> Callable[[list[Record]], list[float]]:
    return lambda records: [number(record[name]) for record in records]


def over_first(records: list[Record], count: int) -> list[float]:
    """Largest time error over the first ``count`` impacts of each case that matches so many [s]."""
    return [max(record["errors"][:count]) for record in records if record["prefix"] >= count]


def locals_of(records: list[Record]) -> list[float]:
    """Local errors of all restarts with an impact [m]."""
    return [number(error) for record in records for error in record["local"]]


# name, unit, what it is, how it is taken from records
SPREADS: tuple[tuple[str, str, str, Callable[[list[Record]], list[float]]], ...] = (
    ("flight", "m", "largest pose error before the first impact", _column("flight")),
    *(
        (
            f"first_{count}",
            "s",
            f"largest time error of the first {count} impacts" if count > 1 else "time error of the first impact",
            lambda records, count=count: over_first(records, count),
        )
        for count in FIRST
    ),
    ("prefix", "impacts", "impacts with the right wall and foot before the first wrong one", _column("prefix")),
    ("local", "m", "pose error 0.1 s after a restart on the reference, with an impact in between", locals_of),
    ("imbalance", "of the kinetic energy", "largest |energy gained - work of the torque|", _column("imbalance")),
    ("depth", "m", "deepest penetration", _column("depth")),
)
MEANS = (("rate", "1/s"), ("speed", "m/s"), ("fast", "m/s"), ("impulse", "N s"))


def summed_up(records: list[Record]) -> dict[str, Any]:
    """One setting over one kind of cases."""
    found: dict[str, Any] = {"cases": len(records)}
    for name, _, _, take in SPREADS:
        found[name] = Spread.of(take(records), least=name == "prefix")._asdict()
    found["sure"] = Spread.of(_column("sure")(records))._asdict()
    found["with_impacts"] = sum(record["sure"] > 0 for record in records)
    found["lacking"] = max(min(record["sure"], PREDICTABLE) - record["prefix"] for record in records)
    found["escaped"] = sum(record["escaped"] for record in records)
    for name in ("missed", "extra", "expected"):
        found[name] = sum(record[name] for record in records)
    for name, _ in MEANS:
        found[name] = Mean.of(_column(name)(records))._asdict()
    return found


def kinds_of(records: Iterable[Record]) -> dict[str, list[Record]]:
    """Records by kind, and all seeded ones together."""
    sorted_out: dict[str, list[Record]] = {}
    for record in records:
        sorted_out.setdefault(record["kind"], []).append(record)
        if record["kind"] != DIGITS:
            sorted_out.setdefault(ALL, []).append(record)
    return sorted_out


class Order(NamedTuple):
    """Exponent p in error ~ h^p, fitted to medians, with its 95 % interval from resampled cases."""

    order: float
    low: float
    high: float


def order_of(errors: dict[float, dict[str, float]]) -> Order:
    """Fit the order of convergence.

    Args:
        errors: by substep h [s], then by case; only cases that every h has are used.
    """
    steps = sorted(errors)
    shared = sorted(set.intersection(*(set(errors[h]) for h in steps)))
    values = np.array([[errors[h][case] for case in shared] for h in steps])
    rng = np.random.default_rng(0)
    fits = []
    for resample in range(_RESAMPLES + 1):
        chosen = rng.integers(len(shared), size=len(shared)) if resample else np.arange(len(shared))
        medians = np.median(values[:, chosen], axis=1)
        fits.append(float(np.polyfit(np.log(steps), np.log(medians), 1)[0]))
    return Order(fits[0], *(float(bound) for bound in np.quantile(fits[1:], [0.025, 0.975])))


def orders(settings: list[Setting], records: dict[str, list[Record]]) -> dict[str, Any]:
    """Orders of convergence of pymunk, by quantity, over all seeded cases."""
    family = [setting for setting in settings if setting.family == PYMUNK and setting.substeps]
    found = {}
    takes: dict[str, Callable[[Record], float]] = {
        "first_1": lambda record: record["errors"][0] if record["prefix"] else math.nan,
        "depth": lambda record: number(record["depth"]),
    }
    for name, take in takes.items():
        errors: dict[float, dict[str, float]] = {}
        for setting in family:
            seeded = [record for record in records[setting.name] if record["kind"] != DIGITS]
            values = {record["case"]: take(record) for record in seeded}
            errors[DT / (setting.substeps or 1)] = {case: error for case, error in values.items() if error > 0.0}
        found[name] = order_of(errors)._asdict()
    return found


class Claim(NamedTuple):
    """Something the page says, and whether this sweep bears it out."""

    what: str
    seen: str
    holds: bool


def claims(results: dict[str, Any]) -> list[Claim]:
    """What must hold in every sweep, however short; the command fails where one does not."""
    by_name = results["settings"]
    digits, seeded = by_name[EXACT]["kinds"][DIGITS], by_name[EXACT]["kinds"][ALL]
    flight = digits["flight"]["worst"]
    order = results["orders"]["first_1"]
    own = {name: entry["kinds"][ALL] for name, entry in by_name.items() if entry["contact"] is not None}
    late = {
        name: own[name]["first_1"]["worst"] / (DT / by_name[name]["substeps"])
        for name in own
        if by_name[name]["substeps"]
    }
    wrong = sum(kind["with_impacts"] - kind["first_1"]["n"] for kind in own.values())
    escaped = sum(kind["escaped"] for kind in own.values())
    return [
        Claim(
            "exact: the first impact of every 60-digit trajectory within 1e-12 s",
            f"{digits['first_1']['worst']:.1e} s, n = {digits['first_1']['n']}",
            digits["first_1"]["worst"] <= 1e-12 and digits["first_1"]["n"] == digits["cases"],
        ),
        Claim(
            "exact: the first 5 impacts within 1e-11 s where there are so many",
            f"{digits['first_5']['worst']:.1e} s, n = {digits['first_5']['n']}",
            digits["first_5"]["worst"] <= 1e-11 and digits["first_5"]["n"] > 0,
        ),
        Claim(
            f"exact: wall and foot of the first {PREDICTABLE} impacts of each 60-digit trajectory, or of all it has",
            f"{digits['prefix']['median']:g} of each compared (median), {digits['lacking']} lacking",
            digits["lacking"] <= 0,
        ),
        Claim("exact: flight within 1e-13 m", f"{flight:.1e} m", flight <= 1e-13),
        Claim(
            "exact: no foot deeper in a wall than 1e-9 m",
            f"{max(digits['depth']['worst'], seeded['depth']['worst']):.1e} m",
            max(digits["depth"]["worst"], seeded["depth"]["worst"]) <= 1e-9,
        ),
        Claim(
            "pymunk: the first impact is the right one, and late by one substep at most",
            f"{wrong} wrong, {max(late.values()):.3f} substeps",
            wrong == 0 and max(late.values()) <= 1.0 + 1e-6,
        ),
        Claim(
            "pymunk: first order in the substep",
            f"{order['order']:.2f} ({order['low']:.2f} to {order['high']:.2f})",
            0.8 <= order["order"] <= 1.2,
        ),
        Claim("exact and pymunk lose no jack", f"{escaped} lost", escaped == 0),
    ]
