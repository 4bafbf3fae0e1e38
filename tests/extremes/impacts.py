"""Impacts at the extremes of mass, inertia, speed and simultaneity, and feet that start on or behind a wall."""

from __future__ import annotations

import numpy as np

from jackbox_env.mechanics import energy, gap_jacobian, gaps
from jackbox_env.scene import Scene
from tests.extremes.measures import (
    follow,
    kept,
    momentum,
    momentum_scale,
    off_the_law,
    started,
)
from tests.extremes.page import Bound, Finding, part, within
from tests.states import Array, inside, one_foot_on_wall, several_contacts

WEIGHTLESS = Scene(gravity=0.0, drive=None)
LIGHT = Scene(gravity=0.0, drive=None, jack_inertia=0.004)
RATIOS = tuple(10.0**power for power in range(-9, 10, 3))
KINDS = ("one wall", "two walls", "corner")
INSTANT = 1e-12  # [s] in which nothing but the impact happens
masses = part("Masses and inertias")
together = part("Slow impacts, and several at once")


def of_mass(ratio: float) -> Scene:
    """A weightless scene with a jack so many times as heavy as the box."""
    return Scene(gravity=0.0, drive=None, jack_mass=400.0 * ratio)


# -- masses and inertias -----------------------------------------------------------------------------------------------


@masses("one impact, jack 1e-9 to 1e9 times as heavy as the box")
def one_impact_at_any_ratio_of_the_masses(contact: str) -> Finding:
    law = kept = 0.0
    for ratio in RATIOS:
        scene, rng = of_mass(ratio), np.random.default_rng(1)
        for _ in range(30):
            state, wall, foot = one_foot_on_wall(scene, rng)
            simulator = started(scene, contact, state)
            law = max(law, off_the_law(simulator, INSTANT))
            assert [hit[1:3] for hit in simulator.impacts] == [(wall, foot)]
            scale = max(momentum_scale(scene, state), momentum_scale(scene, simulator.state))
            kept = max(kept, float(np.abs(momentum(scene, simulator.state) - momentum(scene, state)).max()) / scale)
    return within(Bound("rates off the impact map", law, 1e-12), Bound("momentum", kept, 1e-14))


@masses("4 s of flight and impacts, jack 1e-9 to 1e9 times as heavy as the box")
def flight_and_impacts_at_any_ratio_of_the_masses(contact: str) -> Finding:
    return courses([of_mass(ratio) for ratio in RATIOS], contact)


def courses(scenes: list[Scene], contact: str) -> Finding:
    """Run several scenes from random states; check impacts, containment, momentum and energy."""
    rng = np.random.default_rng(2)
    return kept([follow(started(scene, contact, inside(scene, rng)), 200, 0.02) for scene in scenes], contact, hits=1)


@masses("one foot, two feet and corners, jack inertia a thousandth of m l^2")
def impacts_of_a_light_inertia(contact: str) -> Finding:
    rng, law = np.random.default_rng(3), 0.0
    for number in range(80):
        if number % 4 == 3:
            state, wall, foot = one_foot_on_wall(LIGHT, rng)
            contacts = [(wall, foot)]
        else:
            state, contacts = several_contacts(LIGHT, rng, KINDS[number % 4])
        simulator = started(LIGHT, contact, state)
        law = max(law, off_the_law(simulator, INSTANT))
        assert {hit[1:3] for hit in simulator.impacts} <= set(contacts)
        assert simulator.impacts
    return within(Bound("rates off the law", law, 1e-11))


@masses("4 s of flight and impacts, jack inertia a thousandth of m l^2")
def flight_and_impacts_of_a_light_inertia(contact: str) -> Finding:
    return courses([LIGHT], contact)


# -- slow and simultaneous ---------------------------------------------------------------------------------------------


@together("a foot arrives at 1e-9 m/s")
def a_foot_arrives_hardly_moving(contact: str) -> Finding:
    law = 0.0
    # Straight at the wall with all its speed, and while both bodies turn and slide at some m/s.
    straight = np.zeros(12)
    straight[[3, 9]] = 5.0, 1e-9
    simulator = started(WEIGHTLESS, contact, straight)
    law = max(law, off_the_law(simulator, 1e-4))
    assert simulator.impacts
    rng, slipped = np.random.default_rng(4), 0.0
    for _ in range(50):
        state, wall, foot = one_foot_on_wall(WEIGHTLESS, rng)
        row = gap_jacobian(WEIGHTLESS, state, wall, foot)
        state[6:] -= row * ((row @ state[6:]) + 1e-9) / (row @ row)  # now it approaches at 1e-9 m/s
        normal = row[:2]
        state[3:5] += 1e-13 * normal  # outside by more than rounding: in an instant it moves less than that
        simulator = started(WEIGHTLESS, contact, state)
        slipped = max(slipped, off_the_law(simulator, INSTANT))
        assert (wall, foot) in [hit[1:3] for hit in simulator.impacts]
    return within(
        Bound("rates off the law, head on", law, 1e-12),
        Bound("sliding at some m/s", slipped, 1e-13),
    )


@together("two feet on a wall, on two walls, in a corner: at the same moment")
def feet_that_touch_at_the_same_moment(contact: str) -> Finding:
    rng, law, kept = np.random.default_rng(5), 0.0, 0.0
    for kind in KINDS:
        several = 0
        for _ in range(40):
            state, _ = several_contacts(WEIGHTLESS, rng, kind)
            simulator = started(WEIGHTLESS, contact, state)
            law = max(law, off_the_law(simulator, INSTANT))
            kept = max(kept, abs(energy(WEIGHTLESS, simulator.state) / energy(WEIGHTLESS, state) - 1.0))
            assert len({hit.time for hit in simulator.impacts}) == 1
            several += len(simulator.impacts) > 1
        assert several > 5
    return within(Bound("rates off the simultaneous law", law, 1e-12), Bound("energy", kept, 1e-12))


@together("two feet on a wall, on two walls, in a corner: 1e-15 to 1e-3 s apart")
def feet_that_touch_almost_at_the_same_moment(contact: str) -> Finding:
    rng, law, kept, still, together, apart = np.random.default_rng(6), 0.0, 0.0, 0.0, 0, 0
    for delay in (1e-15, 1e-13, 1e-12, 1e-11, 1e-9, 1e-6, 1e-3):
        for kind in KINDS:
            for _ in range(10):
                state, _ = several_contacts(WEIGHTLESS, rng, kind)
                ahead = 3.0 * delay + INSTANT
                state[5] += delay * rng.choice([-1.0, 1.0])  # one foot is now this much earlier: arms are 1 m
                state[:6] -= ahead * state[6:]
                simulator = started(WEIGHTLESS, contact, state)
                law = max(law, off_the_law(simulator, 4.0 * ahead))
                moments = {hit.time for hit in simulator.impacts}
                together += 0 < len(moments) < len(simulator.impacts)
                apart += len(moments) > 1
                kept = max(kept, abs(energy(WEIGHTLESS, simulator.state) / energy(WEIGHTLESS, state) - 1.0))
                still = max(still, approach_of_closed(simulator.scene, simulator.state))
    assert together > 5
    assert apart > 5
    return within(
        Bound("rates off the law at the moments taken, together or in turn", law, 1e-12),
        Bound("energy", kept, 1e-12),
        Bound("approach of a foot left at a wall", still, 1e-12, "m/s"),
    )


def approach_of_closed(scene: Scene, state: Array) -> float:
    """Fastest approach among the gaps that are not open [m/s]."""
    closed = np.argwhere(gaps(scene, state) <= 0.0).tolist()
    return max((-float(gap_jacobian(scene, state, *pair) @ state[6:]) for pair in closed), default=0.0)
