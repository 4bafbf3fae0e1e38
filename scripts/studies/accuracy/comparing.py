"""How accurate a contact model is, measured against the exact one.

:func:`reference_of` computes the correct course of a case, and how many of its impacts are certain. :func:`compare` and
:func:`restarts` measure the difference.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.measure.accuracy import Case, Course, follow, pose_errors
from jackbox_env.model.states import VX_JACK, VY_JACK, X_BOX, X_JACK, Array
from jackbox_env.simulators import Impact, JackLostError, Simulator, make_simulator
from scripts.referee import prefix_errors

STEPS_PER_RESTART = 5  # control steps: 0.1 s by default
_ASIDE = 1e-13  # by which the start of a reference's twin is moved, far off by 100 units in the last place [m]
_APART = 1e-6  # [s] between an impact of a reference and of its twin, beyond which it is not certain


class Reference(NamedTuple):
    """The correct course of a case."""

    times: Array  # (n,) [s]
    states: Array  # (n, 12) at these times
    impacts: list[Impact]
    sure: int  # impacts that are certain: chaos multiplies rounding by about 10 with each


class Comparison(NamedTuple):
    """One course against its reference."""

    flight: float  # largest pose error before the first impact [m]; NaN: no state before it
    errors: list[float]  # of the impact times over the matched prefix [s]
    sure: int  # impacts that could have matched


class Restarts(NamedTuple):
    """A simulator's errors 0.1 s after restarts from states of the reference: too short for chaos."""

    errors: list[float]  # pose errors at the end of those with an impact [m]; infinite: it failed
    missed: int  # impacts of the reference that did not happen
    extra: int  # impacts that should not have happened
    impacts: int  # of the reference that could be missed


def reference_of(case: Case) -> Reference:
    """The exact model's course of an elastic case, and how many of its impacts are certain.

    An impact is certain while a twin that starts 1e-13 m aside has it too, within 1e-6 s. (Rounding is 1e-15 m.)

    Raises:
        ValueError: the scene is not elastic.
        JackLostError: the exact model cannot follow the case.
    """
    simulator = make_simulator(case.scene, "exact")
    course = follow(simulator, case, inspect=None)
    if course.escaped:
        raise JackLostError(
            f"the jack of {case.name} moves too fast to be followed exactly to the end of {case.steps} steps "
            f"of {case.dt:g} s; use a smaller time step, less speed or less torque"
        )
    aside = case.state.copy()
    by = max(_ASIDE, 100.0 * math.ulp(float(aside[X_JACK])))
    aside[X_JACK] += by * (1.0 if aside[X_BOX] > aside[X_JACK] else -1.0)  # towards the middle, so that it stays inside
    twin = follow(simulator, case._replace(state=aside), inspect=None)
    errors = prefix_errors(twin.impacts, course.impacts)
    sure = next((number for number, error in enumerate(errors) if error > _APART), len(errors))
    times: Array = case.dt * np.arange(case.steps + 1, dtype=np.float64)
    return Reference(times, course.states, course.impacts, sure)


def compare(case: Case, course: Course, reference: Reference) -> Comparison:
    """Compare a course with its reference."""
    errors = prefix_errors(course.impacts, reference.impacts[: reference.sure])
    first = min((impact.time for impact in [*course.impacts[:1], *reference.impacts[:1]]), default=math.inf)
    rows = np.rint(reference.times / case.dt).astype(int)
    flying = (reference.times < first) & (rows < len(course.states)) & (rows > 0)
    flight = math.nan
    if flying.any():
        flight = float(pose_errors(case.scene, course.states[rows[flying]], reference.states[flying]).max())
    return Comparison(flight, errors, reference.sure)


def restarts(simulator: Simulator, case: Case, reference: Reference) -> Restarts:
    """Restart the simulator from the reference every 5 control steps, and compare both 5 steps later.

    Impacts are matched by wall and foot in any order. Those of the last control step may come late: they need no
    partner, but can be one.
    """
    errors, missed, extra, count = list[float](), 0, 0, 0
    rows = {round(time / case.dt): row for row, time in enumerate(reference.times.tolist())}
    for first in range(0, case.steps - STEPS_PER_RESTART + 1, STEPS_PER_RESTART):
        last = first + STEPS_PER_RESTART
        if first not in rows or last not in rows:
            continue
        late = (last - 1) * case.dt
        expected = [hit for hit in reference.impacts if first * case.dt < hit.time <= last * case.dt]
        torques = None if case.torques is None else case.torques[first:last]
        start = reference.states[rows[first]]
        part = case._replace(state=start, steps=STEPS_PER_RESTART, torques=torques, time=first * case.dt)
        course = follow(simulator, part, inspect=None)
        impacts = [] if course.escaped else course.impacts
        count += sum(hit.time <= late for hit in expected)
        missed += _unpaired(expected, impacts, late)
        extra += _unpaired(impacts, expected, late)
        if course.escaped:
            errors.append(math.inf)
        elif expected or impacts:
            errors.append(float(pose_errors(case.scene, course.states[-1:], reference.states[[rows[last]]])[0]))
    return Restarts(errors, missed, extra, count)


def _unpaired(impacts: Sequence[Impact], others: Sequence[Impact], late: float) -> int:
    """The number of impacts up to the time ``late`` [s] without a partner among the others."""
    due = Counter(hit[1:3] for hit in impacts if hit.time <= late)
    return (due - Counter(hit[1:3] for hit in others)).total()


def quantities(course: Course, comparison: Comparison, again: Restarts, dt: float) -> dict[str, Any]:
    """Everything measured on one case, as plain numbers for JSON: SI units, the imbalance over the kinetic energy."""
    duration = dt * (len(course.states) - 1)
    speeds = np.hypot(course.states[:, VX_JACK], course.states[:, VY_JACK])
    impulses = [abs(impact.impulse) for impact in course.impacts]  # a model that pulls has some below 0
    return {
        "flight": comparison.flight,
        "errors": comparison.errors,
        "prefix": len(comparison.errors),
        "sure": comparison.sure,
        "depth": course.depth,
        "imbalance": course.imbalance / course.energy if course.energy > 0.0 else math.nan,
        "escaped": course.escaped,
        "local": again.errors,
        "missed": again.missed,
        "extra": again.extra,
        "expected": again.impacts,
        "rate": len(impulses) / duration if duration > 0.0 else math.nan,
        "speed": float(speeds.mean()),
        "fast": float(np.quantile(speeds, 0.9)),
        "impulse": float(np.mean(impulses)) if impulses else math.nan,
    }
