"""Write docs/results.md: returns of every policy on every task and both contact models."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from agents.policies.network import TRAINED
from agents.policies.planner import FAST_SEARCHES, SEARCHES
from jackbox_env.model.scene import Scene
from jackbox_env.tools import checks as check
from jackbox_env.tools.files import replacing
from scripts.studies import study
from scripts.studies.pages import label_ends, table
from scripts.studies.results import measured as these

# The picture's lines, and notes on the bounds.
LINES = {"upper bound": "-", "planner": (0, (9, 3)), "distilled": "--", "level": "-.", "best chirp": ":"}
NOTES = {"juggle": " (upper bound: of an upright bounce)", "spin": "", "rattle": " (upper bound: 500, off the scale)"}


@dataclass(frozen=True)
class Arguments(study.Arguments):
    """Evaluate all policies and write the page."""

    runs: Path | None = Path("runs/results")
    """Folder of trainings and evaluations, made if missing. Finished ones in it are not repeated."""
    episodes: int = 256
    """Episodes of each policy."""
    planner_episodes: int = 32
    """Episodes of the planner on each task and contact model, one or two seconds of computing each."""
    training_episodes: int = 1024
    """Episodes of each of the five trainings on a task."""
    across_episodes: int = 128
    """Episodes of each policy in each varied scene."""

    def __post_init__(self) -> None:
        """Raise ValueError if an interval cannot be estimated from so few episodes."""
        for name in ("episodes", "planner_episodes", "training_episodes", "across_episodes"):
            check.whole(name, getattr(self, name), at_least=4)


def trials(arguments: Arguments) -> study.Trials:
    """All trials of the page."""
    runs = str(arguments.runs)
    policies = {**dict.fromkeys(these.POLICIES, arguments.episodes), "planner": arguments.planner_episodes}
    every: study.Trials = [
        {"part": "learning", "runs": runs, "task": task, "seed": seed, "episodes": arguments.training_episodes}
        for seed, task in product(these.SEEDS, TRAINED)
    ]
    for task, contact, (policy, count) in product(TRAINED, these.CONTACTS, policies.items()):
        row = {"task": task, "contact": contact, "policy": policy, "episodes": count}
        every.append({"part": "rows", "runs": runs, **row})
    for restitution, mass in product(these.RESTITUTIONS, these.MASSES):
        scene = {"restitution": restitution, "jack_mass": mass}
        every.append({"part": "across", "runs": runs, "scene": scene, "episodes": arguments.across_episodes})
    for contact in these.CONTACTS:
        every.append({"part": "pixels", "runs": runs, "contact": contact, "episodes": arguments.episodes})
    return [*every, {"part": "spin_bound", "episodes": arguments.episodes}]


# -- the page ----------------------------------------------------------------------------------------------------------


def filled(record: study.Record) -> dict[str, Any]:
    """The numbers of docs/results.md."""
    rows = [*record["rows"], *record["pixels"]]
    best = {(row["task"], row["policy"]): row for row in rows if row["contact"] == "exact"}
    earned = {task: {name: row["mean"] for (of, name), row in best.items() if of == task} for task in TRAINED}
    drives = [(task, best[task, "best chirp"]["drive"]) for task in TRAINED]
    fast = 2.0 * Scene().speed_scale
    return {
        "earned": earned,
        "by_pymunk": _mean(record["rows"], "rattle", "planner", "pymunk"),
        "anchors": {name: ", ".join(f"{earned[task][name]:.1f}" for task in TRAINED) for name in ("zero", "planner")},
        "seed": these.SEED,
        "resamples": these.RESAMPLES,
        "episodes": [best["juggle", policy]["episodes"] for policy in ("zero", "planner")],
        "rows": {task: _table([row for row in rows if row["task"] == task]) for task in TRAINED},
        "pixels": {**vars(these.PICTURES), "minutes": record["pixels"][0]["processor_seconds"] / 60.0},
        "tried": len(these.chirps()),
        "upright": these.best_upright(),
        "bare_steps": these.BARE_STEPS,
        "rollouts": _rollouts(SEARCHES),
        "fast_rollouts": _rollouts(FAST_SEARCHES),
        "bound": record["spin_bound"],
        "reached": earned["spin"]["planner"] / record["spin_bound"],
        "fast": [0.5 * fast, these.rattle_at(0.5 * fast), these.rattle_at(fast)],
        "starts": these.STARTS,
        "chirps": ", ".join(f"{one['start_frequency']:g} Hz on {task}" for task, one in drives),
        **_across(record["across"]),
        "commits": ", ".join(sorted({row["commit"] for row in rows})),
        "machines": "; ".join(sorted({row["machine"] for row in rows})),
        "trained": _trained(record["learning"]),
    }


def _mean(rows: list[dict[str, Any]], *wanted: str) -> float:
    """The mean return of a task, policy and contact model."""
    return float(next(row["mean"] for row in rows if (row["task"], row["policy"], row["contact"]) == wanted))


def _rollouts(searches: dict[str, dict[str, Any]]) -> str:
    """Numbers of rollouts in a decision of the planners of all tasks."""
    counts = [searches[task]["samples"] * searches[task]["iterations"] for task in TRAINED]
    return f"{counts[0]:,}, {counts[1]:,} and {counts[2]:,}"


def _cell(row: dict[str, Any]) -> str:
    return f"{row['mean']:.1f} ± {np.ptp(row['interval_95']) / 2.0:.1f}"


def _table(rows: list[dict[str, Any]]) -> str:
    by_contact = {(row["policy"], row["contact"]): row for row in rows}
    lines = []
    for name in dict.fromkeys(policy for policy, _ in by_contact):
        spent = by_contact[name, "exact"]["milliseconds"]
        lines.append((name, *(_cell(by_contact[name, contact]) for contact in these.CONTACTS), f"{spent:.2g}"))
    return table(("policy", *these.CONTACTS, "ms"), lines)


def _across(rows: list[dict[str, Any]]) -> dict[str, Any]:
    names = list(rows[0]["earned"])
    default = next(row["earned"] for row in rows if Scene.of(dict(row["scene"])) == Scene())
    lines, spreads = [], []
    for restitution in dict.fromkeys(row["scene"]["restitution"] for row in rows):
        earned = {
            row["scene"]["jack_mass"]: row["earned"] for row in rows if row["scene"]["restitution"] == restitution
        }
        lines.append([f"{restitution:g}", *(_cell(earned[Scene().jack_mass][name]) for name in names)])
        spreads += [np.ptp([of_mass[name]["mean"] for of_mass in earned.values()]) for name in names]
    return {
        "scenes": len(rows),
        "across": table(("restitution", *names), lines),
        "by_mass": max(spreads),
        "means": {name: float(np.mean([row["earned"][name]["mean"] for row in rows])) for name in names},
        "own": {name: default[name]["mean"] for name in names},
        "ranges": these.RANGES,
    }


def _of_task(rows: list[dict[str, Any]], task: str) -> list[dict[str, Any]]:
    return [row for row in rows if row["task"] == task]


def _trained(rows: list[dict[str, Any]]) -> str:
    lines = []
    for task in TRAINED:
        trainings = _of_task(rows, task)
        settings, means = trainings[0]["settings"], [row["mean"] for row in trainings]
        ends = f"{min(means):.1f} to {max(means):.1f}"
        seconds = np.mean([row["seconds"][-1] for row in trainings])
        lines.append((task, f"{np.mean(means):.1f}", ends, f"{settings['total_steps']:,}", f"{seconds:.0f}"))
    return table(("task", "mean of five", "lowest to highest", "decisions", "seconds"), lines)


def draw(record: study.Record, folder: Path) -> None:
    """Draw the learning curves of five trainings on each task, other policies' returns and upper bounds, for exact."""
    from matplotlib.figure import Figure

    from jackbox_env.commands.plots import GREY, JACK

    figure = Figure(figsize=(5.0, 7.4), layout="constrained")
    panels = figure.subplots(len(TRAINED), 1)
    known = {(row["task"], row["policy"]): row["mean"] for row in record["rows"] if row["contact"] == "exact"}
    known |= {("juggle", "upper bound"): these.best_upright(), ("spin", "upper bound"): record["spin_bound"]}
    for axes, task in zip(panels, TRAINED, strict=True):
        seconds, middle, (low, high) = these.curve_of(_of_task(record["learning"], task))
        axes.plot(seconds, middle, "o-", color=JACK, markersize=4, clip_on=False)
        axes.fill_between(seconds, low, high, color=JACK, alpha=0.25, linewidth=0)
        ends = {"PPO, 5 seeds": middle[-1]}
        for name, style in LINES.items():
            if (task, name) in known:
                value, width = known[task, name], 2.0 if name == "upper bound" else 1.2
                axes.axhline(value, color=GREY, linewidth=width, linestyle=style)
                ends[f"{name} {value:.0f}"] = value
        axes.set_title(f"{task}: return{NOTES[task]}", loc="left", fontsize="medium")
        axes.set_xlim(0.0, seconds[-1])
        axes.margins(y=0.08)
        label_ends(axes, {name: (seconds[-1], end) for name, end in ends.items()}, apart=0.105)
    panels[-1].set_xlabel("seconds of training on one core")
    with replacing(folder / "results.png") as partial_file:
        figure.savefig(partial_file, dpi=150)


STUDY = study.Study(
    "results",
    {
        "learning": these.learning,
        "rows": these.policy_row,
        "across": these.in_scene,
        "pixels": these.of_pixels,
        "spin_bound": these.spin_bound,
    },
    filled,
    Arguments,
    trials,
    single=frozenset({"spin_bound"}),
    draw=draw,
)

if __name__ == "__main__":
    study.main(STUDY, __doc__)
