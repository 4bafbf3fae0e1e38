"""Numbers that are too small or not finite, and scenes that lose energy."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np

from jackbox_env.env import JackInBoxEnv
from jackbox_env.mechanics import energy, gaps
from jackbox_env.planning import rollout
from jackbox_env.scene import Chirp, Drive, Scene
from jackbox_env.simulators import make_simulator
from jackbox_env.states import STATE_NAMES
from jackbox_env.vector_env import JackInBoxVectorEnv
from tests.extremes.measures import Course, deepest_allowed, follow, off_the_law, started
from tests.extremes.page import Bound, Finding, extreme, refuses, refuses_each, sentence_of, within
from tests.states import Array

WEIGHTLESS = Scene(gravity=0.0, drive=None)
SMALLEST = 5e-324
SUBNORMAL = (SMALLEST, -SMALLEST, 1e-310, -1e-310)
NOT_FINITE = (math.nan, math.inf, -math.inf)
QUANTITIES = ("box_half_width", "box_mass", "box_inertia", "jack_arm", "jack_mass", "jack_inertia", "torque_limit")
Calls = dict[str, tuple[Callable[[], object], str]]


# -- small numbers -----------------------------------------------------------------------------------------------------


@extreme("subnormal numbers in states, time steps and torques")
def test_subnormal_numbers_change_no_more_than_they_are(contact: str) -> Finding:
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
        taken = sentence_of(partial(simulator.step, SMALLEST)) is None
        assert taken == (contact == "exact" and scene is WEIGHTLESS)
        assert taken or (simulator.time == 0.0 and np.array_equal(simulator.state, touching))
    return within(
        Bound("off what zeros give", changed, 1e-307, "m, rad, m/s or rad/s"),
        Bound("rates off the law", law, 1e-14),
        note="; a step of 5e-324 s, whose half is 0, taken as it is or refused",
    )


@extreme("subnormal numbers in a scene")
def test_subnormal_numbers_in_a_scene_are_refused(contact: str) -> Finding:
    calls: Calls = {
        f"{name} = {value:.3g}": (
            partial(make_simulator, {name: value}, contact),
            f"^{name} must be a finite number at least 1e-60 and at most 1e[+]60, got ",
        )
        for name, value in itertools.product(QUANTITIES, (SMALLEST, 1e-310, 9.9e-61))
    }
    # These may be as small as they like.
    make_simulator(Scene(gravity=SMALLEST, drive=Chirp(SMALLEST, SMALLEST, -SMALLEST)), contact).step(0.02)
    return refuses_each(calls)


@extreme("jack of 1e-60 to 1e57 kg, half width of 1e-28 to 6 m, 10 s")
def test_light_heavy_and_small_scenes(contact: str) -> Finding:
    scales = ((6.0, 1e-60), (6.0, 1e57), (1e-28, 1e-2), (1e-15, 1e-28))
    return of_every_scale([across(width, mass, contact) for width, mass in scales], contact)


@extreme("half width of 1e15 and 1e25 m, jack crosses it in seconds")
def test_large_scenes(contact: str) -> Finding:
    if contact == "pymunk":
        return refuses(partial(across, 1e25, 1e7, contact), "the jack would leave the box: .* at most 1 m is followed")
    return of_every_scale([across(width, mass, contact) for width, mass in ((1e15, 1e28), (1e25, 1e7))], contact)


def across(width: float, mass: float, contact: str) -> Course:
    """10 s of a jack that crosses a weightless box of this half width [m] in seconds; depths are over the width."""
    scene = Scene(
        gravity=0.0, drive=None, box_half_width=width, jack_arm=width / 6.0, box_mass=10.0 * mass, jack_mass=mass
    )
    start = np.zeros(12)
    start[[3, 4, 5, 9, 10, 11]] = 0.1 * width, 0.2 * width, 0.3, 0.9 * width, 0.5 * width, 1.0
    course = follow(started(scene, contact, start), 500, 0.02)
    assert course.hits > 5
    course.deepest /= width
    return course


def of_every_scale(courses: list[Course], contact: str) -> Finding:
    return within(
        Bound("momentum", max(course.momentum for course in courses), 1e-12),
        Bound("energy", max(course.energy for course in courses), 1e-12),
        Bound("a foot outside", max(0.0, *(course.deepest for course in courses)), deepest_allowed(contact), "L"),
    )


# -- not numbers -------------------------------------------------------------------------------------------------------


@extreme("NaN and infinity in scenes and chirps")
def test_scenes_that_are_not_finite_are_refused(contact: str) -> Finding:
    calls: Calls = {}
    for value in NOT_FINITE:
        for name in (*QUANTITIES, "gravity", "restitution"):
            given: dict[str, Any] = {name: value}
            calls[f"{name} = {value}"] = partial(make_simulator, given, contact), f"^{name} must be a finite number"
        for name in ("amplitude", "start_frequency", "rate"):
            given = {"drive": {name: value}}
            calls[f"{name} = {value}"] = partial(make_simulator, given, contact), f"^{name} must be a finite number"
    return refuses_each(calls)


@extreme("NaN and infinity from a drive's functions")
def test_drives_that_are_not_finite_are_refused(contact: str) -> Finding:
    calls: Calls = {}
    simulators = []
    for name, value, late in itertools.product(("torque", "force_x", "force_y"), NOT_FINITE, (0.0, 0.013)):
        # From the start, and from the middle of the step on.
        drive = Drive(**{name: lambda t, value=value, late=late: value if t >= late else 1.0})
        simulator = started(Scene(drive=drive), contact, touching_soon())
        simulators.append(simulator)
        sentence = rf"^{name}\(.* s\) must be a finite number, got {value}"
        calls[f"{name}(t) = {value} from {late} s"] = partial(simulator.step, 0.02), sentence
    finding = refuses_each(calls)
    assert all(np.array_equal(simulator.state, touching_soon()) for simulator in simulators)
    return finding


def touching_soon() -> Array:
    state = np.zeros(12)
    state[[3, 9]] = 4.99, 3.0
    return state


@extreme("NaN and infinity in states and times")
def test_states_and_times_that_are_not_finite_are_refused(contact: str) -> Finding:
    simulator = started(WEIGHTLESS, contact, touching_soon(), 7.0)
    env = JackInBoxEnv(contact=contact)
    many = JackInBoxVectorEnv(3, contact=contact)
    many.reset(seed=0)
    before = many.states
    calls: Calls = {}
    for value in NOT_FINITE:
        for place, name in enumerate(STATE_NAMES):
            state = np.zeros(12)
            state[place] = value
            rows = np.zeros((3, 12))
            rows[2] = state
            sentence = f"state must be finite, got {name} = {value}"
            calls[f"reset, {name} = {value}"] = partial(simulator.reset, state), sentence
            calls[f"set_state, {name} = {value}"] = partial(env.set_state, state), sentence
            calls[f"set_states, {name} = {value}"] = partial(many.set_states, rows, 0.0), sentence
            if contact == "exact":
                calls[f"rollout, {name} = {value}"] = (
                    partial(rollout, WEIGHTLESS, rows, np.zeros((3, 2)), 0.02),
                    sentence,
                )
        late = "must be a finite number at least -1e[+]09 and at most 1e[+]09"
        calls[f"reset, time = {value}"] = partial(simulator.reset, np.zeros(12), value), late
        calls[f"set_state, time = {value}"] = partial(env.set_state, np.zeros(12), value), late
        calls[f"set_states, time = {value}"] = partial(many.set_states, np.zeros(12), value), late
    finding = refuses_each(calls)
    assert np.array_equal(simulator.state, touching_soon())
    assert simulator.time == 7.0
    assert np.array_equal(many.states, before)
    return finding


@extreme("NaN and infinity in time steps and torques")
def test_steps_and_torques_that_are_not_finite_are_refused(contact: str) -> Finding:
    simulator = started(WEIGHTLESS, contact, touching_soon())
    calls: Calls = {}
    for value in NOT_FINITE:
        dt, torque = "dt must be a finite number above 0", "torque must be a finite number"
        calls[f"step, dt = {value}"] = partial(simulator.step, value), dt
        calls[f"step, torque = {value}"] = partial(simulator.step, 0.02, value), torque
        calls[f"substeps = {value}"] = partial(make_simulator, WEIGHTLESS, contact, substeps=value), "substeps"
        if contact == "exact":
            rows, torques = np.zeros((1, 12)), np.array([[0.0, value]])
            calls[f"rollout, torque = {value}"] = (
                partial(rollout, WEIGHTLESS, rows, torques, 0.02),
                "torques must be finite",
            )
            calls[f"rollout, dt = {value}"] = partial(rollout, WEIGHTLESS, rows, np.zeros((1, 2)), value), dt
        calls[f"control_dt = {value}"] = (partial(JackInBoxEnv, contact, control_dt=value), "control_" + dt)
        calls[f"batch, control_dt = {value}"] = (
            partial(JackInBoxVectorEnv, 2, contact=contact, control_dt=value),
            "control_" + dt,
        )
    finding = refuses_each(calls)
    assert np.array_equal(simulator.state, touching_soon())
    simulator.step(0.02, 0.0)
    return finding


@extreme("NaN and infinity in actions")
def test_actions_that_are_not_finite_are_refused(contact: str) -> Finding:
    env, many = JackInBoxEnv(contact=contact), JackInBoxVectorEnv(3, contact=contact)
    env.reset(seed=0)
    many.reset(seed=0)
    state, states = env.state, many.states
    calls: Calls = {}
    for value in NOT_FINITE:
        for kind in (np.float64, np.float32):
            sentence = "must be a finite number|must be finite"
            calls[f"{kind.__name__} {value}"] = partial(env.step, np.array([value], dtype=kind)), sentence
            rows = np.array([[0.5], [0.5], [value]], dtype=kind)
            calls[f"{kind.__name__} {value} in a batch"] = partial(many.step, rows), sentence
        calls[f"plain {value}"] = partial(env.step, value), sentence
    finding = refuses_each(calls)
    assert np.array_equal(env.state, state)
    assert np.array_equal(many.states, states)
    return finding


@extreme("NaN and infinity in the options of a reset")
def test_options_that_are_not_finite_are_refused(contact: str) -> Finding:
    env, many = JackInBoxEnv(contact=contact), JackInBoxVectorEnv(3, contact=contact)
    env.reset(seed=0)
    many.reset(seed=0)
    state, states = env.state, many.states
    calls: Calls = {}
    for value in NOT_FINITE:
        for place, name in enumerate(STATE_NAMES):
            given = np.zeros(12)
            given[place] = value
            for kind, reset in (("one", env.reset), ("batch", many.reset)):
                sentence = f"state must be finite, got {name} = {value}"
                calls[f"{kind}, {name} = {value}"] = partial(reset, options={"state": given}), sentence
        for kind, reset in (("one", env.reset), ("batch", many.reset)):
            sentence = r"options\['time'\] must be a finite number at least -1e[+]09 and at most 1e[+]09"
            calls[f"{kind}, time = {value}"] = partial(reset, options={"time": value}), sentence
    finding = refuses_each(calls)
    assert np.array_equal(env.state, state)
    assert np.array_equal(many.states, states)
    return finding


# -- what loses energy -------------------------------------------------------------------------------------------------


@extreme("restitution 0 and 0.5: comes to rest")
def test_a_jack_that_loses_energy_comes_to_rest(contact: str) -> Finding:
    speed = moved = lifted = above = put_back = 0.0
    for restitution in (0.0, 0.5):
        scene = Scene(restitution=restitution, drive=None, box_mass=1e12, box_inertia=1e14)
        start = np.zeros(12)
        start[5] = 0.2
        simulator = started(scene, contact, start)
        energies, resting = [energy(scene, start)], []
        for number in range(1200):
            simulator.step(0.02, 0.0)
            energies.append(energy(scene, simulator.state))
            if number >= 1100:
                resting.append(simulator.state)
        states = np.array(resting)
        above = max(above, max(energies) - energies[0])
        put_back = max(put_back, float(np.diff(energies).max()))
        speed = max(speed, float(np.abs(states[:, [9, 10]]).max()))
        moved = max(moved, float(np.ptp(states[:, [3, 4, 5]], axis=0).max()))
        lifted = max(lifted, float(np.abs(np.sort(gaps(scene, states[-1])[3])[:2]).max()))
    # An impact at 9.9 m/s ends up to v h deep in the floor; the jack is then lifted out, against its weight.
    deep = math.sqrt(2.0 * 9.81 * 5.0) * 0.005
    return within(
        Bound("speed after 22 s (g h of a synchronised contact)", speed, 9.81 * 0.005, "m/s"),
        Bound("jitter over 2 s", moved, 1e-3, "m or rad"),
        Bound("two feet off the floor", lifted, 1e-4, "m"),
        Bound("energy above that of the start", above, 1e-9, "J"),
        Bound("energy that lifting a foot out of the floor adds in a step (m g v h)", put_back, 4.0 * 9.81 * deep, "J"),
    )
