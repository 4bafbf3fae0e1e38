"""Intervals and tests for a few trainings and many episodes, by scipy.stats.

A sample holds independent numbers, one per training or one per episode. What follows within an episode is correlated
and enters as one number.
"""

from __future__ import annotations

import math
import warnings
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy import stats

Floats = NDArray[np.float64]

LEVEL = 0.05  # chance of a false alarm that is accepted
POWER = 0.8  # chance with which "would have been seen" is meant
MOST_TRAININGS = 1000  # nobody trains more to settle a question


class Estimate(NamedTuple):
    """A mean with the half width of its 95 % interval."""

    mean: float
    half_width: float

    @property
    def low(self) -> float:
        """Lower end of the interval."""
        return self.mean - self.half_width

    @property
    def high(self) -> float:
        """Upper end of the interval."""
        return self.mean + self.half_width


def standard_error(values: ArrayLike) -> float:
    """Standard error of the mean; infinite for a single number."""
    sample = np.asarray(values, dtype=np.float64)
    return float(stats.sem(sample)) if len(sample) > 1 else math.inf


def t_estimate(values: ArrayLike) -> Estimate:
    """Mean and Student's interval; infinitely wide for a single number."""
    sample = np.asarray(values, dtype=np.float64)
    quantile = float(stats.t.ppf(1.0 - LEVEL / 2.0, max(len(sample) - 1, 1)))
    return Estimate(float(sample.mean()), quantile * standard_error(sample))


def welch(one: ArrayLike, other: ArrayLike) -> tuple[Estimate, float]:
    """Difference of the means of two independent samples, and the probability of so large a one by chance.

    A single number has no spread: the interval is infinitely wide then, and the probability 1.
    """
    a, b = (np.asarray(sample, dtype=np.float64) for sample in (one, other))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # single numbers and samples without spread are meant
        found = stats.ttest_ind(a, b, equal_var=False)
        low, high = found.confidence_interval(1.0 - LEVEL)
    half = math.inf if math.isnan(low) else 0.5 * float(high - low)
    probability = 1.0 if math.isnan(found.pvalue) else float(found.pvalue)
    return Estimate(float(a.mean() - b.mean()), half), probability


def crossed_estimate(values: ArrayLike) -> Estimate:
    """Mean over trainings and starts, shape (trainings, starts), each training run from the same starts.

    The intervals over the trainings' means and over the starts' means are added by their squares. The
    remaining variance counts in both, so the interval is rather too wide than too narrow.
    """
    table = np.asarray(values, dtype=np.float64)
    halves = t_estimate(table.mean(axis=1)).half_width, t_estimate(table.mean(axis=0)).half_width
    return Estimate(float(table.mean()), math.hypot(*halves))


def crossed_difference(one: Floats, other: Floats) -> Estimate:
    """Mean of ``one`` less that of ``other``, both of shape (trainings, starts): other trainings, the same starts.

    The trainings are independent (Welch's interval), the starts are paired; combined as in :func:`crossed_estimate`.
    """
    difference, _ = welch(one.mean(axis=1), other.mean(axis=1))
    return Estimate(difference.mean, math.hypot(difference.half_width, starts_half_width(one, other)))


def starts_half_width(one: Floats, other: Floats) -> float:
    """The starts' part of :func:`crossed_difference`: more episodes shrink it, more trainings do not."""
    return t_estimate(one.mean(axis=0) - other.mean(axis=0)).half_width


def trainings_needed(one: ArrayLike, other: ArrayLike, margin: float, starts: float = 0.0) -> int | None:
    """Trainings of each kind needed to show, with probability ``POWER``, a loss of at most ``margin`` if there is none.

    With n of each, (t + z) s sqrt(2 / n) + ``starts`` is at most the margin. s is the pooled spread of the
    present trainings, t the interval's quantile, ``starts`` the half width that comes from the starts, and z the normal
    quantile of ``POWER``. Without z, chance would push the interval over the margin every other time. None if
    ``MOST_TRAININGS`` are not enough, or if there is one training of each kind, which shows no spread.
    """
    a, b = (np.asarray(sample, dtype=np.float64) for sample in (one, other))
    degrees = len(a) + len(b) - 2
    if degrees < 1:
        return None
    spread = math.sqrt((a.var() * len(a) + b.var() * len(b)) / degrees)
    counts = np.arange(2, MOST_TRAININGS + 1)
    quantiles = stats.t.ppf(1.0 - LEVEL / 2.0, 2 * counts - 2) + stats.norm.ppf(POWER)
    enough = counts[quantiles * spread * np.sqrt(2.0 / counts) + starts <= margin]
    return int(enough[0]) if len(enough) else None


def holm(probabilities: Sequence[float]) -> list[float]:
    """Holm's adjusted probabilities: refusing those below the level keeps the chance of any false alarm below it."""
    given = np.asarray(probabilities, dtype=np.float64)
    order, adjusted = np.argsort(given, kind="stable"), np.empty_like(given)
    adjusted[order] = np.minimum(1.0, np.maximum.accumulate(given[order] * np.arange(len(given), 0, -1)))
    return adjusted.tolist()  # type: ignore[no-any-return]


def would_have_been_seen(error: float, tests: int) -> float:
    """The difference of means that Holm's strictest step of so many tests detects with probability POWER."""
    return error * float(stats.norm.ppf(1.0 - LEVEL / (2.0 * tests)) + stats.norm.ppf(POWER))
