"""The law of the jack in a box against a symbolic derivation, reference data, geometry and exhaustive search.

Errors of velocities are measured in the norm of the kinetic energy, |M^1/2 v|, where one number covers m/s and rad/s
and heavy and light bodies alike.
"""

from __future__ import annotations

import itertools
import math
import re
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import sympy as sp

from jackbox_env.mechanics import energy, gap_jacobian, gaps, impact_map, simultaneous_impact_map
from jackbox_env.scene import Scene
from jackbox_env.states import STATE_NAMES, as_state, clearance, start_tolerance
from tests.states import Array, inside, load, several_contacts
from tests.symbolic import (
    ARM,
    BOX_INERTIA,
    BOX_MASS,
    JACK_INERTIA,
    JACK_MASS,
    WORLD_JACK,
    Derivation,
    body_kinetic_energy,
    four_feet_kinetic_energy,
)

PAIRS = list(itertools.product(range(4), range(4)))  # (wall, foot)
Contacts = list[tuple[int, int]]


def random_scene(rng: np.random.Generator, restitution: float = 1.0) -> Scene:
    """Any sizes, masses and inertias over two to five powers of ten, none of them tied to another."""
    half = rng.uniform(0.5, 20.0)
    return Scene(
        box_half_width=half,
        box_mass=10.0 ** rng.uniform(-1.0, 3.0),
        box_inertia=10.0 ** rng.uniform(-1.0, 4.0),
        jack_arm=half * rng.uniform(0.05, 0.95),
        jack_mass=10.0 ** rng.uniform(-1.0, 2.0),
        jack_inertia=10.0 ** rng.uniform(-1.0, 2.0),
        gravity=rng.uniform(0.0, 20.0),
        restitution=restitution,
    )


def approaching(scene: Scene, rng: np.random.Generator, wall: int, foot: int) -> Array:
    """A random state whose velocities, mirrored if need be, bring the foot closer to the wall."""
    state = inside(scene, rng)
    if gap_jacobian(scene, state, wall, foot) @ state[6:] > 0.0:
        state[6:] *= -1.0
    return state


def energy_norm(scene: Scene, velocities: Array) -> float:
    """Root of twice the kinetic energy [J^1/2]."""
    return float(np.linalg.norm(np.sqrt(scene.mass_diagonal) * velocities))


def velocity_error(scene: Scene, found: Array, expected: Array) -> float:
    """Relative error of six velocities in the norm of the kinetic energy."""
    return energy_norm(scene, found - expected) / energy_norm(scene, expected)


def energy_scale(scene: Scene, state: Array) -> float:
    """Twice the kinetic energy plus the size of the potential energy [J], the yardstick for rounding in ``energy``."""
    return energy_norm(scene, state[6:]) ** 2 + abs(scene.jack_mass * scene.gravity * float(state[4]))


def momenta(scene: Scene, state: Array) -> Array:
    """Total p_x, p_y [N s] and angular momentum about the world's origin [N m s]."""
    box, jack = state[0:2], state[3:5]
    p_box, p_jack = scene.box_mass * state[6:8], scene.jack_mass * state[9:11]
    orbital = box[0] * p_box[1] - box[1] * p_box[0] + jack[0] * p_jack[1] - jack[1] * p_jack[0]
    spin = scene.box_inertia * state[8] + scene.jack_inertia * state[11]
    return np.array([*(p_box + p_jack), orbital + spin])


def momentum_scale(scene: Scene, state: Array) -> float:
    """Sum of the sizes of all terms in ``momenta``, the yardstick for what cancels in them."""
    box, jack = math.hypot(*state[0:2]), math.hypot(*state[3:5])
    orbital = (1.0 + box) * scene.box_mass * math.hypot(*state[6:8])
    orbital += (1.0 + jack) * scene.jack_mass * math.hypot(*state[9:11])
    return float(orbital + scene.box_inertia * abs(state[8]) + scene.jack_inertia * abs(state[11]))


# -- the derivation ---------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def derivation() -> Derivation:
    return Derivation()


def test_four_point_feet_are_a_body_of_inertia_m_l_squared() -> None:
    feet = four_feet_kinetic_energy()
    body = body_kinetic_energy(WORLD_JACK, JACK_MASS, JACK_INERTIA)
    (inertia,) = sp.solve(feet - body, JACK_INERTIA)
    assert sp.simplify(inertia - JACK_MASS * ARM**2) == 0
    assert Scene(jack_mass=7.0, jack_arm=0.5).jack_inertia == 1.75


def test_momenta_are_the_mass_matrix_times_the_velocities(derivation: Derivation) -> None:
    # The package keeps M as a diagonal; the frames must not say otherwise.
    scene = Scene(box_inertia=3.0, jack_inertia=5.0)
    symbols = (BOX_MASS, BOX_INERTIA, JACK_MASS, JACK_INERTIA)
    numbers = (scene.box_mass, scene.box_inertia, scene.jack_mass, scene.jack_inertia)
    matrix = derivation.mass_matrix.subs(dict(zip(symbols, numbers, strict=True)))
    assert np.array_equal(np.array(matrix, dtype=float), np.diag(scene.mass_diagonal))


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


# -- the reference cases ----------------------------------------------------------------------------------------------


def test_reference_cases_to_ten_digits() -> None:
    scene = Scene()
    cases = load("impact_map_cases")
    assert sorted((case["wall"], case["foot"]) for case in cases) == sorted(4 * PAIRS)
    for case in cases:
        state = np.array(case["q"] + case["qdot"])
        after, impulse = impact_map(scene, state, case["wall"], case["foot"])
        np.testing.assert_allclose(after[6:], case["qdot_after"], rtol=1e-10, atol=0.0)  # each velocity on its own
        assert impulse == pytest.approx(case["impulse"], rel=1e-10, abs=0.0)
        assert np.array_equal(after[:6], state[:6])


def test_reference_cases_are_on_the_wall_and_keep_energy_and_momentum() -> None:
    scene = Scene()
    for case in load("impact_map_cases"):
        state = np.array(case["q"] + case["qdot"])
        assert abs(gaps(scene, state)[case["wall"], case["foot"]]) < 1e-13
        after, _ = impact_map(scene, state, case["wall"], case["foot"])
        assert energy(scene, after) == pytest.approx(energy(scene, state), rel=1e-13)
        # The contact forces on jack and box act along one line: they cancel, and so do their moments about any point.
        change = momenta(scene, after) - momenta(scene, state)
        assert np.abs(change).max() < 1e-14 * momentum_scale(scene, state)


# -- geometry ---------------------------------------------------------------------------------------------------------


def gaps_by_corners(scene: Scene, state: Array) -> Array:
    """Distance of each foot from the line through two corners of the box, positive on the inner side [m]."""
    half = scene.box_half_width
    c, s = math.cos(state[2]), math.sin(state[2])
    corners = [(half, -half), (half, half), (-half, half), (-half, -half)]  # wall k runs from corner k to k + 1
    world = [(state[0] + c * x - s * y, state[1] + s * x + c * y) for x, y in corners]
    found = np.empty((4, 4))
    for wall, foot in PAIRS:
        (ax, ay), (bx, by) = world[wall], world[(wall + 1) % 4]
        angle = state[5] + foot * math.pi / 2.0
        x, y = state[3] + scene.jack_arm * math.cos(angle), state[4] + scene.jack_arm * math.sin(angle)
        # Corners run counter-clockwise: the inside is to the left, where this cross product is positive.
        found[wall, foot] = ((bx - ax) * (y - ay) - (by - ay) * (x - ax)) / math.hypot(bx - ax, by - ay)
    return found


def test_gaps_at_the_origin() -> None:
    # L = 6, l = 1, nothing turned: foot 0 is at (1, 0), so 5 from wall 0 (x = 6), 6 from walls 1 and 3, 7 from wall 2.
    expected = [[5.0, 6.0, 7.0, 6.0], [6.0, 5.0, 6.0, 7.0], [7.0, 6.0, 5.0, 6.0], [6.0, 7.0, 6.0, 5.0]]
    np.testing.assert_allclose(gaps(Scene(), np.zeros(12)), expected, rtol=1e-15)


def test_gaps_equal_distances_from_the_sides_of_the_box() -> None:
    rng = np.random.default_rng(2)
    for _ in range(300):
        scene = random_scene(rng)
        state = inside(scene, rng)
        state[[2, 5]] *= 10.0  # several turns
        state[3:5] += rng.uniform(-1.0, 1.0, 2) * scene.box_half_width  # some of them outside, where gaps are negative
        found = gaps(scene, state)
        assert found.shape == (4, 4)
        np.testing.assert_allclose(found, gaps_by_corners(scene, state), rtol=0.0, atol=1e-13 * scene.box_half_width)


@pytest.mark.parametrize(("wall", "foot"), PAIRS)
def test_gap_jacobian_equals_central_differences(wall: int, foot: int) -> None:
    rng = np.random.default_rng([3, wall, foot])
    step = 1e-5  # [m, rad] truncation step^2 / 6 * third derivative and rounding 1e-15 / step are both about 1e-10
    for _ in range(20):
        state = inside(Scene(), rng)
        slopes = []
        for place in range(6):
            ahead, behind = state.copy(), state.copy()
            ahead[place] += step
            behind[place] -= step
            rise = gaps(Scene(), ahead)[wall, foot] - gaps(Scene(), behind)[wall, foot]
            slopes.append(rise / (ahead[place] - behind[place]))
        np.testing.assert_allclose(gap_jacobian(Scene(), state, wall, foot), slopes, rtol=0.0, atol=2e-9)


def test_gaps_know_only_relative_motion() -> None:
    # Box and jack moved as one body change no gap: all 16 gradients have rank 3, and a corner's four contacts tie.
    rng = np.random.default_rng(21)
    for _ in range(50):
        scene = random_scene(rng)
        state = inside(scene, rng)
        x_box, y_box, x_jack, y_jack = state[[0, 1, 3, 4]]
        along_x, along_y = [1.0, 0.0, 0.0, 1.0, 0.0, 0.0], [0.0, 1.0, 0.0, 0.0, 1.0, 0.0]
        about_origin = [-y_box, x_box, 1.0, -y_jack, x_jack, 1.0]
        gradients = np.array([gap_jacobian(scene, state, wall, foot) for wall, foot in PAIRS])
        together = gradients @ np.array([along_x, along_y, about_origin]).T
        assert np.abs(together).max() < 1e-14 * (scene.box_half_width + np.abs(state[:6]).max())
        assert np.linalg.matrix_rank(gradients, tol=1e-12) == 3


def test_clearance_is_the_smallest_gap() -> None:
    rng = np.random.default_rng(4)
    for _ in range(3000):
        scene = random_scene(rng)
        state = inside(scene, rng)
        state[[2, 5]] *= 10.0
        state[3:5] += rng.uniform(-1.0, 1.0, 2) * scene.box_half_width
        found = clearance(scene, list(state))
        assert found == pytest.approx(gaps(scene, state).min(), rel=0.0, abs=1e-14 * scene.box_half_width)


@pytest.mark.parametrize("place", range(6))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
def test_clearance_of_a_lost_state_is_never_inside(place: int, value: float) -> None:
    state = [0.0] * 12
    state[place] = value
    found = clearance(Scene(), state)
    assert math.isnan(found) or found == -math.inf


@pytest.mark.parametrize("place", [0, 1, 3, 4])
@pytest.mark.parametrize("sign", [-1.0, 1.0])
def test_start_tolerance_grows_with_far_off_places(place: int, sign: float) -> None:
    state = [0.0] * 12
    state[2] = state[5] = state[7] = 1e12  # angles and speeds do not count
    assert start_tolerance(state) == 1e-9
    state[place] = sign * 1e5  # 4 ulp(1e5) = 5.8e-11 m
    assert start_tolerance(state) == 1e-9
    state[place] = sign * 1e9
    assert start_tolerance(state) == 4.0 * 2.0**-23  # 2^29 <= 1e9 < 2^30, so a unit in the last place is 2^(29 - 52)


# -- one contact ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("speed", [1e-12, 1.0, 1e6])
def test_head_on_impact_by_hand(speed: float) -> None:
    # The jack moves along x at the middle of wall 0: two balls of 4 kg and 400 kg, the second at rest. However slow, it
    # is an impact. After it the jack has (4 - 400) / 404 and the box 2 * 4 / 404 of the speed; impulse 400 kg of that.
    state = np.zeros(12)
    state[3], state[9] = 5.0, speed
    after, impulse = impact_map(Scene(), state, 0, 0)
    expected = [8.0 / 404.0 * speed, 0.0, 0.0, -396.0 / 404.0 * speed, 0.0, 0.0]
    np.testing.assert_allclose(after[6:], expected, rtol=1e-15, atol=1e-15 * speed)
    assert impulse == pytest.approx(400.0 * 8.0 / 404.0 * speed, rel=1e-15, abs=0.0)


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
        lost = (1.0 - restitution**2) / 2.0 * before_rate**2 / (jacobian**2 @ (1.0 / np.array(scene.mass_diagonal)))
        fall = energy(scene, state) - energy(scene, after)
        assert fall == pytest.approx(lost, rel=0.0, abs=1e-14 * energy_scale(scene, state))


def test_one_contact_returns_a_fresh_state_and_leaves_the_input_alone() -> None:
    rng = np.random.default_rng(6)
    for mirrored in (1.0, -1.0):  # approaching, then separating
        state = approaching(Scene(), rng, 1, 2)
        state[6:] *= mirrored
        kept = state.copy()
        after, _ = impact_map(Scene(), state, 1, 2)
        assert not np.shares_memory(after, state)
        assert np.array_equal(state, kept)
        assert after.dtype == np.float64


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_separating_contact_is_left_alone(restitution: float) -> None:
    rng = np.random.default_rng(7)
    scene = Scene(restitution=restitution)
    for wall, foot in PAIRS:
        state = approaching(scene, rng, wall, foot)
        state[6:] *= -1.0
        after, impulse = impact_map(scene, state, wall, foot)
        assert np.array_equal(after, state)
        assert impulse == 0.0
    at_rest = np.array([*inside(scene, rng)[:6], *np.zeros(6)])  # a gap rate of exactly zero does not approach
    assert np.array_equal(impact_map(scene, at_rest, 0, 0)[0], at_rest)


# -- several contacts -------------------------------------------------------------------------------------------------

SCENES = {
    "nominal": Scene(),
    "lossy": Scene(restitution=0.5),
    "plastic": Scene(restitution=0.0),
    "light jack inertia": Scene(jack_inertia=4e-3),  # 1e-3 of four point feet
    "light box": Scene(box_mass=4e-6),  # 1e-6 of the jack
    "heavy box": Scene(box_mass=4e6),  # 1e6 times the jack
}
# The jack's feet sit in all four corners, 6e-12 m from both walls of each: eight contacts.
JAMMED = math.sqrt(2.0) * 6.0 * (1.0 - 1e-12)
KINDS = {"one wall": 2, "two walls": 2, "corner": 4, "four corners": 8}  # how many contacts


def touching(scene: Scene, rng: np.random.Generator, kind: str) -> tuple[Array, Contacts]:
    """A random pose with several feet on walls, at random velocities: some contacts approach, others separate."""
    if kind == "four corners":
        state = inside(scene, rng)
        state[3:5] = state[0:2]
        state[5] = state[2] + math.pi / 4.0
    else:
        state, _ = several_contacts(scene, rng, kind)
    state[6:] = 5.0 * rng.standard_normal(6)
    contacts = [pair for pair in PAIRS if abs(gaps(scene, state)[pair]) < 1e-9]
    assert len(contacts) == KINDS[kind]
    return state, contacts


def unit_rows(scene: Scene, state: Array, contacts: Contacts) -> tuple[Array, Array]:
    """Rows of J M^-1/2 at unit length, and their lengths: in u = M^1/2 qdot all contacts are then alike."""
    jacobian = np.array([gap_jacobian(scene, state, wall, foot) for wall, foot in contacts])
    rows = jacobian / np.sqrt(scene.mass_diagonal)
    lengths = np.linalg.norm(rows, axis=1)
    return rows / lengths[:, None], lengths


def enumerated(scene: Scene, state: Array, contacts: Contacts) -> Array:
    """Velocities after, by trying every set of contacts that may be the one with impulses.

    Those in the set end at J qdot+ = -e J qdot-, which fixes u+. The set is right when no impulse pulls and no contact
    outside it ends below -e times its rate.
    """
    rows, _ = unit_rows(scene, state, contacts)
    u = np.sqrt(scene.mass_diagonal) * state[6:]
    bound = -scene.restitution * (rows @ u)
    worst, best = math.inf, u
    for size in range(len(contacts) + 1):
        for chosen in itertools.combinations(range(len(contacts)), size):
            normals = rows[list(chosen)]
            impulses = np.linalg.pinv(normals @ normals.T, rcond=1e-12) @ (-(1.0 + scene.restitution) * (normals @ u))
            after = u + impulses @ normals
            wrong = max(0.0, -min(impulses, default=0.0), float((bound - rows @ after).max()))
            if wrong < worst:
                worst, best = wrong, after
    assert worst < 1e-9 * np.linalg.norm(u), "no set of contacts fulfils the law"
    return best / np.sqrt(scene.mass_diagonal)


def reflection(scene: Scene, state: Array, contacts: Contacts) -> tuple[Array, Array]:
    """qdot- - 2 M^-1 J^T pinv(J M^-1 J^T) J qdot-, and its impulses: the law only if none of them pulls."""
    jacobian = np.array([gap_jacobian(scene, state, wall, foot) for wall, foot in contacts])
    spread = jacobian.T / np.array(scene.mass_diagonal)[:, None]
    impulses = -2.0 * np.linalg.pinv(jacobian @ spread, rcond=1e-12) @ (jacobian @ state[6:])
    return state[6:] + spread @ impulses, impulses


def assert_law_holds(scene: Scene, state: Array, contacts: Contacts, tolerance: float = 1e-11) -> Array:
    """Check 0 <= lambda _|_ J qdot+ + e J qdot- >= 0 and M (qdot+ - qdot-) = J^T lambda; return the state after."""
    after, impulses = simultaneous_impact_map(scene, state, contacts)
    rows, lengths = unit_rows(scene, state, contacts)
    root = np.sqrt(scene.mass_diagonal)
    u_before, u_after, pushes = root * state[6:], root * after[6:], impulses * lengths
    scale = float(np.linalg.norm(u_before))
    rates = rows @ (u_after + scene.restitution * u_before)
    assert impulses.min() >= 0.0
    assert rates.min() >= -tolerance * scale
    assert np.abs(pushes * rates).max() <= tolerance * scale * (scale + pushes.max())
    np.testing.assert_allclose(u_after - u_before, pushes @ rows, rtol=0.0, atol=tolerance * (scale + pushes.max()))
    assert np.array_equal(after[:6], state[:6])
    return after


def scene_of(name: str, kind: str) -> Scene:
    return replace(SCENES[name], jack_arm=JAMMED) if kind == "four corners" else SCENES[name]


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SCENES)
def test_simultaneous_law_holds(name: str, kind: str) -> None:
    scene = scene_of(name, kind)
    rng = np.random.default_rng(8)
    for _ in range(100):
        state, contacts = touching(scene, rng, kind)
        after = assert_law_holds(scene, state, contacts)
        if scene.restitution == 1.0:
            assert energy_norm(scene, after[6:]) == pytest.approx(energy_norm(scene, state[6:]), rel=1e-12)
        change = momenta(scene, after) - momenta(scene, state)
        assert np.abs(change).max() < 1e-13 * (momentum_scale(scene, state) + momentum_scale(scene, after))


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SCENES)
def test_simultaneous_law_equals_exhaustive_search(name: str, kind: str) -> None:
    scene = scene_of(name, kind)
    rng = np.random.default_rng(9)
    for _ in range(3 if kind == "four corners" else 30):  # eight contacts have 256 sets
        state, contacts = touching(scene, rng, kind)
        after, _ = simultaneous_impact_map(scene, state, contacts)
        error = energy_norm(scene, after[6:] - enumerated(scene, state, contacts)) / energy_norm(scene, state[6:])
        assert error < 1e-11


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SCENES)
def test_impulses_of_very_different_size_come_back(name: str, kind: str) -> None:
    # Backwards: qdot- = -M^-1 J^T lambda / (1 + e) makes any lambda >= 0 a solution, with J qdot+ = -e J qdot-.
    # Box and jack moving on as one body add nothing to the gap rates.
    scene = scene_of(name, kind)
    rng = np.random.default_rng(22)
    for _ in range(100):
        state, contacts = touching(scene, rng, kind)
        rows, lengths = unit_rows(scene, state, contacts)
        shares = 10.0 ** rng.uniform(-13.0, 0.0, len(contacts)) * rng.integers(0, 2, len(contacts))
        shares[rng.integers(len(contacts))] = 1.0
        drift = np.array([1.0, -2.0, 0.0, 1.0, -2.0, 0.0]) * rng.uniform(0.0, 1.0)
        change = shares @ rows / np.sqrt(scene.mass_diagonal)
        state[6:] = drift - change / (1.0 + scene.restitution)
        after, impulses = simultaneous_impact_map(scene, state, contacts)
        error = energy_norm(scene, after[6:] - (state[6:] + change)) / energy_norm(scene, change)
        assert error < 1e-12 * max(1.0, energy_norm(scene, drift))
        if len(contacts) == 2:  # more contacts may share the same total differently
            np.testing.assert_allclose(impulses * lengths, shares, rtol=0.0, atol=1e-11)


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_one_listed_contact_is_the_impact_map(restitution: float) -> None:
    rng = np.random.default_rng(10)
    for case in range(200):
        scene = random_scene(rng, restitution)
        wall, foot = PAIRS[case % 16]
        state = inside(scene, rng)  # about half of them separate
        expected, impulse = impact_map(scene, state, wall, foot)
        after, impulses = simultaneous_impact_map(scene, state, [(wall, foot)])
        assert energy_norm(scene, after[6:] - expected[6:]) <= 1e-14 * energy_norm(scene, state[6:])
        assert impulses == pytest.approx([impulse], rel=1e-12, abs=0.0)


@pytest.mark.parametrize("kind", ["one wall", "two walls", "corner"])
def test_reflection_is_the_law_while_no_impulse_pulls(kind: str) -> None:
    rng = np.random.default_rng(11)
    compared = 0
    for _ in range(300):
        state, contacts = several_contacts(Scene(), rng, kind)  # every contact approaches
        expected, impulses = reflection(Scene(), state, contacts)
        if impulses.min() < 0.0:
            continue
        compared += 1
        after, found = simultaneous_impact_map(Scene(), state, contacts)
        assert velocity_error(Scene(), after[6:], expected) < 1e-12
        if kind != "corner":  # four contacts of rank 3 leave the impulses open
            np.testing.assert_allclose(found, impulses, rtol=1e-11)
    assert compared > 30


@pytest.mark.parametrize(
    ("kind", "pose", "difference"),
    [
        ("one wall", several_contacts, 0.5),  # every contact approaches
        ("two walls", several_contacts, 0.3),
        ("one wall", touching, 1.0),  # some of them separate
        ("two walls", touching, 1.0),
        ("corner", touching, 1.0),
    ],
)
def test_reflection_is_not_the_law_where_an_impulse_pulls(kind: str, pose: Any, difference: float) -> None:
    # Negative control: reflection keeps energy and momentum as well, and yet needs walls that pull.
    rng = np.random.default_rng(12)
    largest = 0.0
    for _ in range(400):
        state, contacts = pose(Scene(), rng, kind)
        other, impulses = reflection(Scene(), state, contacts)
        if impulses.min() < 0.0:
            after = assert_law_holds(Scene(), state, contacts)
            largest = max(largest, float(np.abs(other - after[6:]).max() / np.abs(after[6:]).max()))
    assert largest > difference


@pytest.mark.parametrize("kind", KINDS)
def test_order_of_contacts_does_not_matter(kind: str) -> None:
    rng = np.random.default_rng(13)
    scene = scene_of("nominal", kind)
    for _ in range(50):
        state, contacts = touching(scene, rng, kind)
        after, impulses = simultaneous_impact_map(scene, state, contacts)
        order = rng.permutation(len(contacts))
        other, shuffled = simultaneous_impact_map(scene, state, [contacts[place] for place in order])
        assert velocity_error(scene, other[6:], after[6:]) < 1e-13
        if len(contacts) == 2:  # more contacts may share the same total differently
            np.testing.assert_allclose(shuffled, impulses[order], rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("kind", KINDS)
def test_quarter_turns_only_rename_walls_and_feet(kind: str) -> None:
    rng = np.random.default_rng(14)
    scene = scene_of("nominal", kind)
    for _ in range(50):
        state, contacts = touching(scene, rng, kind)
        after, _ = simultaneous_impact_map(scene, state, contacts)
        box_turns, jack_turns = (int(turns) for turns in rng.integers(1, 4, 2))
        turned = state.copy()
        turned[2] += box_turns * math.pi / 2.0
        turned[5] += jack_turns * math.pi / 2.0
        renamed = [((wall - box_turns) % 4, (foot - jack_turns) % 4) for wall, foot in contacts]
        other, _ = simultaneous_impact_map(scene, turned, renamed)
        assert velocity_error(scene, other[6:], after[6:]) < 1e-12


def test_several_contacts_return_a_fresh_state_and_leave_the_input_alone() -> None:
    rng = np.random.default_rng(15)
    state, contacts = touching(Scene(), rng, "corner")
    kept, listed = state.copy(), list(contacts)
    for given in (contacts, []):
        after, impulses = simultaneous_impact_map(Scene(), state, given)
        assert not np.shares_memory(after, state)
        assert impulses.shape == (len(given),)
    assert np.array_equal(after, state)  # no contacts, no change
    assert np.array_equal(state, kept)
    assert contacts == listed


def test_separating_contacts_are_left_alone() -> None:
    rng = np.random.default_rng(16)
    for kind in ("one wall", "two walls", "corner"):
        for restitution in (0.0, 0.5, 1.0):
            scene = Scene(restitution=restitution)
            state, contacts = several_contacts(scene, rng, kind)
            state[6:] *= -1.0  # every contact separates
            after, impulses = simultaneous_impact_map(scene, state, contacts)
            assert np.array_equal(after, state)
            assert np.array_equal(impulses, np.zeros(len(contacts)))


def corner_pose(scene: Scene, turn: float) -> tuple[Array, Contacts]:
    """The box at the origin, one foot in its corner between walls 0 and 1, and a neighbour on each of these."""
    reach = math.sqrt(2.0) * scene.box_half_width - scene.jack_arm  # [m] along the diagonal
    place = [reach * math.cos(turn + math.pi / 4.0), reach * math.sin(turn + math.pi / 4.0)]
    return np.array([0.0, 0.0, turn, *place, turn + math.pi / 4.0, *np.zeros(6)]), [(0, 0), (1, 0), (1, 1), (0, 3)]


def tidy_rates(motion: str, turn: float, rng: np.random.Generator) -> Array:
    """Velocities that make contacts of a corner tie exactly, or nearly, for the next one to push."""
    c, s = math.cos(turn), math.sin(turn)
    along_wall_0, along_wall_1 = np.array([-s, c]), np.array([c, s])
    still = np.zeros(3)
    if motion == "at rest":
        return np.zeros(6)
    if motion == "along the diagonal":
        return np.array([*still, *(3.0 * (along_wall_0 + along_wall_1)), 0.0])
    if motion == "along a wall":
        return np.array([*still, *(3.0 * along_wall_0), 0.0])
    if motion == "in step":
        return np.array([*along_wall_1, 0.0, *along_wall_1, 0.0])
    if motion == "turning":
        return np.array([0.0, 0.0, rng.integers(-1, 2), 0.0, 0.0, rng.integers(-1, 2)])
    if motion == "whole numbers":
        return rng.integers(-2, 3, 6).astype(float)
    return 1e-12 * rng.standard_normal(6)  # faint


MOTIONS = ["at rest", "along the diagonal", "along a wall", "in step", "turning", "whole numbers", "faint"]


@pytest.mark.timeout(30)  # [s] takes less than 1; an active set that comes round again would take for ever
@pytest.mark.parametrize("motion", MOTIONS)
def test_ties_between_contacts_end_and_obey_the_law(motion: str) -> None:
    rng = np.random.default_rng(17)
    for case in range(500):
        scene = list(SCENES.values())[case % len(SCENES)]
        turn = rng.choice([0.0, math.pi / 2.0, math.pi / 4.0, rng.uniform(-3.0, 3.0)])
        state, contacts = corner_pose(scene, turn)
        state[6:] = tidy_rates(motion, turn, rng)
        listed = [contacts[place] for place in rng.permutation(4)[: rng.integers(2, 5)]]
        assert_law_holds(scene, state, listed)


@pytest.mark.timeout(30)  # [s] takes 2
def test_ties_among_any_contacts_end_and_obey_the_law() -> None:
    # The law is local: it may be asked about contacts that no pose closes together. Any number of them has rank 3.
    rng = np.random.default_rng(18)
    for case in range(3000):
        scene = SCENES[("nominal", "plastic", "light jack inertia")[case % 3]]
        turn = rng.choice([0.0, math.pi / 2.0, math.pi / 4.0, rng.uniform(-3.0, 3.0)])
        state, _ = corner_pose(scene, turn)
        state[6:] = tidy_rates(MOTIONS[rng.integers(len(MOTIONS))], turn, rng)
        listed = [PAIRS[place] for place in rng.permutation(16)[: rng.integers(2, 17)]]
        assert_law_holds(scene, state, listed, tolerance=1e-10)


@pytest.mark.timeout(20)  # [s] takes milliseconds
def test_dependent_contacts_do_not_go_round_in_circles() -> None:
    # Seven contacts of rank 3 and a light jack inertia: several active sets share one answer and differ by rounding.
    scene = SCENES["light jack inertia"]
    state, _ = corner_pose(scene, 0.0)
    state[9:11] = 3.0  # [m/s] along the diagonal, into the corner
    assert_law_holds(scene, state, [(1, 3), (1, 0), (0, 1), (1, 1), (0, 3), (2, 1), (2, 2)])


@pytest.mark.timeout(20)  # [s] takes milliseconds
def test_contact_that_stops_pushing_is_dropped_at_exactly_zero() -> None:
    # A corner in a box that turns at a touch: an impulse on its way to zero must not linger at 1e-190 N s.
    scene = Scene(
        box_mass=18.303078824267537,
        box_inertia=2.711669915246579e-06,
        jack_mass=24.626456465241397,
        jack_inertia=658.6667798149983,
    )
    pose = [-0.1365446747530128, 0.33103115395102867, 0.0, 5.156348544060439, 5.623924372764481, math.pi / 4.0]
    rates = [-1.615498938712097, -4.5252577261458684e-07, -4.025504736885117e-05]
    rates += [4.7614780340076396e-07, -2.2546028827885607e-08, -1.5617301162274515e-07]
    assert_law_holds(scene, np.array(pose + rates), [(1, 0), (1, 1), (0, 0), (0, 3)], tolerance=1e-9)


# -- energy -----------------------------------------------------------------------------------------------------------


def test_energy_by_hand() -> None:
    state = [0.0, 7.0, 0.3, 0.0, 10.0, -0.4, 1.0, 2.0, 0.5, 3.0, 4.0, 2.0]
    # box:    400 kg (1 + 4) / 2 = 1000 J, 14400 kg m^2 0.25 / 2 = 1800 J, its height of 7 m counts for nothing
    # jack:   4 kg (9 + 16) / 2 = 50 J,    4 kg m^2 4 / 2 = 8 J,           4 kg 9.81 m/s^2 10 m = 392.4 J
    assert energy(Scene(), state) == pytest.approx(3250.4, rel=1e-15)
    # box:    2 kg 5 / 2 = 5 J,     3 kg m^2 0.25 / 2 = 0.375 J
    # jack:   5 kg 25 / 2 = 62.5 J, 7 kg m^2 4 / 2 = 14 J,          5 kg 2 m/s^2 10 m = 100 J
    scene = Scene(box_mass=2.0, box_inertia=3.0, jack_mass=5.0, jack_inertia=7.0, gravity=2.0)
    assert energy(scene, state) == pytest.approx(181.875, rel=1e-15)
    assert isinstance(energy(scene, state), float)


@pytest.mark.parametrize("place", range(6))
def test_only_the_height_of_the_jack_has_potential_energy(place: int) -> None:
    rng = np.random.default_rng(19)
    state = inside(Scene(), rng)
    moved = state.copy()
    moved[place] += 2.0  # [m, rad]
    rise = 4.0 * 9.81 * 2.0 if STATE_NAMES[place] == "y_jack" else 0.0  # [J]
    assert energy(Scene(), moved) - energy(Scene(), state) == pytest.approx(rise, abs=1e-9)


# -- refusals ---------------------------------------------------------------------------------------------------------

OF_STATES = {
    "as_state": lambda state: as_state(state),
    "gaps": lambda state: gaps(Scene(), state),
    "gap_jacobian": lambda state: gap_jacobian(Scene(), state, 0, 0),
    "impact_map": lambda state: impact_map(Scene(), state, 0, 0),
    "simultaneous_impact_map": lambda state: simultaneous_impact_map(Scene(), state, [(0, 0)]),
    "energy": lambda state: energy(Scene(), state),
}
OF_PAIRS = {
    "gap_jacobian": lambda wall, foot: gap_jacobian(Scene(), np.zeros(12), wall, foot),
    "impact_map": lambda wall, foot: impact_map(Scene(), np.zeros(12), wall, foot),
    "simultaneous_impact_map": lambda wall, foot: simultaneous_impact_map(Scene(), np.zeros(12), [(wall, foot)]),
}


@pytest.mark.parametrize("place", range(12))
@pytest.mark.parametrize("value", [math.nan, math.inf, -math.inf])
@pytest.mark.parametrize("function", OF_STATES)
def test_states_that_are_not_finite_are_refused_by_name(function: str, value: float, place: int) -> None:
    state = [0.0] * 12
    state[place] = value
    with pytest.raises(ValueError, match=rf"^state must be finite, got {STATE_NAMES[place]} = {value}$"):
        OF_STATES[function](state)


@pytest.mark.parametrize("shape", [(), (6,), (11,), (13,), (1, 12), (12, 1), (0,)])
@pytest.mark.parametrize("function", OF_STATES)
def test_states_of_another_shape_are_refused(function: str, shape: tuple[int, ...]) -> None:
    with pytest.raises(ValueError, match=rf"^state must have shape \(12,\), got shape {re.escape(str(shape))}$"):
        OF_STATES[function](np.zeros(shape))


NOT_NUMBERS: dict[str, Any] = {
    "words": ["up"] * 12,
    "digits in quotes": ["1.0"] * 12,
    "truths": [True] * 12,
    "a word": "state",
    "a mapping": dict.fromkeys(STATE_NAMES, 0.0),
    "ragged": [[0.0], [0.0, 1.0]],
    "complex list": [1j] * 12,
    "complex array": np.zeros(12, dtype=complex),
    "dates": np.array(["2020-01-01"] * 12, dtype="datetime64[D]"),
}


@pytest.mark.parametrize("given", NOT_NUMBERS)
def test_states_without_numbers_are_refused(given: str) -> None:
    with pytest.raises(TypeError, match=r"^state must hold 12 numbers, got "):
        as_state(NOT_NUMBERS[given])


def test_state_of_numbers_beyond_floats_is_refused() -> None:
    with pytest.raises((TypeError, ValueError), match=r"^state must"):
        as_state([10**400] * 12)


@pytest.mark.parametrize("given", [list(range(12)), tuple(range(12)), np.arange(12), np.arange(12, dtype=np.float32)])
def test_states_of_numbers_become_fresh_float64(given: Any) -> None:
    found = as_state(given)
    assert found.dtype == np.float64
    assert np.array_equal(found, np.arange(12.0))
    double = np.arange(12.0)
    assert not np.shares_memory(as_state(double), double)


@pytest.mark.parametrize("value", [4, -1, 2**70, np.int64(4)])
@pytest.mark.parametrize("part", ["wall", "foot"])
@pytest.mark.parametrize("function", OF_PAIRS)
def test_walls_and_feet_out_of_range_are_refused(function: str, part: str, value: Any) -> None:
    given = {"wall": 0, "foot": 0, part: value}
    with pytest.raises(ValueError, match=f"^{part} must be a whole number from 0 to 3, got {re.escape(repr(value))}$"):
        OF_PAIRS[function](**given)


@pytest.mark.parametrize("value", [True, np.True_, 2.0, np.float64(2.0), "2", None, math.nan, [1]])
@pytest.mark.parametrize("part", ["wall", "foot"])
@pytest.mark.parametrize("function", OF_PAIRS)
def test_walls_and_feet_that_are_no_whole_numbers_are_refused(function: str, part: str, value: Any) -> None:
    given = {"wall": 0, "foot": 0, part: value}
    with pytest.raises(TypeError, match=f"^{part} must be a whole number from 0 to 3, got {re.escape(repr(value))}$"):
        OF_PAIRS[function](**given)


@pytest.mark.parametrize("integer", [np.int64, np.uint8, np.array])
def test_numpy_integers_name_walls_and_feet(integer: Any) -> None:
    state = approaching(Scene(), np.random.default_rng(20), 1, 2)
    expected, impulse = impact_map(Scene(), state, 1, 2)
    after, same = impact_map(Scene(), state, integer(1), integer(2))
    assert same == impulse
    assert np.array_equal(after, expected)


@pytest.mark.parametrize("contact", [5, None, (1,), (1, 2, 3), (), 1.5])
def test_contacts_that_are_no_pairs_are_refused(contact: Any) -> None:
    with pytest.raises(TypeError, match=rf"^a contact must be a pair \(wall, foot\), got {re.escape(repr(contact))}$"):
        simultaneous_impact_map(Scene(), np.zeros(12), [(0, 0), contact])


@pytest.mark.parametrize("contacts", [5, None, 1.5])
def test_contacts_that_are_no_list_are_refused(contacts: Any) -> None:
    with pytest.raises(TypeError, match=f"^contacts must .*, got {re.escape(repr(contacts))}$"):
        simultaneous_impact_map(Scene(), np.zeros(12), contacts)


def test_repeated_contacts_are_refused() -> None:
    contacts: list[Any] = [(2, 3), (0, 1), (np.int64(2), np.int64(3))]  # also where the integers differ in type
    with pytest.raises(ValueError, match=r"^contacts must be distinct \(wall, foot\) pairs, got .*\(2, 3\)"):
        simultaneous_impact_map(Scene(), np.zeros(12), contacts)
