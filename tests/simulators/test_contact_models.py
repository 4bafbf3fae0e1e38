"""What every contact model must do: keep the laws over long runs, restore a state, refuse what it cannot follow.

Each test has one body for all models. A weaker tolerance is granted to a model by name, with the reason.
"""

from __future__ import annotations

import copy
import math
import pickle
from typing import Any

import numpy as np
import pytest

from jackbox_env.mechanics import energy
from jackbox_env.scene import Chirp, Drive, Scene
from jackbox_env.simulators import CONTACT_MODELS, make_simulator
from jackbox_env.states import clearance
from tests.states import inside, one_foot_on_wall

WEIGHTLESS = Scene(gravity=0.0, drive=None)
EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


# -- laws --------------------------------------------------------------------------------------------------------------


@EVERY_MODEL
def test_side_forces_push_the_box_exactly(contact: str) -> None:
    # force_x = 4000 cos(2 t) N on 400 kg: vx = 5 sin 2t, x = 2.5 (1 - cos 2t); force_y held.
    scene = Scene(gravity=0.0, drive=Drive(force_x=lambda t: 4000.0 * math.cos(2.0 * t), force_y=lambda t: 400.0))
    simulator = make_simulator(scene, contact)
    simulator.reset(np.zeros(12))
    for _ in range(40):
        simulator.step(0.02, torque=None)
    x, vx = 2.5 * (1.0 - math.cos(1.6)), 5.0 * math.sin(1.6)
    np.testing.assert_allclose(simulator.state[[0, 1, 6, 7]], [x, 0.32, vx, 0.8], atol=1e-12)
    simulator.reset(np.zeros(12))
    simulator.step(0.02, torque=14400.0)  # replaces the drive's torque only
    assert simulator.state[8] == pytest.approx(0.02)
    assert simulator.state[6] == pytest.approx(5.0 * math.sin(0.04), abs=1e-12)
    assert simulator.torque == 14400.0


@EVERY_MODEL
@pytest.mark.parametrize("drive", ["chirp", "held", "none"])
def test_momentum_and_centre_of_mass_follow_the_exact_laws(drive: str, contact: str) -> None:
    scene = Scene(drive=Chirp() if drive == "chirp" else None)
    rng = np.random.default_rng(8)
    simulator = make_simulator(scene, contact)
    start = np.zeros(12)
    start[[3, 5]] = 0.5, 0.3
    simulator.reset(start)
    impacts = 0
    for _ in range(500):
        simulator.step(0.02, rng.uniform(-9e4, 9e4) if drive == "held" else None)
        impacts += len(simulator.impacts)
    state, total = simulator.state, scene.box_mass + scene.jack_mass
    assert impacts > 5
    momentum = scene.box_mass * state[6:8] + scene.jack_mass * state[9:11]
    # Each contact in the last substep of a step shifts the synchronised velocity by at most g h / 2 = 0.0245 m/s.
    assert momentum[0] == pytest.approx(0.0, abs=1e-9)
    assert momentum[1] == pytest.approx(-scene.jack_mass * scene.gravity * simulator.time, abs=1e-9)
    centre = (scene.box_mass * state[0:2] + scene.jack_mass * state[3:5]) / total
    np.testing.assert_allclose(centre, [0.5 * 4.0 / 404.0, -4.0 / 404.0 * 9.81 * 10.0**2 / 2.0], atol=1e-9)


@pytest.mark.parametrize(
    "settings", [{"substeps": 1}, {"substeps": 4}, {"substeps": 64}, {"contact": "exact"}], ids=str
)
def test_energy_gained_is_the_work_of_the_torque(settings: dict[str, Any]) -> None:
    # A held torque's work is torque times the box's turn. In pymunk half-step velocities make the scheme symmetric in
    # time, so even impacts resolved late keep the balance to rounding.
    for seed in range(6):
        rng = np.random.default_rng(seed)
        simulator = make_simulator(Scene(), **settings)
        start = np.zeros(12)
        start[3:6] = rng.uniform(-1.0, 1.0, 3)
        simulator.reset(start)
        work = largest = 0.0
        impacts = 0
        for _ in range(300):
            torque, before = rng.uniform(-9e4, 9e4), simulator.state[2]
            simulator.step(0.02, torque)
            work += torque * (simulator.state[2] - before)
            largest = max(largest, abs(work))
            impacts += len(simulator.impacts)
        gained = energy(simulator.scene, simulator.state) - energy(simulator.scene, start)
        assert impacts > 3
        assert largest > 100.0
        assert gained == pytest.approx(work, abs=1e-11 * largest + 1e-9)


@EVERY_MODEL
def test_far_from_the_origin_is_as_good_as_near_it(contact: str) -> None:
    rng = np.random.default_rng(9)
    for _ in range(50):
        state, wall, foot = one_foot_on_wall(WEIGHTLESS, rng)
        far = state.copy()
        far[[0, 1, 3, 4]] += np.round([1e9, -1e9, 1e9, -1e9])
        far[3:5] -= 3e-7 * np.sign(far[3:5] - far[0:2])  # the rounding there is 1.2e-7 m: stay inside
        near = far.copy()
        near[[0, 1, 3, 4]] -= np.round([1e9, -1e9, 1e9, -1e9])
        one, other = make_simulator(WEIGHTLESS, contact), make_simulator(WEIGHTLESS, contact)
        one.reset(far)
        other.reset(near)
        for simulator in (one, other):
            simulator.step(1e-4)
        assert [hit[1:3] for hit in one.impacts] == [hit[1:3] for hit in other.impacts] == [(wall, foot)]
        np.testing.assert_allclose(one.state[6:], other.state[6:], rtol=1e-12, atol=1e-12)


@EVERY_MODEL
def test_full_torque_for_a_whole_episode_stays_in_the_box(contact: str) -> None:
    simulator = make_simulator(Scene(), contact)
    simulator.reset(np.array([0, 0, 0, 0.5, 0.2, 0.3, 0, 0, 0, 0, 0, 0]))
    deepest = 1.0 if contact == "pymunk" else 1e-9  # the depth at which a substep may end, and rounding
    for _ in range(500):
        simulator.step(0.02, torque=90000.0)
        assert clearance(simulator.scene, simulator.state.tolist()) >= -deepest
    assert simulator.state[8] > 50.0


# -- restoring ---------------------------------------------------------------------------------------------------------


@EVERY_MODEL
def test_the_future_follows_from_state_and_time_bitwise_also_pickled_and_copied(contact: str) -> None:
    rng = np.random.default_rng(7)
    run = make_simulator(Scene(jack_arm=5.0), contact)
    run.reset(inside(run.scene, rng))
    impacts = 0
    for _ in range(300):
        restored = make_simulator(run.scene, contact)
        restored.reset(run.state, run.time)
        twins = [restored, copy.deepcopy(run), pickle.loads(pickle.dumps(run))]
        torque = rng.uniform(-5e4, 5e4) if rng.uniform() < 0.7 else None
        for one in [run, *twins]:
            one.step(0.02, torque)
        for twin in twins:
            np.testing.assert_array_equal(twin.state, run.state)
            assert (twin.time, twin.impacts, twin.torque) == (run.time, run.impacts, run.torque)
        impacts += len(run.impacts)
    assert impacts > 20


@EVERY_MODEL
def test_what_is_handed_out_is_never_written_again(contact: str) -> None:
    simulator = make_simulator(Scene(jack_arm=5.0), contact)
    kept = []
    for _ in range(100):
        simulator.step(0.02)
        state, impacts = simulator.state, simulator.impacts
        kept.append((state, state.copy(), impacts, list(impacts)))
    assert any(impacts for _, _, impacts, _ in kept)
    for state, copied, impacts, listed in kept:
        np.testing.assert_array_equal(state, copied)
        assert impacts == listed
    simulator.state[:] = 0.0
    assert simulator.state.any()


# -- refusals ----------------------------------------------------------------------------------------------------------


@EVERY_MODEL
def test_times_that_stand_still_or_run_out_are_refused(contact: str) -> None:
    simulator = make_simulator(Scene(drive=None), contact)
    simulator.reset(np.zeros(12), time=1e8)
    with pytest.raises(ValueError, match="dt must move the time and end by 1e[+]09 s, got 1e-09 at t = 1e[+]08 s"):
        simulator.step(1e-9)
    with pytest.raises(ValueError, match="dt must move the time and end by 1e[+]09 s"):
        simulator.step(1e300)


@EVERY_MODEL
def test_states_that_a_model_may_leave_are_taken_back(contact: str) -> None:
    for outside in (1e-9, 0.3, 0.99):
        for speed, hits in ((-2.0, 0), (2.0, 1)):  # leaving is free, approaching bounces at once
            state = np.zeros(12)
            state[[3, 9]] = 5.0 + outside, speed
            simulator = make_simulator(WEIGHTLESS, contact)
            simulator.reset(state)
            np.testing.assert_array_equal(simulator.state, state)
            simulator.step(0.001)
            assert len(simulator.impacts) == hits
            assert simulator.state[9] < 0.0
    too_deep = np.zeros(12)
    too_deep[3] = 6.01
    with pytest.raises(ValueError, match="at most 1 m outside, got 1.01 m"):
        simulator.reset(too_deep)
    small = make_simulator(Scene(box_half_width=0.1, jack_arm=0.02), contact)
    with pytest.raises(ValueError, match="at most 0.1 m outside"):
        small.reset(np.array([0, 0, 0, 0.25, 0, 0, 0, 0, 0, 0, 0, 0]))


@EVERY_MODEL
@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf, "1", None, True, [1.0], 1j])
def test_unusable_numbers_are_refused_in_one_sentence(bad: Any, contact: str) -> None:
    simulator = make_simulator(Scene(), contact)
    before = simulator.state
    with pytest.raises((TypeError, ValueError), match="dt must be a finite number above 0, got"):
        simulator.step(bad)
    if bad is not None:
        with pytest.raises((TypeError, ValueError), match="torque must be a finite number, got"):
            simulator.step(0.02, torque=bad)
        with pytest.raises((TypeError, ValueError), match="substeps must be a whole number from 1"):
            make_simulator(Scene(), substeps=bad)
        with pytest.raises((TypeError, ValueError), match="time must be a finite number at least -1e[+]09 and at"):
            simulator.reset(np.zeros(12), time=bad)
    if not isinstance(bad, str | bool):  # numpy reads these as numbers
        with pytest.raises((TypeError, ValueError), match="state must"):
            simulator.reset([0.0] * 11 + [bad])
    np.testing.assert_array_equal(simulator.state, before)
    simulator.step(0.02)


@EVERY_MODEL
@pytest.mark.parametrize("dt", [0.0, -0.02])
def test_time_steps_must_be_positive(dt: float, contact: str) -> None:
    with pytest.raises(ValueError, match="must be a finite number above 0"):
        make_simulator(Scene(), contact).step(dt)


def test_unknown_models_and_settings_are_refused() -> None:
    with pytest.raises(ValueError, match="contact must be one of 'pymunk', 'exact', got 'box2d'"):
        make_simulator(Scene(), contact="box2d")
    with pytest.raises(ValueError, match="takes only 'substeps', 'iterations', got 'fidelity'"):
        make_simulator(Scene(), fidelity=3)
    assert make_simulator({"gravity": 0.0}).scene == Scene(gravity=0.0)


@EVERY_MODEL
def test_a_drive_that_fails_or_answers_nonsense_leaves_the_simulator_usable(contact: str) -> None:
    answers: list[Any] = [math.nan]
    simulator = make_simulator(Scene(drive=Drive(torque=lambda t: answers[0])), contact)
    for nonsense in (math.nan, math.inf, "much"):
        answers[0] = nonsense
        with pytest.raises((TypeError, ValueError), match=r"torque\(.* s\) must be a finite number"):
            simulator.step(0.02)
    answers[0] = 5.0
    simulator.step(0.02)
    assert simulator.torque == pytest.approx(5.0, rel=1e-15)
    assert simulator.time == 0.02
