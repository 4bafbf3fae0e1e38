"""What a study comes to: which fidelities are safe for learning, which differ from exact, computed from the numbers."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from agents.inference import (
    LEVEL,
    POWER,
    Estimate,
    Floats,
    crossed_difference,
    crossed_estimate,
    holm,
    ks_statistic,
    ks_test,
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
        needed: trainings of each kind that would tell a loss of the margin from none; None where one is all there is.
    """

    task: str
    fidelity: str
    exact: float
    own: float
    loss: Estimate
    shift: Estimate
    needed: int | None = None

    @property
    def learning(self) -> str:
        """``safe``, ``harmful`` (loses more than the margin), ``worse`` (loses, how much is open), or ``undecided``."""
        margin = MARGIN * abs(self.exact)
        if self.loss.low >= -margin:
            return "safe"
        if self.loss.high < -margin:
            return "harmful"
        return "worse" if self.loss.high < 0.0 else "undecided"

    @property
    def promise(self) -> str:
        """``honest`` (within the margin), ``too high``, ``too low`` or ``undecided``."""
        margin = MARGIN * abs(self.exact)
        if self.shift.low >= -margin and self.shift.high <= margin:
            return "honest"
        if self.shift.low > 0.0:
            return "too high"
        return "too low" if self.shift.high < 0.0 else "undecided"


def finding(task: str, trained: Mapping[str, Mapping[str, Floats]], fidelity: str) -> Finding:
    """What training on ``fidelity`` came to; ``trained`` maps trained on -> run on -> returns (seeds, starts)."""
    own, on_exact, best = trained[fidelity][fidelity], trained[fidelity][EXACT], trained[EXACT][EXACT]
    return Finding(
        task=task,
        fidelity=fidelity,
        exact=float(best.mean()),
        own=float(own.mean()),
        loss=crossed_difference(on_exact, best),
        shift=crossed_estimate(own - on_exact),  # the same policies from the same starts: paired
        needed=trainings_needed(on_exact.mean(axis=1), best.mean(axis=1), MARGIN * abs(float(best.mean()))),
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
    "safe": "is safe to learn on",
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
    needed = f" (about {found.needed} of each would)" if found.learning == "undecided" and found.needed else ""
    return (
        f"`{found.fidelity}` {_LEARNING[found.learning]}{needed}: run on exact, its policies earn "
        f"{percent(found.loss, found.exact)} against those trained on exact. Measured on itself, "
        f"{_PROMISE[found.promise]}: {percent(found.shift, found.exact)} against what the same policies earn on exact."
    )


def headline(task: str, findings: Sequence[Finding]) -> str:
    """The verdict on a task in one line: what is safe, what is not, what is open, and where policies carry over."""
    learning = _grouped(
        findings, "learning", {"safe": ("safe",), "not safe": ("harmful", "worse"), "undecided": ("undecided",)}
    )
    promise = _grouped(
        findings, "promise", {"yes": ("honest",), "no": ("too high", "too low"), "undecided": ("undecided",)}
    )
    return (
        f"**Learning `{task}` by shortcut**: {learning}. Does a policy earn on exact what it earned on the shortcut it "
        f"was trained on, within {MARGIN:.0%}? {promise[0].upper()}{promise[1:]}."
    )


def _grouped(findings: Sequence[Finding], question: str, answers: Mapping[str, tuple[str, ...]]) -> str:
    """Fidelities by their answer to a question: ``safe `accurate`; not safe `fast```."""
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
                one, other = (part[~np.isnan(part)] for part in (samples[setting][statistic], values))
                difference = welch(one, other)
                error = float(np.sqrt(one.var(ddof=1) / len(one) + other.var(ddof=1) / len(other)))
                found.append(
                    Comparison(
                        condition, setting, statistic, float(other.mean()), difference, ks_statistic(one, other),
                        two_sided(difference), ks_test(one, other, rng), would_have_been_seen(error, tests),
                        (len(other), len(one)),
                    )
                )  # fmt: skip
    raw = [row.mean_probability for row in found] + [row.shape_probability for row in found]
    adjusted = holm(raw)
    return [
        row._replace(mean_probability=adjusted[index], shape_probability=adjusted[len(found) + index])
        for index, row in enumerate(found)
    ]


def statistics_sentence(setting: str, comparisons: Sequence[Comparison]) -> str:
    """What the long run shows of a setting: where it differs most, or what would have been seen."""
    rows = [row for row in comparisons if row.setting == setting]
    differing = [row for row in rows if row.differs]

    def relative(row: Comparison) -> float:
        return abs(row.difference.mean / row.exact) if row.exact else 0.0

    if not differing:
        sizes = [row.seen / abs(row.exact) for row in rows if row.exact]
        return (
            f"`{setting}`: no difference from exact was found in {len(rows)} comparisons; a difference of the means "
            f"of more than {100.0 * min(sizes):.1f} to {100.0 * max(sizes):.1f} %, by statistic, would have been seen "
            f"with probability {POWER:g}."
        )
    most = max(differing, key=relative)
    return (
        f"`{setting}`: differs from exact in {len(differing)} of {len(rows)} comparisons, most in "
        f"{most.statistic} under {most.condition}: {percent(most.difference, most.exact)}."
    )
