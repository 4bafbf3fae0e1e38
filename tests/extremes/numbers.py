"""Numbers that are very small or very large."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from functools import partial

import numpy as np

from jackbox_env.scene import Chirp, Scene
from jackbox_env.simulators import make_simulator
from tests.extremes.measures import Course, follow, kept, off_the_law, started
from tests.extremes.page import REFUSED, Bound, Finding, part, refuses, within

WEIGHTLESS = Scene(gravity=0.0, drive=None)
SMALLEST = 5e-324
SUBNORMAL = (SMALLEST, -SMALLEST, 1e-310, -1e-310)
QUANTITIES = ("box_half_width", "box_mass", "box_inertia", "jack_arm", "jack_mass", "jack_inertia", "torque_limit")
Calls = dict[str, tuple[Callable[[], object], str]]
sizes = part("Numbers too small or too large")


# -- small numbers -----------------------------------------------------------------------------------------------------


@sizes("subnormal numbers in states, time steps and torques")
def subnormal_numbers_change_no_more_than_they_are(contact: str) -> Finding:
    # Each answer is compared with that of zeros in their place, and a time step with no time at all.
    free, touching = np.zeros(12), np.zeros(12)
    free[:6], free[6:] = (0.0, 0.0, 0.1, 1.0, 0.5, 0.3), (0.3, 0.1, 0.2, -0.4, 0.7, 1.0)
    touching[[3, 9]] = 5.0 + 1e-12, 1.0
    changed = law = 0.0
    for state, tiny, torque in itertools.product((np.zeros(12), free, touching), SUBNORMAL, (0.0, SMALLEST, -1e-310)):
        plain, disturbed = started(WEIGHTLESS, contact, state), started(WEIGHTLESS, contact, state + tiny)
        plain.step(0.02, 0.0)
        disturbed.step(0.02, torque)
        assert [hit[1:3] for hit in disturbed.impacts] == [hit[1:3] for hit in plain.impacts]
        changed = max(changed, float(np.abs(disturbed.state - plain.state).max()))
    for dt, scene in itertools.product((4e-323, 1e-310, 1e-308), (WEIGHTLESS, Scene())):
        simulator = started(scene, contact, free)
        simulator.step(dt)
        assert simulator.time == dt
        changed = max(changed, float(np.abs(simulator.state - free).max()))
        law = max(law, off_the_law(started(WEIGHTLESS, contact, touching), dt))
    for scene in (WEIGHTLESS, Scene()):  # half of the smallest number is 0: a model that needs half a step refuses it
        simulator = started(scene, contact, touching)
        taken = refuses(partial(simulator.step, SMALLEST), "").verdict != REFUSED
        assert taken == (contact == "exact" and scene is WEIGHTLESS)
        assert taken or (simulator.time == 0.0 and np.array_equal(simulator.state, touching))
    return within(
        Bound("off what zeros give", changed, 1e-307, "m, rad, m/s or rad/s"),
        Bound("rates off the law", law, 1e-14),
        note="; a step of 5e-324 s, whose half is 0, taken as it is or refused",
    )


@sizes("subnormal numbers in a scene")
def subnormal_numbers_in_a_scene_are_refused(contact: str) -> Finding:
    # These may be as small as they like.
    make_simulator(Scene(gravity=SMALLEST, drive=Chirp(SMALLEST, SMALLEST, -SMALLEST)), contact).step(0.02)
    for name, value in itertools.product(QUANTITIES, (SMALLEST, 1e-310, 9.9e-61)):
        finding = refuses(
            partial(make_simulator, {name: value}, contact),
            f"^{name} must be a finite number at least 1e-60 and at most 1e[+]60, got ",
        )
        assert finding.verdict == REFUSED
    return finding


@sizes("jack of 1e-60 to 1e57 kg, half width of 1e-28 to 6 m, 10 s")
def light_heavy_and_small_scenes(contact: str) -> Finding:
    scales = ((6.0, 1e-60), (6.0, 1e57), (1e-28, 1e-2), (1e-15, 1e-28))
    return kept([across(width, mass, contact) for width, mass in scales], contact, 5, unit="L")


@sizes("half width of 1e15 and 1e25 m, jack crosses it in seconds")
def large_scenes(contact: str) -> Finding:
    if contact == "pymunk":
        return refuses(partial(across, 1e25, 1e7, contact), "the jack would leave the box: .* at most 1 m is followed")
    courses = [across(width, mass, contact) for width, mass in ((1e15, 1e28), (1e25, 1e7))]
    return kept(courses, contact, 5, unit="L")


def across(width: float, mass: float, contact: str) -> Course:
    """10 s of a jack that crosses a weightless box of this half width [m] in seconds; depths are over the width."""
    scene = Scene(
        gravity=0.0, drive=None, box_half_width=width, jack_arm=width / 6.0, box_mass=10.0 * mass, jack_mass=mass
    )
    start = np.zeros(12)
    start[[3, 4, 5, 9, 10, 11]] = 0.1 * width, 0.2 * width, 0.3, 0.9 * width, 0.5 * width, 1.0
    course = follow(started(scene, contact, start), 500, 0.02)
    course.deepest /= width
    return course
