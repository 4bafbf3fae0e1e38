"""Baselines, other simulations of the jack: each does what its module describes, failures included."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from jackbox_env.measure.accuracy import Case, follow
from jackbox_env.mechanics import energy, impact_map
from jackbox_env.model.scene import Scene
from jackbox_env.model.tasks import sample_start
from jackbox_env.simulators import make_simulator
from scripts.referee import prefix_errors, reference
from scripts.studies import baselines
from scripts.studies.accuracy.comparing import compare, reference_of
from scripts.studies.baselines.base import Baseline
from scripts.studies.baselines.threshold import BAND, reflect
from tests.states import WEIGHTLESS, one_foot_on_wall

NEEDS_MUJOCO = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="mujoco: pip install mujoco")
EVERY_BASELINE = pytest.mark.parametrize("name", ["threshold", "box2d", pytest.param("mujoco", marks=NEEDS_MUJOCO)])


def baseline(name: str, scene: Scene, substeps: int) -> Baseline:
    return baselines.baseline(name)(scene, substeps)


def chirped(seed: int, steps: int = 500) -> Case:
    return Case(f"seed {seed}", Scene(), sample_start(Scene(), np.random.default_rng(seed)), steps)


def test_a_threshold_impact_is_the_impact_map_when_approaching_and_its_reflection_when_leaving() -> None:
    rng = np.random.default_rng(5)
    for _ in range(30):
        state, wall, foot = one_foot_on_wall(Scene(), rng)
        after, impulse = reflect(Scene(), state, wall, foot)
        mapped, wanted = impact_map(Scene(), state, wall, foot)
        np.testing.assert_array_equal(after, mapped)
        assert impulse == wanted > 0.0
        # Reflected again the foot separates: the map would leave it alone, this goes back to where it came from.
        back, pull = reflect(Scene(), after, wall, foot)
        np.testing.assert_allclose(back, state, rtol=1e-12, atol=1e-12)
        assert pull == pytest.approx(-impulse, rel=1e-12)
        assert energy(Scene(), back) == pytest.approx(energy(Scene(), after), rel=1e-13)


def test_threshold_loses_the_jack_through_a_wall_and_keeps_its_energy_all_the_while() -> None:
    threshold, exact, escaped = baseline("threshold", Scene(), 2), make_simulator(Scene(), "exact"), 0
    for seed in range(4, 8):
        course = follow(threshold, chirped(seed), inspect=threshold.inside_last_step)
        if course.escaped:
            escaped += 1
            assert course.depth > BAND  # where nothing brings it back
            assert course.imbalance < 1e-5 * course.energy
            assert not follow(exact, chirped(seed), inspect=None).escaped
    assert escaped


@EVERY_BASELINE
def test_the_first_impact_comes_in_time_and_the_run_stays_balanced(name: str) -> None:
    case = chirped(1, 150)
    simulator = baseline(name, case.scene, 16)
    course = follow(simulator, case, inspect=simulator.inside_last_step)
    comparison = compare(case, course, reference_of(case))
    assert not course.escaped
    assert comparison.errors[0] < (BAND / 5.0 if name == "threshold" else 0.00125)  # h
    # A spring's energy is missing while a foot is on it.
    assert course.imbalance < {"threshold": 1e-8, "box2d": 1e-3, "mujoco": 0.05}[name] * course.energy
    assert len(course.impacts) > 1


def test_solve_ivp_has_the_proven_impacts_and_misses_a_foot_that_goes_in_and_out_within_a_step() -> None:
    for name in ("chirp-0", "corner", "held-e0.6"):
        case, impacts = reference()[name]
        for tolerance, bound in ((1e-3, 1e-9), (1e-10, 1e-10)):
            course = follow(baselines.baseline("solve_ivp")(case.scene, tolerance=tolerance), case, inspect=None)
            errors = prefix_errors(course.impacts, impacts)
            assert len(errors) == len(course.impacts) == len(impacts)
            assert errors[0] < bound
    loose = baselines.baseline("solve_ivp")(WEIGHTLESS, tolerance=1e-3)
    for simulator, struck in ((loose, []), (make_simulator(WEIGHTLESS, "exact"), [(0, 0)])):
        simulator.reset([0.0, 0.0, 0.0, 5.2, 0.0, -0.79, 0.0, 0.0, 0.0, 0.0, 0.0, 79.0])
        simulator.step(0.02)
        assert [hit[1:3] for hit in simulator.impacts] == struck
