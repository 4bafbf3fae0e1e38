"""Write docs/results.md: returns of every policy on every task and both contact models."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from agents.policies.network import TRAINED
from agents.policies.planner import FAST_SEARCHES, SEARCHES
from jackbox_env.model.scene import Scene
from jackbox_env.tools.command_line import command_line
from jackbox_env.tools.files import check_writable, replacing, write_text
from scripts.studies.pages import label_ends, table
from scripts.studies.results import measured as these

# The picture's lines, and notes on the bounds.
LINES = {"upper bound": "-", "planner": (0, (9, 3)), "distilled": "--", "level": "-.", "best chirp": ":"}
NOTES = {"juggle": " (upper bound: of an upright bounce)", "spin": "", "rattle": " (upper bound: 500, off the scale)"}


@dataclass(frozen=True)
class Arguments:
    """Evaluate all policies and write the page."""

    episodes: int = 256
    """Episodes of each policy."""
    planner_episodes: int = 32
    """Episodes of the planner on each task and contact model, one or two seconds of computing each."""
    training_episodes: int = 1024
    """Episodes of each of the five trainings on a task."""
    across_episodes: int = 128
    """Episodes of each policy in each varied scene."""
    runs: Path = Path("runs/results")
    """Folder of trainings and evaluations, made if missing. Finished ones in it are not repeated."""
    workers: int | None = None
    """Number of evaluations at a time, each in a separate process; None: one after the other in this process."""
    out: Path = Path("docs")
    """Folder for results.md, results.json and results.png."""
    progress: bool = True
    """Show a progress bar."""
    render: bool = False
    """Measure nothing: write the page and draw the picture from the results that are stored."""


# -- the page ----------------------------------------------------------------------------------------------------------


def page(record: dict[str, Any]) -> str:
    """The page."""
    best = {(row["task"], row["policy"]): row for row in record["rows"] if row["contact"] == "exact"}
    earned = {task: {name: row["mean"] for (of, name), row in best.items() if of == task} for task in TRAINED}
    drives = [(task, best[task, "best chirp"]["drive"]) for task in TRAINED]
    fast = 2.0 * Scene().speed_scale
    fields = {
        "earned": earned,
        "by_pymunk": _mean(record["rows"], "rattle", "planner", "pymunk"),
        "anchors": {name: ", ".join(f"{earned[task][name]:.1f}" for task in TRAINED) for name in ("zero", "planner")},
        "seed": record["seed"],
        "resamples": record["resamples"],
        "episodes": [best["juggle", policy]["episodes"] for policy in ("zero", "planner")],
        "rows": {task: _table([row for row in record["rows"] if row["task"] == task]) for task in TRAINED},
        "tried": len(these.chirps()),
        "upright": these.best_upright(),
        "bare_steps": these.BARE_STEPS,
        "rollouts": _rollouts(SEARCHES),
        "fast_rollouts": _rollouts(FAST_SEARCHES),
        "bound": record["spin_bound"],
        "reached": earned["spin"]["planner"] / record["spin_bound"],
        "fast": [0.5 * fast, these.rattle_at(0.5 * fast), these.rattle_at(fast)],
        "starts": these.STARTS,
        "chirps": table(
            ("task", "amplitude [N m]", "first frequency [Hz]", "rate [Hz/s]"),
            [(task, f"{d['amplitude']:,.0f}", f"{d['start_frequency']:g}", f"{d['rate']:g}") for task, d in drives],
        ),
        **_across(record["across"]),
        "commits": ", ".join(sorted({row["commit"] for row in record["rows"]})),
        "machines": "; ".join(sorted({row["machine"] for row in record["rows"]})),
        "trained": _trained(record["learning"]),
    }
    return (Path(__file__).parent / "page.md").read_text().format(**fields)


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


def draw(rows: list[dict[str, Any]], learning: list[dict[str, Any]], spin_bound: float, path: Path) -> None:
    """Draw the learning curves of five trainings on each task, other policies' returns and upper bounds, for exact."""
    from matplotlib.figure import Figure

    from jackbox_env.commands.plots import GREY, JACK

    figure = Figure(figsize=(5.0, 7.4), layout="constrained")
    panels = figure.subplots(len(TRAINED), 1)
    known = {(row["task"], row["policy"]): row["mean"] for row in rows if row["contact"] == "exact"}
    known |= {("juggle", "upper bound"): these.best_upright(), ("spin", "upper bound"): spin_bound}
    for axes, task in zip(panels, TRAINED, strict=True):
        seconds, middle, (low, high) = these.curve_of(_of_task(learning, task))
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
    with replacing(path) as partial_file:
        figure.savefig(partial_file, dpi=150)


# -- the command -------------------------------------------------------------------------------------------------------


def gathered(arguments: Arguments) -> dict[str, Any]:
    """All results; unfinished trials in the folder are run."""
    from agents.sweep_ray import runner_for
    from scripts.studies.sweeping import swept

    folder, runner = arguments.runs.resolve(), runner_for(arguments.workers, None)
    folder.mkdir(parents=True, exist_ok=True)
    counts = arguments.episodes, arguments.planner_episodes, arguments.across_episodes, arguments.training_episodes
    trials = these.trials(*counts)
    rows = swept(folder / "sweep", trials, partial(these.measured, folder), runner, arguments.progress)
    parts: dict[str, list[Any]] = {"learning": [], "bare": [], "rows": [], "across": []}
    for row in rows:
        parts[row["part"]].append((row, row["row"]))
    across: dict[str, dict[str, Any]] = {}
    for row, earned in parts["across"]:
        across.setdefault(json.dumps(row["scene"]), {})[row["policy"]] = earned
    return {
        "seed": these.SEED,
        "resamples": these.RESAMPLES,
        "learning": [row for _, row in parts["learning"]],
        "rows": these.with_bare([row for _, row in parts["rows"]], [row for _, row in parts["bare"]]),
        "across": [{"scene": json.loads(scene), "earned": earned} for scene, earned in across.items()],
        "spin_bound": these.spin_bound(arguments.episodes),
    }


@command_line
def main() -> None:
    """Parse, run the missing evaluations, write the page."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    from jackbox_env.tools import checks as check

    for name in ("episodes", "planner_episodes", "training_episodes", "across_episodes"):
        check.whole(name, getattr(arguments, name), at_least=4)
    check_writable(arguments.out)
    path = arguments.out / "results.json"
    record = json.loads(path.read_text()) if arguments.render else gathered(arguments)
    write_text(arguments.out / "results.md", page(record))
    draw(record["rows"], record["learning"], record["spin_bound"], arguments.out / "results.png")
    write_text(path, json.dumps(record, indent=1) + "\n")
    print(f"Written: {arguments.out / 'results.md'}")


if __name__ == "__main__":
    main()
