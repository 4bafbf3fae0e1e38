"""Nothing wrong converges: stalled searches, and fields that are given wrongly are problems."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jackbox_env import Recording, Scene, fit, rollout
from jackbox_env.fits import outcome
from jackbox_env.fits.first_guess import flights_of
from jackbox_env.fits.least_squares import Rows, minimise
from jackbox_env.fits.shooting import Parameters, Shooting, Window
from jackbox_env.model.states import STATE_NAMES, Array

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


def searched(
    what: Any, of: tuple[int, ...] = (0, 0), most: int = 60, low: float = -9.0, high: float = 9.0
) -> tuple[Array, bool, list[int], int]:
    """The search for the least squares of what is returned, with slopes, for two fields: each belongs to a window."""
    windows, calls = max(of) + 1, list[Array]()
    window = np.append(of, np.repeat(np.arange(windows), 12))
    order = np.argsort(window, kind="stable")

    def evaluate(unknowns: Array) -> Rows | None:
        calls.append(unknowns)
        if (found := what(*unknowns[:2])) is None:
            return None
        jacobian = np.zeros((len(window), 26))
        jacobian[: len(of), 24:], jacobian[len(of) :, :12] = found[1], np.tile(np.eye(12), (windows, 1))
        residuals = np.append(found[0], unknowns[2:])
        return Rows(residuals[order], jacobian[order], np.zeros(len(window), np.intp), window[order])

    bounds = np.array([low, -9.0]), np.array([high, 9.0])
    found, ended, blocking = minimise(evaluate, np.zeros(2 + 12 * windows), windows, most, *bounds)
    return found[:2], ended, blocking.tolist(), len(calls)


def test_a_search_ends_at_a_bound_along_valleys_and_around_what_cannot_be_followed() -> None:
    found, ended, *_ = searched(lambda x, y: ((x - 2.0, 1e3 * (x - y)), ((1.0, 0.0), (1e3, -1e3))), high=1.0)
    assert ended
    np.testing.assert_allclose(found, 1.0, rtol=1e-9)
    found, ended, _, calls = searched(lambda x, y: ((x - 1.0, 1e3 * (y - x * x)), ((1.0, 0.0), (-2e3 * x, 1e3))))
    assert ended
    np.testing.assert_allclose(found, 1.0, rtol=1e-6)
    assert calls < 12
    found, ended, *_ = searched(  # Rosenbrock's valley, whose x may not be above 1.05
        lambda x, y: ((10.0 * (y - x * x), 1.0 - x), ((-20.0 * x, 10.0), (-1.0, 0.0))) if x <= 1.05 else None
    )
    assert ended
    np.testing.assert_allclose(found, 1.0, atol=1e-6)


def test_a_search_that_stalls_has_not_ended_and_names_the_window_that_blocks_it() -> None:
    found, ended, *_ = searched(lambda x, y: ((1.0 + abs(x), y), ((-1.0, 0.0), (0.0, 1.0))))  # no step is downhill
    assert not ended
    assert abs(found[0]) < 1e-9
    jump = searched(
        lambda x, y: ((x - 1.0, x - 1.0 + 5.0 * (x > 0.5), y), ((1.0, 0.0),) * 2 + ((0.0, 1.0),)), (0, 1, 0)
    )
    assert (jump[1:3], jump[0][0]) == ((False, [1]), pytest.approx(0.5, abs=0.1))
    first = searched(lambda x, y: ((3.0 * (x - 1.0), y), np.diag([3.0, 1.0])), most=1)[0][0]
    to_and_fro = searched(  # from the first step on: to 2, and from there to where it was
        lambda x, y: (
            ((3.0 * (x - 1.0), y), np.diag([3.0, 1.0]))
            if x < 0.9
            else (((x - 2.0, y), np.eye(2)) if x < 1.5 else ((2.0 * (x - first), y), np.diag([2.0, 1.0])))
        )
    )
    assert to_and_fro[0][0] == pytest.approx(1.5, abs=0.1)
    crawl = searched(  # the second wants y = sin(30 x), a valley that winds
        lambda x, y: ((x - 1.0, 1e3 * (y - np.sin(30.0 * x))), ((1.0, 0.0), (-3e4 * np.cos(30.0 * x), 1e3))), (0, 1), 6
    )
    assert crawl[1:3] == (False, [1])
    nowhere = searched(lambda x, y: None if x or y else ((-1.0, 0.0), np.eye(2)))
    assert not nowhere[1]
    assert nowhere[3] < 7


def test_a_wrong_box_mass_is_a_problem_unless_its_inertia_follows() -> None:
    recording, start = filmed(LAB, 1.7), LAB.changed(box_mass=0.5 * 1.03)
    fitted = fit(recording, FIELDS, start)  # the same motion, of masses that are 1.03 times as large
    assert fitted.problems == ()
    assert fitted.scene.jack_mass == pytest.approx(1.03 * 0.08, rel=0.01)
    given = "jack_inertia and jack_mass by those that are given"
    assert fitted.unidentified == (f"without a torque or a force on the box only ratios of masses are known: {given}",)
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


def test_a_window_that_cannot_be_followed_ends_a_search_and_is_named() -> None:
    recording = filmed(LAB)
    windows = [Window(0, first, first + 10, start=np.zeros(12)) for first in (0, 10, 20)]
    windows[1].start[3] = 2.0 * LAB.box_half_width  # the jack is outside
    shooting = Shooting([recording], Parameters(("jack_mass",), LAB), windows)
    assert shooting.rows(shooting.unknowns(np.log([LAB.jack_mass])), np.ones(13), 1.0) is None
    assert shooting.not_followed == [1]


def test_what_is_not_fitted_and_would_fit_better_widens_the_intervals(monkeypatch: pytest.MonkeyPatch) -> None:
    widths = list[float]()
    for away in (1.0, 3.0):
        monkeypatch.setattr(outcome, "_contradicted", lambda *_, away=away: ("gravity", away))
        low, high = fit(filmed(LAB, 1.0), FIELDS, LAB).intervals["restitution"]
        widths.append(high - low)
    assert widths[1] == pytest.approx(1.5 * widths[0], rel=1e-6)


def test_rest_is_no_flight() -> None:
    lossy, noise = LAB.changed(restitution=0.6), np.tile([3e-4, 3e-4, 4e-3], 2)
    flights = flights_of(filmed(lossy, seconds=8.0), lossy, noise)  # rests after a second
    assert flights is not None
    assert flights.first[flights.lasting].tolist() == [0]


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


def far(scene: Scene) -> Scene:
    """A start of a fit whose masses are wrong by a factor of 4."""
    return scene.changed(jack_mass=4.0 * scene.jack_mass, jack_inertia=4.0 * scene.jack_inertia, restitution=1.0)


def test_a_fit_arrives_from_far_away_past_bad_rows_and_names_them() -> None:
    recording, rng = filmed(LAB, 1.7), np.random.default_rng(2)
    rows = np.sort(rng.choice(np.arange(1, len(recording.states)), 20, replace=False))  # of 103; not 42 to 44
    recording.states[rows, 3:6] = np.nan
    recording.states[43, 3] += 0.05
    fitted = fit(recording, FIELDS, far(LAB))
    assert fitted.problems == ()
    assert fitted.scene.jack_mass == pytest.approx(LAB.jack_mass, rel=0.01)
    assert fitted.scene.restitution == pytest.approx(LAB.restitution, abs=0.005)
    assert any(sentence.startswith("row 43: x_jack is 0.05") for sentence in fitted.bad_rows), fitted.bad_rows
    assert len(fitted.bad_rows) <= 3
    recording.states[rows[::3], 3:6] = 0.1  # 7 rows
    fitted = fit(recording, FIELDS, LAB)
    assert any("rows are off the fitted path" in problem for problem in fitted.problems), fitted.problems
    assert fitted.left_out < 10  # a discounted number keeps no window from being explained


def test_impacts_that_determine_only_some_fields_lead_to_all() -> None:
    fitted = fit(filmed(LAB, 1.3, seed=1, jack=(0.03, 0.0, 0.5, 0.3, -0.2, 2.0)), FIELDS, far(LAB))
    assert fitted.problems == ()
    for name in FIELDS:
        assert getattr(fitted.scene, name) == pytest.approx(getattr(LAB, name), rel=0.01)


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
    assert fits[0].scene.jack_mass == pytest.approx(fits[1].scene.jack_mass, rel=1e-5)


def test_a_recording_of_which_nothing_agrees_is_a_problem_and_counts_no_window_twice() -> None:
    junk, noise = np.full((40, 12), np.nan), dict(zip(STATE_NAMES, [3e-4, 3e-4, 4e-3] * 4, strict=True))
    junk[:, :6] = np.random.default_rng(1).normal(0.0, 0.1, (40, 6))
    fitted = fit([filmed(LAB, 1.0), Recording(junk, np.zeros(39), 1.0 / RATE)], FIELDS, LAB, noise=noise)
    assert "no part of recording 1 agrees with the scene" in fitted.problems, fitted.problems
    assert fitted.left_out >= 39
    assert fitted.unexplained >= 0.0


def test_rows_that_agree_with_the_fitted_motion_are_no_bad_rows() -> None:
    elastic = LAB.changed(restitution=1.0)
    assert fit(filmed(elastic), FIELDS, elastic).bad_rows == ()
    assert fit(filmed(elastic, 1.7), FIELDS, elastic).bad_rows == ()  # row 64 is between two impacts, and left out


def test_a_recording_that_is_wrong_is_named_and_does_not_spoil_the_others() -> None:
    other = LAB.changed(jack_arm=0.06, jack_mass=0.3)
    fitted = fit([filmed(other, 1.7), filmed(LAB, 1.7)], FIELDS, far(LAB))
    assert any("recording 0" in problem for problem in fitted.problems), fitted.problems
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
    recording = filmed(LAB, 1.3)
    problems = fit(recording, FIELDS, LAB, noise=1.0).problems  # it is 0.3 mm
    assert "the search did not end" in problems
    assert evaluated[0] < 300 * len(recording.states)
