"""docs/costs.md: what a thing costs is the time of steps with it less that of steps without it."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from typing import Any

from scripts.studies.costs.cost_steps import FLIGHT, LOSS, RESTING
from scripts.studies.pages import cells, figure, joined, rough
from scripts.studies.timing import Rates

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
LAYERS: dict[str, dict[str, float]] = {
    "contact model": {"contact": 1.0},
    "observation and reward": {"plain": 1.0, "_score": -1.0},
    "info dict": {"plain": 1.0, "_info": -1.0},
    "checks of actions, torques and times": {"plain": 1.0, "checks": -1.0},
    "wrappers of `gymnasium.make`": {"plain": 1.0, "bare": -1.0},
    "the rest of `step`": {"bare": 1.0, "_score": 1.0, "_info": 1.0, "checks": 1.0, "contact": -1.0, "plain": -3.0},
}
Figures = dict[str, dict[str, list[float]]]  # by thing and model: ns in each round


# -- figures -----------------------------------------------------------------------------------------------------------


def in_rounds(rates: Rates, passes: int, weights: Mapping[str, float]) -> list[float]:
    """A weighted sum of times [ns], taken within each pass; its median in each round."""
    each = [
        sum(weight * 1e9 / rate for weight, rate in zip(weights.values(), at_once, strict=True))
        for at_once in zip(*(rates[name] for name in weights), strict=True)
    ]
    return [statistics.median(each[k : k + passes]) for k in range(0, len(each), passes)]


def figures(rates: Rates, passes: int) -> dict[str, Figures]:
    """A plain step's time, what each thing costs on top of it, and where it goes."""

    def of(model: str, weights: Mapping[str, float]) -> list[float]:
        return in_rounds(rates, passes, {f"{model}: {kind}": weight for kind, weight in weights.items()})

    def both(model: str, pair: tuple[str, str]) -> bool:
        return {f"{model}: {kind}" for kind in pair} <= set(rates)

    return {
        "plain": {"a plain step": {model: of(model, {"plain": 1.0}) for model in MODELS}},
        "on_top": {
            what: {model: of(model, {pair[0]: 1.0, pair[1]: -1.0}) for model in MODELS if both(model, pair)}
            for what, pair in THINGS.items()
        },
        "layers": {what: {model: of(model, weights) for model in (PYMUNK, EXACT)} for what, weights in LAYERS.items()},
    }


def loss_figures(rates: Rates, passes: int) -> Figures:
    """The times of steps with loss."""
    return {
        kind: {model: in_rounds(rates, passes, {f"{model}: {kind}": 1.0}) for model in (EXACT, BATCH)} for kind in LOSS
    }


def seen(values: Sequence[float]) -> bool:
    """Whether a difference is above the noise: of one sign in all rounds."""
    return min(values) > 0.0 or max(values) < 0.0


# -- the page ----------------------------------------------------------------------------------------------------------


def cell(values: Sequence[float] | None, plain: float) -> str:
    """Nanoseconds, and the share of a plain step."""
    if values is None:
        return ""
    if not seen(values):
        return "below noise"
    middle = statistics.median(values)
    share = middle / plain
    return f"{'+' if middle > 0.0 else ''}{figure(middle)} ns ({share:{'+,.0%' if abs(share) > 0.1 else '+.1%'}})"


def glance(on_top: Figures, plain: Mapping[str, float]) -> list[str]:
    """One line per thing that costs something, one column per model; then what hardly costs."""
    lines = ["| on top of a plain step | " + " | ".join(MODELS) + " |", "|---|" + "---:|" * len(MODELS)]
    lines.append("| **a plain step** | " + " | ".join(f"**{figure(plain[model])} ns**" for model in MODELS) + " |")
    single = {what: found for what, found in on_top.items() if set(found) != {BATCH}}
    small = [
        what
        for what, found in single.items()
        if all(abs(statistics.median(values)) < 0.1 * plain[model] for model, values in found.items())
    ]
    for what, found in single.items():
        if what not in small:
            lines.append(f"| {what} | " + " | ".join(cell(found.get(m), plain[m]) for m in MODELS) + " |")
    return [*lines, "", f"Less than a tenth of a plain step with every model: {'; '.join(small)}."]


def batch_table(on_top: Figures, plain: float) -> list[str]:
    """What only batches have."""
    lines = ["| on top of a plain step, in a batch only | " + BATCH + " |", "|---|---:|"]
    only = {what: found[BATCH] for what, found in on_top.items() if set(found) == {BATCH}}
    return lines + [f"| {what} | {cell(values, plain)} |" for what, values in only.items()]


def layer_table(layers: Figures, plain: Mapping[str, float]) -> list[str]:
    """Where the time of one environment's step goes."""
    lines = ["| one environment | pymunk, ns | smallest to largest | exact, ns | smallest to largest |"]
    lines.append("|---|---:|---:|---:|---:|")
    lines += [f"| {what} | {cells(found[PYMUNK])} | {cells(found[EXACT])} |" for what, found in layers.items()]
    return [*lines, f"| **a plain step** | **{figure(plain[PYMUNK])}** | | **{figure(plain[EXACT])}** | |"]


def loss_table(loss: Figures, impacts: Mapping[str, float]) -> list[str]:
    """What a step costs that flies, bounces with loss, or rests; each against the one that flies."""
    lines = ["| a step of exact | impacts in it | contact model alone | of a flight | in a batch | of a flight |"]
    lines.append("|---|---:|---:|---:|---:|---:|")
    for kind, found in loss.items():
        pairs = [_against_flight(found[model], loss[FLIGHT][model]) for model in (EXACT, BATCH)]
        lines.append(f"| {kind} | {figure(impacts[kind])} | " + " | ".join(pairs) + " |")
    return lines


def _against_flight(values: Sequence[float], flight: Sequence[float]) -> str:
    """Microseconds, and the ratio, taken within rounds."""
    ratio = statistics.median(one / other for one, other in zip(values, flight, strict=True))
    return f"{figure(statistics.median(values) / 1000.0)} µs | {figure(ratio)}"


def held_cost(loss: Figures) -> str:
    """What a step with held feet takes, for the exact model's head: whole microseconds around all kinds."""
    middles = [statistics.median(loss[kind][EXACT]) / 1e3 for kind in RESTING]
    return f"{math.floor(min(middles))} to {math.ceil(max(middles))} microseconds"


def answer(results: Mapping[str, Any], plain: Mapping[str, float]) -> str:
    """The page in three sentences."""
    each = {model: rough(value) for model, value in plain.items()}
    frame, function = (rough(statistics.median(results["on_top"][what][PYMUNK])) for what in (FRAME, FUNCTION))
    return (
        f"A control step takes {each[PYMUNK]} ns with pymunk, {each[EXACT]} ns with exact, and {each[BATCH]} ns for "
        f"each environment of an exact batch. The most expensive additions are a frame ({frame} ns) and a drive "
        f"written as a Python function ({function} ns more than the chirp). What is off costs nothing: its code does "
        "not run, and tests count that."
    )


def page(results: Mapping[str, Any], picture: str) -> str:
    """docs/costs.md."""
    on_top, impacts, loss = results["on_top"], results["impacts"], results["loss"]
    plain = {model: statistics.median(values) for model, values in results["plain"]["a plain step"].items()}
    more = impacts["long arm"] - impacts["usual"]
    each = [f"{figure(statistics.median(values) / more)} ns ({model})" for model, values in on_top[ARM].items()]
    asked = [f"{count:.0f} times per step by {model}" for model, count in results["asked"].items()]
    notes = [
        f"- An arm of 8 m makes {impacts['long arm']:.2f} impacts per step instead of {impacts['usual']:.3f}. "
        f"One impact, with the steps near a wall that it takes, costs {', '.join(each)}.",
        f"- A drive's Python function is called {', '.join(asked)}; a batch calls it once for all environments that "
        "share a time.",
        "- A batch with a `render_mode` is stepped one by one. A batch of pymunk builds its infos with `with_infos` "
        "and without.",
    ]
    return joined(
        {
            "# What each thing costs": [answer(results, plain), "", f"![Where the time of a step goes]({picture})"],
            "## On top of a plain step": [
                *glance(on_top, plain),
                "",
                *notes,
                "",
                *batch_table(on_top, plain[BATCH]),
            ],
            "## With loss, and at rest": [
                f"A step with held feet takes some {held_cost(loss['steps'])}.",
                "",
                *loss_table(loss["steps"], loss["impacts"]),
                "",
                REST,
                "",
                loss["made"],
            ],
            "## Where the time of a step goes": layer_table(results["layers"], plain),
            "## What is off does not run": [OFF],
            "## How it was measured": [HOW, "", results["made"]],
        }
    )


OFF = (
    "Without gravity the engine is given no force. Without a drive it is given no torque, and no chirp is computed. "
    "Without side forces none is averaged. Without a `render_mode` no renderer is loaded, and none is told of a "
    "step. Another task's reward is not computed. A batch without `with_infos` gathers no infos, and a batch of "
    "exact has no room for impact records. Without `randomize` no scene is drawn. Without a task of one's own no "
    "function of a user is compiled, and steps never compile one. tests/studies/test_costs.py counts the calls: none "
    "without the thing, some with it."
)
REST = (
    "All under no torque. A flight is without impacts, though it may be near a wall. Bounces pile up in "
    "steps of 10 to 20 impacts. A jack that rests lies on two feet, in a corner on three. A held foot counts as one "
    "impact for each wall. In a batch, a "
    "figure is the step of one of 1,024 environments that all do the same, with observation and reward. "
    "`make costs-loss` measures only these steps: not on the day and the machine of the rest of the page."
)
HOW = (
    "`make costs` times a control step of 0.02 s with a thing and without it, on one core. Figures are medians over "
    "rounds. The figure of a round is the median of passes in which all take turns. A difference is taken within a "
    "pass; one that changes its sign between rounds counts as noise. Times are processor times, which leave out "
    "what other processes use. A plain step is the default scene's, with a held random torque and the task juggle, "
    "as `gymnasium.make` makes it; in a batch, it is the step of one of 1,024 environments. All start from the same "
    "states of episodes, restored before each step. Scenes that are varied differ from the default by at most 1e-6, so "
    "that the motion stays the same. A reset is timed in episodes of one step. Observation, info dict, checks and "
    "wrappers cannot be switched off: to measure them, stand-ins took their place. This page and [the "
    "speeds](speed.md) were measured in different hours of a shared machine, so only the ratios within a page count."
)


def pictured(results: Mapping[str, Any]) -> dict[str, dict[str, float]]:
    """The bars of the picture: the layers of a step, end to end."""
    layers: Figures = results["layers"]
    return {m: {what: statistics.median(found[m]) for what, found in layers.items()} for m in (EXACT, PYMUNK)}
