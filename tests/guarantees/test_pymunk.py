"""The pymunk model: impacts, their record, their order in the substep, and flight."""

from __future__ import annotations

import math

import numpy as np
import pymunk
import pytest

from jackbox_env.mechanics import energy, simultaneous_impact_map
from jackbox_env.scene import Scene
from jackbox_env.simulators import Impact
from jackbox_env.simulators.pymunk import PymunkSimulator
from jackbox_env.states import clearance
from tests.simulators.engine import WEIGHTLESS, impact_in_an_instant, relative_error
from tests.states import Array, inside, load, several_contacts

# -- impacts -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["one wall", "corner"])
def test_one_iteration_is_not_enough_for_simultaneous_contacts(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(PymunkSimulator, "_resolved", lambda *_: True)  # else steps that gain energy are refused
    rng = np.random.default_rng(2)
    errors, gains = [], []
    for _ in range(50):
        state, contacts = several_contacts(WEIGHTLESS, rng, kind)
        expected, _ = simultaneous_impact_map(WEIGHTLESS, state, contacts)
        hasty = impact_in_an_instant(WEIGHTLESS, state, iterations=1).state
        errors.append(relative_error(hasty, expected))
        gains.append(energy(WEIGHTLESS, hasty) / energy(WEIGHTLESS, state) - 1.0)
    assert max(errors) > 0.1
    assert max(np.abs(gains)) > 0.01


def test_position_correction_would_move_bodies_that_the_law_does_not() -> None:
    # Foot 0 is 0.5 m outside and leaves at 0.1 m/s. The engine's default correction pushes it out of the wall.
    deep = np.zeros(12)
    deep[[3, 9]] = 5.5, -0.1
    lawful, corrected = PymunkSimulator(WEIGHTLESS), PymunkSimulator(WEIGHTLESS)
    corrected._space.collision_bias = pymunk.Space().collision_bias
    for simulator in (lawful, corrected):
        simulator.reset(deep)
        simulator.step(0.02)
    assert lawful.state[3] == pytest.approx(5.5 - 0.1 * 0.02, abs=1e-12)
    assert corrected.state[3] < lawful.state[3] - 1e-3


def test_a_jack_at_rest_on_a_turning_wall_does_not_sink_in() -> None:
    # The wall turns under the resting feet by omega^2 L h^2 / 2 per substep; only position correction answers that.
    scene = Scene(restitution=0.5, drive=None)
    start = np.zeros(12)
    start[[3, 5, 8]] = 4.0, 0.3, 6.0

    def deepest(corrected: bool) -> float:
        simulator = PymunkSimulator(scene)
        if not corrected:
            simulator._space.collision_bias = 1.0
        simulator.reset(start)
        depth = 0.0
        for _ in range(400):
            try:
                simulator.step(0.02)
            except RuntimeError:
                return 1.0
            depth = max(depth, -clearance(scene, simulator.state.tolist()))
            assert energy(scene, simulator.state) <= energy(scene, start) + 1e-9
        return depth

    assert deepest(corrected=True) < 0.15
    assert deepest(corrected=False) > 0.5


def test_one_substep_corrects_too_where_a_jack_rests_in_a_corner_that_turns(monkeypatch: pytest.MonkeyPatch) -> None:
    # The engine corrects in its next step: with one substep that is the one in which it forgets its contacts.
    scene = Scene(restitution=0.0, drive=None, box_inertia=1e9, box_mass=1e7)
    start = np.array([0.0, 0.0, 0.0, 0.0, math.sqrt(0.5) - 6.0, math.pi / 4.0, 0.0, 0.0, 2.0, 0.0, 0.0, 0.0])

    def deepest() -> float:
        simulator = PymunkSimulator(scene, substeps=1)
        simulator.reset(start)
        depth = 0.0
        for _ in range(1000):
            simulator.step(0.02, 0.0)
            depth = max(depth, -clearance(scene, simulator.state.tolist()))
        return depth

    assert deepest() < 0.3
    monkeypatch.setattr(PymunkSimulator, "_corrected", lambda self, after, rates, h: after)
    assert deepest() > 0.8


def test_every_impulse_is_recorded() -> None:
    # With the box immovable and level, the jack's momentum changes by its weight and by the recorded impulses alone;
    # without restitution a foot that rests is hit in every substep of one and the same contact.
    scene = Scene(box_mass=1e12, box_inertia=1e14, restitution=0.0, drive=None)
    simulator = PymunkSimulator(scene)
    start = np.zeros(12)
    start[[3, 4, 5, 9, 11]] = 0.4, -4.0, 0.2, 1.0, 0.5
    simulator.reset(start)
    momentum = scene.jack_mass * start[9:11]
    longest = 0
    for _ in range(200):
        simulator.step(0.02)
        for hit in simulator.impacts:
            assert hit.impulse > 0.0
            angle = hit.wall * math.pi / 2.0
            momentum = momentum - hit.impulse * np.array([math.cos(angle), math.sin(angle)])
        longest = max(longest, len(simulator.impacts))
    momentum[1] -= scene.jack_mass * scene.gravity * simulator.time
    assert longest >= simulator.substeps
    np.testing.assert_allclose(scene.jack_mass * simulator.state[9:11], momentum, atol=0.2)  # m g h / 2 = 0.1


def test_impacts_are_in_time_order_with_their_walls_and_feet() -> None:
    simulator = PymunkSimulator(Scene())
    simulator.reset(load("seed_scene")[0]["q"] + load("seed_scene")[0]["qdot"], time=0.0)
    hits: list[Impact] = []
    for _ in range(150):
        before = simulator.time
        simulator.step(0.02)
        assert all(before < hit.time <= simulator.time + 1e-12 for hit in simulator.impacts)
        hits += simulator.impacts
    assert hits == sorted(hits, key=lambda hit: hit.time)
    known = load("seed_scene")[0]["impacts"][:3]
    assert [(hit.wall, hit.foot) for hit in hits[:3]] == [(hit["wall"], hit["foot"]) for hit in known]
    # An impact waits for the end of its substep: at most h late, and what happens then compounds.
    assert 0.0 <= hits[0].time - known[0]["time"] <= 0.005


# -- first order in the substep ----------------------------------------------------------------------------------------


def test_the_first_impact_is_late_by_half_a_substep_on_average() -> None:
    # First order: over many starts the impact waits h / 2 in the mean, so 8 times the substeps wait 8 times less.
    def delay(substeps: int) -> float:
        late = []
        for height in np.linspace(0.5, 3.5, 60):
            simulator = PymunkSimulator(Scene(drive=None), substeps=substeps)
            start = np.zeros(12)
            start[4] = height
            simulator.reset(start)
            while not simulator.impacts:
                simulator.step(0.02)
            late.append(simulator.impacts[0].time - math.sqrt(2.0 * (5.0 + height) / 9.81))
        assert min(late) > -1e-9
        return float(np.mean(late))

    assert delay(2) == pytest.approx(0.005, rel=0.2)
    assert delay(2) / delay(16) == pytest.approx(8.0, rel=0.25)


# -- flight ------------------------------------------------------------------------------------------------------------


@pytest.fixture
def always_the_engine(monkeypatch: pytest.MonkeyPatch) -> None:
    """Switch off the closed-form flight, so that the engine takes every step."""
    monkeypatch.setattr(PymunkSimulator, "_may_touch", lambda *arguments: True)


def closed_form(scene: Scene, start: Array, time: float, torque: float) -> Array:
    """Flight under gravity and a held torque."""
    state = start.copy()
    state[:6] += start[6:] * time
    state[4] -= 0.5 * scene.gravity * time**2
    state[10] -= scene.gravity * time
    state[2] += 0.5 * torque / scene.box_inertia * time**2
    state[8] += torque / scene.box_inertia * time
    return state


@pytest.mark.usefixtures("always_the_engine")
@pytest.mark.parametrize("substeps", [1, 3, 64])
def test_the_engine_flies_exactly(substeps: int) -> None:
    scene = Scene()
    start = np.array([0.3, -0.2, 0.1, 0.5, 3.0, 0.4, 0.5, -0.25, 0.2, 0.3, 1.0, 2.0])
    simulator = PymunkSimulator(scene, substeps=substeps)
    simulator.reset(start)
    for _ in range(40):
        simulator.step(0.02, torque=2500.0)
    assert simulator.impacts == []
    np.testing.assert_allclose(simulator.state, closed_form(scene, start, 0.8, 2500.0), atol=1e-11)


def test_the_engine_is_used_wherever_a_foot_can_reach_a_wall(request: pytest.FixtureRequest) -> None:
    # With and without the closed-form flight the same impacts come at the same substeps, over many wild scenes.
    rng = np.random.default_rng(5)
    scenes = [Scene(), Scene(jack_arm=5.0), Scene(gravity=100.0, torque_limit=9e5), Scene(box_mass=4.0, jack_mass=4.0)]
    starts = [
        (scene, inside(scene, rng, speed=10.0), rng.uniform(-1.0, 1.0, 30)) for scene in scenes for _ in range(25)
    ]

    def run() -> list[tuple[list[Impact], Array]]:
        results = []
        for scene, start, actions in starts:
            simulator = PymunkSimulator(scene)
            simulator.reset(start)
            hits: list[Impact] = []
            for action in actions:
                simulator.step(0.02, torque=action * scene.torque_limit * (1.0 if scene.box_mass > 4.0 else 0.01))
                hits += simulator.impacts
                if len(hits) >= 2:  # beyond, rounding grows into other paths
                    break
            results.append((hits, simulator.state))
        return results

    mixed = run()
    request.getfixturevalue("always_the_engine")
    pure = run()
    for (hits, state), (engine_hits, engine_state) in zip(mixed, pure, strict=True):
        assert [hit[:3] for hit in hits] == [pytest.approx(hit[:3], abs=1e-9) for hit in engine_hits]
        np.testing.assert_allclose(state, engine_state, rtol=1e-7, atol=1e-7)
    assert sum(len(hits) for hits, _ in mixed) > 100
