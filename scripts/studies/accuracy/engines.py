"""Engines that people use, on the proven motions: the search for their best settings, their scores and their costs.

This project does without all of them. The results of an engine that is not installed stay as they are stored.
"""

from __future__ import annotations

import importlib.metadata
import importlib.util
import time
from collections.abc import Callable
from functools import partial
from typing import Any, NamedTuple

from jackbox_env.simulators import Simulator
from scripts import referee
from scripts.studies import baselines
from scripts.studies.accuracy import measured as these
from scripts.studies.accuracy.measured import COST, REFERENCE
from scripts.studies.baselines import javascript
from scripts.studies.study import Record
from scripts.studies.timing import Timed, measure, ratios, repeat

TIMED = ("chirp-0", "chirp-1", "held-0", "held-1", "weightless")  # proven cases of 5 s, on which costs are measured
SUBSTEPS = (2, 4, 16, 64)
RATIO = f"{COST}_over_default"


class Engine(NamedTuple):
    """An engine that people use."""

    package: str
    adapter: str  # a module of scripts.studies.baselines, or a file in JavaScript there
    best: dict[str, Any]  # settings that the search found
    tried: dict[str, tuple[Any, ...]]  # by setting: its default, which the search starts from, and others
    unit: str = "substeps"  # what the points are
    points: tuple[float, ...] = SUBSTEPS
    searched: tuple[float, ...] = (4, 64)  # points at which settings are compared

    @property
    def missing(self) -> str:
        """How to install it; empty if it is."""
        if self.adapter in baselines.IN_JAVASCRIPT:
            return "" if javascript.is_installed(self.package) else f"not installed (npm install {self.package})"
        module = "pydrake" if self.package == "drake" else self.package
        return "" if importlib.util.find_spec(module) else f"not installed (pip install {self.package})"


ENGINES = {
    "Box2D v3": Engine(
        "pyb2d3", "box2d3",
        {
            "inner": 1, "threshold": 0.0, "units": 0.1, "hertz": 30.0, "damping": 1.0, "push": 3.0, "radius": 0.001,
            "bullet": False,
        },
        {
            "inner": (1, 2, 4), "threshold": (0.0, 1.0), "units": (1.0, 0.1, 0.01), "hertz": (30.0, 1.0, 240.0),
            "damping": (10.0, 1.0, 0.0), "push": (3.0, 0.0), "radius": (0.001, 0.0, 0.01), "bullet": (False, True),
        },
    ),
    "Rapier": Engine(
        "@dimforge/rapier2d-compat", "rapier",
        {
            "inner": 1, "lengthUnit": 0.1, "contact_natural_frequency": 30.0, "normalizedPredictionDistance": 0.002,
            "normalizedAllowedLinearError": 0.001, "numInternalPgsIterations": 1, "radius": 0.001, "ccd": False,
        },
        {
            "inner": (1, 2, 4), "lengthUnit": (1.0, 0.1, 10.0), "contact_natural_frequency": (30.0, 1.0, 1000.0),
            "normalizedPredictionDistance": (0.002, 0.0, 0.1), "normalizedAllowedLinearError": (0.001, 0.0, 0.1),
            "numInternalPgsIterations": (1, 4), "radius": (0.001, 0.0001, 0.01), "ccd": (False, True),
        },
    ),
    "matter.js": Engine(
        "matter-js", "matter",
        {"resting": 0.0, "slop": 0.005, "dampen": 0.0, "velocityIterations": 4, "positionIterations": 6},
        {
            "resting": (0.0, 2.0), "slop": (0.05, 0.0, 0.005), "dampen": (0.9, 0.0, 0.5),
            "velocityIterations": (4, 1, 16), "positionIterations": (6, 1, 20),
        },
    ),
    "Drake": Engine(
        "drake", "drake", {"scheme": "runge_kutta3", "longest": 0.005},
        {"scheme": ("runge_kutta3", "runge_kutta5"), "longest": (0.02, 0.005)},
        "accuracy", (1e-3, 1e-6, 1e-10), (1e-3, 1e-6),
    ),
}  # fmt: skip


def name_of(engine: str, point: float) -> str:
    """Name of an engine's row."""
    return these.named(engine, int(point)) if ENGINES[engine].unit == "substeps" else f"{engine}, accuracy {point:g}"


def made(engine: str, point: float, settings: dict[str, Any]) -> Callable[..., Simulator]:
    """The adapter of an engine in Python, as a function of the scene."""
    return partial(baselines.baseline(ENGINES[engine].adapter), **{ENGINES[engine].unit: point}, **settings)


def played(engine: str, point: float, settings: dict[str, Any]) -> tuple[list[referee.Score], str]:
    """The referee's scores of the proven cases, and the version of the engine's package."""
    package, adapter, *_ = ENGINES[engine]
    if adapter in baselines.IN_JAVASCRIPT:
        states, impacts, printed = javascript.play(adapter, {"substeps": point, **settings})
        return referee.scores_of(states, impacts, referee.TOLERANCE), printed["version"]
    make = made(engine, point, settings)
    scores = [these.score_of(make, known) for known in referee.reference().values()]
    return scores, importlib.metadata.version(package)


# -- parts of the study ------------------------------------------------------------------------------------------------


def search_of(engine: str) -> dict[str, Any]:
    """Change one setting after the other to the value with the most correct impacts, then the least error of energy."""
    chosen = ENGINES[engine]
    if chosen.missing:
        return {"engine": engine, "missing": chosen.missing}
    best, rows = {name: values[0] for name, values in chosen.tried.items()}, list[dict[str, Any]]()

    def tried(settings: dict[str, Any]) -> tuple[float, float]:
        totals = [referee.summary(played(engine, point, settings)[0]) for point in chosen.searched]
        correct, energy = sum(total["correct"] for total in totals), max(total["energy_median"] for total in totals)
        rows.append({"settings": settings, "correct": correct, "energy": energy})
        return correct, -energy

    reached = tried(best)
    for name, values in chosen.tried.items():
        for value in values[1:]:
            other = best | {name: value}
            if (now := tried(other)) > reached:
                best, reached = other, now
    return {"engine": engine, "best": best, "tried": rows}


def engine_of(engine: str, point: float) -> dict[str, Any]:
    """The scores of an engine at its best settings, summed up."""
    chosen, name = ENGINES[engine], name_of(engine, point)
    setting = [name, engine, point if chosen.unit == "substeps" else None]
    if chosen.missing:
        return {"setting": setting, "missing": chosen.missing}
    scores, version = played(engine, point, chosen.best)
    return {
        "setting": setting,
        "version": version,
        "rows": these.summaries([these.as_record(name, score) for score in scores]),
    }


def costs_of(rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Costs of all that play the proven cases, measured in turn; of an engine that is missing only its name."""
    timed = {one.name: timed_of(one.make, seconds) for one in these.contenders(quick=False) if one.make}
    missing = []
    for engine, chosen in ENGINES.items():
        for point in chosen.points:
            if chosen.missing:
                missing.append({"setting": [name_of(engine, point), engine, None], "missing": chosen.missing})
            elif chosen.adapter in baselines.IN_JAVASCRIPT:
                settings = {"substeps": point, "seconds": seconds, "timed": TIMED, **chosen.best}
                timed[name_of(engine, point)] = partial(_speed, chosen.adapter, settings)
            else:
                timed[name_of(engine, point)] = timed_of(made(engine, point, chosen.best), seconds)
    rates = measure(timed, rounds)
    groups = []
    for name in timed:
        values = {COST: [1e6 / rate for rate in rates[name]], RATIO: ratios(rates, these.DEFAULT, name)}
        rows = [
            {"kind": REFERENCE, "quantity": of, "unit": unit, **these.summed_up(values[of])}
            for of, unit in ((COST, "us/s"), (RATIO, "1"))
        ]
        groups.append({"setting": [name, name.split(",")[0], None], "rows": rows})
    return [*groups, *missing]


def _speed(adapter: str, settings: dict[str, Any]) -> float:
    return float(javascript.play(adapter, settings)[2]["speed"])


def timed_of(make: Callable[..., Simulator], seconds: float) -> Timed:
    """Simulated seconds per second of this thread's own time, over whole plays of some proven cases."""
    cases = [referee.reference()[name][0] for name in TIMED]
    rate = repeat(these.stepped(make, cases), seconds, clock=time.thread_time)
    return lambda: these.DT * rate()


def with_stored(new: Record, stored: Record) -> Record:
    """New results; those of an engine that is missing now are the stored ones, marked as kept."""
    for part in ("search", "engines", "engine_costs"):
        before = {_key(one): one for one in stored.get(part, []) if "missing" not in one}
        kept = [
            before[_key(one)] | {"kept": one["missing"]}
            for one in new.get(part, [])
            if "missing" in one and _key(one) in before
        ]
        if part in new:
            new[part] = [one for one in new[part] if "missing" not in one] + kept
    return new


def _key(one: dict[str, Any]) -> str:
    return one["engine"] if "engine" in one else one["setting"][0]


PARTS = {"search": search_of, "engines": engine_of, "engine_costs": costs_of}


def trials(rounds: int, seconds: float) -> list[dict[str, Any]]:
    """The trials of these parts."""
    searches = [{"part": "search", "engine": engine} for engine in ENGINES]
    scores = [
        {"part": "engines", "engine": name, "point": point} for name, of in ENGINES.items() for point in of.points
    ]
    return [*searches, *scores, {"part": "engine_costs", "rounds": rounds, "seconds": seconds}]
