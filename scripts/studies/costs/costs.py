"""Write docs/costs.md: the cost of each modelled thing per control step."""

from __future__ import annotations

import os
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from scripts.studies import study, timing
from scripts.studies.costs import measured as these
from scripts.studies.pages import figure, rounded, table
from scripts.studies.timing import Rates

PASSES = 9  # through everything, in a round
DERIVED = "with derivatives"
MODELS = PYMUNK, EXACT, BATCH = "pymunk", "exact", "exact, batch"
ARM, FRAME = "more impacts: an arm of 8 m", "a frame drawn in each step"
FUNCTION = "a torque that is a Python function, in place of the chirp"
THINGS = {
    "gravity": ("plain", "weightless"),
    "task rattle, in place of juggle": ("rattle", "plain"),
    "the chirp, in place of a held torque": ("chirp", "plain"),
    FUNCTION: ("function", "chirp"),
    "side forces that are Python functions": ("pushed", "plain"),
    ARM: ("long arm", "plain"),
    "a `render_mode`, nothing drawn": ("picture", "plain"),
    FRAME: ("drawn", "picture"),
    "stepped in a batch of 16": ("together", "plain"),
    "`with_infos` of a batch": ("infos", "plain"),
    "a scene for each environment": ("own scenes", "plain"),
    "scenes drawn at each reset, two fields each: only in a step that resets": ("redrawn", "restarted"),
    "a task of one's own, in place of a built-in one that does the same": ("own task", "plain"),
}
Figures = dict[str, dict[str, list[float]]]  # by thing and model: ns in each round


@dataclass(frozen=True)
class Arguments(study.TimedArguments):
    """Measure in interleaved rounds; every figure is the median over the rounds."""

    rounds: int = 7
    """Rounds; each measures everything nine times in turn, and a figure is their median."""
    seconds: float = 0.03
    """Time per measurement [s], or once through the moments."""


# -- figures -----------------------------------------------------------------------------------------------------------


def measured(rounds: int, seconds: float) -> dict[str, Any]:
    """All figures of the page."""
    timing.on_cores({max(os.sched_getaffinity(0))} if timing.PINNED else ())
    usual, far = these.moments(these.FEW, 4), these.moments(these.FEW, 4, these.LONG)
    many, many_far = these.moments(these.TOGETHER, 40), these.moments(these.TOGETHER, 40, these.LONG)
    lossy = {kind: these.with_loss(kind) for kind in these.LOSS}
    timed = {f"{PYMUNK}: together": these.batched(PYMUNK, usual, seconds)}
    for kind in these.KINDS:
        for contact in (PYMUNK, EXACT):
            timed[f"{contact}: {kind}"] = these.stepped(contact, far if kind == "long arm" else usual, seconds, kind)
    for kind, settings in (these.KINDS | these.IN_BATCHES).items():
        if kind != "drawn":
            moments = many_far if kind == "long arm" else many
            timed[f"{BATCH}: {kind}"] = these.batched(EXACT, moments, seconds, **settings)
    for kind, scene in these.LOSS.items():
        timed[f"{EXACT}: {kind}"] = these.alone(scene, lossy[kind], seconds)
        timed[f"{BATCH}: {kind}"] = these.batched(EXACT, lossy[kind], seconds, scene=scene)
        timed[f"{DERIVED}: {kind}"] = these.derived(scene, lossy[kind], seconds)
    results = figures(timing.measure(timed, rounds * PASSES), PASSES)
    results["loss"]["impacts"] = {kind: float(moments.hits.mean()) for kind, moments in lossy.items()}
    impacts = {"usual": float(usual.hits.mean()), "long arm": float(far.hits.mean())}
    return {**results, "impacts": impacts}


def in_rounds(rates: Rates, passes: int, weights: Mapping[str, float]) -> list[float]:
    """A weighted sum of times [ns] within each pass; its median in each round."""
    each = [
        sum(weight * 1e9 / rate for weight, rate in zip(weights.values(), at_once, strict=True))
        for at_once in zip(*(rates[name] for name in weights), strict=True)
    ]
    return [statistics.median(each[k : k + passes]) for k in range(0, len(each), passes)]


def figures(rates: Rates, passes: int) -> dict[str, Any]:
    """The times of a plain step, of each thing on top of it, and of steps with loss."""

    def of(model: str, *kinds: str) -> list[float]:
        weights = dict(zip((f"{model}: {kind}" for kind in kinds), (1.0, -1.0), strict=False))
        return in_rounds(rates, passes, weights)

    def timed(pair: tuple[str, str]) -> list[str]:
        return [model for model in MODELS if {f"{model}: {kind}" for kind in pair} <= set(rates)]

    return {
        "plain": {"a plain step": {model: of(model, "plain") for model in MODELS}},
        "on_top": {what: {model: of(model, *pair) for model in timed(pair)} for what, pair in THINGS.items()},
        "loss": {"steps": {kind: {model: of(model, kind) for model in (EXACT, BATCH, DERIVED)} for kind in these.LOSS}},
    }


# -- the page ----------------------------------------------------------------------------------------------------------


def cell(values: Sequence[float] | None, plain: float) -> str:
    """Nanoseconds, and the share of a plain step."""
    if values is None:
        return ""
    if min(values) <= 0.0 <= max(values):  # not of one sign in all rounds
        return "below noise"
    middle = statistics.median(values)
    share = middle / plain
    return f"{'+' if middle > 0.0 else ''}{figure(middle)} ({share:{'+,.0%' if abs(share) > 0.1 else '+.1%'}})"


def filled(record: study.Record) -> dict[str, Any]:
    """The numbers of docs/costs.md."""
    results = record["costs"]
    plain, on_top, impacts = _plain(results), results["on_top"], results["impacts"]
    steps, more = results["loss"]["steps"], impacts["long arm"] - impacts["usual"]
    frame, function = (rounded(statistics.median(on_top[what][PYMUNK])) for what in (FRAME, FUNCTION))
    single = {what: costs for what, costs in on_top.items() if set(costs) != {BATCH}}
    small = [
        what
        for what, costs in single.items()
        if all(abs(statistics.median(values)) < 0.1 * plain[model] for model, values in costs.items())
    ]
    rows = [
        [what, *(cell(costs.get(m), plain[m]) for m in MODELS)] for what, costs in single.items() if what not in small
    ]
    only = [[what, cell(costs[BATCH], plain[BATCH])] for what, costs in on_top.items() if set(costs) == {BATCH}]
    return {
        "plain": {model: rounded(value) for model, value in plain.items()},
        "frame": frame,
        "function": function,
        "on_top": table(
            ("on top of a plain step [ns]", *MODELS),
            [["**a plain step**", *(f"**{figure(plain[model])}**" for model in MODELS)], *rows],
        ),
        "small": "; ".join(small),
        "impacts": impacts,
        "each": ", ".join(f"{figure(statistics.median(on_top[ARM][m]) / more)} ns ({m})" for m in on_top[ARM]),
        "in_batches": table(("on top of a plain step, in a batch only [ns]", BATCH), only),
        "loss": _loss_table(steps, results["loss"]["impacts"]),
    }


def _plain(results: Mapping[str, Any]) -> dict[str, float]:
    return {model: statistics.median(values) for model, values in results["plain"]["a plain step"].items()}


def _loss_table(loss: Figures, impacts: Mapping[str, float]) -> str:
    """Times of steps of flight, of bounces with loss and of rest."""
    rows = []
    for kind, times in loss.items():
        spent = (figure(statistics.median(times[model]) / 1e3) for model in (EXACT, BATCH, DERIVED))
        rows.append([kind, figure(impacts[kind]), *spent])
    return table(("a step of exact [µs]", "impacts in it", "contact model alone", "in a batch", DERIVED), rows)


STUDY = study.Study(
    "costs",
    {"costs": measured},
    filled,
    Arguments,
    alone=frozenset({"costs"}),
    packages=("jackbox", "gymnasium", "numpy", "pymunk", "numba"),
)

if __name__ == "__main__":
    study.main(STUDY, __doc__)
