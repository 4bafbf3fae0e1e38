"""The measures of accuracy, on courses whose errors are known."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jackbox_env import Impact, Scene, make_simulator
from jackbox_env.measure.accuracy import Case, Course, at_ends, follow, pose_errors
from jackbox_env.model.tasks import sample_start
from jackbox_env.simulators.base import JackLostError, StepResult
from jackbox_env.simulators.exact import UNSCORED, ExactSimulator, Scoring
from jackbox_env.simulators.replay import flown
from scripts.referee import prefix_errors
from scripts.studies.accuracy.comparing import compare, reference_of, restarts
from tests.states import WEIGHTLESS, Array, at

Hit = tuple[float, int, int]


def hits(*listed: Hit) -> list[Impact]:
    return [Impact(time, wall, foot, 1.0) for time, wall, foot in listed]


def flying_at_a_wall(speed: float = 10.0) -> Array:
    """Foot 0 ahead, 5 m from the wall at x = 6 m."""
    return at(vx_jack=speed)


# -- matching impacts --------------------------------------------------------------------------------------------------

ONE, TWO, THREE = (1.0, 0, 0), (2.0, 1, 3), (3.0, 2, 1)
CLOSE = [ONE, (1.001, 0, 1), (2.0, 1, 1)]


@pytest.mark.parametrize(
    ("simulated", "reference", "errors"),
    [
        ([(1.1, 0, 0), (1.8, 1, 3)], [ONE, TWO, THREE], [0.1, 0.2]),
        ([(1.1, 0, 0), (1.8, 1, 2), THREE], [ONE, TWO, THREE], [0.1]),
        ([ONE, (1.5, 3, 3), TWO], [ONE, TWO, THREE], [0.0]),
        ([], [ONE], []),
        # recorded at one time they have no order, later ones do
        ([(1.005, 0, 1), (1.005, 0, 0), (2.0, 1, 1)], CLOSE, [0.005, 0.004, 0.0]),
        ([(1.005, 0, 1), (1.006, 0, 0), (2.0, 1, 1)], CLOSE, []),
        ([ONE, (1.1, 0, 1), (2.0, 1, 1)], [(1.0, 0, 1), ONE, (2.0, 1, 1)], [0.1, 0.0, 0.0]),
        ([(1.005, 0, 1)], CLOSE, []),
    ],
)
def test_impacts_are_matched_as_far_as_walls_and_feet_agree(
    simulated: list[Hit], reference: list[Hit], errors: list[float]
) -> None:
    assert prefix_errors(hits(*simulated), hits(*reference)) == pytest.approx(errors)


def test_pose_errors_are_the_farthest_that_a_wall_or_a_foot_is_off() -> None:
    scene, reference = Scene(), np.zeros((5, 12))
    states = reference.copy()
    states[0, [0, 1]] = 3.0, 4.0
    states[1, 2] = -0.5  # 6 m away at the walls
    states[2, [3, 4]] = 0.3, -0.4
    states[3, 5] = 0.25  # 1 m away at the feet
    states[4, 6:] = 100.0  # rates are no pose
    np.testing.assert_allclose(pose_errors(scene, states, reference), [5.0, 3.0, 0.5, 0.25, 0.0])


# -- what happens inside a step ----------------------------------------------------------------------------------------


def test_penetration_is_seen_where_the_contact_was_resolved() -> None:
    # 5 m at 10 m/s: on the wall after 0.5 s, which substeps of h = 0.015 s reach in the 34th, 0.1 m too far
    case = Case("straight", WEIGHTLESS, flying_at_a_wall(), 20, None, 0.03)
    course = follow(make_simulator(WEIGHTLESS, substeps=2), case)
    assert [(round(hit.time, 9), hit.wall, hit.foot) for hit in course.impacts] == [(0.51, 0, 0)]
    assert course.depth == pytest.approx(0.1)
    # ... and with h = 0.004 s in the 125th, just there, though no control step ends with a foot in a wall
    inside = Case("straight", WEIGHTLESS, flying_at_a_wall(11.0), 60, None, 0.02)
    course = follow(make_simulator(WEIGHTLESS, substeps=5), inside)
    assert course.depth == pytest.approx(11.0 * 0.456 - 5.0)
    assert max(course.states[:, 3]) - 5.0 < course.depth - 1e-3
    assert abs(follow(make_simulator(WEIGHTLESS, "exact"), inside).depth) < 1e-12


def test_energy_that_comes_from_nowhere_is_seen() -> None:
    class Heater(ExactSimulator):
        def stepped(self, dt: float, torque: float | None, scoring: Scoring = UNSCORED) -> StepResult:
            result = super().stepped(dt, torque)
            return result._replace(state=result.state * np.where(np.arange(12) == 9, 1.001, 1.0))

    case = Case("straight", WEIGHTLESS, flying_at_a_wall(), 10)
    honest, heated = (follow(kind(WEIGHTLESS), case) for kind in (ExactSimulator, Heater))
    assert honest.imbalance < 1e-12 * honest.energy
    gained = 0.5 * 4.0 * 10.0**2 * (1.001**20 - 1.0)
    assert heated.imbalance == pytest.approx(gained)
    assert heated.energy == pytest.approx(200.0 + gained)


# -- escapes -----------------------------------------------------------------------------------------------------------


class Ghost(ExactSimulator):
    """Flies through walls and keeps its energy."""

    def stepped(self, dt: float, torque: float | None, scoring: Scoring = UNSCORED) -> StepResult:
        return StepResult(np.array(flown(self.scene, self.state.tolist(), self.time, dt, torque)), self.time + dt)


class Coward(ExactSimulator):
    """Gives up at walls."""

    def stepped(self, dt: float, torque: float | None, scoring: Scoring = UNSCORED) -> StepResult:
        result = super().stepped(dt, torque)
        if result.impacts:
            raise JackLostError("the jack would leave the box")
        return result


@pytest.mark.parametrize("kind", [Ghost, Coward])
def test_a_jack_that_is_lost_is_reported_and_its_course_ends(kind: type[ExactSimulator]) -> None:
    # at 11 m/s the foot hits in the 23rd step and is 1 m outside in the 28th
    case = Case("straight", WEIGHTLESS, flying_at_a_wall(11.0), 100)
    assert not follow(ExactSimulator(WEIGHTLESS), case).escaped
    course = follow(kind(WEIGHTLESS), case)
    assert course.escaped
    assert len(course.states) == {Ghost: 1 + 28, Coward: 1 + 22}[kind]
    assert course.imbalance < 1e-9  # energy alone proves nothing


# -- references and comparisons ----------------------------------------------------------------------------------------


CHIRPED = Case("chirp", Scene(), sample_start(Scene(), np.random.default_rng(5)), 1000)


def test_a_reference_is_sure_of_as_many_impacts_as_rounding_allows() -> None:
    reference = reference_of(CHIRPED)
    assert 5 <= reference.sure < len(reference.impacts)  # chaos wins within 20 s
    assert reference.states.shape == (1001, 12)
    assert reference.times[-1] == pytest.approx(20.0)
    short = reference_of(CHIRPED._replace(steps=100))
    assert short.sure == len(short.impacts)
    far = CHIRPED.state + 1e5 * (np.eye(12)[0] + np.eye(12)[3])
    assert reference_of(CHIRPED._replace(state=far)).sure <= reference.sure


def test_the_exact_model_has_no_error_against_itself_and_a_late_one_has_its_delay() -> None:
    case = CHIRPED._replace(steps=250)
    reference = reference_of(case)
    same = Course(reference.states, reference.impacts, 0.0, 0.0, 1.0, False)
    assert compare(case, same, reference) == (0.0, [0.0] * reference.sure, reference.sure)
    late = [impact._replace(time=impact.time + 0.003) for impact in reference.impacts]
    course = same._replace(states=reference.states + 0.02 * np.eye(12)[3], impacts=late)
    comparison = compare(case, course, reference)
    assert comparison.errors == pytest.approx([0.003] * reference.sure)
    assert comparison.flight == pytest.approx(0.02)
    wrong = [late[0], late[1]._replace(foot=(late[1].foot + 1) % 4), *late[2:]]
    assert compare(case, course._replace(impacts=wrong), reference).errors == pytest.approx([0.003])


def test_restarts_count_what_is_missed_and_what_is_extra() -> None:
    class Nervous(ExactSimulator):
        def stepped(self, dt: float, torque: float | None, scoring: Scoring = UNSCORED) -> StepResult:
            result = super().stepped(dt, torque)
            return result._replace(impacts=(*result.impacts, Impact(result.time - 0.001, 3, 3, 1.0)))

    # 11 m/s: hits at 0.4545 s, in the middle of the restart from 0.4 s
    case = Case("straight", WEIGHTLESS, flying_at_a_wall(11.0), 50)
    reference = reference_of(case)
    fine, ghost, nervous, coward = (
        restarts(kind(WEIGHTLESS), case, reference) for kind in (ExactSimulator, Ghost, Nervous, Coward)
    )
    assert fine == ([0.0], 0, 0, 1)  # the other nine are flight
    assert ghost.errors == pytest.approx([2.0 * 11.0 * (0.5 - 5.0 / 11.0)], rel=0.05)  # it goes on instead of back
    assert ghost[1:] == (1, 0, 1)
    assert (nervous.missed, nervous.extra) == (0, 10 * 4)  # what comes in the last control step might be paired later
    assert coward == ([math.inf], 1, 0, 1)


def test_steps_too_long_to_be_played_once_more_give_nan_rather_than_a_wrong_number() -> None:
    # a second of a box at some 50 rad/s: hundreds of impacts in one step, each multiplies the replay's rounding by 5
    start = at(x_jack=0.5, theta_jack=0.3, omega_box=60.0)
    case = Case("fast box", Scene(drive=None), start, 20, None, 1.0)
    exact = make_simulator(case.scene, "exact")
    course, ends = follow(exact, case), follow(exact, case, at_ends)
    assert len(course.impacts) > 1000
    assert np.isnan([course.depth, course.imbalance, ends.imbalance]).all()
    assert -1.0 < ends.depth < 1e-9
