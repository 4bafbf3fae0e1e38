"""What every policy earns on every task and both contact models: docs/results.md."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import tyro

from jackbox_env.commands.common import command_line
from jackbox_env.scene import Scene
from jackbox_env.tasks import TASKS
from scripts.studies.pages import table
from scripts.studies.results import measured as these

LINES = ("planner", "level", "best chirp")  # in the picture


@dataclass(frozen=True)
class Arguments:
    """Evaluate all policies and write the page."""

    episodes: int = 256
    """Episodes of each policy."""
    planner_episodes: int = 64
    """Episodes of the planner on each task and contact model, a second or two of computing for each."""
    across_episodes: int = 128
    """Episodes of each policy in each of the scenes that vary."""
    folder: Path = Path("runs/results")
    """Folder to make, or to go on in; trainings that are finished there are not trained again."""
    out: Path = Path("docs")
    """Folder for results.md, results.json and results.png."""
    progress: bool = True
    """Show a progress bar."""


# -- the page ----------------------------------------------------------------------------------------------------------


def page(record: dict[str, Any]) -> str:
    """The page."""
    best = {(row["task"], row["policy"]): row for row in record["rows"] if row["contact"] == "exact"}
    earned = {task: {name: row["mean"] for (of, name), row in best.items() if of == task} for task in TASKS}
    drives = [(task, best[task, "best chirp"]["drive"]) for task in TASKS]
    fast = 2.0 * Scene().speed_scale
    fields = {
        "earned": earned,
        "seed": record["seed"],
        "resamples": record["resamples"],
        "rows": {task: _table([row for row in record["rows"] if row["task"] == task]) for task in TASKS},
        "tried": len(these.chirps()),
        "bound": record["spin_bound"],
        "reached": earned["spin"]["planner"] / record["spin_bound"],
        "fast": [0.5 * fast, these.rattle_at(0.5 * fast), these.rattle_at(fast)],
        "starts": these.STARTS,
        "chirps": table(
            ("task", "amplitude [N m]", "first frequency [Hz]", "rate [Hz/s]"),
            [(task, f"{d['amplitude']:,.0f}", f"{d['start_frequency']:g}", f"{d['rate']:g}") for task, d in drives],
        ),
        **_ahead(record["ahead"], record["plan_alone"]),
        **_across(record["across"]),
        "commits": ", ".join(sorted({row["commit"] for row in record["rows"]})),
        "machines": "; ".join(sorted({row["machine"] for row in record["rows"]})),
        "trained": _trained(record["trained"]),
    }
    return (Path(__file__).parent / "page.md").read_text().format(**fields)


def _span(ends: list[float]) -> str:
    return f"{ends[0]:.1f} to {ends[1]:.1f}"


def _table(rows: list[dict[str, Any]]) -> str:
    heads = "policy", "contact", "mean return", "95 % interval", "interquartile mean", "95 % interval", "episodes"
    lines = [
        (row["policy"], row["contact"], f"{row['mean']:.1f}", _span(row["interval_95"]), f"{row['iqm']:.1f}",
         _span(row["iqm_interval_95"]), str(row["episodes"]))
        for row in rows
    ]  # fmt: skip
    return table(heads, lines)


def _ahead(rows: list[dict[str, Any]], alone: dict[str, Any]) -> dict[str, Any]:
    shares = [row["time"]["parts"]["looking ahead"] / row["time"]["seconds"] for row in rows]
    lines = [
        (str(row["seed"]), f"{row['mean']:.1f}", _span(row["interval_95"]), f"{row['time']['seconds'] / 60.0:.1f}")
        for row in rows
    ]
    return {
        "ahead": table(("seed", "mean return", "95 % interval", "minutes"), lines),
        "above": sum(row["interval_95"][0] > 300.0 for row in rows),
        "trainings": len(rows),
        "alone": f"{alone['mean']:.1f} ({_span(alone['interval_95'])})",
        "looking": [min(shares), max(shares)],
    }


def _across(rows: list[dict[str, Any]]) -> dict[str, Any]:
    names = list(rows[0]["earned"])
    own = next(row["earned"] for row in rows if Scene.of(dict(row["scene"])) == Scene())
    lines = []
    for row in rows:
        cells = [(earned["mean"], np.ptp(earned["interval_95"]) / 2.0) for earned in row["earned"].values()]
        fields = row["scene"]["restitution"], row["scene"]["jack_mass"]
        lines.append([*(f"{field:g}" for field in fields), *(f"{mean:.1f} ± {half:.1f}" for mean, half in cells)])
    return {
        "scenes": len(rows),
        "across": table(("restitution", "jack's mass [kg]", *names), lines),
        "means": {name: float(np.mean([row["earned"][name]["mean"] for row in rows])) for name in names},
        "own": {name: own[name]["mean"] for name in names},
        "ranges": these.RANGES,
    }


def _trained(trained: dict[str, Any]) -> str:
    lines = []
    for task, found in trained.items():
        settings, spent = found["settings"], found["time"]
        units = " x ".join(map(str, settings["hidden_units"]))
        figures = f"{spent['seconds'] / 60.0:.1f}", f"{spent['steps'] / spent['seconds']:,.0f}"
        lines.append((task, f"{settings['total_steps']:,}", str(settings["hold"]), units, *figures))
    return table(("task", "steps", "control steps of each", "network", "minutes", "steps per second"), lines)


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw how the shipped networks learnt, and what others earn as lines, for the exact model."""
    from matplotlib.figure import Figure

    from agents.evaluation.figures import ACCENT
    from agents.policies.network import SHIPPED
    from agents.runs import EVALUATIONS
    from jackbox_env.commands.plots import JACK
    from jackbox_env.recording.files import replacing

    figure = Figure(figsize=(10.0, 3.4), layout="constrained")
    panels = figure.subplots(1, len(TASKS))
    earned = {(row["task"], row["policy"]): row["mean"] for row in rows if row["contact"] == "exact"}
    for axes, task in zip(panels, TASKS, strict=True):
        stored = np.load(SHIPPED / f"{task}-ppo" / EVALUATIONS)
        steps, results = stored["timesteps"] / 1e6, stored["results"]
        mean, error = results.mean(axis=1), 1.96 * results.std(axis=1, ddof=1) / np.sqrt(results.shape[1])
        axes.plot(steps, mean, color=JACK)
        axes.fill_between(steps, mean - error, mean + error, color=JACK, alpha=0.2, linewidth=0)
        for name in LINES:
            axes.axhline(earned[task, name], color=ACCENT, linewidth=0.8, linestyle=":")
            place = 0.98, earned[task, name]
            axes.annotate(
                name, place, xycoords=("axes fraction", "data"), ha="right", va="bottom", color=ACCENT, fontsize=8
            )
        axes.set(title=task, xlabel="steps [million]", xlim=(0.0, steps[-1]))
        axes.margins(y=0.12)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("return (95 % interval)")
    with replacing(path) as partial_file:
        figure.savefig(partial_file, dpi=120)


# -- the command -------------------------------------------------------------------------------------------------------


def trained() -> dict[str, Any]:
    """Settings and times of the networks that come with the repository."""
    from agents.policies.network import SHIPPED
    from agents.runs import SETTINGS, TIME

    files = {"settings": SETTINGS, "time": TIME}
    return {
        task: {key: json.loads((SHIPPED / f"{task}-ppo" / name).read_text()) for key, name in files.items()}
        for task in TASKS
    }


def gathered(arguments: Arguments) -> dict[str, Any]:
    """Everything that the page shows; what has not finished in the folder is run."""
    from agents.sweeps.in_process import InTurn
    from jackbox_env.recording.files import make_folder
    from scripts.studies.sweeping import swept

    folder = arguments.folder.resolve()
    make_folder(folder)
    asked = these.trials(arguments.episodes, arguments.planner_episodes, arguments.across_episodes)
    found = swept(folder / "sweep", asked, partial(these.measured, folder), InTurn(), arguments.progress)
    parts: dict[str, list[Any]] = {"rows": [], "across": [], "ahead": []}
    for row in found:
        parts[row["part"]].append((row, json.loads(row["row"])))
    across: dict[str, dict[str, Any]] = {}
    for row, earned in parts["across"]:
        across.setdefault(row["scene"], {})[row["policy"]] = earned
    *ahead, (_, alone) = parts["ahead"]
    return {
        "seed": these.SEED,
        "resamples": these.RESAMPLES,
        "rows": [row for _, row in parts["rows"]],
        "across": [{"scene": json.loads(scene), "earned": earned} for scene, earned in across.items()],
        "ahead": [row for _, row in ahead],
        "plan_alone": alone,
        "spin_bound": these.spin_bound(arguments.episodes),
        "trained": trained(),
    }


@command_line
def main() -> None:
    """Parse, evaluate what is missing, write the page."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from jackbox_env import _validation as check
    from jackbox_env.recording.files import check_writable, write_text

    for name in ("episodes", "planner_episodes", "across_episodes"):
        check.whole(name, getattr(arguments, name), at_least=4)
    check_writable(arguments.out)
    record = gathered(arguments)
    write_text(arguments.out / "results.md", page(record))
    draw(record["rows"], arguments.out / "results.png")
    write_text(arguments.out / "results.json", json.dumps(record, indent=1) + "\n")
    print(f"Written: {arguments.out / 'results.md'}")


if __name__ == "__main__":
    main()
