"""What a study comes to: which fidelities are safe for learning, and which settings differ from exact."""

from __future__ import annotations

import math
import warnings
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike
from scipy import stats

from scripts.studies.transfer import inference
from scripts.studies.transfer.inference import Estimate, Floats

EXACT = "exact"
MARGIN = 0.05  # of the return, what may be lost and still be called safe; chosen before anything was measured

Samples = Mapping[str, Mapping[str, Floats]]  # setting -> statistic -> one number per episode


class Finding(NamedTuple):
    """The result of training on a fidelity."""

    fidelity: str  # trained on
    exact: float  # mean return trained and run on exact
    trainings: Sequence[float]  # mean return of each, run on exact
    loss: Estimate  # run on exact: trained on the fidelity less trained on exact
    shift: Estimate  # trained on the fidelity: run on it less run on exact, so how far its own evaluation overstates
    starts: float = 0.0  # half width of the loss that the starts leave, however many trainings there are
    needed: int | None = None  # trainings of each kind that would show it safe, see inference.trainings_needed

    @property
    def margin(self) -> float:
        """What may be lost and still be called safe."""
        return MARGIN * abs(self.exact)

    @property
    def learning(self) -> str:
        """``safe``, ``harmful`` (loses more than the margin), ``worse`` (loses, how much is open), or ``undecided``."""
        if self.fidelity == EXACT:
            return "reference"
        if self.loss.low >= -self.margin:
            return "safe"
        if self.loss.high < -self.margin:
            return "harmful"
        return "worse" if self.loss.high < 0.0 else "undecided"

    @property
    def promise(self) -> str:
        """``honest`` (within the margin), ``too high``, ``too low`` or ``undecided``."""
        if self.shift.low >= -self.margin and self.shift.high <= self.margin:
            return "honest"
        if self.shift.low > 0.0:
            return "too high"
        return "too low" if self.shift.high < 0.0 else "undecided"


def finding(trained: Mapping[str, Mapping[str, ArrayLike]], fidelity: str) -> Finding:
    """The result of training on ``fidelity``; ``trained`` maps trained on -> run on -> returns (seeds, starts)."""
    cells = trained[fidelity][fidelity], trained[fidelity][EXACT], trained[EXACT][EXACT]
    own, on_exact, best = (np.asarray(returns, dtype=np.float64) for returns in cells)
    exact, starts = float(best.mean()), inference.starts_half_width(on_exact, best)
    return Finding(
        fidelity=fidelity,
        exact=exact,
        trainings=on_exact.mean(axis=1).tolist(),
        loss=inference.crossed_difference(on_exact, best),
        shift=inference.crossed_estimate(own - on_exact),  # the same policies from the same starts: paired
        starts=starts,
        needed=inference.trainings_needed(on_exact.mean(axis=1), best.mean(axis=1), MARGIN * abs(exact), starts),
    )


class Comparison(NamedTuple):
    """One statistic of one setting under one kind of torque against exact; one number per episode in each."""

    condition: str  # what turns the box
    setting: str
    statistic: str  # its name with its unit
    exact: float  # mean over the episodes on exact
    difference: Estimate  # of the means, setting less exact; NaN and infinitely wide where no episode has the number
    distance: float  # of the distributions (Kolmogorov and Smirnov)
    mean_probability: float  # that the means differ so much by chance, after Holm over all comparisons
    shape_probability: float  # that the distributions differ so much by chance, likewise
    seen: float  # difference of means that would have been seen with probability 0.8
    episodes: tuple[int, int]  # on exact and on the setting, those that have the number

    @property
    def differs(self) -> bool:
        """Whether the setting is shown to differ from exact."""
        return min(self.mean_probability, self.shape_probability) < inference.LEVEL


def compare(runs: Mapping[str, Samples]) -> list[Comparison]:
    """Compare every setting with exact in every statistic and condition; all tests are one family for Holm."""
    tests = 2 * sum(len(samples[EXACT]) * (len(samples) - 1) for samples in runs.values())
    found = [
        _row((condition, setting, statistic), values[statistic], reference, tests)
        for condition, samples in runs.items()
        for setting, values in samples.items()
        for statistic, reference in samples[EXACT].items()
        if setting != EXACT
    ]
    adjusted = inference.holm([row.mean_probability for row in found] + [row.shape_probability for row in found])
    return [
        row._replace(mean_probability=mean, shape_probability=shape)
        for row, mean, shape in zip(found, adjusted, adjusted[len(found) :], strict=False)
    ]


def _row(names: tuple[str, str, str], measured: Floats, reference: Floats, tests: int) -> Comparison:
    """One comparison before Holm. Jacks that were lost are not among the values; without an impact some are NaN.

    Counts of impacts have ties. Ties make the probability of ``ks_2samp`` too large, never too small, so they add no
    false alarms. Welch's test finds differences of counts that it may miss.
    """
    one, other = (part[~np.isnan(part)] for part in (measured, reference))
    episodes, exact = (len(other), len(one)), float(other.mean()) if len(other) else math.nan
    if not len(one) or not len(other):
        return Comparison(*names, exact, Estimate(math.nan, math.inf), math.nan, 1.0, 1.0, math.inf, episodes)
    difference, by_chance = inference.welch(one, other)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)  # a tiny distance may round to a probability above 1
        distance, shape = map(float, stats.ks_2samp(one, other))
    seen = inference.would_have_been_seen(
        math.hypot(inference.standard_error(one), inference.standard_error(other)), tests
    )
    return Comparison(*names, exact, difference, distance, by_chance, shape, seen, episodes)
