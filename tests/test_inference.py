"""Intervals and tests of equality, held against published tables, hand-worked examples and repeated chance."""

from __future__ import annotations

import math

import mpmath
import numpy as np
import pytest
from numpy.typing import NDArray

from scripts.studies.transfer.inference import (
    crossed_difference,
    crossed_estimate,
    failures_not_excluded,
    holm,
    ks_statistic,
    ks_test,
    starts_half_width,
    student_probability,
    student_quantile,
    t_estimate,
    trainings_needed,
    two_sided,
    welch,
    would_have_been_seen,
)

# -- intervals --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("degrees", "published"), [(1, 12.706), (2, 4.303), (4, 2.776), (5, 2.571), (10, 2.228), (30, 2.042), (120, 1.980)]
)
def test_quantiles_of_student_are_those_of_the_tables(degrees: int, published: float) -> None:
    assert student_quantile(degrees) == pytest.approx(published, abs=5e-4)


@pytest.mark.parametrize("degrees", [1, 2, 3, 7, 8, 50, 1023])
@pytest.mark.parametrize("t", [0.1, 1.0, 3.0])
def test_probabilities_of_student_are_the_incomplete_beta_function(degrees: int, t: float) -> None:
    beyond = mpmath.betainc(degrees / 2, 0.5, 0, degrees / (degrees + t * t), regularized=True)
    assert student_probability(t, degrees) == pytest.approx(1.0 - float(beyond), abs=1e-12)


def test_intervals_of_small_samples_worked_by_hand() -> None:
    # sd 1, n 3: 4.3027 / sqrt(3)
    assert t_estimate([1.0, 2.0, 3.0]) == pytest.approx((2.0, 2.4841), abs=1e-4)
    assert t_estimate([5.0]).half_width == math.inf
    # variances 5/3 and 10: error^2 = 5/12 + 2, degrees 5.52 -> 5, 2.5706 sqrt(2.41667)
    assert welch([1, 2, 3, 4], [2, 4, 6, 8, 10]) == pytest.approx((-3.5, 3.9962), abs=1e-4)
    assert welch([1.0], [2.0, 3.0]) == (-1.5, math.inf)
    assert welch([2.0, 2.0], [1.0, 1.0]) == (1.0, 0.0)


def drawn(
    rng: np.random.Generator, starts: NDArray[np.float64], trainings: int, mean: float = 0.0
) -> NDArray[np.float64]:
    """Returns (trainings, starts): of a training, of a start, and of chance."""
    trained = rng.normal(size=(trainings, 1))
    return mean + trained + starts + 3.0 * rng.normal(size=(trainings, starts.shape[-1]))


def test_intervals_over_trainings_and_starts_hold_the_truth_and_pooled_ones_do_not() -> None:
    rng = np.random.default_rng(0)
    held, pooled_held, difference_held = 0, 0, 0
    for _ in range(400):
        starts = 2.0 * rng.normal(size=(1, 32))
        one, other = drawn(rng, starts, 3), drawn(rng, starts, 3, mean=1.0)
        held += abs(crossed_estimate(one).mean) <= crossed_estimate(one).half_width
        pooled_held += abs(t_estimate(one.ravel()).mean) <= t_estimate(one.ravel()).half_width
        difference = crossed_difference(other, one)
        difference_held += difference.low <= 1.0 <= difference.high
    assert held >= 0.93 * 400
    assert difference_held >= 0.93 * 400
    assert pooled_held < 0.85 * 400  # episodes of one training are no independent trainings


def test_pairing_by_start_takes_the_starts_out_of_a_difference() -> None:
    rng = np.random.default_rng(1)
    starts = 100.0 * rng.normal(size=(1, 64))
    one, other = drawn(rng, starts, 3), drawn(rng, starts, 3)
    assert crossed_difference(one, other).half_width < 12.0
    assert crossed_difference(one, rng.permuted(other, axis=1)).half_width > 20.0


def test_the_trainings_needed_worked_by_hand() -> None:
    # pooled variance (2 + 2) / 4 = 1: (t_18 + 0.842) sqrt(2 / 10) = 1.316, (t_16 + 0.842) sqrt(2 / 9) = 1.396
    one, other = [1.0, 2.0, 3.0], [11.0, 12.0, 13.0]
    assert trainings_needed(one, other, 1.32) == 10
    assert trainings_needed(one, other, 1.40) == 9
    assert trainings_needed(one, other, 1.52, starts=0.2) == 10
    assert trainings_needed([1.0, 1.0], [2.0, 2.0], 0.1) == 2
    assert trainings_needed([1.0], [2.0], 0.1) is None


def test_the_trainings_needed_have_no_number_beyond_a_thousand_or_where_the_starts_alone_are_too_wide() -> None:
    one, other = [1.0, 2.0, 3.0], [11.0, 12.0, 13.0]
    # (1.961 + 0.842) sqrt(2 / 1000) = 0.1254
    assert trainings_needed(one, other, 0.126) in range(980, 1001)
    assert trainings_needed(one, other, 0.125) is None
    assert trainings_needed(one, other, 1.32, starts=1.3) is None


def test_as_many_trainings_as_needed_show_four_times_in_five_that_nothing_is_lost() -> None:
    rng = np.random.default_rng(11)
    count = trainings_needed([-1.0, 0.0, 1.0], [-1.0, 0.0, 1.0], 1.2)  # spread 1
    assert count is not None
    shown = sum(welch(rng.normal(size=count), rng.normal(size=count)).low >= -1.2 for _ in range(1000))
    assert 0.76 * 1000 <= shown <= 0.86 * 1000


def test_the_part_of_the_starts_stays_however_many_trainings_there_are() -> None:
    rng = np.random.default_rng(12)
    # what a start adds to one of the two only: standard error 4 / sqrt(64), t_63 = 1.998
    effect = 4.0 * rng.normal(size=(1, 64))
    few, many = (starts_half_width(rng.normal(size=(n, 64)) + effect, rng.normal(size=(n, 64))) for n in (4, 400))
    own = 1.998 * float(effect.std(ddof=1)) / 8.0
    assert many == pytest.approx(own, rel=0.02)
    assert few == pytest.approx(own, rel=0.2)


@pytest.mark.parametrize("count", [1, 5, 58, 59])
def test_as_many_failures_as_are_not_excluded_stay_unseen_once_in_twenty(count: int) -> None:
    assert (1.0 - failures_not_excluded(count)) ** count == pytest.approx(0.05)
    # the rule of 59 trials: no failure among them shows fewer than 5 %
    assert (failures_not_excluded(count) < 0.05) == (count >= 59)


# -- tests of equality ------------------------------------------------------------------------------------------------


def test_the_distance_of_distributions_worked_by_hand() -> None:
    assert ks_statistic([1.0, 2.0], [3.0, 4.0]) == pytest.approx(1.0)
    assert ks_statistic([1.0, 3.0], [2.0, 4.0]) == pytest.approx(0.5)
    assert ks_statistic([1.0, 1.0, 2.0], [1.0, 1.0, 2.0]) == pytest.approx(0.0)  # ties are no distance
    assert ks_statistic([0.0, 0.0, 1.0, 1.0], [0.0, 1.0, 1.0, 1.0, 1.0]) == pytest.approx(0.3)


def test_the_test_of_distributions_finds_a_spread_that_means_do_not_show() -> None:
    rng = np.random.default_rng(2)
    narrow, wide = rng.normal(size=300), 2.0 * rng.normal(size=300)
    assert ks_test(narrow, wide, rng) < 0.001
    assert two_sided(welch(narrow, wide)) > 0.05


def test_the_test_of_distributions_raises_false_alarms_as_often_as_it_says() -> None:
    rng = np.random.default_rng(3)
    found = []
    for _ in range(400):
        one, other = rng.poisson(4.0, 40), rng.poisson(4.0, 40)  # with ties
        found.append(ks_test(one, other, rng, permutations=199))
    for level in (0.05, 0.5):  # settled by all permutations, and early
        deviation = math.sqrt(400 * level * (1.0 - level))
        alarms = int((np.array(found) <= level).sum())
        # fewer where ties make the distance coarse
        assert 400 * level - 5.0 * deviation <= alarms <= 400 * level + 3.0 * deviation


def test_holm_worked_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []


@pytest.mark.parametrize("tests", [1, 100])
def test_the_difference_that_would_have_been_seen_is_seen_four_times_in_five(tests: int) -> None:
    rng = np.random.default_rng(4)
    planted = would_have_been_seen(math.sqrt(2.0 / 200.0), tests)
    seen = sum(
        two_sided(welch(rng.normal(size=200) + planted, rng.normal(size=200))) < 0.05 / tests for _ in range(400)
    )
    assert 0.74 * 400 <= seen <= 0.86 * 400
