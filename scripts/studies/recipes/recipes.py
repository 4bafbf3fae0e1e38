"""Write docs/recipes.md: what plain algorithms earn on each task, and what the other recipes that train earn."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.runners import ONE_THREAD
from jackbox_env.model.tasks import TASKS
from scripts.recipes.run import HERE
from scripts.studies import study
from scripts.studies.pages import table
from scripts.studies.results.results import STUDY as RESULTS

DOCS = Path(__file__).parents[3] / "docs"
PLAIN = {name: ("sb3", name) for name in ("PPO", "RecurrentPPO", "SAC", "TQC", "DQN")} | {"CleanRL's PPO": ("cleanrl",)}
OTHERS = ("servo", "pixels")


@dataclass(frozen=True)
class Arguments(study.Arguments):
    """Run the recipes that train in full, about half an hour of one core, and write the page."""

    runs: Path | None = Path("runs/recipes-study")
    """Folder of results, made if missing. Finished recipes in it are not repeated."""


def trials(arguments: Arguments) -> study.Trials:
    """Each plain algorithm on each task, and each of the other recipes once."""
    plain = [
        {"part": "plain", "recipe": recipe, "arguments": [*first, "--task", task]}
        for task in TASKS
        for recipe, *first in PLAIN.values()
    ]
    return [*plain, *({"part": "others", "recipe": recipe, "arguments": []} for recipe in OTHERS)]


def trained(recipe: str, arguments: list[str]) -> dict[str, Any]:
    """Run a recipe, on one thread: the return that it prints, and the processor seconds of the whole program.

    Raises:
        RuntimeError: it failed.
    """
    before = os.times()
    command = [sys.executable, str(HERE / f"with_{recipe}.py"), *arguments]
    done = subprocess.run(command, env=os.environ | ONE_THREAD, capture_output=True, text=True, check=False)
    printed = re.search(r"^(?:after ([\d,]+) actions: )?return (-?[\d.]+)(?: \+- ([\d.]+))?", done.stdout, re.MULTILINE)
    if done.returncode or printed is None:
        raise RuntimeError(f"the recipe {recipe} failed: {done.stderr[-500:]}")
    after = os.times()
    actions, mean, interval = printed.groups()
    return {
        "recipe": recipe, "arguments": arguments, "actions": int(actions.replace(",", "")) if actions else None,
        "mean": float(mean),
        "half_width_95": float(interval) if interval else None,
        "seconds": after.children_user + after.children_system - before.children_user - before.children_system,
    }  # fmt: skip


def filled(record: study.Record) -> dict[str, Any]:
    """The numbers of docs/recipes.md; those of zero torque are of docs/results.json."""
    rows = {(row["recipe"], *row["arguments"]): row for row in (*record["plain"], *record["others"])}
    lines = [["no torque", "", *map(zero, TASKS), ""]]
    for name, recipe in PLAIN.items():
        on = [rows[*recipe, "--task", task] for task in TASKS]
        cells = [_cell(row["mean"], row["half_width_95"]) for row in on]
        lines.append([name, f"{on[0]['actions']:,}", *cells, f"{sum(row['seconds'] for row in on) / len(on):.0f}"])
    single = {"cleanrl": rows["cleanrl", "--task", "juggle"]} | {name: rows[(name,)] for name in OTHERS}
    sentences = {name: f"{row['seconds']:.0f} s, to a return of {row['mean']:.0f}" for name, row in single.items()}
    return {"plain": table(("algorithm", "actions", *TASKS, "seconds"), lines), **sentences}


def zero(task: str) -> str:
    """What zero torque earns on a task."""
    stored = RESULTS.read(DOCS)["rows"]
    row = next(row for row in stored if (row["task"], row["policy"], row["contact"]) == (task, "zero", "exact"))
    low, high = row["interval_95"]
    return _cell(row["mean"], (high - low) / 2.0)


def _cell(mean: float, half_width: float) -> str:
    return f"{mean:.1f} ± {half_width:.1f}"


STUDY = study.Study("recipes", {"plain": trained, "others": trained}, filled, Arguments, trials)

if __name__ == "__main__":
    study.main(STUDY, __doc__)
