"""The pymunk model: position correction, impacts that wait for the end of a substep, and flight."""

from __future__ import annotations

import math

import numpy as np
import pymunk
import pytest

from jackbox_env.mechanics import energy
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import clearance
from jackbox_env.simulators import JackLostError
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.states import WEIGHTLESS, at, inside, started

# -- impacts -----------------------------------------------------------------------------------------------------------


def test_position_correction_would_move_bodies_that_the_law_does_not() -> None:
    # Foot 0 is 0.5 m outside and leaves at 0.1 m/s. The engine's default correction pushes it out of the wall.
    lawful, corrected = (started(PymunkSimulator(WEIGHTLESS), at(x_jack=5.5, vx_jack=-0.1)) for _ in range(2))
    corrected._space.collision_bias = pymunk.Space().collision_bias
    for simulator in (lawful, corrected):
        simulator.step(0.02)
    assert lawful.state[3] == pytest.approx(5.5 - 0.1 * 0.02, abs=1e-12)
    assert corrected.state[3] < lawful.state[3] - 1e-3


def deepest(simulator: PymunkSimulator, start: list[float]) -> float:
    """How deep a foot gets into a wall in 20 s [m]; infinite if a step is refused. No energy is gained."""
    simulator.reset(start)
    scene, depth = simulator.scene, 0.0
    for _ in range(1000):
        try:
            simulator.step(0.02, 0.0)
        except JackLostError:
            return math.inf
        depth = max(depth, -clearance(scene, simulator.state.tolist()))
        assert energy(scene, simulator.state) <= energy(scene, start) + 1e-9
    return depth


@pytest.mark.parametrize(
    ("scene", "start", "substeps", "most"),
    [
        # The wall turns under the resting feet by omega^2 L h^2 / 2 per substep; only position correction answers that.
        (Scene(restitution=0.5, drive=None), [0, 0, 0, 4.0, 0, 0.3, 0, 0, 6.0, 0, 0, 0], 4, 0.15),
        # The engine corrects in its next step: with one substep that is the one in which it forgets its contacts.
        (Scene(restitution=0.0, drive=None, box_inertia=1e9, box_mass=1e7),
         [0, 0, 0, 0, math.sqrt(0.5) - 6.0, math.pi / 4.0, 0, 0, 2.0, 0, 0, 0], 1, 0.3),
    ],
    ids=["on a wall", "in a corner, one substep"],
)  # fmt: skip
def test_a_jack_at_rest_in_a_box_that_turns_does_not_sink_in(
    scene: Scene, start: list[float], substeps: int, most: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert deepest(PymunkSimulator(scene, substeps=substeps), start) < most
    uncorrected = PymunkSimulator(scene, substeps=substeps)
    uncorrected._space.collision_bias = 1.0
    monkeypatch.setattr(uncorrected, "_corrected", lambda after, rates, h: after)
    assert deepest(uncorrected, start) > 2.0 * most


# -- first order in the substep ----------------------------------------------------------------------------------------


def test_the_first_impact_is_late_by_half_a_substep_on_average() -> None:
    # First order: over many starts the impact waits h / 2 in the mean, so 8 times the substeps wait 8 times less.
    def delay(substeps: int) -> float:
        late = []
        for height in np.linspace(0.5, 3.5, 60):
            simulator = started(PymunkSimulator(Scene(drive=None), substeps=substeps), height * np.eye(12)[4])
            while not simulator.impacts:
                simulator.step(0.02)
            late.append(simulator.impacts[0].time - math.sqrt(2.0 * (5.0 + height) / 9.81))
        assert min(late) > -1e-9
        return float(np.mean(late))

    assert delay(2) == pytest.approx(0.005, rel=0.2)
    assert delay(2) / delay(16) == pytest.approx(8.0, rel=0.25)


# -- flight ------------------------------------------------------------------------------------------------------------


def test_the_engine_is_used_wherever_a_foot_can_reach_a_wall(monkeypatch: pytest.MonkeyPatch) -> None:
    # With and without the closed-form flight the same impacts come at the same substeps, over many wild scenes.
    rng, total = np.random.default_rng(5), 0
    scenes = [Scene(), Scene(jack_arm=5.0), Scene(gravity=100.0, torque_limit=9e5)]
    for scene in 25 * [*scenes, Scene(box_mass=4.0, jack_mass=4.0, torque_limit=900.0)]:
        start, hits = inside(scene, rng, speed=10.0), 0
        mixed, engine = PymunkSimulator(scene), PymunkSimulator(scene)
        monkeypatch.setattr(engine, "_may_touch", lambda *_: True)
        for one in (mixed, engine):
            one.reset(start)
        for torque in rng.uniform(-scene.torque_limit, scene.torque_limit, 30).tolist():
            for one in (mixed, engine):
                one.step(0.02, torque)
            assert [hit[:3] for hit in mixed.impacts] == [pytest.approx(hit[:3], abs=1e-9) for hit in engine.impacts]
            hits += len(mixed.impacts)
            if hits >= 2:  # beyond, rounding grows into other paths
                break
        np.testing.assert_allclose(mixed.state, engine.state, rtol=1e-7, atol=1e-7)
        total += hits
    assert total > 100
