"""``cheapest`` measures which contact model and setting to use for a scene of your own."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.measure.accuracy import Case, at_ends, between, follow
from jackbox_env.model.scene import Scene, scenes_of
from jackbox_env.model.tasks import sample_start
from jackbox_env.simulators import Impact, Simulator, make_simulator
from jackbox_env.simulators.fidelity import Setting
from jackbox_env.tools import checks as check

_CANDIDATES = (1, 2, 4, 8, 16, 32, 64, 128, 256)  # substeps of pymunk, cheapest first
_ROUNDS = 5  # of interleaved timings of two settings


class Choice(NamedTuple):
    """A setting and its measurements; errors are the worst over the cases.

    Attributes:
        setting: contact model and substeps.
        first_impact_error: of the time of the first impact [s].
        penetration: deepest that a foot was in a wall at an impact or a step's end [m].
        microseconds: per control step.
        cases: the number of cases with an impact.
    """

    setting: Setting
    first_impact_error: float
    penetration: float
    microseconds: float
    cases: int


def cheapest(
    scene: Scene | Mapping[str, Any] | Sequence[Scene | Mapping[str, Any] | None] | None = None,
    *,
    first_impact_error: float = math.inf,
    penetration: float = math.inf,
    cases: int = 12,
    steps: int = 250,
    control_dt: float = 0.02,
    seed: int = 0,
    contact: str | None = None,
) -> Choice:
    """Measure the cheapest setting whose errors stay within bounds, for one scene or for several.

    The cases begin at starts of the environment, alternately under random torques within ``scene.torque_limit``, one
    per step, and under the scene's drive. The reference for the first impact is the exact model, whose error is
    rounding. Restitution has no effect before it, so scenes with loss are measured too. The fewest substeps of pymunk
    (1, 2, 4, ... 256) within both bounds are timed against the exact model, and the faster is returned. A setting that
    loses a jack, or whose first impact is of another foot or wall, is never returned.

    For scenes drawn at random, pass a list of some. One setting is then within the bounds in all cases.

    It takes seconds for an ordinary scene; the first exact step on a machine compiles. The result is a measurement on
    these cases, not a guarantee.

    Args:
        scene: a Scene, a dict of some of its fields, or None for the default scene; or a list of these.
        first_impact_error: largest error of the time of the first impact [s], > 0.
        penetration: deepest that a foot may be in a wall, at an impact or at the end of a control step [m], > 0.
        cases: number of trajectories, 1 to 10,000, at least one for each scene. Those without an impact do not count.
        steps: control steps of each, 1 to 1,000,000.
        control_dt: control step [s].
        seed: of the starts and the torques.
        contact: only settings of this contact model, ``"pymunk"`` or ``"exact"``; None: of both.

    Returns:
        The setting with its measurements: ``gym.make("JackInBox-v0", **choice.setting._asdict())``.

    Raises:
        TypeError, ValueError: an argument out of its range; no jack touches a wall; or no setting is within the bounds,
            and the message has the errors of the finest.
        JackLostError: the exact model cannot follow a case to its first impact.

    >>> from jackbox_env import cheapest
    >>> scene = {"restitution": 0.5}
    >>> choice = cheapest(scene, first_impact_error=0.005, penetration=0.2, contact="pymunk")
    >>> choice.setting.substeps
    4
    """
    if contact is not None:
        check.choice("contact", contact, ("pymunk", "exact"))
    bounds = _bound("first_impact_error", first_impact_error), _bound("penetration", penetration)
    scenes = scenes_of(scene)[0]
    drawn = _cases(scenes, cases, steps, control_dt, seed)
    measured: list[Choice] = []
    try:
        for one in scenes:
            make_simulator(one, "pymunk")
    except ValueError:  # its solver would need too many iterations
        if contact == "pymunk":
            raise
        contact = "exact"
    if contact != "exact":
        for substeps in _CANDIDATES:
            measured = [_measured(Setting("pymunk", substeps), drawn, bounds)]
            if _within(measured[0], bounds):
                break
    if contact != "pymunk":
        measured.append(_measured(Setting("exact"), drawn, bounds))
    suitable = [choice for choice in measured if _within(choice, bounds)]
    if not suitable:
        finest = measured[-1]
        raise ValueError(
            f"no setting has the first impact within {bounds[0]:g} s and penetration within {bounds[1]:g} m; "
            f"the finest, {finest.setting}, reaches {finest.first_impact_error:.3g} s and "
            f"{finest.penetration:.3g} m or more"
        )
    costs = _costs([choice.setting for choice in suitable], [case for case, _ in drawn])
    return min(
        (choice._replace(microseconds=cost) for choice, cost in zip(suitable, costs, strict=True)),
        key=lambda choice: choice.microseconds,
    )


def _bound(name: str, value: float) -> float:
    """A bound above 0; infinity means none."""
    if isinstance(value, float | np.floating) and value == math.inf:
        return math.inf
    return check.real(name, value, above=0.0)


def _within(choice: Choice, bounds: tuple[float, float]) -> bool:
    """Whether both errors are within their bounds. False if an error is NaN or infinite."""
    errors = choice.first_impact_error, choice.penetration
    return all(error <= bound and error < math.inf for error, bound in zip(errors, bounds, strict=True))


def _cases(
    scenes: list[Scene], cases: int, steps: int, control_dt: float, seed: int
) -> list[tuple[Case, list[Impact]]]:
    """Cases with an impact, and their first impacts; the scenes alternate."""
    check.whole("cases", cases, at_least=1, at_most=10_000)
    if cases < len(scenes):
        raise ValueError(f"cases must be at least {len(scenes)}, one for each scene, got {cases}")
    check.whole("steps", steps, at_least=1, at_most=1_000_000)
    rng = np.random.default_rng(check.whole("seed", seed, at_least=0))
    dt = check.real("control_dt", control_dt, above=0.0)
    drawn = []
    for number in range(cases):
        turn, index = divmod(number, len(scenes))
        scene = scenes[index]
        start = sample_start(scene, rng)
        torques = rng.uniform(-scene.torque_limit, scene.torque_limit, steps).tolist()
        driven = scene.drive is not None and turn % 2 == 1
        case = Case(f"case {number}", scene, start, steps, None if driven else torques, dt)
        first = _first_impacts(case)
        if first:
            drawn.append((case, first))
    if not drawn:
        raise ValueError(
            f"no foot reaches a wall within {steps} steps of {dt:g} s in any of {cases} cases: pass more steps"
        )
    return drawn


def _first_impacts(case: Case) -> list[Impact]:
    """The exact model's first impact, and those at the same moment; empty if there is none."""
    simulator = make_simulator(replace(case.scene, restitution=1.0), "exact")
    simulator.reset(case.state)
    for number in range(case.steps):
        impacts = simulator.step(case.dt, None if case.torques is None else case.torques[number]).impacts
        if impacts:
            return [hit for hit in impacts if hit.time == impacts[0].time]
    return []


def _first_error(impacts: list[Impact], first: list[Impact]) -> float:
    """Error of the time of the first impact [s]; infinite if it is another contact's.

    Impacts recorded at one time have no order. An engine may resolve simultaneous contacts without an impulse on some.
    """
    contacts = {hit[1:3] for hit in impacts if hit.time == impacts[0].time}
    if not contacts & {hit[1:3] for hit in first}:
        return math.inf
    return abs(impacts[0].time - first[0].time)


def _measured(setting: Setting, drawn: list[tuple[Case, list[Impact]]], bounds: tuple[float, float]) -> Choice:
    """The worst errors over the cases, up to the first case that breaks a bound.

    Infinite if the contact model cannot follow a case, or if its steps are too long to be replayed.
    """
    inspect = at_ends if setting.contact == "exact" else between
    simulators = _simulators(setting, [case for case, _ in drawn])
    choice = Choice(setting, 0.0, 0.0, math.nan, len(drawn))
    for simulator, (case, first) in zip(simulators, drawn, strict=True):
        course = follow(simulator, case, inspect)
        error = max(choice.first_impact_error, _first_error(course.impacts, first))
        depth = math.inf if course.escaped or math.isnan(course.depth) else max(choice.penetration, course.depth)
        choice = choice._replace(first_impact_error=error, penetration=depth)
        if not _within(choice, bounds):
            break
    return choice


def _simulators(setting: Setting, cases: list[Case]) -> list[Simulator]:
    """A simulator for each case, the same one for all cases of a scene."""
    scenes = {id(case.scene): case.scene for case in cases}
    simulators = {number: make_simulator(scene, **setting._asdict()) for number, scene in scenes.items()}
    return [simulators[id(case.scene)] for case in cases]


def _costs(settings: list[Setting], cases: list[Case]) -> list[float]:
    """Microseconds per control step of each setting, as medians over interleaved rounds."""
    costs: list[list[float]] = [[] for _ in settings]
    simulators = [_simulators(setting, cases) for setting in settings]
    for _ in range(_ROUNDS if len(settings) > 1 else 1):
        for of_setting, record in zip(simulators, costs, strict=True):
            began = time.perf_counter()
            courses = (follow(simulator, case, inspect=None) for simulator, case in zip(of_setting, cases, strict=True))
            steps = sum(len(course.states) - 1 for course in courses)
            record.append(1e6 * (time.perf_counter() - began) / max(steps, 1))
    return [statistics.median(record) for record in costs]
