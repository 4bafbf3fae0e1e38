"""Engines that people use, on the proven motions: the search for their best settings, their scores and their costs.

This project does without all of them. The results of an engine that is not installed stay as they are stored.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

from agents.runs import installed
from scripts import referee
from scripts.studies.accuracy import measured as these
from scripts.studies.accuracy.measured import COST, REFERENCE, Setting
from scripts.studies.baselines import IN_JAVASCRIPT, baseline
from scripts.studies.baselines.javascript import play, version
from scripts.studies.study import Record
from scripts.studies.timing import Timed, measure, repeat

TIMED = ("chirp-0", "chirp-1", "held-0", "held-1", "weightless")  # proven cases of 5 s, on which costs are measured


class Engine(NamedTuple):
    """An engine that people use."""

    package: str
    adapter: str  # a module of scripts.studies.baselines, or a file in JavaScript there
    best: dict[str, Any]  # settings that the search found
    tried: dict[str, tuple[Any, ...]]  # by setting: its default, which the search starts from, and others
    unit: str = "substeps"  # what the points are
    points: tuple[float, ...] = (2, 4, 16, 64)
    searched: tuple[float, ...] = (4, 64)  # points at which settings are compared

    @property
    def version(self) -> str:
        """The package's version; empty if Python or Node does not find it."""
        return (
            version(self.package)
            if self.adapter in IN_JAVASCRIPT
            else installed([self.package])[self.package].removeprefix("not installed")
        )


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


def setting_of(engine: str, point: float) -> Setting:
    """A point of an engine's line at its best settings; one in JavaScript cannot be made."""
    _, adapter, best, _, unit, *_ = ENGINES[engine]
    name = these.named(engine, int(point)) if unit == "substeps" else f"{engine}, {unit} {point:g}"
    make = None if adapter in IN_JAVASCRIPT else partial(baseline(adapter), **{unit: point}, **best)
    return Setting(name, engine, int(point) or None, make)


def scores_of(engine: str, point: float, settings: dict[str, Any], cases: Sequence[str] = ()) -> list[referee.Score]:
    """The referee's scores of the proven cases, all or those of these names."""
    names, make = list(cases or referee.reference()), setting_of(engine, point).make
    if make is not None:
        return [these.score_of(partial(make, **settings), referee.reference()[name]) for name in names]
    states, impacts, _ = play(ENGINES[engine].adapter, {"substeps": point, "cases": names, **settings})
    return referee.scores_of(states, impacts, referee.TOLERANCE)


# -- parts of the study ------------------------------------------------------------------------------------------------


def search_of(engine: str) -> dict[str, Any]:
    """Change one setting after the other to the value with the most correct impacts, then the least error of energy."""
    _, _, _, tried, unit, _, points = ENGINES[engine]
    best, reached, rows = {name: values[0] for name, values in tried.items()}, (-1.0, 0.0), list[dict[str, Any]]()
    for change in ({}, *({name: value} for name, values in tried.items() for value in values[1:])):
        settings = best | change
        totals = [referee.summary(scores_of(engine, point, settings)) for point in points]
        correct, energy = sum(total["correct"] for total in totals), max(total["energy_median"] for total in totals)
        rows.append({"settings": settings, "correct": correct, "energy": energy})
        if (correct, -energy) > reached:
            best, reached = settings, (correct, -energy)
    return {"setting": [engine, unit, points], "version": ENGINES[engine].version, "best": best, "tried": rows}


def engine_of(engine: str, point: float) -> dict[str, Any]:
    """The scores of an engine at its best settings, summed up."""
    setting, scores = setting_of(engine, point), scores_of(engine, point, ENGINES[engine].best)
    return {"setting": setting[:3], "rows": these.summaries([these.as_record(setting.name, one) for one in scores])}


def costs_of(rounds: int, seconds: float) -> list[dict[str, Any]]:
    """Costs of all that play the proven cases, measured in turn: processor times of whole plays of some of them."""
    theirs = (setting_of(name, point) for name, one in ENGINES.items() if one.version for point in one.points)
    settings = {one.name: one for one in (*these.contenders(quick=False), *theirs)}
    rates = measure({name: timed_of(setting, seconds) for name, setting in settings.items()}, rounds)
    row = {"kind": REFERENCE, "quantity": COST, "unit": "us/s"}
    costs = ((settings[name][:3], these.summed_up(1e6 / rate for rate in of)) for name, of in rates.items())
    return [{"setting": setting, "rows": [row | cost]} for setting, cost in costs]


def timed_of(setting: Setting, seconds: float) -> Timed:
    """Simulated seconds per second of the processor."""
    if setting.make is None:
        _, adapter, best, *_ = ENGINES[setting.family]
        settings = {"substeps": setting.substeps, "seconds": seconds, "cases": TIMED, **best}
        return lambda: float(play(adapter, settings)[2]["speed"])
    cases = [referee.reference()[name][0] for name in TIMED]
    rate = repeat(these.stepped(setting.make, cases), seconds, clock=time.thread_time)
    return lambda: these.DT * rate()


PARTS: dict[str, Callable[..., Any]] = {"search": search_of, "engines": engine_of, "engine_costs": costs_of}


def trials(rounds: int, seconds: float) -> list[dict[str, Any]]:
    """The trials of these parts, of the engines that are installed."""
    present = {name: engine.points for name, engine in ENGINES.items() if engine.version}
    searches = [{"part": "search", "engine": name} for name in present]
    scores = [{"part": "engines", "engine": name, "point": point} for name in present for point in present[name]]
    return [*searches, *scores, {"part": "engine_costs", "rounds": rounds, "seconds": seconds}]


def with_stored(new: Record, stored: Record) -> Record:
    """New results; what was not measured now, as it is not installed, stays as it is stored and is marked as kept."""
    for part in PARTS.keys() & new.keys():
        measured = {one["setting"][0] for one in new[part]}
        new[part] += [{**one, "kept": True} for one in stored.get(part, []) if one["setting"][0] not in measured]
    return new
