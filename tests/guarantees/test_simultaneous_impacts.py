"""The law of several contacts at once: its conditions, exhaustive search, ties, and the bits of its results."""

from __future__ import annotations

import itertools
import math
import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest

from jackbox_env.exact import contact
from jackbox_env.exact.workspace import new_log, new_workspaces
from jackbox_env.mechanics import energy, gap_jacobian, gaps, impact_map, simultaneous_impact_map
from jackbox_env.model.scene import Scene
from jackbox_env.simulators import CONTACT_MODELS, make_simulator
from tests.fingerprints import digest
from tests.guarantees.poses import PAIRS, energy_norm, momenta, momentum_scale, random_scene, velocity_error
from tests.states import Array, at, inside, one_foot_on_wall, several_contacts, started

Contacts = list[tuple[int, int]]
Cases = Callable[[int], int]


# -- several contacts --------------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", SCENES)
def test_simultaneous_law_holds_and_equals_exhaustive_search(name: str, kind: str, cases: Cases) -> None:
    scene, rng = SCENES[name], np.random.default_rng(8)
    if kind == "four corners":
        scene = scene.changed(jack_arm=JAMMED)
    for number in range(cases(100)):
        state, contacts = touching(scene, rng, kind)
        after, before = assert_law_holds(scene, state, contacts), energy_norm(scene, state[6:])
        if scene.restitution == 1.0:
            assert energy_norm(scene, after[6:]) == pytest.approx(before, rel=1e-12)
        change = momenta(scene, after) - momenta(scene, state)
        assert np.abs(change).max() < 1e-13 * (momentum_scale(scene, state) + momentum_scale(scene, after))
        if number < cases(3 if kind == "four corners" else 30):  # eight contacts have 256 sets
            assert energy_norm(scene, after[6:] - enumerated(scene, state, contacts)) < 1e-11 * before


@pytest.mark.parametrize("restitution", [0.0, 0.5, 1.0])
def test_one_listed_contact_is_the_impact_map(restitution: float, cases: Cases) -> None:
    rng = np.random.default_rng(10)
    for case in range(cases(200)):
        scene = random_scene(rng, restitution)
        wall, foot = PAIRS[case % 16]
        state = inside(scene, rng)  # about half of them separate
        expected, impulse = impact_map(scene, state, wall, foot)
        original = state.copy()
        after, impulses = simultaneous_impact_map(scene, state, [(wall, foot)])
        assert np.array_equal(state, original)
        assert np.array_equal(after, state) or impulse > 0.0
        assert energy_norm(scene, after[6:] - expected[6:]) <= 1e-14 * energy_norm(scene, state[6:])
        assert impulses == pytest.approx([impulse], rel=1e-12, abs=0.0)


@pytest.mark.parametrize(
    ("kind", "pose", "difference"),
    [
        ("one wall", several_contacts, 0.2),  # every contact approaches
        ("two walls", several_contacts, 0.2),
        ("one wall", touching, 1.0),  # some of them separate
        ("two walls", touching, 1.0),
        ("corner", touching, 1.0),
    ],
)
def test_reflection_is_not_the_law_where_an_impulse_pulls(
    kind: str, pose: Any, difference: float, cases: Cases
) -> None:
    # Negative control: reflection keeps energy and momentum as well, and yet needs walls that pull.
    rng = np.random.default_rng(12)
    largest = 0.0
    for _ in range(cases(400)):
        state, contacts = pose(Scene(), rng, kind)
        other, impulses = reflection(Scene(), state, contacts)
        if impulses.min() < 0.0:
            after = assert_law_holds(Scene(), state, contacts)
            largest = max(largest, float(np.abs(other - after[6:]).max() / np.abs(after[6:]).max()))
    assert largest > difference


@pytest.mark.parametrize("contact", CONTACT_MODELS)
@pytest.mark.parametrize(
    ("kind", "fields"),
    [
        *[(kind, {"jack_inertia": inertia}) for kind in ("one wall", "two walls", "corner") for inertia in (4.0, 0.4)],
        *[("one foot", {"jack_inertia": 2.0, "box_mass": 70.0, "restitution": e}) for e in (0.3, 1.0)],
    ],
)
def test_both_contact_models_apply_the_law(contact: str, kind: str, fields: Any, cases: Cases) -> None:
    rng, several, scene = np.random.default_rng(2), 0, Scene(gravity=0.0, drive=None, **fields)
    for _ in range(cases(60)):
        if kind == "one foot":
            state, *pair = one_foot_on_wall(scene, rng)
            contacts = [(pair[0], pair[1])]
        else:
            state, contacts = several_contacts(scene, rng, kind)
        expected, impulses = simultaneous_impact_map(scene, state, contacts)
        simulator = started(make_simulator(scene, contact, substeps=1 if contact == "pymunk" else None), state)
        simulator.step(1e-13, torque=0.0)
        assert velocity_error(scene, simulator.state[6:], expected[6:]) < 1e-8
        struck = {(hit.wall, hit.foot): hit.impulse for hit in simulator.impacts}
        assert sum(struck.values()) == pytest.approx(impulses.sum(), rel=1e-8)
        several += len(struck) > 1
    assert several > cases(5) or kind == "one foot"


CORNER = 6.0 - math.sqrt(0.5)  # of the jack's centre along each wall from the box's, with a foot in a corner [m]


@pytest.mark.timeout(30)  # [s] takes 2
def test_ties_among_any_contacts_end_and_obey_the_law(cases: Cases) -> None:
    # The law is local: it accepts contacts that no pose closes together. Any number of them has rank 3.
    rng = np.random.default_rng(18)
    for case in range(cases(400)):
        scene = SCENES[("nominal", "plastic", "light jack inertia")[case % 3]]
        turn = rng.choice([0.0, math.pi / 2.0, math.pi / 4.0, rng.uniform(-3.0, 3.0)])
        walls = np.array([[math.cos(turn), -math.sin(turn)], [math.sin(turn), math.cos(turn)]])  # their directions
        state = np.array([0.0, 0.0, turn, *walls @ (2 * [CORNER]), turn + math.pi / 4.0, *np.zeros(6)])
        # Whole numbers along the walls, half of them 0: contacts tie exactly, or nearly, for the next one to push.
        state[6:] = rng.integers(-2, 3, 6) * rng.integers(0, 2, 6) * rng.choice([1.0, 1e-12])
        state[6:8], state[9:11] = walls @ state[6:8], walls @ state[9:11]
        listed = [PAIRS[index] for index in rng.permutation(16)[: rng.integers(2, 17)]]
        assert_law_holds(scene, state, listed, tolerance=1e-10)


@pytest.mark.timeout(20)  # [s] takes milliseconds
@pytest.mark.parametrize(
    ("scene", "state", "contacts", "tolerance"),
    [
        # Seven contacts of rank 3 and a light jack inertia: several active sets share one answer but for rounding.
        (
            SCENES["light jack inertia"],
            [0.0, 0.0, 0.0, CORNER, CORNER, math.pi / 4.0, 0.0, 0.0, 0.0, 3.0, 3.0, 0.0],
            [(1, 3), (1, 0), (0, 1), (1, 1), (0, 3), (2, 1), (2, 2)],
            1e-11,
        ),
        # A corner in a box that turns at a touch: an impulse on its way to zero must not linger at 1e-190 N s.
        (
            Scene(
                box_mass=18.303078824267537, box_inertia=2.711669915246579e-06, jack_mass=24.626456465241397,
                jack_inertia=658.6667798149983,
            ),
            [
                -0.1365446747530128, 0.33103115395102867, 0.0, 5.156348544060439, 5.623924372764481, math.pi / 4.0,
                -1.615498938712097, -4.5252577261458684e-07, -4.025504736885117e-05, 4.7614780340076396e-07,
                -2.2546028827885607e-08, -1.5617301162274515e-07,
            ],
            [(1, 0), (1, 1), (0, 0), (0, 3)],
            1e-9,
        ),
    ],
    ids=["contacts that depend on one another", "an impulse that fades"],
)  # fmt: skip
def test_the_search_for_the_contacts_that_push_ends(
    scene: Scene, state: list[float], contacts: Contacts, tolerance: float
) -> None:
    assert_law_holds(scene, np.array(state), contacts, tolerance)


# -- more contacts than the three that can push ------------------------------------------------------------------------


FOUR = [(0, 0), (1, 1), (2, 2), (3, 3)]  # contacts of a wedged jack: of rank 3


def wedged(count: int) -> Iterator[tuple[Scene, Array]]:
    """States of a jack a little longer than the box's half width, with feet 0 to 3 at walls 0 to 3."""
    rng = np.random.default_rng(5)
    for case in range(count):
        arm = 6.0 * (1.0 + 10.0 ** rng.uniform(-4.0, -1.3))
        state = at(theta_jack=math.acos(6.0 / arm))
        if case % 3 == 0:
            state[6:] = rng.standard_normal(6)
        elif case % 3 == 1:
            state[6:] = rng.integers(-2, 3, 6)  # ties
        else:
            state[9:] = rng.uniform(0.0, 0.2), rng.uniform(0.5, 1.5), -rng.uniform(0.5, 1.5)
        if case % 2:
            state[[2, 5]] += rng.uniform(-3.0, 3.0)
        yield Scene(gravity=0.0, drive=None, jack_arm=arm), state


def bits_of_the_law() -> str:
    """Digest of its results for such states."""
    parts: list[Any] = []
    for scene, state in wedged(60):
        parts += [*simultaneous_impact_map(scene, state, FOUR), *impact_map(scene, state, 0, 0), gaps(scene, state)]
        parts += [gap_jacobian(scene, state, wall, foot) for wall, foot in FOUR]
    return digest(parts)


def test_the_law_has_the_same_bits_with_every_kernel_of_the_linear_algebra() -> None:
    command = [sys.executable, "-c", f"from {__name__} import bits_of_the_law; print(bits_of_the_law())"]
    surroundings = {**os.environ, "OPENBLAS_CORETYPE": "Prescott", "PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(command, env=surroundings, capture_output=True, text=True, check=True)
    assert run.stdout.strip() == bits_of_the_law()


def test_a_wedged_jack_gets_the_velocities_of_the_exact_model_and_keeps_its_energy(cases: Cases) -> None:
    several, work = 0, new_workspaces()[0]
    for scene, state in wedged(cases(200)):
        after, impulses = simultaneous_impact_map(scene, state, FOUR)
        work.state[:12] = state
        contact.resolve(scene.numbers, work, new_log(), 1e-9, 0, 0)
        expected = work.state[6:12]
        np.testing.assert_allclose(after[6:], expected, rtol=0.0, atol=1e-12 * max(1.0, np.abs(expected).max()))
        assert energy(scene, after) == pytest.approx(energy(scene, state), rel=1e-13)
        assert np.count_nonzero(impulses) <= 3
        several += int(np.count_nonzero(impulses) > 1)
    assert several > cases(100)
