"""Impacts at the extremes of mass, inertia, speed and simultaneity; rest; feet that start on or behind a wall."""

from __future__ import annotations

import itertools

import numpy as np

from jackbox_env.mechanics import energy, gap_jacobian, gaps
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import clearance
from tests.extremes.measures import (
    courses,
    flown,
    momentum,
    momentum_scale,
    off_the_law,
    started,
    steps,
)
from tests.extremes.page import Bound, Finding, case, within
from tests.states import WEIGHTLESS, Array, at, inside, lying, one_foot_on_wall, several_contacts

LIGHT = Scene(gravity=0.0, drive=None, jack_inertia=0.004)
RATIOS = [Scene(gravity=0.0, drive=None, jack_mass=400.0 * 10.0**power) for power in range(-9, 10, 3)]
KINDS = ("one wall", "two walls", "corner")
INSTANT = 1e-12  # [s] in which nothing but the impact happens


def from_random_states(scenes: list[Scene]) -> list[tuple[Scene, Array]]:
    rng = np.random.default_rng(2)
    return [(scene, inside(scene, rng)) for scene in scenes]


# -- masses and inertias -----------------------------------------------------------------------------------------------


@case("one impact, jack 1e-9 to 1e9 times as heavy as the box")
def one_impact_at_any_ratio_of_the_masses(contact: str) -> Finding:
    law = drift = 0.0
    for scene in RATIOS:
        rng = np.random.default_rng(1)
        for _ in range(30):
            state, wall, foot = one_foot_on_wall(scene, rng)
            simulator = started(scene, contact, state)
            law = max(law, off_the_law(simulator, INSTANT))
            assert [hit[1:3] for hit in simulator.impacts] == [(wall, foot)]
            scale = max(momentum_scale(scene, state), momentum_scale(scene, simulator.state))
            drift = max(drift, float(np.abs(momentum(scene, simulator.state) - momentum(scene, state)).max()) / scale)
    return within(Bound("rates off the impact map", law, 1e-12), Bound("momentum", drift, 1e-14))


case("4 s of flight and impacts, jack 1e-9 to 1e9 times as heavy as the box")(
    courses(lambda: from_random_states(RATIOS), 200, 0.02, 1),
)
case("4 s of flight and impacts, jack inertia a thousandth of m l^2")(
    courses(lambda: from_random_states([LIGHT]), 200, 0.02, 1),
)


# -- slow and simultaneous ---------------------------------------------------------------------------------------------


@case("a foot arrives at 1e-9 m/s, sliding at some m/s")
def a_foot_arrives_hardly_moving(contact: str) -> Finding:
    rng, law = np.random.default_rng(4), 0.0
    for _ in range(50):
        state, wall, foot = one_foot_on_wall(WEIGHTLESS, rng)
        row = gap_jacobian(WEIGHTLESS, state, wall, foot)
        state[6:] -= row * ((row @ state[6:]) + 1e-9) / (row @ row)  # now it approaches at 1e-9 m/s
        state[3:5] += 1e-13 * row[:2]  # outside by more than rounding: in an instant it moves less than that
        simulator = started(WEIGHTLESS, contact, state)
        law = max(law, off_the_law(simulator, INSTANT))
        assert (wall, foot) in [hit[1:3] for hit in simulator.impacts]
    return within(Bound("rates off the law", law, 1e-13))


@case("two feet on a wall, on two walls, in a corner: 0 to 1e-3 s apart")
def feet_that_touch_almost_at_the_same_moment(contact: str) -> Finding:
    rng, law, drift, still, together, apart = np.random.default_rng(6), 0.0, 0.0, 0.0, 0, 0
    for delay, kind in itertools.product((0.0, 1e-15, 1e-13, 1e-12, 1e-11, 1e-9, 1e-6, 1e-3), steps(4, 10) * KINDS):
        state, _ = several_contacts(WEIGHTLESS, rng, kind)
        state[5] += delay * rng.choice([-1.0, 1.0])  # one foot is now this much earlier: arms are 1 m
        ahead = 3.0 * delay + INSTANT
        simulator = started(WEIGHTLESS, contact, flown(state, -ahead))
        law = max(law, off_the_law(simulator, 4.0 * ahead))
        drift = max(drift, abs(energy(WEIGHTLESS, simulator.state) / energy(WEIGHTLESS, state) - 1.0))
        moments = {hit.time for hit in simulator.impacts}
        together += 0 < len(moments) < len(simulator.impacts)
        apart += len(moments) > 1
        closed = np.argwhere(gaps(WEIGHTLESS, simulator.state) <= 0.0).tolist()
        rates = [float(gap_jacobian(WEIGHTLESS, simulator.state, *pair) @ simulator.state[6:]) for pair in closed]
        still = max([still, *(-rate for rate in rates)])
    assert min(together, apart) > 5
    return within(
        Bound("rates off the law at the moments taken, together or in turn", law, 1e-12),
        Bound("energy", drift, 1e-12),
        Bound("approach of a foot left at a wall", still, 1e-12, "m/s"),
    )


# -- loss --------------------------------------------------------------------------------------------------------------


@case("restitution 0, 0.5 and 0.9: lies on a level, a tilted and a turning floor for 1000 s")
def a_jack_at_rest_stays_on_its_floor(contact: str) -> Finding:
    # A tilted and a turning floor let it slide into a corner, where two walls support it.
    deepest = gained = 0.0
    for e in (0.0, 0.5, 0.9):
        for tilt, omega in ((0.0, 0.0), (0.3, 0.0), (0.0, 0.2)):
            gravity = 0.0 if omega else 9.81
            scene = Scene(restitution=e, gravity=gravity, drive=None, box_mass=1e9, box_inertia=36e9)
            state = lying(1.0, omega, tilt)
            run = started(scene, contact, state)
            start = energy(scene, state)
            size = 4.0 * 9.81 * 12.0 + abs(start)  # a fall through the box
            for _ in range(steps(500, 50_000)):
                run.step(0.02, 0.0)
                deepest = max(deepest, -clearance(scene, run.state.tolist()))
                gained = max(gained, (energy(scene, run.state) - start) / size)
    return within(
        Bound("a foot in a wall", deepest, 1e-12 if contact == "exact" else 0.1, "m"),
        Bound("energy above that of the start, relative", gained, 1e-12 if contact == "exact" else 1e-4),
    )


@case("restitution 0 and 0.5: comes to rest")
def a_jack_that_loses_energy_comes_to_rest(contact: str) -> Finding:
    speed = moved = lifted = above = 0.0
    for restitution in (0.0, 0.5):
        scene = Scene(restitution=restitution, drive=None, box_mass=1e12, box_inertia=1e14)
        start = at(theta_jack=0.2)
        simulator, states = started(scene, contact, start), [start]
        for _ in range(1200):
            simulator.step(0.02, 0.0)
            states.append(simulator.state)
        resting = np.array(states[-100:])
        above = max(above, *(energy(scene, state) - energy(scene, start) for state in states))
        speed = max(speed, float(np.abs(resting[:, [9, 10]]).max()))
        moved = max(moved, float(np.ptp(resting[:, [3, 4, 5]], axis=0).max()))
        lifted = max(lifted, float(np.abs(np.sort(gaps(scene, states[-1])[3])[:2]).max()))
    return within(
        Bound("speed after 22 s (g h of a synchronised contact)", speed, 9.81 * 0.005, "m/s"),
        Bound("jitter over 2 s", moved, 1e-3, "m or rad"),
        Bound("two feet off the floor", lifted, 1e-4, "m"),
        Bound("energy above that of the start", above, 1e-9, "J"),
    )


# -- feet that start on a wall or behind it ----------------------------------------------------------------------------


@case("a state with a foot on a wall or up to 1 m outside, put back")
def a_state_outside_is_put_back_up_to_1_m(contact: str) -> Finding:
    law, rng = 0.0, np.random.default_rng(8)
    for depth in 10 * (0.0, 1e-12, 1e-9, 1e-3, 0.3, 0.99):
        state, wall, foot = one_foot_on_wall(WEIGHTLESS, rng)
        normal = gap_jacobian(WEIGHTLESS, state, wall, foot)[:2]
        state[3:5] += depth * normal
        state[9:11] += 30.0 * normal  # so that whichever foot is outside approaches
        simulator = started(WEIGHTLESS, contact, state)
        law = max(law, off_the_law(simulator, 1e-9))
        assert simulator.impacts
        state[6:] *= -1.0
        simulator.reset(state)
        simulator.step(1e-9)
        assert simulator.impacts == []
    return within(Bound("rates off the law after it bounced at once", law, 1e-12), note="; free if it leaves")
