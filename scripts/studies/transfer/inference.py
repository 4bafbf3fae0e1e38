"""What a few trainings and many episodes can tell: intervals, tests of equality, what a test would have seen.

Samples are independent numbers, one per training or one per episode: what follows within an episode is correlated and
enters as one number.
"""

from __future__ import annotations

import math
from bisect import bisect_left
from collections.abc import Sequence
from statistics import NormalDist
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]

LEVEL = 0.05  # chance of a false alarm that is accepted
POWER = 0.8  # chance with which "would have been seen" is meant
_PERMUTATIONS = 9999
MOST_TRAININGS = 1000  # nobody trains more to settle a question
_ENOUGH = 20  # as large: no further permutations are drawn
_AT_ONCE = 500  # permutations held in memory together


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


def student_probability(t: float, degrees: int) -> float:
    """Probability that \\|T\\| < t >= 0 for Student's T: the finite sums of Abramowitz and Stegun 26.7.3 and 26.7.4."""
    angle = math.atan(t / math.sqrt(degrees))
    cosine = math.cos(angle)
    odd = degrees % 2
    term, total = (cosine, 0.0) if odd else (1.0, 0.0)
    for k in range(1 + odd, degrees, 2):
        total += term
        term *= cosine * cosine * k / (k + 1)
    return 2.0 / math.pi * (angle + math.sin(angle) * total) if odd else math.sin(angle) * total


def student_quantile(degrees: int, inside: float = 1.0 - LEVEL) -> float:
    """The t that Student's \\|T\\| stays below with probability ``inside``, by bisection; e.g. 2.776 for 4 degrees."""
    low, high = 0.0, 1.0
    while student_probability(high, degrees) < inside:
        high *= 2.0
    for _ in range(80):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if student_probability(middle, degrees) < inside else (low, middle)
    return 0.5 * (low + high)


def standard_error(values: ArrayLike) -> float:
    """Standard error of the mean of independent numbers; infinite for a single one."""
    sample = np.asarray(values, dtype=np.float64)
    return float(sample.std(ddof=1)) / math.sqrt(len(sample)) if len(sample) > 1 else math.inf


def t_estimate(values: ArrayLike) -> Estimate:
    """Mean and 95 % t-interval of independent numbers; infinitely wide for a single one."""
    sample = np.asarray(values, dtype=np.float64)
    half = student_quantile(len(sample) - 1) * standard_error(sample) if len(sample) > 1 else math.inf
    return Estimate(float(sample.mean()), half)


def crossed_estimate(values: ArrayLike) -> Estimate:
    """Mean over trainings and starts, shape (trainings, starts), each training run from the same starts.

    Another training and other starts would each give another mean: the half width is the root of the squares of the
    t-interval over the trainings' means and of the one over the starts' means. What is neither counts in both, so the
    interval is rather too wide than too narrow.
    """
    table = np.asarray(values, dtype=np.float64)
    halves = t_estimate(table.mean(axis=1)).half_width, t_estimate(table.mean(axis=0)).half_width
    return Estimate(float(table.mean()), math.hypot(*halves))


def crossed_difference(one: ArrayLike, other: ArrayLike) -> Estimate:
    """Mean of ``one`` less that of ``other``, both shape (trainings, starts), other trainings run from the same starts.

    The trainings are independent (Welch's interval), the starts are paired; combined as in :func:`crossed_estimate`.
    """
    a, b = (np.asarray(table, dtype=np.float64) for table in (one, other))
    over_trainings = welch(a.mean(axis=1), b.mean(axis=1)).half_width
    return Estimate(float(a.mean() - b.mean()), math.hypot(over_trainings, starts_half_width(a, b)))


def starts_half_width(one: ArrayLike, other: ArrayLike) -> float:
    """The starts' part of :func:`crossed_difference`: more trainings leave it, more episodes make it smaller."""
    a, b = (np.asarray(table, dtype=np.float64) for table in (one, other))
    return t_estimate(a.mean(axis=0) - b.mean(axis=0)).half_width


def trainings_needed(one: ArrayLike, other: ArrayLike, margin: float, starts: float = 0.0) -> int | None:
    """How many trainings of each kind show with ``POWER`` that no more than ``margin`` is lost, if nothing is.

    With n of each, (t + z) s sqrt(2 / n) + ``starts`` is at most the margin: t is the interval's quantile; without z,
    the normal quantile of ``POWER``, chance would push the interval over the margin every other time.

    Args:
        one, other: what trainings came to, shape (trainings,) each; s is their pooled spread.
        margin: what may be lost, >= 0.
        starts: half width that the starts leave, however many trainings there are.

    Returns:
        None where ``MOST_TRAININGS`` do not suffice, or where a single one of each tells no spread.
    """
    a, b = (np.asarray(sample, dtype=np.float64) for sample in (one, other))
    if len(a) + len(b) < 3:
        return None
    squares = float(((a - a.mean()) ** 2).sum() + ((b - b.mean()) ** 2).sum())
    spread = math.sqrt(squares / (len(a) + len(b) - 2))
    power = NormalDist().inv_cdf(POWER)

    def enough(count: int) -> bool:
        reach = (student_quantile(2 * count - 2) + power) * spread * math.sqrt(2.0 / count)
        return reach + starts <= margin

    counts = range(2, MOST_TRAININGS + 1)
    found = bisect_left(counts, True, key=enough)
    return counts[found] if found < len(counts) else None


def failures_not_excluded(trainings: int) -> float:
    """The largest share of trainings that may fail although none of ``trainings`` did, at 95 %; normal or not."""
    return float(1.0 - LEVEL ** (1.0 / trainings))


def welch(one: ArrayLike, other: ArrayLike) -> Estimate:
    """Difference of the means of two independent samples with Welch's 95 % interval, degrees rounded down."""
    a, b = (np.asarray(sample, dtype=np.float64) for sample in (one, other))
    difference = float(a.mean() - b.mean())
    if min(len(a), len(b)) < 2:
        return Estimate(difference, math.inf)
    parts = [standard_error(sample) ** 2 for sample in (a, b)]
    total = sum(parts)
    if total == 0.0:
        return Estimate(difference, 0.0)
    degrees = total**2 / sum(part**2 / (len(sample) - 1) for part, sample in zip(parts, (a, b), strict=True))
    # beyond some thousand degrees the quantile no longer changes in its third digit
    return Estimate(difference, student_quantile(min(int(degrees + 1e-9), 10_000)) * math.sqrt(total))


def ks_statistic(one: ArrayLike, other: ArrayLike) -> float:
    """Kolmogorov and Smirnov's: the largest distance of the two empirical distributions."""
    return float(_ks(np.concatenate([one, other]), _labels(len(np.asarray(one)), len(np.asarray(other)))[None])[0])


def ks_test(one: ArrayLike, other: ArrayLike, rng: np.random.Generator, permutations: int = _PERMUTATIONS) -> float:
    """Probability of so large a distance of the distributions if the samples differed in nothing, by permutation.

    Holds for any distribution and for ties; it cannot be below 1 / (permutations + 1). Where equality is plain it ends
    early (Besag and Clifford 1991, "Sequential Monte Carlo p-values"): after 20 distances as large, of n drawn, 20 / n.
    """
    pooled = np.concatenate([one, other]).astype(np.float64)
    labels = _labels(len(np.asarray(one)), len(np.asarray(other)))
    found = _ks(pooled, labels[None])[0]
    as_large = 0
    for begin in range(0, permutations, _AT_ONCE):
        rows = np.tile(labels, (min(_AT_ONCE, permutations - begin), 1))
        reached = as_large + np.cumsum(_ks(pooled, rng.permuted(rows, axis=1)) >= found - 1e-12)
        if reached[-1] >= _ENOUGH:
            return _ENOUGH / (begin + int(np.argmax(reached >= _ENOUGH)) + 1)
        as_large = int(reached[-1])
    return (as_large + 1) / (permutations + 1)


def _labels(first: int, second: int) -> Floats:
    """What each value adds to the distance of the two distributions: 1 / first, or -1 / second."""
    return np.concatenate([np.full(first, 1.0 / first), np.full(second, -1.0 / second)])


def _ks(pooled: Floats, labels: Floats) -> Floats:
    """Largest distance for each row of labels, shape (rows, n)."""
    order = np.argsort(pooled, kind="stable")
    values = pooled[order]
    last_of_ties = np.append(values[1:] != values[:-1], True)  # between equal values there is no distance
    distances: Floats = np.abs(np.cumsum(labels[:, order], axis=1)[:, last_of_ties]).max(axis=1)
    return distances


def holm(probabilities: Sequence[float]) -> list[float]:
    """Holm's adjusted probabilities: refusing those below the level keeps the chance of any false alarm below it."""
    order = np.argsort(probabilities, kind="stable")
    adjusted, running = [0.0] * len(order), 0.0
    for rank, index in enumerate(order):
        running = max(running, min(1.0, (len(order) - rank) * probabilities[index]))
        adjusted[int(index)] = running
    return adjusted


def would_have_been_seen(error: float, tests: int) -> float:
    """The difference of means that ``tests`` tests together, each on Holm's strictest step, find with ``POWER``.

    Args:
        error: standard error of the difference.
        tests: how many there are.
    """
    normal = NormalDist()
    return error * (normal.inv_cdf(1.0 - LEVEL / (2.0 * tests)) + normal.inv_cdf(POWER))


def two_sided(estimate: Estimate) -> float:
    """Probability of so large a mean if the true one were 0, from a 95 % interval of many degrees of freedom."""
    if not math.isfinite(estimate.half_width):
        return 1.0
    if estimate.half_width == 0.0:
        return 1.0 if estimate.mean == 0.0 else 0.0
    deviations = abs(estimate.mean) / estimate.half_width * NormalDist().inv_cdf(1.0 - LEVEL / 2.0)
    return 2.0 * (1.0 - NormalDist().cdf(deviations))


def quantiles(values: Any, at: Sequence[float] = (0.1, 0.5, 0.9)) -> list[float]:
    """Quantiles as plain numbers."""
    return [float(value) for value in np.quantile(np.asarray(values, dtype=np.float64), at)]
