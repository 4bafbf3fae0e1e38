"""The exact model against 60 digits, the law of impact, rest, limits."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import JackLostError
from jackbox_env.exact import contact
from jackbox_env.exact.workspace import Status
from jackbox_env.mechanics import energy, simultaneous_impact_map
from jackbox_env.scene import Chirp, Drive, Scene
from jackbox_env.simulators import Impact
from jackbox_env.states import clearance
from tests.simulators.exact_runs import plain_step, simulator
from tests.states import Array, inside, load, several_contacts

WEIGHTLESS = Scene(gravity=0.0, drive=None)


RECORDS = [*load("exact_trajectories"), *load("seed_scene")]


# -- against the 60-digit reference ------------------------------------------------------------------------------------


def run_record(record: dict[str, Any]) -> tuple[list[Impact], list[Array]]:
    """Impacts, and states every 0.1 s."""
    scene = Scene(gravity=record["gravity"], drive=Chirp() if record["drive"] == "chirp" else None)
    run = simulator(scene, record["q"] + record["qdot"])
    hits: list[Impact] = []
    states = []
    for number in range(round(record["T"] / 0.02)):
        run.step(0.02, 90000.0 * record["actions"][number] if record["drive"] == "held" else None)
        hits += run.impacts
        if number % 5 == 4:
            states.append(run.state)
    return hits, states


@pytest.mark.parametrize("record", RECORDS, ids=lambda record: record["name"])
def test_impacts_and_states_equal_the_60_digit_reference(record: dict[str, Any]) -> None:
    hits, states = run_record(record)
    predictable = 14 if record["name"] == "seed" else len(record["impacts"])  # beyond, rounding decides
    expected = record["impacts"][:predictable]
    assert [(hit.wall, hit.foot) for hit in hits[:predictable]] == [(hit["wall"], hit["foot"]) for hit in expected]
    if record["name"] != "seed":
        assert len(hits) == predictable
    for hit, reference in list(zip(hits, expected, strict=False))[:5]:
        assert hit.time == pytest.approx(reference["time"], abs=1e-10, rel=0.0)
        assert hit.impulse == pytest.approx(reference["impulse"], rel=1e-8)
    times = [hit["time"] for hit in record["impacts"]]
    checked = 0
    for state, reference in zip(states, record["states"], strict=True):
        before = sum(time < reference["time"] for time in times)
        if before > 5:
            break
        tolerance = 1e-12 if before == 0 else 1e-8
        np.testing.assert_allclose(state, reference["state"], rtol=0.0, atol=tolerance)
        checked += 1
    assert checked > 9


def test_without_torque_time_can_be_turned_back() -> None:
    rng = np.random.default_rng(3)
    scene = Scene(drive=None)
    total = 0
    for _ in range(20):
        start = inside(scene, rng, speed=3.0)
        run = simulator(scene, start)
        hits = 0
        while hits < 4:
            run.step(0.02)
            hits += len(run.impacts)
        there = run.state
        there[6:] *= -1.0
        back = simulator(scene, there)
        for _ in range(round(run.time / 0.02)):
            back.step(0.02)
        home = back.state
        home[6:] *= -1.0
        np.testing.assert_allclose(home, start, atol=1e-7)
        total += hits
    assert total >= 80


# -- the law of impact -------------------------------------------------------------------------------------------------


def relative_error(actual: Array, expected: Array) -> float:
    return float(np.abs(actual[6:] - expected[6:]).max() / np.abs(expected[6:]).max())


def test_one_contact_after_the_other_would_break_the_simultaneous_law(monkeypatch: pytest.MonkeyPatch) -> None:
    # Resolved one by one, two feet on a floor give another, also energy-keeping, answer.
    def one_by_one(n: Any, w: Any, count: int) -> None:
        for number in range(count):
            w.impulses[number] = contact.bounce(n, w.state, w.gradients[number])

    rng = np.random.default_rng(2)
    state, contacts = several_contacts(WEIGHTLESS, rng, "one wall")
    expected, _ = simultaneous_impact_map(WEIGHTLESS, state, contacts)
    assert relative_error(plain_step(WEIGHTLESS, state, 1e-13, 0.0)[1], expected) < 1e-9
    monkeypatch.setattr(contact, "bounce_together", one_by_one)
    assert relative_error(plain_step(WEIGHTLESS, state, 1e-13, 0.0)[1], expected) > 0.01


def test_a_jack_that_fits_at_45_degrees_only_rattles_in_its_corners() -> None:
    # Eight contacts of rank three, with 1e-4 m of play: thousands of impacts per second, some of them together.
    scene = Scene(gravity=0.0, drive=None, jack_arm=6.0 * math.sqrt(2.0) - 1e-4)
    state = np.zeros(12)
    state[5], state[9], state[10] = math.pi / 4.0, 3.0, 3.0
    run = simulator(scene, state)
    hits: list[Impact] = []
    for _ in range(10):
        run.step(0.001)
        hits += run.impacts
        assert clearance(scene, run.state.tolist()) > -1e-9
    assert len(hits) > 100
    assert len({hit.time for hit in hits}) < len(hits)
    assert energy(scene, run.state) == pytest.approx(energy(scene, state), rel=1e-11)
    np.testing.assert_allclose(400.0 * run.state[6:8] + 4.0 * run.state[9:11], [12.0, 12.0], rtol=1e-9)


@pytest.mark.slow
def test_a_jack_without_any_play_is_refused_rather_than_shaken_for_ever() -> None:
    scene = Scene(gravity=0.0, drive=None, jack_arm=6.0 * math.sqrt(2.0) * (1.0 - 4e-16))
    state = np.zeros(12)
    state[5], state[9] = math.pi / 4.0, 3.0
    with pytest.raises(RuntimeError, match="the jack needs more than 1,000,000 gap evaluations"):
        simulator(scene, state).step(1e-9)


# -- resting, grazing, touching ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [0.02, 0.2, 1.0])
@pytest.mark.parametrize("angle", [0.0, math.pi / 4.0])
def test_a_foot_that_slides_along_a_wall_is_let_slide(dt: float, angle: float) -> None:
    # It touches the wall and nothing presses on it: the jack falls along the wall.
    scene = Scene(drive=None)
    state = np.zeros(12)
    state[3], state[5] = 6.0 - math.cos(angle), angle
    run = simulator(scene, state)
    run.step(dt)
    assert [hit for hit in run.impacts if hit.impulse > 1e-6] == []
    assert run.state[4] == pytest.approx(-0.5 * 9.81 * dt * dt, abs=1e-9)
    assert clearance(scene, run.state.tolist()) > -1e-9


@pytest.mark.parametrize("depth", [1e-12, 1e-11])
def test_a_grazing_foot_bounces_when_it_reaches_the_wall(depth: float) -> None:
    # Foot 0 turns at 10 rad/s on an arm of 1 m: it reaches the wall at the angle -phi, with 1 - cos phi = depth.
    state = np.array([0.0, 0.0, 0.0, 5.0 + depth, 0.0, -0.1, 0.0, 0.0, 0.0, 0.0, 0.0, 10.0])
    phi = 2.0 * math.asin(math.sqrt(0.5 * (state[3] - 5.0)))
    run = simulator(WEIGHTLESS, state)
    run.step(0.02)
    resolved = 2e-15 / (10.0 * math.sin(phi))  # of the time, by a gap that is rounded [s]
    assert run.impacts[0].time == pytest.approx(0.1 * (0.1 - phi), rel=0.0, abs=resolved)


# -- limits ------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("numbers", [{2: 1e14}, {5: 1e14}, {7: 1e14, 10: 1e14}], ids=str)
def test_a_state_that_float64_can_not_resolve_near_a_wall_is_refused_and_stays(numbers: dict[int, float]) -> None:
    state = np.zeros(12)
    state[[3, 5, 9]] = 5.2, 0.785, 10.0
    state[list(numbers)] = list(numbers.values())
    run = simulator(WEIGHTLESS, state)
    with pytest.raises(JackLostError, match="too fast to be followed .* or is too far off"):
        run.step(0.02)
    np.testing.assert_array_equal(run.state, state)


def test_many_impacts_of_one_step_are_all_recorded() -> None:
    scene = Scene(gravity=0.0, drive=None, box_mass=1e12, box_inertia=1e14, jack_arm=0.5)
    run = simulator(scene, np.array([0, 0, 0, 0, 0, 0.1, 0, 0, 0, 3000.0, 0, 0]))
    run.step(1.0)
    assert 100 < len(run.impacts) < 300
    times = [hit.time for hit in run.impacts]
    assert times == sorted(times)
    assert all(hit.impulse > 0.0 for hit in run.impacts)


# -- compiled and plain ------------------------------------------------------------------------------------------------


def test_compiled_and_plain_give_the_same_bits() -> None:
    rng = np.random.default_rng(8)
    hits = 0
    for scene in (Scene(), Scene(jack_arm=5.9), Scene(jack_arm=6.5), Scene(drive=Drive(force_x=lambda t: 1e4 * t))):
        state = np.zeros(12)
        state[5] = math.pi / 4.0
        state[6:] = rng.standard_normal(6) * (2.0, 2.0, 0.5, 8.0, 8.0, 3.0)
        run = simulator(scene, state)
        for number in range(100):
            torque = rng.uniform(-9e4, 9e4) if number % 2 else None
            ended, after, impacts = plain_step(scene, run.state, 0.02, torque, run.time)
            run.step(0.02, torque)
            assert ended == Status.DONE
            np.testing.assert_array_equal(run.state, after)
            assert [(hit.wall, hit.foot) for hit in run.impacts] == [hit[1:] for hit in impacts]
            hits += len(impacts)
    assert hits > 30
