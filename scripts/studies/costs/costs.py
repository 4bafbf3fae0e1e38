"""Write docs/costs.md: what each thing that is modelled costs per control step, and that what is off costs nothing."""

from __future__ import annotations

import os
import statistics
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

from scripts.common import command_line
from scripts.studies.speed.speed import PINNED, cells, figure, joined, meanwhile, on_cores

if TYPE_CHECKING:
    from scripts.studies.costs.cost_steps import Moments
    from scripts.studies.timing import Timed

PYMUNK, EXACT, BATCH = "pymunk", "exact", "exact, batch"
MODELS = (PYMUNK, EXACT, BATCH)
PASSES = 9  # through everything, in a round

Times = dict[str, list[list[float]]]  # ns per step in each pass of each round


@dataclass(frozen=True)
class Arguments:
    """Measure in interleaved rounds; every figure is the median over the rounds."""

    rounds: int = 7
    """Rounds; each measures everything nine times in turn, and takes the median."""
    seconds: float = 0.03
    """Time per measurement [s], or once through the moments."""
    out: Path = Path("docs/costs.md")
    """The page to write."""


class Row(NamedTuple):
    """What something costs: the time of the one measurement less that of the other."""

    what: str
    model: str
    having: str
    without: str


PLAIN, ALONE = "plain", "simulator"
THINGS = {
    "gravity": (ALONE, "weightless"),
    "the chirp, in place of a held torque": ("driven", "trusting"),
    "a torque that is a Python function, in place of the chirp": ("function", "chirp"),
    "side forces that are Python functions": ("pushed", ALONE),
    "more impacts: an arm of 8 m": ("long arm", ALONE),
    "task spin, in place of juggle": ("spin", PLAIN),
    "task rattle, in place of juggle": ("rattle", PLAIN),
    "observation and reward": (PLAIN, "_score"),
    "the info dict": (PLAIN, "_info"),
    "`with_infos` of a batch": ("infos", "together"),
    "reading `env.unwrapped.impacts`": ("read", PLAIN),
    "checks of actions, torques and times": (PLAIN, "_torque_of"),
    "the wrappers of `gymnasium.make`": (PLAIN, "bare"),
    "a `render_mode`, nothing drawn": ("picture", PLAIN),
    "a frame drawn in each step": ("drawn", "picture"),
    "stepped in a batch": ("together", PLAIN),
}


def name_of(model: str, name: str) -> str:
    """Name of a measurement: a batch has no simulator alone, and the exact model's batch is a model of its own here."""
    if model == EXACT and name == "together":
        return f"{BATCH}: {PLAIN}"
    if model == BATCH:
        name = {ALONE: PLAIN, "trusting": PLAIN, "together": PLAIN, "driven": "chirp"}.get(name, name)
    return f"{model}: {name}"


def rows(names: Iterable[str]) -> list[Row]:
    """All that was measured, thing by thing."""
    every = [
        Row(what, model, name_of(model, having), name_of(model, without))
        for what, (having, without) in THINGS.items()
        for model in MODELS
    ]
    known = set(names)
    return [row for row in every if {row.having, row.without} <= known and row.having != row.without]


# -- what is measured -------------------------------------------------------------------------------------------------


def of_one(contact: str, usual: Moments, far: Moments, seconds: float) -> dict[str, Timed]:
    """One environment and its simulator."""
    from scripts.studies.costs import cost_steps as cost

    some = usual.part(1, cost.DRAWN)
    timed = {
        ALONE: cost.simulated(contact, usual, seconds),
        "weightless": cost.simulated(contact, usual, seconds, cost.WEIGHTLESS),
        "chirp": cost.simulated(contact, usual, seconds, held=False),
        "driven": cost.simulated(contact, usual, seconds, held=False, checked=False),
        "function": cost.simulated(contact, usual, seconds, cost.TURNED, held=False),
        "pushed": cost.simulated(contact, usual, seconds, cost.SHAKEN),
        "long arm": cost.simulated(contact, far, seconds, cost.LONG),
        "trusting": cost.simulated(contact, usual, seconds, checked=False),
        "inner": cost.compiled_step(usual, seconds) if contact == "exact" else cost.without_engine(usual, seconds),
        PLAIN: cost.stepped(contact, usual, seconds),
        **{kind: cost.stepped(contact, usual, seconds, kind) for kind in ("bare", "read", "_info", "_score")},
        "_torque_of": cost.stepped(contact, usual, seconds, "_torque_of"),
        **{task: cost.stepped(contact, usual, seconds, task=task) for task in ("spin", "rattle")},
        "picture": cost.stepped(contact, usual, seconds, render_mode="rgb_array"),
        "drawn": cost.stepped(contact, some, seconds, "drawn", render_mode="rgb_array"),
    }
    if contact == "pymunk":
        timed["together"] = cost.batched(contact, cost.FEW, usual, seconds)
        timed["infos"] = cost.batched(contact, cost.FEW, usual, seconds, with_infos=True)
    return {f"{contact}: {name}": run for name, run in timed.items()}


def of_batch(usual: Moments, far: Moments, seconds: float) -> dict[str, Timed]:
    """A batch of the exact model."""
    from scripts.studies.costs import cost_steps as cost

    def timed(given: Moments = usual, count: int = cost.TOGETHER, **settings: Any) -> Timed:
        return cost.batched("exact", count, given, seconds, **settings)

    made = {
        PLAIN: timed(),
        "weightless": timed(scene=cost.WEIGHTLESS),
        "chirp": timed(torque="chirp"),
        "function": timed(torque="chirp", scene=cost.TURNED),
        "pushed": timed(scene=cost.SHAKEN),
        "long arm": timed(far, scene=cost.LONG),
        "_torque_of": timed(checked=False),
        "spin": timed(task="spin"),
        "rattle": timed(task="rattle"),
        "infos": timed(with_infos=True),
        "picture": timed(count=cost.FEW, render_mode="rgb_array"),
    }
    return {f"{BATCH}: {name}": run for name, run in made.items()}


def measured(rounds: int, seconds: float) -> tuple[Times, tuple[float, float]]:
    """Time everything; also the impacts per step of the usual moments and of those with the long arm."""
    from scripts.studies.costs import cost_steps as cost
    from scripts.studies.timing import measure

    (usual, many), (far, many_far) = cost.moments(), cost.moments(cost.LONG)
    timed = {
        **of_one(PYMUNK, usual, far, seconds),
        **of_one(EXACT, usual, far, seconds),
        **of_batch(many, many_far, seconds),
    }
    rates = measure(timed, rounds * PASSES)
    times = {
        name: [[1e9 / rate for rate in values[k : k + PASSES]] for k in range(0, len(values), PASSES)]
        for name, values in rates.items()
    }
    return times, (float(usual.hits.mean()), float(far.hits.mean()))


# -- figures ----------------------------------------------------------------------------------------------------------


def of_rounds(times: Times, weights: Mapping[str, float]) -> list[float]:
    """A weighted sum of measurements, taken within each pass; its median in each round."""
    rounds = zip(*(times[name] for name in weights), strict=True)
    return [
        statistics.median(
            sum(w * t for w, t in zip(weights.values(), at_once, strict=True)) for at_once in zip(*passes, strict=True)
        )
        for passes in rounds
    ]


def on_top(times: Times, row: Row) -> list[float]:
    """What a thing costs on top, in each round [ns]."""
    return of_rounds(times, {row.having: 1.0, row.without: -1.0})


def over_plain(times: Times, row: Row) -> list[float]:
    """A plain step and that on top, over a plain step, in each round."""
    plain = of_rounds(times, {f"{row.model}: {PLAIN}": 1.0})
    return [1.0 + cost / whole for cost, whole in zip(on_top(times, row), plain, strict=True)]


def seen(values: Sequence[float]) -> bool:
    """Whether a difference is above the noise: of one sign in all rounds."""
    return min(values) > 0.0 or max(values) < 0.0


def signed(value: float) -> str:
    """A difference with its sign."""
    return f"{'+' if value > 0.0 else ''}{figure(value)}"


def share(times: Times, row: Row) -> float:
    """What a thing costs on top, as a share of a plain step."""
    return statistics.median(over_plain(times, row)) - 1.0


# -- the page ---------------------------------------------------------------------------------------------------------


def glance(times: Times) -> list[str]:
    """One line per thing, one column per model."""
    lines = ["| on top of a plain step | " + " | ".join(MODELS) + " |", "|---|" + "---:|" * len(MODELS)]
    plain = [figure(statistics.median(of_rounds(times, {f"{model}: {PLAIN}": 1.0}))) for model in MODELS]
    lines.append("| **a plain step** | " + " | ".join(f"**{value} ns**" for value in plain) + " |")
    found = {(row.what, row.model): row for row in rows(times)}
    for what in THINGS:
        line = []
        for model in MODELS:
            row = found.get((what, model))
            if row is None:
                line.append("")
            elif not seen(on_top(times, row)):
                line.append("below noise")
            else:
                part = share(times, row)
                percent = f"{part:+.1%}" if abs(part) < 0.1 else f"{part:+,.0%}"
                line.append(f"{signed(statistics.median(on_top(times, row)))} ns ({percent})")
        lines.append(f"| {what} | " + " | ".join(line) + " |")
    return lines


def in_short(times: Times) -> list[str]:
    """What costs little with every model, and what costs much with some."""
    shares = {what: [abs(share(times, row)) for row in rows(times) if row.what == what] for what in THINGS}
    little = [what for what, found in shares.items() if found and max(found) < 0.1]
    much = [what for what, found in shares.items() if found and max(found) > 1.0]
    return [
        f"- Less than a tenth of a plain step with every model: {'; '.join(little) or 'nothing'}.",
        f"- More than another plain step with some model: {'; '.join(much) or 'nothing'}.",
        f"- {asked_line()}",
        "- A batch with a `render_mode` is stepped one by one, hence what it costs there.",
        "- What is off costs nothing: it is not executed, which is counted below. One thing is not so: a batch of the "
        "pymunk model builds its infos with `with_infos` and without.",
    ]


def asked_line() -> str:
    """How often a drive's functions are asked."""
    from scripts.studies.costs.counting import STEPS, asked

    each = [f"{asked(model) / STEPS:.0f} times per step by {model}" for model in (PYMUNK, EXACT)]
    return f"A drive's Python function is asked {', '.join(each)}; in a batch of it once for all at the same time."


def full_table(times: Times) -> list[str]:
    """Each thing of each model with its extremes."""
    lines = [
        "| what | model | ns on top | smallest to largest | over a plain step | smallest to largest | |",
        "|---|---|---:|---:|---:|---:|---|",
    ]
    for row in rows(times):
        top, over = on_top(times, row), over_plain(times, row)
        words = "below noise" if not seen(top) else "costs" if top[0] > 0.0 else "saves"
        lines.append(f"| {row.what} | {row.model} | {cells(top)} | {cells(over)} | {words} |")
    return lines


def impact_line(times: Times, impacts: tuple[float, float]) -> str:
    """What one impact costs."""
    usual, far = impacts
    each = [
        f"{statistics.median(on_top(times, row)) / (far - usual):,.0f} ns ({row.model})"
        for row in rows(times)
        if "arm" in row.what
    ]
    return (
        f"An arm of 8 m makes {far:.2f} impacts per step of {usual:.3f}. So an impact, and being near a wall for it, "
        f"costs {', '.join(each)}."
    )


def layers(times: Times, contact: str) -> dict[str, list[float]]:
    """Where the time of a plain step goes, in each round [ns]."""

    def of(**weights: float) -> list[float]:
        return of_rounds(times, {f"{contact}: {name}": weight for name, weight in weights.items()})

    inner, around = "contact model: compiled code", "contact model: Python around it"
    if contact == PYMUNK:
        inner, around = "contact model: is a wall in reach, flight", "contact model: steps near a wall, by the engine"
    return {
        inner: of(inner=1.0),
        around: of(trusting=1.0, inner=-1.0),
        "observation and reward": of(plain=1.0, _score=-1.0),
        "info dict": of(plain=1.0, _info=-1.0),
        "checks": of(plain=1.0, _torque_of=-1.0),
        "wrappers of `gymnasium.make`": of(plain=1.0, bare=-1.0),
        "the rest of `step`": of(bare=1.0, trusting=-1.0, _score=1.0, _info=1.0, _torque_of=1.0, plain=-3.0),
    }


def layer_table(times: Times, contact: str) -> list[str]:
    """The layers of one model's step and their shares."""
    plain = statistics.median(of_rounds(times, {f"{contact}: {PLAIN}": 1.0}))
    lines = [f"| {contact}, one environment | ns | smallest to largest | share |", "|---|---:|---:|---:|"]
    for what, values in layers(times, contact).items():
        lines.append(f"| {what} | {cells(values)} | {statistics.median(values) / plain:.0%} |")
    return [*lines, f"| **a plain step** | **{figure(plain)}** | | |"]


def proof_table() -> list[str]:
    """Calls without a thing and with it."""
    from scripts.studies.costs.counting import PROOFS, SIDE_BY_SIDE, STEPS

    lines = ["| what is off | model | what does not run | calls without | calls with |", "|---|---|---|---:|---:|"]
    for proof in PROOFS:
        without, having = proof.counts()
        lines.append(f"| {proof.thing} | {proof.model} | {proof.what} | {without:,} | {having:,} |")
    return [
        f"Counted, not timed: calls of functions in {STEPS} control steps, in a batch of {SIDE_BY_SIDE} environments. "
        "The exact model's code is counted as the plain Python that is compiled. tests/test_costs.py holds these "
        "counts and what is said below them, and shows that each would be seen if it were not so.",
        "",
        *lines,
        "",
        *OTHER_PROOFS,
    ]


OTHER_PROOFS = (
    "Gravity is one line of the pymunk model, executed once per engine step: all other lines are executed as often "
    "without it. The exact model executes the same lines with it and without it; it is a product there.",
    "",
    "The engine's space has two bodies, four segments and four circles, whatever the scene. No renderer is loaded "
    "unless a `render_mode` is given. A batch of the exact model has no room for impact records and writes none, and a "
    "step of it allocates what it returns and its actions as float64.",
)


def head(arguments: Arguments) -> str:
    """What all figures have in common, and what they were measured with."""
    from agents.runs import PACKAGES, machine, versions
    from scripts.studies.costs.cost_steps import FEW, TOGETHER

    known = versions((*(name for name in PACKAGES if name not in ("torch", "stable-baselines3")), "numba"))
    where = "on one core" if PINNED else "on no core in particular"
    return (
        "Written by `make costs`: what a control step of 0.02 s takes with a thing less what it takes without, "
        f"{where}. Medians over {arguments.rounds} rounds, each the median of {PASSES} passes in which all take turns; "
        "every difference and ratio is taken within a pass. What changes its sign between rounds is below noise. Times "
        "are the processor's, while other processes have it they stand still.\n\n"
        "A plain step: the default scene, a held random torque, task juggle, no pictures, as `gymnasium.make` makes "
        f"it; of the batch, one of its {TOGETHER:,} environments. All step the same moments of {FEW} episodes "
        f"({TOGETHER:,} in the batch), put back before each step, so that a thing's cost is not mixed up with where it "
        "leads the jack. Observation, reward, info dict, checks and wrappers always act: they were taken out to be "
        "measured. Batches of single environments (of the pymunk model, and any with a `render_mode`) have "
        f"{FEW}.\n\n"
        f"{machine()}; " + ", ".join(f"{name} {version}" for name, version in known.items())
    )


@command_line
def main() -> None:
    """Parse, measure, count, write, print."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    if PINNED:
        on_cores({max(os.sched_getaffinity(0))})
    from jackbox_env import _validation as check
    from scripts.studies.timing import others

    rounds = check.whole("rounds", arguments.rounds, at_least=1)
    seconds = check.real("seconds", arguments.seconds, above=0.0)
    if not arguments.out.parent.is_dir():
        raise FileNotFoundError(f"{arguments.out.parent} is no folder to write a page in")
    top, before = head(arguments), others()
    times, impacts = measured(rounds, seconds)
    text = joined(
        {
            "# What each thing costs": [top, "", meanwhile(before)],
            "## At a glance": [*glance(times), "", *in_short(times), f"- {impact_line(times, impacts)}"],
            "## Where the time of a step goes": [*layer_table(times, PYMUNK), "", *layer_table(times, EXACT)],
            "## What is off is not there": proof_table(),
            "## All figures": full_table(times),
        }
    )
    arguments.out.write_text(text)
    print(text)


if __name__ == "__main__":
    main()
