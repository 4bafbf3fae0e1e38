"""Speeds, spins, steps, arms, gravity, torque and positions at their extremes."""

from __future__ import annotations

import math
from functools import partial

import numpy as np

from jackbox_env.mechanics import gap_jacobian, gaps
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import clearance
from tests.extremes.measures import (
    DEEPEST,
    angular_momentum,
    conserved,
    course_of,
    courses,
    flown,
    started,
    steps,
)
from tests.extremes.page import Bound, Finding, case, refuses, within
from tests.states import WEIGHTLESS, Array, at, inside, one_foot_on_wall

TOO_FAST_FOR_SUBSTEPS = "the jack would leave the box: .* use more substeps, a smaller time step or less torque"


# -- spins and speeds --------------------------------------------------------------------------------------------------


def spun(index: int, dt: float, contact: str) -> Finding:
    """The jack drifts to a wall for 0.2 s while it or the box spins; in ordinary steps feet pass pymunk's walls."""
    state = at(theta_jack=0.3, vx_jack=60.0, vy_jack=7.0)
    state[index] = 3e4
    simulator = started(WEIGHTLESS, contact, state)
    if contact == "pymunk" and dt == 0.02:
        return refuses(lambda: simulator.step(dt, 0.0), TOO_FAST_FOR_SUBSTEPS)
    course = course_of(simulator, round(0.2 / dt), dt)
    error = abs(angular_momentum(WEIGHTLESS, simulator.state) / angular_momentum(WEIGHTLESS, state) - 1.0)
    return conserved([course], contact, 1, Bound("angular momentum", error, 1e-11))


case("jack spins at 3e4 rad/s among the walls, steps of 0.02 s")(partial(spun, 11, 0.02))
case("jack spins at 3e4 rad/s among the walls, steps of 1 ms")(partial(spun, 11, 1e-3))
case("box spins at 3e4 rad/s around the jack, steps of 0.02 s")(partial(spun, 8, 0.02))
case("box spins at 3e4 rad/s around the jack, steps of 0.1 ms")(partial(spun, 8, 1e-4))


case("jack at 7000 m/s straight to and fro for 1 s")(
    courses(lambda: [(WEIGHTLESS, np.array([0.0] * 9 + [7000.0, 0.0, 0.0]))], 50, 0.02, 600),
)


def in_any_direction() -> list[tuple[Scene, Array]]:
    """Jacks at 1000 to 7000 m/s."""
    rng, starts = np.random.default_rng(9), []
    for speed in (1000.0, 3000.0, 7000.0):
        state, angle = inside(WEIGHTLESS, rng), rng.uniform(0.0, 2.0 * math.pi)
        state[9:11] = speed * math.cos(angle), speed * math.sin(angle)
        starts.append((WEIGHTLESS, state))
    return starts


case("jack at 1000 to 7000 m/s in any direction for 0.2 s")(courses(in_any_direction, 40, 0.005, 10))


# -- time steps --------------------------------------------------------------------------------------------------------


@case("an impact amid five control steps of 1e-6 to 1 s")
def an_impact_amid_steps_of_any_length(contact: str) -> Finding:
    rng, runs = np.random.default_rng(10), []
    for dt in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0) * 10:
        start = np.full(12, math.inf)
        while not clearance(WEIGHTLESS, start.tolist()) > 0.0:
            impact, _, _ = one_foot_on_wall(WEIGHTLESS, rng)
            impact[6:] *= min(1.0, 0.02 / dt)
            start = flown(impact, -2.5 * dt)
        runs.append(course_of(started(WEIGHTLESS, contact, start), 5, dt))
    # pymunk misses a foot that dips into a wall and out again within a substep.
    return conserved(runs, contact, int(contact == "exact"))


# -- arms --------------------------------------------------------------------------------------------------------------


def at_any_angle() -> list[tuple[Scene, Array]]:
    """Arms that fit however they are turned."""
    rng, starts = np.random.default_rng(11), []
    for share in (1e-3, 0.01, 0.5, 0.99, 0.9999, 1.0 - 1e-6):
        scene = Scene(gravity=0.0, drive=None, jack_arm=6.0 * share)
        start = inside(scene, rng)
        start[6:9], start[9:11] = 0.0, (9.0, 7.0)
        starts.append((scene, start))
    return starts


def at_some_angles() -> list[tuple[Scene, Array]]:
    """Arms that only fit near 45 degrees."""
    rng, starts = np.random.default_rng(12), []
    for arm in (6.0, 6.5, 7.5, 8.4, 6.0 * math.sqrt(2.0) - 1e-4):
        room, state = 6.0 - arm * math.sqrt(0.5), np.zeros(12)
        state[5], state[9:11], state[11] = math.pi / 4.0, 20.0 * room * rng.standard_normal(2), 5.0 * room
        starts.append((Scene(gravity=0.0, drive=None, jack_arm=arm), state))
    return starts


LONG = "arm from 0.001 of the half width to 1e-6 of it less than the half width, 4 s"
case(LONG)(courses(at_any_angle, 200, 0.02, 3))
case("arm from the half width to its sqrt(2)-fold less 1e-4 m, 1 s")(courses(at_some_angles, 500, 0.002, 10))


# -- forces ------------------------------------------------------------------------------------------------------------


@case("1000 g: 30 bounces on the floor")
def a_thousandfold_gravity(contact: str) -> Finding:
    # Relative to the box it is a point that falls 5 m and comes back: the relative velocity turns round at each impact.
    simulator = started(Scene(gravity=9810.0, drive=None), contact, np.zeros(12))
    course = course_of(simulator, 90, 2.0 * math.sqrt(2.0 * 5.0 / 9810.0) / 3.0)
    height = abs(simulator.state[4] - simulator.state[1])
    bound = Bound("height after 30 whole periods off the closed form", height, 1e-9, "m")
    return conserved([course], contact, 30, *[bound] * (contact == "exact"))


# -- places ------------------------------------------------------------------------------------------------------------


@case("angles of 1e6 to 4e12 rad: 4,000 impacts, 1e-7 s later")
def angles_of_a_million_turns(contact: str) -> Finding:
    rng, metres, units = np.random.default_rng(20), [0.0], [0.0]
    for _ in range(steps(500, 4_000)):
        half = 10.0 ** rng.uniform(0.0, 2.0)
        scene = Scene(box_half_width=half, jack_arm=half * rng.uniform(0.05, 0.95), gravity=0.0, drive=None)
        state, wall, foot = one_foot_on_wall(scene, rng)
        state[[2, 5]] += 2.0 * math.pi * round(10.0 ** rng.uniform(5.2, 11.8))
        row, gap = gap_jacobian(scene, state, wall, foot), gaps(scene, state)[wall, foot]
        state[3:5] += gap * row[:2]
        state[6:] *= -np.sign(row @ state[6:])
        simulator = started(scene, contact, flown(state, -1e-7))
        simulator.step(2e-7, torque=0.0)
        metres.append(-clearance(scene, simulator.state.tolist()))
        units.append(metres[-1] / (half * math.ulp(max(abs(state[2]), abs(state[5])))))
    rounded = Bound("a foot outside", max(units), 4.0, "L ulp(angle)")
    return within(rounded if contact == "exact" else Bound("a foot outside", max(metres), DEEPEST[contact], "m"))
