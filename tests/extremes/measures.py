"""What the cases measure: how far a trajectory is from the laws that every contact model must obey."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np

from jackbox_env.compiled.step import make_numbers
from jackbox_env.mechanics import energy, simultaneous_impact_map
from jackbox_env.scene import Scene
from jackbox_env.simulators import Impact, Simulator, make_simulator
from jackbox_env.states import clearance
from tests.extremes.page import Bound, Finding, within
from tests.states import Array


def started(scene: Scene, contact: str, state: Array | list[float], time: float = 0.0) -> Simulator:
    simulator = make_simulator(scene, contact)
    simulator.reset(state, time)
    return simulator


def deepest_allowed(contact: str) -> float:
    """How far a foot may be outside at a step's end [m]: 1 m after a substep of pymunk, rounding for exact."""
    return 1.0 if contact == "pymunk" else 1e-9


def least_clearance(values: Array, states: Array) -> float:
    """Smallest gap [m] in any of the states, shape (N, 12); to be compiled."""
    numbers = make_numbers(values)
    least = math.inf
    for i in range(states.shape[0]):
        least = min(least, clearance(numbers, states[i]))
    return least


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


@dataclass
class Course:
    """What happened over some steps without torque, and how far it was from the laws.

    Momentum changes by m_j g t, energy not at all.
    """

    scene: Scene
    start: Array
    hits: int = 0
    deepest: float = -math.inf  # [m] outside
    momentum: float = 0.0  # largest error, relative to the largest momentum of a body
    energy: float = 0.0  # largest error, relative to the kinetic energy at the start and the fall's
    scale: float = field(init=False)

    def __post_init__(self) -> None:
        self.scale = momentum_scale(self.scene, self.start)

    def look(self, state: Array, time: float) -> None:
        scene, start = self.scene, self.start
        fallen = np.array([0.0, scene.jack_mass * scene.gravity * time])
        self.scale = max(self.scale, momentum_scale(scene, state))
        error = np.abs(momentum(scene, state) + fallen - momentum(scene, start)).max()
        self.momentum = max(self.momentum, float(error) / self.scale)
        height = scene.jack_mass * scene.gravity * max(abs(state[4]), abs(start[4]))
        most = max(energy(scene, start) - scene.jack_mass * scene.gravity * start[4], height)
        self.energy = max(self.energy, abs(energy(scene, state) - energy(scene, start)) / most)
        self.deepest = max(self.deepest, -clearance(scene, state.tolist()))


def follow(simulator: Simulator, steps: int, dt: float, course: Course | None = None) -> Course:
    """Step without torque and look at every state."""
    course = course or Course(simulator.scene, simulator.state)
    begun = simulator.time
    for _ in range(steps):
        simulator.step(dt, torque=0.0)
        course.hits += len(simulator.impacts)
        course.look(simulator.state, simulator.time - begun)
    return course


def kept(courses: list[Course], contact: str, hits: int, *more: Bound, unit: str = "m") -> Finding:
    """The bounds ``more``, then momentum, energy and containment; each course has at least ``hits`` impacts."""
    fewest = min(course.hits for course in courses)
    assert fewest >= hits
    return within(
        *more,
        Bound("momentum", max(course.momentum for course in courses), 1e-12),
        Bound("energy", max(course.energy for course in courses), 1e-11),
        Bound("a foot outside", max(0.0, *(course.deepest for course in courses)), deepest_allowed(contact), unit),
        note=f"; {fewest:,} impacts or more",
    )


def replayed(scene: Scene, state: Array, begun: float, end: float, impacts: Iterable[Impact]) -> Array:
    """Fly without forces between the recorded impacts, apply the law at each, and return the final state.

    Impacts at the same moment are taken by the simultaneous law.
    """
    state, now = state.copy(), begun
    for time, together in groupby(impacts, key=lambda hit: hit.time):
        state[:6] += state[6:] * (time - now)
        state, _ = simultaneous_impact_map(scene, state, [hit[1:3] for hit in together])
        now = time
    state[:6] += state[6:] * (end - now)
    return state


def off_the_law(simulator: Simulator, dt: float) -> float:
    """Take a step without forces and compare the rates after it with the law applied to its recorded impacts."""
    before, begun = simulator.state, simulator.time
    simulator.step(dt, torque=0.0)
    expected = replayed(simulator.scene, before, begun, simulator.time, simulator.impacts)
    return relative(simulator.state, expected)


def relative(found: Array, expected: Array) -> float:
    """Largest error of a rate over the largest rate."""
    return float(np.abs(found[6:] - expected[6:]).max() / np.abs(expected[6:]).max())
