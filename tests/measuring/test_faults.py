"""What is wrong with a recording, though the scene is right, keeps a fit from converging, and is named."""

from __future__ import annotations

import math

import numpy as np
import pytest

pytest.importorskip("scipy")
from scipy.signal import savgol_filter

from jackbox_env import Fit, Recording, Scene, fit, rollout
from jackbox_env.fits.faults import FAULTS, spoilt
from jackbox_env.mechanics import gaps
from scripts.studies.fitting.people import recorded_by_people
from tests.measuring.test_convergence import FIELDS, LAB, RATE, filmed

SIZES = dict(zip(FAULTS, (0.02, 0.02, 0.01, 0.02, 0.06, 0.01), strict=True))  # [rad], [rad], 1, [rad], 1, [s]


def farthest(fitted: Fit, scene: Scene) -> float:
    """The most standard deviations that an identified field is from the truth."""
    ends = {name: one for name, one in fitted.intervals.items() if one not in ((0.0, math.inf), (0.0, 1.0))}
    off = [abs(getattr(fitted.scene, name) - getattr(scene, name)) / (high - low) for name, (low, high) in ends.items()]
    return 3.92 * max(off, default=0.0)


@pytest.fixture(scope="module")
def turned() -> Recording:
    """What a camera sees of a lab whose box a motor turns."""
    rng, state = np.random.default_rng(0), np.zeros(12)
    torques = np.repeat(rng.uniform(-0.05, 0.05, 12), 12)
    state[3:6], state[9:] = (0.0, 0.03, 0.3), (0.2, 0.0, 1.0)
    seen = rollout(LAB, state, torques, 1.0 / RATE)[0]
    seen += np.tile([3e-4, 3e-4, 4e-3], 4) * rng.standard_normal(seen.shape)
    seen[:, 6:] = np.nan
    return Recording(seen, torques, 1.0 / RATE)


@pytest.mark.parametrize("fault", FAULTS)
def test_what_is_wrong_with_a_recording_is_named(turned: Recording, fault: str) -> None:
    problems = fit(spoilt(turned, fault, SIZES[fault]), FIELDS, LAB).problems
    assert any(one.startswith(f"{fault}, or something else that is not fitted, is wrong") for one in problems), problems


def test_a_right_recording_of_a_motor_and_a_smoothed_one(turned: Recording) -> None:
    assert fit(turned, FIELDS, LAB).problems == ()
    states = turned.states.copy()
    states[:, :6] = savgol_filter(states[:, :6], 7, 2, axis=0)
    problems = fit(Recording(states, turned.torques, turned.dt), FIELDS, LAB).problems
    assert problems[0] == "the track looks smoothed: fit what was measured", problems


def test_time_in_which_no_foot_is_near_a_wall_is_no_rest() -> None:
    recording = spoilt(filmed(LAB, 3.0), FAULTS[0], 0.1)
    fitted = fit(recording, FIELDS, LAB)
    left_out = np.nan_to_num(recording.states[np.isnan(fitted.motions[0][:, 3])])
    flown = sum(gaps(LAB, state).min() > 0.08 * LAB.box_half_width for state in left_out)
    assert 5 < flown < fitted.unexplained * RATE + 2


def test_flight_is_no_rest_where_the_box_was_not_seen() -> None:
    _, start, fields, recording = recorded_by_people(15, verdict=True)
    assert np.isnan(recording.states[:, :2]).all()
    assert fit(recording, fields, start).unexplained > 0.5  # of 2.2 s that are left out; 0.3 s by the box that is seen


def test_a_converged_fit_of_few_impacts_does_not_depend_on_one_that_was_followed_wrongly() -> None:
    scene, start, fields, recording = recorded_by_people(271, verdict=True)  # 47 of 353 steps are used
    fitted = fit(recording, fields, start)
    assert farthest(fitted, scene) < 4.0 or not fitted.converged, fitted.problems


def test_of_the_place_of_the_jack_alone_other_motions_may_agree() -> None:
    recording = filmed(LAB)
    recording.states[:, [0, 1, 2, 5]] = np.nan
    problems = fit(recording, ("restitution",), LAB).problems
    assert any(one.startswith("nothing but the jack's place was observed") for one in problems), problems


@pytest.mark.slow
def test_toys_with_a_fault_do_not_converge_to_wrong_values() -> None:
    """Half widths of 4 to 8 cm, and faults of 0.25 to 2 times what a camera shows."""
    for seed in range(4):
        scene, start, fields, recording = recorded_by_people(1000 + seed, True, (0.04, 0.08), 5.0)
        fault = FAULTS[seed % len(FAULTS)]
        size = SIZES[fault] * np.exp(np.random.default_rng(seed).uniform(np.log(0.25), np.log(2.0)))
        fitted = fit(spoilt(recording, fault, size), fields, start)
        assert farthest(fitted, scene) < 4.0 or not fitted.converged, (seed, fault)


@pytest.mark.parametrize("seed", [1, 4])
def test_a_toy_that_rests_most_of_the_time_converges(seed: int) -> None:
    _, start, fields, recording = recorded_by_people(seed, True, (0.04, 0.08), 5.0)
    assert fit(recording, fields, start).problems == ()  # 0.4 s of 17.7


@pytest.mark.parametrize(("seed", "true_start"), [(195, False), (49, True)])
def test_a_right_recording_converges_in_spite_of_windows_that_show_little(seed: int, true_start: bool) -> None:
    """One has rows after a step without a derivative; in the other a search comes to a kink."""
    scene, start, fields, recording = recorded_by_people(seed, verdict=True)
    fitted = fit(recording, fields, scene if true_start else start)
    assert fitted.problems == ()
    assert farthest(fitted, scene) < 4.0
