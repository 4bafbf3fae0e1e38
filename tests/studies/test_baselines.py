"""Baselines, other simulations of the jack: each does what its module describes, failures included."""

from __future__ import annotations

import importlib.util

import numpy as np
import pytest

from jackbox_env.measure.accuracy import Case, follow, prefix_errors
from jackbox_env.mechanics import energy, impact_map
from jackbox_env.model.scene import Scene
from jackbox_env.model.tasks import sample_start
from jackbox_env.simulators import make_simulator
from scripts.referee import reference
from scripts.studies import baselines
from scripts.studies.accuracy.comparing import compare, reference_of
from scripts.studies.baselines.base import Baseline
from scripts.studies.baselines.threshold import BAND, reflect
from tests.states import inside, one_foot_on_wall

WEIGHTLESS = Scene(gravity=0.0, drive=None)
NEEDS_MUJOCO = pytest.mark.skipif(importlib.util.find_spec("mujoco") is None, reason="mujoco: pip install mujoco")
EVERY_BASELINE = pytest.mark.parametrize("name", ["threshold", "box2d", pytest.param("mujoco", marks=NEEDS_MUJOCO)])
EVERY_ENGINE = pytest.mark.parametrize("name", ["box2d", pytest.param("mujoco", marks=NEEDS_MUJOCO)])


def baseline(name: str, scene: Scene, substeps: int) -> Baseline:
    return baselines.baseline(name)(scene, substeps)


def started(name: str, scene: Scene, substeps: int, numbers: dict[int, float], time: float = 0.0) -> Baseline:
    """A baseline in a state that is 0 except for these numbers."""
    simulator = baseline(name, scene, substeps)
    simulator.reset([numbers.get(index, 0.0) for index in range(12)], time)
    return simulator


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


@EVERY_ENGINE
def test_flight_runs_ahead_of_the_truth_by_half_a_substep(name: str) -> None:
    # Semi-implicit Euler under constant acceleration a: x is ahead by a h t / 2, v is exact.
    torque, steps = 14400.0, 20
    for substeps in (1, 8):
        simulator = started(name, Scene(drive=None), substeps, {2: 7.0, 5: -9.0, 11: 2.0}, time=1.0)
        for _ in range(steps):
            simulator.step(0.02, torque)
        h, t = 0.02 / substeps, 0.4
        ahead = 0.5 * h * t
        wanted = [0, 0, 7.0 + 0.5 * t**2 + ahead, 0, -9.81 * (0.5 * t**2 + ahead), -9.0 + 2.0 * t]
        wanted += [0, 0, t, 0, -9.81 * t, 2.0]
        tolerance = 4e-5 if name == "box2d" else 1e-12  # float32, rounded 160 times
        np.testing.assert_allclose(simulator.state, wanted, atol=tolerance)
        assert simulator.torque == torque
        assert simulator.time == pytest.approx(1.4, rel=1e-14)
        assert simulator.impacts == []


@EVERY_ENGINE
def test_one_straight_bounce_is_the_impact_map(name: str) -> None:
    # mujoco: the jack is on its spring for two substeps, whose turn of 0.9999 of a quarter leaves 1e-4.
    tolerance = 1e-6 if name == "box2d" else 2e-4
    for wall, (x, y) in enumerate([(1, 0), (0, 1), (-1, 0), (0, -1)]):
        for part in (0.1, 0.5, 0.9):  # of a substep, at which the foot reaches the wall
            h, impacts = 0.005, []
            distance = 5.0 - 3.0 * h * (2.0 + part)
            simulator = started(name, WEIGHTLESS, 2, {3: x * distance, 4: y * distance, 9: x * 3.0, 10: y * 3.0})
            state = simulator.state
            for _ in range(4):
                simulator.step(2 * h)
                impacts += simulator.impacts
            wanted, impulse = impact_map(WEIGHTLESS, state, wall, wall)
            np.testing.assert_allclose(simulator.state[6:], wanted[6:], atol=3.0 * tolerance)
            assert [hit[1:3] for hit in impacts] == [(wall, wall)]
            assert impacts[0].time == pytest.approx(3 * h)  # the first substep that starts with the foot in the wall
            assert impacts[0].impulse == pytest.approx(impulse, rel=tolerance)


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


@EVERY_BASELINE
def test_the_motion_follows_from_state_and_time_bitwise(name: str) -> None:
    rng = np.random.default_rng(7)
    run, twin = (baseline(name, Scene(jack_arm=4.0), 4) for _ in range(2))
    run.reset(inside(run.scene, rng, speed=3.0))
    impacts = 0
    for _ in range(100):
        twin.reset(run.state, run.time)
        torque = rng.uniform(-3e4, 3e4) if rng.uniform() < 0.7 else None
        for one in (run, twin):
            one.step(0.02, torque)
        np.testing.assert_array_equal(twin.state, run.state)
        assert (twin.time, twin.torque) == (run.time, run.torque)
        impacts += len(run.impacts)
    assert impacts > 3


@EVERY_BASELINE
def test_a_jack_that_would_leave_is_refused_and_the_simulator_stays_as_it_was(name: str) -> None:
    simulator = started(name, WEIGHTLESS, 1, {3: 4.5, 9: 90.0 if name == "box2d" else 200.0}, time=3.0)
    state = simulator.state
    with pytest.raises(RuntimeError, match="t = 3 s"):
        simulator.step(0.02)
    np.testing.assert_array_equal(simulator.state, state)
    assert simulator.time == 3.0
    case = Case("too fast", WEIGHTLESS, state, 5)
    assert follow(simulator, case, inspect=simulator.inside_last_step).escaped


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
