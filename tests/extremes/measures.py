"""Measures of the cases: how far a trajectory is from the laws that every contact model must obey."""

from __future__ import annotations

import os
from collections.abc import Callable
from itertools import groupby
from typing import NamedTuple

import numpy as np

from jackbox_env.mechanics import energy, simultaneous_impact_map
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import clearance
from jackbox_env.simulators import Simulator, make_simulator
from tests.extremes.page import Bound, Finding, Measure, within
from tests.states import Array

DEEPEST = {"pymunk": 1.0, "exact": 1e-9}  # a foot outside at a step's end [m]: after a substep, and rounding


def steps(quick: int, full: int) -> int:
    """All of a long run in ``python -m tests.extremes``, else a few."""
    return full if "JACKBOX_EXTREMES" in os.environ else quick


def started(scene: Scene, contact: str, state: Array | list[float], time: float = 0.0) -> Simulator:
    simulator = make_simulator(scene, contact)
    simulator.reset(state, time)
    return simulator


def momentum(scene: Scene, state: Array) -> Array:
    return scene.box_mass * state[6:8] + scene.jack_mass * state[9:11]


def momentum_scale(scene: Scene, state: Array) -> float:
    """Largest momentum of a body [kg m/s]."""
    return float(max(scene.box_mass * np.abs(state[6:8]).max(), scene.jack_mass * np.abs(state[9:11]).max()))


def angular_momentum(scene: Scene, state: Array) -> float:
    """About the common centre of mass [kg m^2/s]."""
    reduced = scene.box_mass * (scene.jack_mass / (scene.box_mass + scene.jack_mass))
    (x, y), (vx, vy) = state[3:5] - state[0:2], state[9:11] - state[6:8]
    return float(scene.box_inertia * state[8] + scene.jack_inertia * state[11] + reduced * (x * vy - y * vx))


class Course(NamedTuple):
    """Some steps without torque, and their distance from the laws."""

    hits: int
    deepest: float  # [m] outside
    momentum: float  # largest error, relative to the largest momentum of a body
    energy: float  # largest error, relative to the kinetic energy at the start and the fall's


def course_of(simulator: Simulator, steps: int, dt: float) -> Course:
    """Step without torque: momentum changes by m_j g t, energy not at all."""
    scene, states, falls, hits = simulator.scene, [simulator.state], [0.0], 0
    weight, begun = scene.jack_mass * scene.gravity, simulator.time
    for _ in range(steps):
        simulator.step(dt, torque=0.0)
        hits += len(simulator.impacts)
        states.append(simulator.state)
        falls.append(weight * (simulator.time - begun))
    pushed = np.array([momentum(scene, state) for state in states]) + np.outer(falls, [0.0, 1.0])
    energies = np.array([energy(scene, state) for state in states])
    most = max(energies[0] - weight * states[0][4], weight * max(abs(state[4]) for state in states))
    return Course(
        hits,
        max(-clearance(scene, state.tolist()) for state in states),
        float(np.abs(pushed - pushed[0]).max()) / max(momentum_scale(scene, state) for state in states),
        float(np.abs(energies - energies[0]).max() / most),
    )


def conserved(courses: list[Course], contact: str, hits: int, *more: Bound) -> Finding:
    """The bounds ``more``, then momentum, energy and containment; each course has at least ``hits`` impacts."""
    fewest = min(course.hits for course in courses)
    assert fewest >= hits
    return within(
        *more,
        Bound("momentum", max(course.momentum for course in courses), 1e-12),
        Bound("energy", max(course.energy for course in courses), 1e-11),
        Bound("a foot outside", max(0.0, *(course.deepest for course in courses)), DEEPEST[contact], "m"),
        note=f"; {fewest:,} impacts or more",
    )


def courses(starts: Callable[[], list[tuple[Scene, Array]]], steps: int, dt: float, hits: int) -> Measure:
    """Follow each start for some steps of dt [s], with at least so many impacts."""
    return lambda contact: conserved(
        [course_of(started(scene, contact, state), steps, dt) for scene, state in starts()], contact, hits
    )


def flown(state: Array, seconds: float) -> Array:
    """The state after a flight without forces."""
    return np.concatenate([state[:6] + seconds * state[6:], state[6:]])


def off_the_law(simulator: Simulator, dt: float) -> float:
    """Step without forces; the largest error of a rate, over the largest rate, by the law at the recorded impacts.

    Impacts at the same moment are resolved by the simultaneous law.
    """
    state, now = simulator.state, simulator.time
    simulator.step(dt, torque=0.0)
    for time, together in groupby(simulator.impacts, key=lambda hit: hit.time):
        contacts = [hit[1:3] for hit in together]
        state, _ = simultaneous_impact_map(simulator.scene, flown(state, time - now), contacts)
        now = time
    return float(np.abs(simulator.state[6:] - state[6:]).max() / np.abs(state[6:]).max())
