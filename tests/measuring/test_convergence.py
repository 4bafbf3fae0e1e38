"""Nothing wrong converges: stalled searches, links that stay open, and fields that are given wrongly are problems."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from tqdm import tqdm

from jackbox_env import Recording, Scene, fit, rollout
from jackbox_env.commands.fit import read_recording
from jackbox_env.measure import fitting, outcome, search
from jackbox_env.measure.chain import Rows, minimise
from jackbox_env.measure.flights import flights_of
from jackbox_env.measure.recordings import known_noise, state_at
from jackbox_env.measure.residuals import jumps
from jackbox_env.measure.shooting import Parameters, Shooting, Window, followed, motion, units
from jackbox_env.tools.command_line import ROOT
from tests.states import Array

FIELDS = ("jack_mass", "jack_inertia", "restitution")
LAB = Scene(  # on a tilted table, its walls heavier than its middle
    box_half_width=0.15, gravity=0.855, box_mass=0.5, jack_mass=0.08, jack_arm=0.04, jack_inertia=6e-5,
    restitution=0.9, drive=None,
)  # fmt: skip
RATE = 60.0  # frames a second


def filmed(
    scene: Scene, seconds: float = 2.5, seed: int = 0, jack: tuple[float, ...] = (0.0, 0.03, 0.3, 0.2, 0.0, 1.0)
) -> Recording:
    """What a camera sees of a lab in which nothing turns the box; the jack's place, angle and rates at first."""
    state, steps = np.zeros(12), round(seconds * RATE)
    state[3:6], state[9:] = jack[:3], jack[3:]
    seen = rollout(scene, state, np.zeros(steps), 1.0 / RATE)[0]
    seen += np.tile([3e-4, 3e-4, 4e-3], 4) * np.random.default_rng(seed).standard_normal(seen.shape)
    seen[:, 6:] = np.nan
    return Recording(seen, np.zeros(steps), 1.0 / RATE)


def test_a_stall_is_no_end() -> None:
    def evaluate(unknowns: Array) -> Rows:
        """1 + |x| with the slope of x < 0 at 0: the linear model predicts a decrease, and every step increases it."""
        jacobian = np.zeros((13, 25))
        jacobian[0, 24], jacobian[1:, :12] = -1.0, np.eye(12)
        residuals = np.concatenate([[1.0 + abs(unknowns[0])], unknowns[1:]])
        return Rows(residuals, jacobian, np.zeros(13, np.intp), np.zeros(13, np.intp))

    unknowns, ended, _ = minimise(evaluate, np.zeros(13), 1, 60, np.array([-9.0]), np.array([9.0]))
    np.testing.assert_allclose(unknowns, 0.0, atol=1e-9)
    assert not ended


def test_a_search_ends_at_a_bound_with_the_others_at_their_best() -> None:
    def evaluate(unknowns: Array) -> Rows:
        """x is 2 at best, and y follows it closely; x may be 1 at most."""
        jacobian = np.zeros((14, 26))
        jacobian[0, 24], jacobian[1, 24:], jacobian[2:, :12] = 1.0, (1e3, -1e3), np.eye(12)
        residuals = np.concatenate([[unknowns[0] - 2.0, 1e3 * (unknowns[0] - unknowns[1])], unknowns[2:]])
        assert unknowns[0] <= 1.0
        return Rows(residuals, jacobian, np.zeros(14, np.intp), np.zeros(14, np.intp))

    low, high = np.array([-9.0, -9.0]), np.array([1.0, 9.0])
    unknowns, ended, _ = minimise(evaluate, np.zeros(14), 1, 60, low, high)
    assert ended
    np.testing.assert_allclose(unknowns[:2], 1.0, rtol=1e-9)


@pytest.mark.parametrize("gravity", [1e-3, 1.0, 1e3])
@pytest.mark.parametrize("length", [1e-3, 1.0, 1e3])
def test_an_open_link_weighs_the_same_in_scenes_of_any_length_and_speed(length: float, gravity: float) -> None:
    scene = Scene(box_half_width=6.0 * length, jack_arm=length, gravity=9.81 * gravity, drive=None)
    dt = 0.02 * np.sqrt(length / gravity)
    states = rollout(scene, 0.1 * np.eye(12)[5], np.zeros(20), dt)[0]  # falls freely
    seen = np.where(np.arange(12) < 6, states, np.nan)
    windows = [Window(0, 0, 10, True, states[0]), Window(0, 10, 20, False, states[10].copy())]
    noise = 1e-3 * np.append(units(scene), 1.0)
    windows[1].start[10] += 0.3 * noise[4] / (10.0 * dt)  # so that the last row is 0.3 standard deviations away
    shooting = Shooting([Recording(seen, np.zeros(20), dt)], Parameters(("gravity",), scene), windows)
    rows = shooting.rows(shooting.unknowns(np.array([gravity])), noise, 1e-8)
    assert rows is not None
    gaps = jumps(rows, 2, slack=1e-8, noise=1e-3)
    assert gaps[0] == pytest.approx(0.3, rel=1e-3)
    assert gaps[1] == 0.0


def test_links_that_stay_open_are_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitting, "LINK_SLACKS", (1.0, 0.3))  # never tightened
    problems = fit(filmed(LAB, 1.3), FIELDS, LAB).problems
    assert any("links between windows are open, by up to" in problem for problem in problems), problems


def test_a_motion_that_is_followed_in_pieces_is_a_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    solve = search.Search.solve

    def apart(self: search.Search, *arguments: Any, **keywords: Any) -> Any:
        search.unlink(self.windows, range(len(self.windows)))
        return solve(self, *arguments, **keywords)

    recording = filmed(LAB, 1.7)
    assert fit(recording, FIELDS, LAB).problems == ()
    monkeypatch.setattr(search.Search, "solve", apart)
    problems = fit(recording, FIELDS, LAB).problems
    assert any(problem.startswith("only 0 of ") and "in pieces" in problem for problem in problems), problems


def test_a_wrong_box_mass_is_a_problem_unless_its_inertia_follows() -> None:
    recording, start = filmed(LAB, 1.7), LAB.changed(box_mass=0.5 * 1.03)
    fitted = fit(recording, FIELDS, start)  # the same motion, of masses that are 1.03 times as large
    assert fitted.problems == ()
    assert fitted.scene.jack_mass == pytest.approx(1.03 * 0.08, rel=0.01)
    relative = "jack_mass and jack_inertia are relative to box_mass as given"
    assert fitted.unidentified == (
        f"without a torque or a force on the box only ratios of masses are known: {relative}",
    )
    problems = fit(recording, FIELDS, start.changed(box_inertia=LAB.box_inertia)).problems
    assert any(
        "something else that is not fitted, is wrong: another value would fit better by" in one for one in problems
    )


def test_a_wrong_arm_is_named_where_the_inertia_follows_it() -> None:
    scene, fields = LAB.changed(jack_inertia=None), ("jack_mass", "restitution")
    recording = filmed(scene, 1.5, seed=3)
    assert fit(recording, fields, scene).problems == ()
    problems = fit(recording, fields, scene.changed(jack_arm=1.01 * scene.jack_arm)).problems
    assert any(problem.startswith("jack_arm, or something else that is not fitted") for problem in problems), problems


def test_a_window_that_jumps_blocks_a_search_and_is_named() -> None:
    def evaluate(unknowns: Array) -> Rows:
        """Two windows that want x = 1; the second jumps where x is above 0.5."""
        jacobian, x = np.zeros((26, 25)), unknowns[0]
        jacobian[[0, 13], 24], jacobian[1:13, :12], jacobian[14:, :12] = 1.0, np.eye(12), np.eye(12)
        residuals = np.concatenate([[x - 1.0], unknowns[1:13], [x - 1.0 + 5.0 * (x > 0.5)], unknowns[13:]])
        return Rows(residuals, jacobian, np.zeros(26, np.intp), np.repeat([0, 1], 13))

    unknowns, ended, blocking = minimise(evaluate, np.zeros(25), 2, 60, np.array([-9.0]), np.array([9.0]))
    assert not ended
    assert blocking.tolist() == [1]
    assert unknowns[0] == pytest.approx(0.5, abs=0.1)


def test_a_window_in_which_a_search_crawls_is_named() -> None:
    def evaluate(unknowns: Array) -> Rows:
        """Two windows that want x = 1; the second is much steeper and wants y = sin(30 x), a valley that winds."""
        (x, y), jacobian = unknowns[:2], np.zeros((26, 26))
        jacobian[0, 24], jacobian[13, 24:] = 1.0, (-3e4 * np.cos(30.0 * x), 1e3)
        jacobian[1:13, :12], jacobian[14:, :12] = np.eye(12), np.eye(12)
        residuals = np.concatenate([[x - 1.0], unknowns[2:14], [1e3 * (y - np.sin(30.0 * x))], unknowns[14:]])
        return Rows(residuals, jacobian, np.zeros(26, np.intp), np.repeat([0, 1], 13))

    _, ended, blocking = minimise(evaluate, np.zeros(26), 2, 6, np.full(2, -9.0), np.full(2, 9.0))
    assert not ended
    assert blocking.tolist() == [1]


def test_a_window_that_cannot_be_followed_ends_a_search_and_is_named() -> None:
    recording = filmed(LAB)
    windows = [Window(0, first, first + 10, start=np.zeros(12)) for first in (0, 10, 20)]
    windows[1].start[3] = 2.0 * LAB.box_half_width  # the jack is outside
    shooting = Shooting([recording], Parameters(("jack_mass",), LAB), windows)
    assert shooting.rows(shooting.unknowns(np.log([LAB.jack_mass])), np.ones(13), 1.0) is None
    assert shooting.not_followed == [1]
    evaluated = [0]

    def evaluate(unknowns: Array) -> Rows | None:
        """Wants x = 1, and no step from 0 can be followed."""
        evaluated[0] += 1
        jacobian = np.zeros((13, 25))
        jacobian[0, 24], jacobian[1:, :12] = 1.0, np.eye(12)
        rows = Rows(unknowns - np.eye(13)[0], jacobian, np.zeros(13, np.intp), np.zeros(13, np.intp))
        return None if unknowns.any() else rows

    assert not minimise(evaluate, np.zeros(13), 1, 60, np.array([-9.0]), np.array([9.0]))[1]
    assert evaluated[0] < 7


def test_rest_is_no_flight() -> None:
    lossy, noise = LAB.changed(restitution=0.6), np.tile([3e-4, 3e-4, 4e-3], 2)
    flights = flights_of(filmed(lossy, seconds=8.0), lossy, noise)  # rests after a second
    assert flights is not None
    assert flights.first[flights.lasting].tolist() == [0]


def test_a_model_that_rests_where_the_recorded_jack_flies_does_not_explain_it() -> None:
    recording, bar = filmed(LAB), tqdm(disable=True)
    arguments = [recording], Parameters(FIELDS, LAB), known_noise(None), bar
    again = search.Search(*arguments, before=search.Search(*arguments))
    again.windows, again.resting_steps = [Window(0, 0, 10, start=state_at(recording))], [len(recording.states) - 11]
    assert outcome._not_followed(again)[1][0] > 0.5  # [s] of 2.5


def test_windows_have_two_rows_for_each_impact() -> None:
    lossy = LAB.changed(restitution=0.6)
    recording, parameters = filmed(lossy), Parameters(FIELDS, lossy)
    state, numbers = np.zeros(12), parameters.of(lossy)
    state[3:6], state[9:] = (0.0, 0.03, 0.3), (0.2, 0.0, 1.0)
    before = motion(recording, Window(0, 0, 34, start=state), parameters, numbers)
    assert before is not None
    for last, enough in ((37, False), (38, True)):  # impacts at rows 35.4 and 36.1
        window = Window(0, 34, last, start=before.states[-1])
        assert followed(window, motion(recording, window, parameters, numbers), most=4) == enough


def test_held_out_windows_are_judged_by_the_fit_without_them(monkeypatch: pytest.MonkeyPatch) -> None:
    covariances = list[Array]()

    def studentised(_: Rows, covariance: Array) -> Array:
        covariances.append(covariance)
        return np.zeros(1)

    monkeypatch.setattr(outcome, "studentised", studentised)
    fitted = fit(filmed(LAB, 1.0), FIELDS, LAB)
    low, high = fitted.intervals["restitution"]
    assert len(covariances) == 1
    assert np.sqrt(covariances[0][2, 2]) > 1.5 * (high - low) / 3.92


def test_a_search_follows_a_narrow_curved_valley() -> None:
    evaluations = [0]

    def evaluate(unknowns: Array) -> Rows:
        """x is 1 at best, and a tight link makes y the square of x."""
        evaluations[0] += 1
        (x, y), jacobian = unknowns[:2], np.zeros((14, 26))
        jacobian[0, 24], jacobian[1, 24:], jacobian[2:, :12] = 1.0, (-2e3 * x, 1e3), np.eye(12)
        residuals = np.concatenate([[x - 1.0, 1e3 * (y - x * x)], unknowns[2:]])
        return Rows(residuals, jacobian, np.zeros(14, np.intp), np.zeros(14, np.intp))

    unknowns, ended, _ = minimise(evaluate, np.zeros(14), 1, 60, np.full(2, -9.0), np.full(2, 9.0))
    assert ended
    np.testing.assert_allclose(unknowns[:2], 1.0, rtol=1e-6)
    assert evaluations[0] < 12


def far(scene: Scene) -> Scene:
    """A start of a fit whose masses are wrong by a factor of 4."""
    return scene.changed(jack_mass=4.0 * scene.jack_mass, jack_inertia=4.0 * scene.jack_inertia, restitution=1.0)


def test_a_fit_arrives_from_far_away_past_bad_rows_and_names_them() -> None:
    recording, rng = filmed(LAB, 1.7), np.random.default_rng(2)
    rows = np.sort(rng.choice(np.arange(1, len(recording.states)), 20, replace=False))  # of 103; not 42 to 44
    recording.states[rows, 3:6] = 0.0
    recording.states[43, 3] += 0.05
    fitted = fit(recording, FIELDS, far(LAB))
    assert fitted.problems == ()
    assert fitted.scene.jack_mass == pytest.approx(LAB.jack_mass, rel=0.01)
    assert fitted.scene.restitution == pytest.approx(LAB.restitution, abs=0.005)
    assert any(sentence.startswith("row 43: x_jack is 0.05") for sentence in fitted.bad_rows), fitted.bad_rows
    lost = [f"row {row}: x_jack and y_jack are 0, as of a lost frame" for row in rows.tolist()]
    assert {*lost} <= {*fitted.bad_rows}, fitted.bad_rows
    assert len(fitted.bad_rows) <= 23
    recording.states[rows[::2], 3] = 0.1  # 10 rows
    problems = fit(recording, FIELDS, LAB).problems
    assert any("rows are off the jack's path" in problem for problem in problems), problems


def test_impacts_that_determine_only_some_fields_lead_to_all() -> None:
    fitted = fit(filmed(LAB, 1.3, seed=1, jack=(0.03, 0.0, 0.5, 0.3, -0.2, 2.0)), FIELDS, far(LAB))
    assert fitted.problems == ()
    for name in FIELDS:
        assert getattr(fitted.scene, name) == pytest.approx(getattr(LAB, name), rel=0.01)


def test_a_fit_whose_first_windows_run_away_begins_again_from_other_guesses() -> None:
    rng, scene = np.random.default_rng(10), Scene(jack_mass=20.0, restitution=0.84, drive=None)
    torques = np.repeat(rng.uniform(-3e4, 3e4, 12), 10)
    seen = rollout(scene, 0.3 * np.eye(12)[5], torques, dt=0.02)[0]
    seen += 1e-3 * rng.standard_normal(seen.shape)
    seen[:, [0, 1, 2, 6, 7, 8]] = np.nan  # the box was not observed
    start = scene.changed(jack_mass=15.0, restitution=0.75)
    fitted = fit(Recording(seen, torques, dt=0.02), ("jack_mass", "restitution"), start)  # 2,452 kg without others
    assert fitted.converged, fitted.problems
    assert fitted.scene.jack_mass == pytest.approx(20.0, rel=0.01)


def test_a_fit_goes_through_rest_and_stays_where_the_start_is_true() -> None:
    lossy = LAB.changed(restitution=0.7)
    recording = filmed(lossy, seconds=8.0)  # the jack rests for most of them
    fits = [fit(recording, FIELDS, start) for start in (far(lossy), lossy)]
    for fitted in fits:
        assert fitted.problems == ()
        assert fitted.left_out > 200
        assert fitted.unexplained < 0.1
        assert fitted.scene.jack_mass == pytest.approx(lossy.jack_mass, rel=0.02)
        assert fitted.scene.restitution == pytest.approx(lossy.restitution, abs=0.01)
    assert fits[0].scene.jack_mass == pytest.approx(fits[1].scene.jack_mass, rel=1e-4)


def test_a_recording_of_which_nothing_agrees_is_a_problem_and_counts_no_window_twice() -> None:
    junk, noise = np.full((40, 12), np.nan), np.tile([3e-4, 3e-4, 4e-3], 4)
    junk[:, :6] = np.random.default_rng(1).normal(0.0, 0.1, (40, 6))
    fitted = fit([filmed(LAB, 1.0), Recording(junk, np.zeros(39), 1.0 / RATE)], FIELDS, LAB, noise=noise)
    assert "no part of recording 1 agrees with the scene" in fitted.problems, fitted.problems
    assert fitted.left_out >= 39
    assert fitted.unexplained >= 0.0


def test_rows_that_agree_with_the_fitted_motion_are_no_bad_rows() -> None:
    elastic = LAB.changed(restitution=1.0)
    for seed in range(3):
        assert fit(filmed(elastic, seed=seed), FIELDS, elastic).bad_rows == ()


def test_a_recording_that_is_wrong_is_named_and_does_not_spoil_the_others() -> None:
    other = LAB.changed(jack_arm=0.06, jack_mass=0.3)
    fitted = fit([filmed(other, 1.7), filmed(LAB, 1.7)], FIELDS, far(LAB))
    assert "no part of recording 0 agrees with the scene" in fitted.problems, fitted.problems
    assert fitted.scene.jack_mass == pytest.approx(LAB.jack_mass, rel=0.02)
    assert fitted.scene.restitution == pytest.approx(LAB.restitution, abs=0.01)


def test_flights_before_and_after_several_hops_are_followed() -> None:
    jack = (-0.026, -0.007, 0.87, 0.357, -0.323, -2.995)
    fitted = fit(filmed(LAB, jack=jack), FIELDS, far(LAB))
    assert fitted.problems == ()
    assert fitted.left_out == 0  # 48 if only flights that follow closely are linked
    assert fitted.scene.jack_mass == pytest.approx(LAB.jack_mass, rel=0.005)


def test_the_work_of_a_fit_is_bounded(monkeypatch: pytest.MonkeyPatch) -> None:
    evaluated = [0]
    rows = Shooting.rows

    def counted(self: Shooting, *arguments: Any) -> Rows | None:
        evaluated[0] += sum(window.last - window.first for window in self.windows)
        return rows(self, *arguments)

    monkeypatch.setattr(Shooting, "rows", counted)
    names = {
        "time": "t",
        **{f"{one}_box": f"box_{one}" for one in "xy"},
        **{f"{one}_jack": f"ball_{one}" for one in "xy"},
    }
    names |= {"theta_box": "box_angle", "theta_jack": "ball_angle"}
    recording = read_recording(ROOT / "docs" / "cam.csv", Scene(), names=names, y_down=True)
    problems = fit(recording, ("jack_mass", "restitution"), noise=2.0).problems  # it is 5 mm
    assert "the search did not end" in problems
    assert evaluated[0] < 300 * len(recording.states)
