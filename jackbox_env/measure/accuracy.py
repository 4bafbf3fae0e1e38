"""How accurate a contact model is, measured against the exact one.

A :class:`Case` is a scene, a start and torques. :func:`follow` runs a simulator on it and inspects every step.
:func:`reference_of` computes the correct course, and how many of its impacts are certain. :func:`compare` and
:func:`restarts` measure the difference. They compare impact times, their order and containment. Energy alone proves
nothing: a jack outside the box keeps it perfectly.
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.mechanics import energy_of
from jackbox_env.scene import Scene
from jackbox_env.simulators import Impact, JackLostError, Simulator, make_simulator
from jackbox_env.simulators.replay import replayed
from jackbox_env.states import (
    THETA_BOX,
    THETA_JACK,
    VX_JACK,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
    clearance,
    deepest_restored,
)

STEPS_PER_RESTART = 5  # control steps: 0.1 s by default
_ASIDE = 1e-13  # by which the start of a reference's twin is moved, far off by 100 units in the last place [m]
_REPLAY_TOLERANCE = 1e-6  # over L, of the end of a replay from the end of the model's step
_APART = 1e-6  # [s] between an impact of a reference and of its twin, beyond which it is not certain


class Case(NamedTuple):
    """A start, and the torques that follow or the drive."""

    name: str
    scene: Scene
    state: Array  # (12,)
    steps: int  # control steps
    torques: Sequence[float] | None = None  # constant in each control step [N m]; None: the scene's drive
    dt: float = 0.02  # control step [s]
    time: float = 0.0  # at the start [s]


class Between(NamedTuple):
    """What happened inside one control step; NaN if it cannot be determined."""

    depth: float  # deepest that a foot was in a wall at an impact or at the step's end [m]; negative: none was
    work: float  # of torque and side forces on the box [J]


Inspect = Callable[[Simulator, Array, float, float | None], Between]


class Course(NamedTuple):
    """The course of a simulator through a case."""

    states: Array  # (steps taken + 1, 12)
    impacts: list[Impact]
    depth: float  # deepest that a foot was in a wall at an impact or a step's end [m]; negative: none was
    imbalance: float  # largest |energy gained - work done| at the end of a step [J]
    energy: float  # largest kinetic energy [J], the scale of the imbalance
    escaped: bool  # the jack left the box, or the simulator refused to go on


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


# -- running a simulator ----------------------------------------------------------------------------------------------


def between(simulator: Simulator, before: Array, time: float, torque: float | None) -> Between:
    """Replay the last step of a contact model of this package (:mod:`jackbox_env.simulators.replay`).

    Each impact multiplies rounding by about 10. If the replay of a long step ends elsewhere than the model did, the
    result is NaN.

    Args:
        simulator: after the step.
        before: the state before it, shape (12,).
        time: the time before it [s].
        torque: constant through the step [N m]; None: the drive.
    """
    scene, after = simulator.scene, simulator.state
    again = replayed(scene, before.tolist(), time, simulator.impacts, simulator.time, torque)
    depth = max(again.depth, -clearance(scene, after.tolist()))
    allowed = _REPLAY_TOLERANCE * scene.box_half_width
    if not scene.elastic:  # overlap is moved apart, by no more than there is, at each contact
        allowed += (1 + len(simulator.impacts)) * max(depth, -clearance(scene, before.tolist()), 0.0)
    if not pose_errors(scene, np.array([again.state]), after[None])[0] <= allowed:
        return Between(math.nan, math.nan)
    return Between(depth, again.work)


def at_ends(simulator: Simulator, before: Array, time: float, torque: float | None) -> Between:
    """Inspect the end of a step only, for any dt. Enough for the exact model: its impacts act exactly on the wall."""
    return Between(-clearance(simulator.scene, simulator.state.tolist()), math.nan)


def follow(simulator: Simulator, case: Case, inspect: Inspect | None = between) -> Course:
    """Run a case and inspect every step.

    Args:
        simulator: of the case's scene.
        case: to run.
        inspect: evaluates the inside of a step; None: depth, imbalance and energy are NaN.

    Raises:
        ValueError: the case has fewer torques than steps, or a start that the simulator refuses.
    """
    if case.torques is not None and len(case.torques) < case.steps:
        raise ValueError(f"a case of {case.steps} steps must have as many torques, got {len(case.torques)}")
    simulator.reset(case.state, case.time)
    scene, state = case.scene, simulator.state
    states, impacts = [state], list[Impact]()
    start, depth, work, imbalance, largest = energy_of(scene, state.tolist()), -math.inf, 0.0, 0.0, 0.0
    escaped = False
    for number in range(case.steps):
        torque = None if case.torques is None else case.torques[number]
        time = simulator.time
        try:
            simulator.step(case.dt, torque)
        except JackLostError:
            escaped = True
            break
        before, state = state, simulator.state
        states.append(state)
        impacts += simulator.impacts
        escaped = -clearance(scene, state.tolist()) > deepest_restored(scene)
        if inspect is not None:
            inside = inspect(simulator, before, time, torque)
            depth, work = float(np.maximum(depth, inside.depth)), work + inside.work  # a NaN stays
            now = energy_of(scene, state.tolist())
            imbalance = float(np.maximum(imbalance, abs(now - start - work)))
            largest = max(largest, now - scene.jack_mass * scene.gravity * float(state[Y_JACK]))
        if escaped:
            break
    if inspect is None:
        depth = imbalance = largest = math.nan
    return Course(np.array(states), impacts, depth, imbalance, largest, escaped)


# -- the reference ----------------------------------------------------------------------------------------------------


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


# -- comparing --------------------------------------------------------------------------------------------------------


def prefix_errors(impacts: Sequence[Impact], reference: Sequence[Impact]) -> list[float]:
    """Errors of the impact times [s] over the longest common start of both, by wall and foot.

    Impacts recorded at one time (a substep's end, two feet at once) have no order.
    """
    rest, errors = list(impacts), list[float]()
    for number, expected in enumerate(reference):
        index = number
        while index < len(rest) and rest[index][1:3] != expected[1:3]:
            index += 1
            together = index < len(rest) and rest[index].time == rest[number].time
            alike = index < len(reference) and reference[index].time == expected.time
            if not (together or alike):
                return errors
        if index >= len(rest):
            return errors
        rest.insert(number, rest.pop(index))
        errors.append(abs(rest[number].time - expected.time))
    return errors


def pose_errors(scene: Scene, states: Array, reference: Array) -> Array:
    """Pose errors [m], shape (n,), of states, shape (n, 12), from their references.

    The largest of four: the errors of both centres, of the box's angle times L, of the jack's angle times l.
    """
    off = np.abs(np.asarray(states) - reference)
    parts = [
        np.hypot(off[:, X_BOX], off[:, Y_BOX]),
        scene.box_half_width * off[:, THETA_BOX],
        np.hypot(off[:, X_JACK], off[:, Y_JACK]),
        scene.jack_arm * off[:, THETA_JACK],
    ]
    largest: Array = np.max(parts, axis=0)
    return largest


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
