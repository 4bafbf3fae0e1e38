"""Speeds, spins, steps, arms, gravity, torque and places at their extremes."""

from __future__ import annotations

import math

import numpy as np

from jackbox_env.mechanics import energy, impact_map
from jackbox_env.scene import Chirp, Scene
from jackbox_env.simulators import Simulator
from jackbox_env.states import clearance
from tests.closed_forms import chirp_motion_by_fresnel
from tests.extremes.measures import (
    Course,
    angular_momentum,
    deepest_allowed,
    follow,
    kept,
    relative,
    started,
)
from tests.extremes.page import Bound, Finding, part, refuses, within
from tests.states import Array, inside, one_foot_on_wall

WEIGHTLESS = Scene(gravity=0.0, drive=None)
TOO_FAST_FOR_SUBSTEPS = "the jack would leave the box: .* use more substeps, a smaller time step or less torque"
speeds = part("Spins and speeds")
steps = part("Steps and arms")
forces = part("Forces, times and places")


# -- spins and speeds --------------------------------------------------------------------------------------------------


def spinning(place: int) -> Array:
    """The jack drifts from the middle towards a wall while it or the box spins at 3e4 rad/s."""
    state = np.zeros(12)
    state[[5, 9, 10]] = 0.3, 60.0, 7.0
    state[place] = 3e4
    return state


@speeds("jack spins at 3e4 rad/s among the walls, steps of 0.02 s")
def a_jack_that_spins_fast_in_ordinary_steps(contact: str) -> Finding:
    return spun(11, 0.02, 10, contact)


@speeds("jack spins at 3e4 rad/s among the walls, steps of 1 ms")
def a_jack_that_spins_fast_in_short_steps(contact: str) -> Finding:
    return spun(11, 1e-3, 200, contact)


@speeds("box spins at 3e4 rad/s around the jack, steps of 0.02 s")
def a_box_that_spins_fast_in_ordinary_steps(contact: str) -> Finding:
    return spun(8, 0.02, 10, contact)


@speeds("box spins at 3e4 rad/s around the jack, steps of 0.1 ms")
def a_box_that_spins_fast_in_short_steps(contact: str) -> Finding:
    return spun(8, 1e-4, 2000, contact)


def spun(place: int, dt: float, steps: int, contact: str) -> Finding:
    """Follow the spin for 0.2 s. In ordinary steps feet pass pymunk's walls within a substep, so it refuses."""
    simulator = started(WEIGHTLESS, contact, spinning(place))
    if contact == "pymunk" and dt == 0.02:
        before = simulator.state
        finding = refuses(lambda: follow(simulator, 1, dt), TOO_FAST_FOR_SUBSTEPS)
        assert np.array_equal(simulator.state, before)
        return finding
    turning = angular_momentum(WEIGHTLESS, simulator.state)
    course = follow(simulator, steps, dt)
    error = abs(angular_momentum(WEIGHTLESS, simulator.state) / turning - 1.0)
    return kept([course], contact, 1, Bound("angular momentum", error, 1e-11))


@speeds("jack at 7000 m/s straight to and fro for 1 s")
def a_jack_straight_to_and_fro_at_7_km_per_s(contact: str) -> Finding:
    # Relative to the box it is a point between walls at +-5 m; each impact turns the relative velocity round.
    start, speed = np.zeros(12), 7000.0
    start[9] = speed
    simulator = started(WEIGHTLESS, contact, start)
    course = follow(simulator, 50, 0.02)
    way = (speed * simulator.time + 5.0) % 20.0
    place, sign = (way - 5.0, 1.0) if way < 10.0 else (15.0 - way, -1.0)
    x = simulator.state[3] - simulator.state[0]
    if contact == "pymunk":  # late at each impact, so it has another phase
        return kept([course], contact, hits=600)
    assert simulator.state[9] - simulator.state[6] == sign * speed or abs(abs(place) - 5.0) < 1e-6
    assert course.hits == int((speed * simulator.time + 5.0) // 10.0)
    return kept([course], contact, 600, Bound("place off the closed form", abs(x - place), 1e-9, "m"))


@speeds("jack at 1000 to 7000 m/s in any direction for 0.2 s")
def a_jack_at_km_per_s_in_any_direction(contact: str) -> Finding:
    rng, courses = np.random.default_rng(9), []
    for speed in (1000.0, 3000.0, 7000.0):
        state, angle = inside(WEIGHTLESS, rng), rng.uniform(0.0, 2.0 * math.pi)
        state[9:11] = speed * math.cos(angle), speed * math.sin(angle)
        courses.append(follow(started(WEIGHTLESS, contact, state), 40, 0.005))
    return kept(courses, contact, hits=10)


# -- time steps --------------------------------------------------------------------------------------------------------


@steps("an impact amid five control steps of 1e-6 to 1 s")
def an_impact_amid_steps_of_any_length(contact: str) -> Finding:
    # From a state on a wall: half way back in closed form, five steps forward, compared with the impact map's way on.
    rng, worst = np.random.default_rng(10), 0.0
    torque = 100.0
    for dt in (1e-6, 1e-5, 1e-4, 1e-3, 1e-2, 0.1, 1.0):
        for _ in range(10):
            state, expected = amid(dt, torque, rng)
            simulator = started(WEIGHTLESS, contact, state)
            hits = 0
            for _ in range(5):
                simulator.step(dt, torque)
                hits += len(simulator.impacts)
            assert hits == 1
            speed = max(np.abs(state[6:]).max(), np.abs(expected[6:]).max())
            h = dt / 4 if contact == "pymunk" else 0.0
            error = np.abs(simulator.state[:6] - expected[:6]).max()
            worst = max(worst, error / (speed * h) if h else error)
    if contact == "pymunk":
        return within(
            Bound(
                "places off the closed form",
                worst,
                8.0,
                "times what the fastest coordinate moves in a substep of a quarter of the step",
            )
        )
    return within(Bound("places off the closed form", worst, 1e-11, "m or rad"))


def amid(dt: float, torque: float, rng: np.random.Generator) -> tuple[Array, Array]:
    """A state 2.5 steps before an impact, and the state 2.5 steps after it by the impact map; slow for long steps.

    States are left out in which a foot dips into the wall and out again within a substep: pymunk does not see that.
    """
    alpha, half = torque / WEIGHTLESS.box_inertia, 2.5 * dt
    while True:
        impact, wall, foot = one_foot_on_wall(WEIGHTLESS, rng)
        impact[6:] *= min(1.0, 0.02 / dt)
        after, _ = impact_map(WEIGHTLESS, impact, wall, foot)
        before = impact.copy()
        for state, way in ((before, -half), (after, half)):
            state[:6] += state[6:] * way
            state[2] += 0.5 * alpha * way * way
            state[8] += alpha * way
        through = impact[:6] + 0.5 * dt * impact[6:]  # half a step later, had there been no impact
        dips = clearance(WEIGHTLESS, [*through, *impact[6:]]) < 0.0
        if dips and min(clearance(WEIGHTLESS, state.tolist()) for state in (before, after)) > 0.01 * min(1.0, dt):
            return before, after


# -- arms --------------------------------------------------------------------------------------------------------------


@steps("arm from 0.001 of the half width to 1e-6 of it less than the half width, 4 s")
def arms_that_fit_at_any_angle(contact: str) -> Finding:
    rng, courses = np.random.default_rng(11), []
    for share in (1e-3, 0.01, 0.5, 0.99, 0.9999, 1.0 - 1e-6):
        scene = Scene(gravity=0.0, drive=None, jack_arm=6.0 * share)
        start = inside(scene, rng)
        start[6:9], start[9:11] = 0.0, (9.0, 7.0)
        courses.append(follow(started(scene, contact, start), 200, 0.02))
    return kept(courses, contact, hits=3)


@steps("arm from the half width to its sqrt(2)-fold less 1e-4 m, 1 s")
def arms_that_fit_at_some_angles_only(contact: str) -> Finding:
    rng, courses = np.random.default_rng(12), []
    for arm in (6.0, 6.5, 7.5, 8.4, 6.0 * math.sqrt(2.0) - 1e-4):
        scene = Scene(gravity=0.0, drive=None, jack_arm=arm)
        state = np.zeros(12)
        room = 6.0 - arm * math.sqrt(0.5)
        state[5], state[9:11], state[11] = math.pi / 4.0, 20.0 * room * rng.standard_normal(2), 5.0 * room
        courses.append(follow(started(scene, contact, state), 500, 0.002))
    return kept(courses, contact, hits=10)


# -- forces ------------------------------------------------------------------------------------------------------------


@forces("no gravity: bodies without forces for 200 s")
def without_gravity_nothing_is_lifted_or_falls(contact: str) -> Finding:
    # Both move on alike, so nothing touches.
    start = np.array([0.0, 0.0, 0.1, 1.0, 2.0, 0.3, 3.0, -2.0, 0.0, 3.0, -2.0, 0.5])
    simulator = started(WEIGHTLESS, contact, start)
    course = follow(simulator, 10_000, 0.02)
    assert course.hits == 0
    expected = start.copy()
    expected[:6] += 200.0 * start[6:]
    assert np.array_equal(simulator.state[6:], start[6:])
    error = float(np.abs(simulator.state - expected).max())
    return within(
        Bound("places off the closed form", error, 10_000 * 5.7e-14, "m or rad"),
        note=" (half a unit in the last place of 600 m per step); rates the same bits",
    )


@forces("1000 g: 30 bounces on the floor")
def a_thousandfold_gravity(contact: str) -> Finding:
    # Relative to the box it is a point that falls 5 m and comes back: the relative velocity turns round at each impact.
    scene, start = Scene(gravity=9810.0, drive=None), np.zeros(12)
    simulator = started(scene, contact, start)
    period = 2.0 * math.sqrt(2.0 * 5.0 / 9810.0)
    course, dt = Course(scene, start), period / 3.0
    follow(simulator, 90, dt, course)
    assert simulator.time > 29.9 * period
    if contact == "pymunk":
        return kept([course], contact, hits=25)
    assert course.hits == 30
    height = abs(simulator.state[4] - simulator.state[1])
    return kept([course], contact, 30, Bound("height after 30 whole periods off the closed form", height, 1e-9, "m"))


def worked(simulator: Simulator, torque: float, dt: float, steps: int) -> tuple[float, int, float]:
    """Energy gained less the torque's work, over the work; impacts; and how far a foot ever was outside [m]."""
    scene, start = simulator.scene, simulator.state
    hits, deepest = 0, -math.inf
    for _ in range(steps):
        simulator.step(dt, torque)
        hits += len(simulator.impacts)
        deepest = max(deepest, -clearance(scene, simulator.state.tolist()))
    work = torque * (simulator.state[2] - start[2])
    gained = energy(scene, simulator.state) - energy(scene, start)
    return abs(gained - work) / abs(work), hits, deepest


@forces("torque of 1e9 N m, steps of 1 ms for 0.02 s")
def a_torque_of_a_giga_newton_metre_in_short_steps(contact: str) -> Finding:
    start = np.zeros(12)
    start[[3, 5, 9]] = 4.9, 0.3, 10.0
    error, hits, deepest = worked(started(WEIGHTLESS, contact, start), 1e9, 1e-3, 20)
    assert hits > 0
    return within(
        Bound("energy gained less the torque's work", error, 1e-11),
        Bound("a foot outside", max(0.0, deepest), deepest_allowed(contact), "m"),
    )


@forces("torque of 1e9 N m for a step of 0.02 s with a foot near a wall")
def a_torque_of_a_giga_newton_metre_in_an_ordinary_step(contact: str) -> Finding:
    start = np.zeros(12)
    start[[3, 5, 9]] = 4.9, 0.3, 30.0
    error, hits, deepest = worked(started(WEIGHTLESS, contact, start), 1e9, 0.02, 1)
    assert hits > 0
    return within(
        Bound("energy gained less the torque's work", error, 1e-11),
        Bound("a foot outside", max(0.0, deepest), deepest_allowed(contact), "m"),
    )


@forces("the chirp at t = 1e6 s")
def the_chirp_after_a_million_seconds(contact: str) -> Finding:
    # 12 turns show the phase best, 18,000 turns how well they cancel.
    chirp, rates, angles = Chirp(), [], []
    for dt in (1.3e-5, 0.02):
        simulator = started(Scene(gravity=0.0, drive=chirp), contact, np.zeros(12), 1e6)
        simulator.step(dt)
        spun, turned = chirp_motion_by_fresnel(chirp, 14400.0, 1e6, dt)
        assert abs(spun) > 1e-9
        rates.append(abs(simulator.state[8] - spun))
        angles.append(abs(simulator.state[2] - turned))
    return within(
        Bound("box's rate off the closed form after 1.3e-5 s", rates[0], 1e-14, "rad/s"),
        Bound("after 0.02 s", rates[1], 1e-14, "rad/s"),
        Bound("its angle", max(angles), 1e-15, "rad"),
    )


# -- places ------------------------------------------------------------------------------------------------------------


@forces("1e9 m from the origin")
def a_giga_metre_from_the_origin(contact: str) -> Finding:
    rng, offset, rates, places = np.random.default_rng(13), np.array([1e9, -1e9]), 0.0, 0.0
    for _ in range(100):
        state, wall, foot = one_foot_on_wall(WEIGHTLESS, rng)
        state[3:5] -= 3e-7 * np.sign(state[3:5] - state[0:2])  # inside by more than the rounding there, 1.2e-7 m
        far = state.copy()
        far[:2], far[3:5] = far[:2] + offset, far[3:5] + offset
        near = far.copy()
        near[:2], near[3:5] = near[:2] - offset, near[3:5] - offset  # exact: what the rounding of the input left
        one, other = started(WEIGHTLESS, contact, far), started(WEIGHTLESS, contact, near)
        one.step(1e-4, torque=0.0)
        other.step(1e-4, torque=0.0)
        assert [hit[1:3] for hit in one.impacts] == [hit[1:3] for hit in other.impacts]
        assert (wall, foot) in [hit[1:3] for hit in one.impacts]
        rates = max(rates, relative(one.state, other.state))
        moved = one.state[:6] - [*offset, 0.0, *offset, 0.0] - other.state[:6]
        places = max(places, float(np.abs(moved).max()))
    return within(
        Bound("rates off those of the same state at the origin", rates, 1e-12),
        Bound("places", places, 1.2e-7, "m"),
    )


def outside_after_impacts(scene: Scene, contact: str, state: Array, steps: int) -> tuple[float, int]:
    """How far a foot is outside up to 1e-6 s after the first impact of each step [m], and how many states were seen."""
    simulator, deepest, looks = started(scene, contact, state), 0.0, 0
    for _ in range(steps):
        before, begun = simulator.state, simulator.time
        simulator.step(0.02, torque=0.0)
        if not simulator.impacts:
            continue
        after, end, since = simulator.state, simulator.time, simulator.impacts[0].time - begun
        for later in (0.0, 1e-12, 1e-9, 1e-7, 1e-6):
            if since + later > 0.0:
                simulator.reset(before, begun)
                simulator.step(since + later, torque=0.0)
                deepest, looks = max(deepest, -clearance(scene, simulator.state.tolist())), looks + 1
        simulator.reset(after, end)
    return deepest, looks


@forces("angles of 1e6 to 4e12 rad: 4,000 states up to 1e-6 s after an impact")
def angles_of_a_million_turns(contact: str) -> Finding:
    rng, units, metres, looks = np.random.default_rng(20), 0.0, 0.0, 0
    while looks < 4_000:
        half = 10.0 ** rng.uniform(-2.0, 2.0)
        scene = Scene(box_half_width=half, jack_arm=half * rng.uniform(0.05, 0.95), gravity=0.0, drive=None)
        state = inside(scene, rng, speed=math.sqrt(half))
        angle = 10.0 ** rng.uniform(6.0, 12.6)
        state[2] += rng.choice([0.0, angle, -angle])
        state[5] += angle
        state[[8, 11]] = 3.0 * rng.standard_normal(2)
        if clearance(scene, state.tolist()) < 0.0:
            continue
        deepest, looked = outside_after_impacts(scene, contact, state, 100)
        unit = math.ulp(max(abs(state[2]), abs(state[5])))
        units, metres, looks = max(units, deepest / (half * unit)), max(metres, deepest), looks + looked
    if contact == "pymunk":
        return within(Bound("a foot outside", metres, deepest_allowed(contact), "m"))
    return within(Bound("a foot outside", units, 4.0, "L ulp(angle)"))
