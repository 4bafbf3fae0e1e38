"""Intervals and tests of equality, held against published tables, hand-worked examples and repeated chance."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from scripts.studies.transfer.inference import (
    crossed_difference,
    crossed_estimate,
    holm,
    starts_half_width,
    t_estimate,
    trainings_needed,
    welch,
    would_have_been_seen,
)

# Student's own data of 1908: hours of sleep gained by ten patients on each of two drugs
DRUG_ONE = [0.7, -1.6, -0.2, -1.2, -0.1, 3.4, 3.7, 0.8, 0.0, 2.0]
DRUG_TWO = [1.9, 0.8, 1.1, 0.1, -0.1, 4.4, 5.5, 1.6, 4.6, 3.4]


@pytest.mark.parametrize(
    ("degrees", "published"), [(1, 12.706), (2, 4.303), (4, 2.776), (5, 2.571), (10, 2.228), (30, 2.042), (120, 1.980)]
)
def test_intervals_are_as_wide_as_the_tables_of_student_say(degrees: int, published: float) -> None:
    sample = np.random.default_rng(degrees).normal(3.0, 2.0, degrees + 1)
    found = t_estimate(sample)
    error = math.sqrt(sum((value - sample.mean()) ** 2 for value in sample) / degrees / (degrees + 1))
    assert found.mean == pytest.approx(sample.mean())
    assert found.half_width / error == pytest.approx(published, abs=5e-4)


def test_a_single_number_has_an_infinitely_wide_interval() -> None:
    assert t_estimate([5.0]) == (5.0, math.inf)
    assert welch([1.0], [2.0, 3.0]) == ((-1.5, math.inf), 1.0)


def test_the_interval_and_probability_of_welch_are_the_published_ones() -> None:
    # R's t.test(extra ~ group, data = sleep): t = -1.8608, df = 17.776, p-value = 0.07939, -3.3654832 0.2054832
    difference, by_chance = welch(DRUG_ONE, DRUG_TWO)
    assert (difference.low, difference.high) == pytest.approx((-3.3654832, 0.2054832), abs=1e-7)
    assert difference.mean == pytest.approx(-1.58)
    assert by_chance == pytest.approx(0.07939, abs=5e-6)


def test_samples_without_spread_differ_surely_or_not_at_all() -> None:
    assert welch([2.0, 2.0], [1.0, 1.0]) == ((1.0, 0.0), 0.0)
    assert welch([1.0, 1.0], [1.0, 1.0]) == ((0.0, 0.0), 1.0)
    # one without spread: Student's interval of the other
    difference, _ = welch([0.0, 0.0], [1.0, 2.0, 3.0])
    assert difference == pytest.approx((-2.0, t_estimate([1.0, 2.0, 3.0]).half_width))


def drawn(
    rng: np.random.Generator, starts: NDArray[np.float64], trainings: int, mean: float = 0.0
) -> NDArray[np.float64]:
    """Returns, shape (trainings, starts): effects of the training, of the start and of chance."""
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


def test_trainings_and_starts_both_widen_an_interval() -> None:
    # two means that differ by 2: error 1, t_1 = 12.706
    assert crossed_estimate([[1.0, 1.0], [3.0, 3.0]]) == pytest.approx((2.0, 12.7062), abs=1e-4)
    assert crossed_estimate([[1.0, 3.0], [1.0, 3.0]]) == pytest.approx((2.0, 12.7062), abs=1e-4)
    assert crossed_estimate([[0.0, 2.0], [2.0, 4.0]]) == pytest.approx((2.0, 12.7062 * math.sqrt(2.0)), abs=1e-4)


def test_pairing_by_start_takes_the_starts_out_of_a_difference() -> None:
    rng = np.random.default_rng(1)
    starts = 100.0 * rng.normal(size=(1, 64))
    one, other = drawn(rng, starts, 3), drawn(rng, starts, 3)
    assert crossed_difference(one, other).half_width < 12.0
    assert crossed_difference(one, rng.permuted(other, axis=1)).half_width > 20.0


def test_the_part_of_the_starts_stays_however_many_trainings_there_are() -> None:
    rng = np.random.default_rng(12)
    # what a start adds to one of the two only: standard error 4 / sqrt(64), t_63 = 1.998
    effect = 4.0 * rng.normal(size=(1, 64))
    few, many = (starts_half_width(rng.normal(size=(n, 64)) + effect, rng.normal(size=(n, 64))) for n in (4, 400))
    own = 1.998 * float(effect.std(ddof=1)) / 8.0
    assert many == pytest.approx(own, rel=0.02)
    assert few == pytest.approx(own, rel=0.2)


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
    shown = sum(welch(rng.normal(size=count), rng.normal(size=count))[0].low >= -1.2 for _ in range(1000))
    assert 0.76 * 1000 <= shown <= 0.86 * 1000


def test_holm_worked_by_hand() -> None:
    assert holm([0.01, 0.04, 0.03]) == pytest.approx([0.03, 0.06, 0.06])
    assert holm([0.5, 0.9]) == pytest.approx([1.0, 1.0])
    assert holm([]) == []


@pytest.mark.parametrize("tests", [1, 100])
def test_the_difference_that_would_have_been_seen_is_seen_four_times_in_five(tests: int) -> None:
    rng = np.random.default_rng(4)
    planted = would_have_been_seen(math.sqrt(2.0 / 200.0), tests)
    seen = sum(welch(rng.normal(size=200) + planted, rng.normal(size=200))[1] < 0.05 / tests for _ in range(400))
    assert 0.74 * 400 <= seen <= 0.86 * 400
