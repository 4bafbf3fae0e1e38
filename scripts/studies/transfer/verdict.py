"""What a study comes to: which fidelities are safe for learning, which differ from exact, computed from the numbers."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from scripts.studies.transfer.inference import (
    LEVEL,
    MOST_TRAININGS,
    POWER,
    Estimate,
    Floats,
    crossed_difference,
    crossed_estimate,
    failures_not_excluded,
    holm,
    ks_statistic,
    ks_test,
    standard_error,
    starts_half_width,
    t_estimate,
    trainings_needed,
    two_sided,
    welch,
    would_have_been_seen,
)

EXACT = "exact"
MARGIN = 0.05  # of the return, what may be lost and still be called safe; chosen before anything was measured


@dataclass(frozen=True)
class Finding:
    """What training on a fidelity came to.

    Attributes:
        task: what was rewarded.
        fidelity: trained on.
        exact: mean return trained and run on exact.
        own: mean return run on the fidelity trained on.
        loss: run on exact, trained on the fidelity less trained on exact.
        shift: trained on the fidelity, run on it less run on exact: what its own evaluation promises too much.
        trainings: of each kind.
        starts: half width of the loss that the starts leave, however many trainings there are.
        needed: trainings of each kind that would show it safe with probability 0.8 if nothing is lost; None where more
            than 1,000 would be needed, or where one training is all there is.
    """

    task: str
    fidelity: str
    exact: float
    own: float
    loss: Estimate
    shift: Estimate
    trainings: int = 1
    starts: float = 0.0
    needed: int | None = None

    @property
    def margin(self) -> float:
        """What may be lost and still be called safe."""
        return MARGIN * abs(self.exact)

    @property
    def learning(self) -> str:
        """``safe``, ``harmful`` (loses more than the margin), ``worse`` (loses, how much is open), or ``undecided``."""
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


def finding(task: str, trained: Mapping[str, Mapping[str, Floats]], fidelity: str) -> Finding:
    """What training on ``fidelity`` came to; ``trained`` maps trained on -> run on -> returns (seeds, starts)."""
    own, on_exact, best = trained[fidelity][fidelity], trained[fidelity][EXACT], trained[EXACT][EXACT]
    margin, starts = MARGIN * abs(float(best.mean())), starts_half_width(on_exact, best)
    return Finding(
        task=task,
        fidelity=fidelity,
        exact=float(best.mean()),
        own=float(own.mean()),
        loss=crossed_difference(on_exact, best),
        shift=crossed_estimate(own - on_exact),  # the same policies from the same starts: paired
        trainings=len(best),
        starts=starts,
        needed=trainings_needed(on_exact.mean(axis=1), best.mean(axis=1), margin, starts),
    )


def baseline_shift(returns: Mapping[str, Floats], fidelity: str) -> Estimate:
    """A scripted policy's return on a fidelity less that on exact, from the same starts, shape (starts,) each."""
    return t_estimate(returns[fidelity] - returns[EXACT])


def percent(estimate: Estimate, of: float) -> str:
    """A difference in percent of something, with its interval: ``+1.2 % (-0.3 to +2.7)``; plain where that is 0."""
    if of == 0.0:
        return f"{estimate.mean:+.3g} ({estimate.low:+.3g} to {estimate.high:+.3g})"
    mean, low, high = (100.0 * value / abs(of) for value in (estimate.mean, estimate.low, estimate.high))
    return f"{mean:+.1f} % ({low:+.1f} to {high:+.1f})"


_LEARNING = {
    "safe": "is safe on average to learn on",
    "harmful": "is not safe to learn on",
    "worse": "is not safe to learn on (how much is lost is open)",
    "undecided": "is undecided for learning, so few trainings do not tell",
}
_PROMISE = {
    "honest": "its own returns are honest",
    "too high": "its own returns promise too much",
    "too low": "its own returns promise too little",
    "undecided": "whether its own returns are honest is undecided",
}


def sentence(found: Finding) -> str:
    """One finding in words, with the numbers it stands on."""
    needed = _needed(found) if found.learning == "undecided" else ""
    return (
        f"`{found.fidelity}` {_LEARNING[found.learning]}{needed}: run on exact, its policies earn "
        f"{percent(found.loss, found.exact)} against those trained on exact. Measured on itself, "
        f"{_PROMISE[found.promise]}: {percent(found.shift, found.exact)} against what the same policies earn on exact."
    )


def _needed(found: Finding) -> str:
    """What would tell, if nothing is lost; nothing where a single training shows no spread."""
    if found.trainings < 2:
        return ""
    if found.starts >= found.margin:
        return " (nor would any number: more episodes are needed, the starts alone leave more than the margin)"
    if found.needed is None:
        return f" (more than {MOST_TRAININGS:,} of each would be needed)"
    return f" (at least about {max(found.needed, found.trainings + 1)} of each would)"


def failures_sentence(trained: Mapping[str, Mapping[str, Floats]]) -> str:
    """What an average hides: how many trainings may fail, and the worst of each fidelity, run on exact."""
    count = len(trained[EXACT][EXACT])
    worst = []
    for fidelity, returns in trained.items():
        means = returns[EXACT].mean(axis=1)
        seed, mean = int(means.argmin()), float(means.mean())
        worst.append(f"`{fidelity}` seed {seed} {_relative(float(means[seed]) - mean, mean)}")
    return (
        f"Safe means on average: {count} training{'s' if count > 1 else ''} cannot exclude that up to "
        f"{100.0 * failures_not_excluded(count):.1f} % of trainings fail, even if none of them did. The worst training "
        f"of each fidelity, run on exact, against the mean of its trainings: {', '.join(worst)}."
    )


def _relative(value: float, of: float) -> str:
    return f"{100.0 * value / abs(of):+.1f} %" if of else f"{value:+.3g}"


def headline(task: str, findings: Sequence[Finding]) -> str:
    """The verdict on a task in one line: what is safe, what is not, what is open, and where policies carry over."""
    learning = _grouped(
        findings,
        "learning",
        {"safe on average": ("safe",), "not safe": ("harmful", "worse"), "undecided": ("undecided",)},
    )
    promise = _grouped(
        findings, "promise", {"yes": ("honest",), "no": ("too high", "too low"), "undecided": ("undecided",)}
    )
    return (
        f"**Learning `{task}` by shortcut**: {learning}. Does a policy earn on exact what it earned on the shortcut it "
        f"was trained on, within {MARGIN:.0%}? {promise[0].upper()}{promise[1:]}."
    )


def _grouped(findings: Sequence[Finding], question: str, answers: Mapping[str, tuple[str, ...]]) -> str:
    """Fidelities by their answer to a question: ``safe `fine`; not safe `coarse```."""
    parts = []
    for words, kinds in answers.items():
        names = [f"`{found.fidelity}`" for found in findings if getattr(found, question) in kinds]
        if names:
            parts.append(f"{words} {', '.join(names)}")
    return "; ".join(parts)


class Comparison(NamedTuple):
    """One statistic of one setting under one kind of torque, against exact; one number per episode in each.

    Attributes:
        condition: what turns the box.
        setting: contact setting.
        statistic: its name with its unit.
        exact: mean over the episodes on exact.
        difference: of the means, setting less exact, Welch's interval.
        distance: of the distributions (Kolmogorov and Smirnov).
        mean_probability: that the means differ so much by chance, after Holm over all comparisons.
        shape_probability: that the distributions differ so much by chance, likewise.
        seen: difference of means that would have been seen with probability 0.8.
        episodes: those on exact and on the setting that have the number.
        absent: why there is nothing to compare, e.g. ``all lost``; empty where there is something.
    """

    condition: str
    setting: str
    statistic: str
    exact: float
    difference: Estimate
    distance: float
    mean_probability: float
    shape_probability: float
    seen: float
    episodes: tuple[int, int]
    absent: str = ""

    @property
    def differs(self) -> bool:
        """Whether the setting is shown to differ from exact."""
        return min(self.mean_probability, self.shape_probability) < LEVEL


Samples = Mapping[str, Mapping[str, Floats]]  # setting -> statistic -> one number per episode


def compare(runs: Mapping[str, Samples], rng: np.random.Generator) -> list[Comparison]:
    """Hold every setting against exact in every statistic under every condition; all are one family for Holm."""
    found: list[Comparison] = []
    tests = 2 * sum(len(samples[EXACT]) * (len(samples) - 1) for samples in runs.values())
    for condition, samples in runs.items():
        for setting in samples:
            for statistic, values in samples[EXACT].items() if setting != EXACT else ():
                found.append(_row((condition, setting, statistic), samples[setting][statistic], values, tests, rng))
    raw = [row.mean_probability for row in found] + [row.shape_probability for row in found]
    adjusted = holm(raw)
    return [
        row._replace(mean_probability=adjusted[index], shape_probability=adjusted[len(found) + index])
        for index, row in enumerate(found)
    ]


def _row(
    names: tuple[str, str, str], measured: Floats, reference: Floats, tests: int, rng: np.random.Generator
) -> Comparison:
    """One comparison, its probabilities as they are; where one of the two has no number at all, that is the result."""
    one, other = (part[~np.isnan(part)] for part in (measured, reference))
    episodes = len(other), len(one)
    mean = float(other.mean()) if len(other) else math.nan
    absent = _absent(measured) or (f"{_absent(reference)} on exact" if not len(other) else "")
    if absent:
        nothing = Estimate(math.nan, math.inf)
        return Comparison(*names, mean, nothing, math.nan, 1.0, 1.0, math.inf, episodes, absent)
    difference = welch(one, other)
    error = math.hypot(standard_error(one), standard_error(other))
    return Comparison(
        *names, mean, difference, ks_statistic(one, other), two_sided(difference), ks_test(one, other, rng),
        would_have_been_seen(error, tests), episodes,
    )  # fmt: skip


def _absent(values: Floats) -> str:
    """Why no episode has the number: lost ones are not among the values, those without an impact are NaN."""
    if not len(values):
        return "all lost"
    return "all lost or without an impact" if np.isnan(values).all() else ""


def statistics_sentence(setting: str, comparisons: Sequence[Comparison]) -> str:
    """What the long run shows of a setting: where it differs most, or what would have been seen."""
    rows = [row for row in comparisons if row.setting == setting and not row.absent]
    reasons = [f"{row.absent} under {row.condition}" for row in comparisons if row.setting == setting and row.absent]
    missing = f"{'; '.join(dict.fromkeys(reasons))}: nothing to compare; " if reasons else ""
    if not rows:
        return f"`{setting}`: {missing.removesuffix('; ')}."
    differing = [row for row in rows if row.differs]

    def relative(row: Comparison) -> float:
        return abs(row.difference.mean / row.exact) if row.exact else 0.0

    if not differing:
        sizes = [row.seen / abs(row.exact) for row in rows if row.exact]
        return (
            f"`{setting}`: {missing}no difference from exact was found in {len(rows)} comparisons; a difference of the "
            f"means of more than {100.0 * min(sizes):.1f} to {100.0 * max(sizes):.1f} %, by statistic, would have been "
            f"seen with probability {POWER:g}."
        )
    most = max(differing, key=relative)
    return (
        f"`{setting}`: {missing}differs from exact in {len(differing)} of {len(rows)} comparisons, most in "
        f"{most.statistic} under {most.condition}: {percent(most.difference, most.exact)}."
    )
