"""The law of one contact, energy and geometry against their symbolic derivation."""

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
from tests.batches.several import assert_same
from tests.guarantees.poses import (
    PAIRS,
    approaching,
    energy_norm,
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
from tests.states import Array, inside


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


def test_many_states_at_once_are_each_alone(cases: Callable[[int], int]) -> None:
    rng, count = np.random.default_rng(5), cases(400)
    scene = Scene(restitution=0.9, jack_mass=7.0)
    states = np.array([inside(scene, rng) for _ in range(count)])
    walls, feet = rng.integers(0, 4, (2, count))
    distances, jacobians = contacts_of(scene, states, walls, feet)
    after, impulses = impact_maps(scene, states, walls, feet)
    alone = [(state, *pair) for state, *pair in zip(states, walls.tolist(), feet.tolist(), strict=True)]
    assert_same([*zip(after, impulses, strict=True)], [impact_map(scene, *one) for one in alone])
    assert_same([*jacobians], [gap_jacobian(scene, *one) for one in alone])
    np.testing.assert_allclose(distances, [gaps(scene, state)[wall, foot] for state, wall, foot in alone], atol=1e-14)
    assert (impulses > 0.0).any()
    assert (impulses == 0.0).any()
