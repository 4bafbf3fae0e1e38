"""The law of one contact against its symbolic derivation, the reference cases and closed forms; geometry; energy."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import sympy as sp

from jackbox_env.mechanics import contacts_of, energy, gap_jacobian, gaps, impact_map, impact_maps
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import clearance
from jackbox_env.simulators import CONTACT_MODELS, make_simulator
from tests.guarantees.poses import (
    PAIRS,
    approaching,
    energy_norm,
    momenta,
    momentum_scale,
    random_scene,
    velocity_error,
)
from tests.guarantees.symbolic import (
    ARM,
    JACK_INERTIA,
    JACK_MASS,
    WORLD_JACK,
    Derivation,
    body_kinetic_energy,
    four_feet_kinetic_energy,
)
from tests.states import Array, inside, load, one_foot_on_wall


def energy_scale(scene: Scene, state: Array) -> float:
    """Twice the kinetic energy plus the size of the potential energy [J], the yardstick for rounding in ``energy``."""
    return energy_norm(scene, state[6:]) ** 2 + abs(scene.jack_mass * scene.gravity * float(state[4]))


# -- the derivation ----------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def derivation() -> Derivation:
    return Derivation()


def test_four_point_feet_are_a_body_of_inertia_m_l_squared() -> None:
    feet = four_feet_kinetic_energy()
    body = body_kinetic_energy(WORLD_JACK, JACK_MASS, JACK_INERTIA)
    (inertia,) = sp.solve(feet - body, JACK_INERTIA)
    assert sp.simplify(inertia - JACK_MASS * ARM**2) == 0
    assert Scene(jack_mass=7.0, jack_arm=0.5).jack_inertia == 1.75


@pytest.mark.parametrize(("wall", "foot"), PAIRS)
def test_closed_forms_equal_the_derivation(derivation: Derivation, wall: int, foot: int) -> None:
    rng = np.random.default_rng([1, wall, foot])
    for case in range(100):
        scene = Scene() if case % 2 else random_scene(rng)
        state = approaching(scene, rng, wall, foot)
        derived = derivation.evaluate(scene, state, wall, foot)
        length = scene.box_half_width + math.dist(state[0:2], state[3:5])  # [m]
        assert gaps(scene, state)[wall, foot] == pytest.approx(derived.gap, abs=1e-14 * length)
        gradient = gap_jacobian(scene, state, wall, foot)
        np.testing.assert_allclose(gradient, derived.gradient, rtol=0.0, atol=1e-14 * (1.0 + length))
        assert energy(scene, state) == pytest.approx(derived.hamiltonian, abs=1e-14 * energy_scale(scene, state))
        after, impulse = impact_map(scene, state, wall, foot)
        assert velocity_error(scene, after[6:], derived.after) < 1e-13
        # The gap rate of a grazing foot is a small difference of large terms; this is their share of the impulse [N s].
        terms = float(
            2.0 * np.abs(gradient) @ np.abs(state[6:]) / (gradient**2 @ (1.0 / np.array(scene.mass_diagonal)))
        )
        assert impulse == pytest.approx(derived.impulse, rel=0.0, abs=1e-14 * terms)
        assert impulse > 0.0


def test_a_scene_one_in_a_thousand_off_would_be_seen(derivation: Derivation) -> None:
    rng = np.random.default_rng(1)
    state = approaching(Scene(), rng, 0, 0)
    derived = derivation.evaluate(Scene(), state, 0, 0)
    for name in ("box_mass", "box_inertia", "jack_mass", "jack_inertia", "jack_arm"):
        other = replace(Scene(), **{name: 1.001 * getattr(Scene(), name)})
        assert velocity_error(Scene(), impact_map(other, state, 0, 0)[0][6:], derived.after) > 1e-7


# -- the reference cases -----------------------------------------------------------------------------------------------


def test_reference_cases_to_ten_digits_on_the_wall_with_energy_and_momentum_conserved() -> None:
    scene, cases = Scene(), load("impact_map_cases")
    assert sorted((case["wall"], case["foot"]) for case in cases) == sorted(4 * PAIRS)
    for case in cases:
        state = np.array(case["q"] + case["qdot"])
        assert abs(gaps(scene, state)[case["wall"], case["foot"]]) < 1e-13
        after, impulse = impact_map(scene, state, case["wall"], case["foot"])
        np.testing.assert_allclose(after[6:], case["qdot_after"], rtol=1e-10, atol=0.0)  # for each velocity
        assert impulse == pytest.approx(case["impulse"], rel=1e-10, abs=0.0)
        assert np.array_equal(after[:6], state[:6])
        assert energy(scene, after) == pytest.approx(energy(scene, state), rel=1e-13)
        # The contact forces on jack and box act along one line: they cancel, and so do their moments about any point.
        change = momenta(scene, after) - momenta(scene, state)
        assert np.abs(change).max() < 1e-14 * momentum_scale(scene, state)


# -- geometry ----------------------------------------------------------------------------------------------------------


def test_clearance_is_the_smallest_gap() -> None:
    rng = np.random.default_rng(4)
    for _ in range(3000):
        scene = random_scene(rng)
        state = inside(scene, rng)
        state[[2, 5]] *= 10.0
        state[3:5] += rng.uniform(-1.0, 1.0, 2) * scene.box_half_width
        smallest = clearance(scene, list(state))
        assert smallest == pytest.approx(gaps(scene, state).min(), rel=0.0, abs=1e-14 * scene.box_half_width)


# -- one contact -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_gap_rate_comes_back_times_minus_e(restitution: float) -> None:
    rng = np.random.default_rng(5)
    for _ in range(300):
        scene = random_scene(rng, restitution)
        wall, foot = PAIRS[rng.integers(16)]
        state = approaching(scene, rng, wall, foot)
        jacobian = gap_jacobian(scene, state, wall, foot)
        after, _ = impact_map(scene, state, wall, foot)
        before_rate, after_rate = jacobian @ state[6:], jacobian @ after[6:]
        terms = np.abs(jacobian) @ (np.abs(state[6:]) + np.abs(after[6:]))  # [m/s] what cancels in the gap rate
        assert after_rate == pytest.approx(-restitution * before_rate, rel=0.0, abs=1e-14 * terms)
        # The lost energy is (1 - e^2) / 2 * rate^2 / (J M^-1 J^T).
        loss = (1.0 - restitution**2) / 2.0 * before_rate**2 / (jacobian**2 @ (1.0 / np.array(scene.mass_diagonal)))
        fall = energy(scene, state) - energy(scene, after)
        assert fall == pytest.approx(loss, rel=0.0, abs=1e-14 * energy_scale(scene, state))


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_a_contact_that_does_not_approach_changes_nothing(restitution: float) -> None:
    rng = np.random.default_rng(7)
    scene = Scene(restitution=restitution)
    for wall, foot in PAIRS:
        state = approaching(scene, rng, wall, foot)
        for factor in (-1.0, 0.0):  # leaving, and at rest
            state[6:] *= factor
            original = state.copy()
            after, impulse = impact_map(scene, state, wall, foot)
            assert np.array_equal(state, original)
            assert np.array_equal(after, original)
            assert not np.shares_memory(after, state)
            assert impulse == 0.0


@pytest.mark.parametrize("contact", CONTACT_MODELS)
@pytest.mark.parametrize("restitution", [0.3, 1.0])
def test_both_contact_models_apply_the_map(contact: str, restitution: float, cases: Callable[[int], int]) -> None:
    rng = np.random.default_rng(0)
    scene = Scene(gravity=0.0, drive=None, restitution=restitution, jack_inertia=2.0, box_mass=70.0)
    for _ in range(cases(1000)):
        state, wall, foot = one_foot_on_wall(scene, rng)
        expected, impulse = impact_map(scene, state, wall, foot)
        simulator = make_simulator(scene, contact, substeps=1 if contact == "pymunk" else None)
        simulator.reset(state)
        simulator.step(1e-12, torque=0.0)  # [s] in which nothing but the impact happens
        assert [(hit.wall, hit.foot) for hit in simulator.impacts] == [(wall, foot)]
        assert velocity_error(scene, simulator.state[6:], expected[6:]) < 1e-9
        assert simulator.impacts[0].impulse == pytest.approx(impulse, abs=1e-9 * 4.0 * np.abs(state[6:]).max())


def test_many_states_at_once_are_each_alone(cases: Callable[[int], int]) -> None:
    rng, count = np.random.default_rng(5), cases(400)
    scene = Scene(restitution=0.9, jack_mass=7.0)
    states = np.array([inside(scene, rng) for _ in range(count)])
    walls, feet = rng.integers(0, 4, count), rng.integers(0, 4, count)
    distances, jacobians = contacts_of(scene, states, walls, feet)
    after, impulses = impact_maps(scene, states, walls, feet)
    for row, (state, wall, foot) in enumerate(zip(states, walls.tolist(), feet.tolist(), strict=True)):
        expected, impulse = impact_map(scene, state, wall, foot)
        assert np.array_equal(after[row], expected)
        assert impulses[row] == impulse
        assert np.array_equal(jacobians[row], gap_jacobian(scene, state, wall, foot))
        assert distances[row] == pytest.approx(gaps(scene, state)[wall, foot], abs=1e-14)
    assert (impulses > 0.0).any()
    assert (impulses == 0.0).any()
