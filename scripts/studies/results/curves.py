"""The picture of docs/results.md: how the shipped networks learnt."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")

from matplotlib import pyplot as plt

from agents.evaluation.figures import ACCENT
from agents.policies.network import SHIPPED
from agents.runs import EVALUATIONS
from jackbox_env.commands.plots import JACK
from jackbox_env.recording.files import replacing
from jackbox_env.tasks import TASKS

LINES = ("planner", "level", "best chirp")


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw the separate evaluations of each training, and what others earn as lines, for the exact model."""
    figure, panels = plt.subplots(1, len(TASKS), figsize=(10.0, 3.4), layout="constrained")
    earned = {(row["task"], row["policy"]): row["mean"] for row in rows if row["contact"] == "exact"}
    for axes, task in zip(panels, TASKS, strict=True):
        stored = np.load(SHIPPED / f"{task}-ppo" / EVALUATIONS)
        steps, results = stored["timesteps"] / 1e6, stored["results"]
        mean, error = results.mean(axis=1), 1.96 * results.std(axis=1, ddof=1) / np.sqrt(results.shape[1])
        axes.plot(steps, mean, color=JACK)
        axes.fill_between(steps, mean - error, mean + error, color=JACK, alpha=0.2, linewidth=0)
        for name in LINES:
            axes.axhline(earned[task, name], color=ACCENT, linewidth=0.8, linestyle=":")
            axes.annotate(
                name, (0.98, earned[task, name]), xycoords=("axes fraction", "data"), ha="right", va="bottom",
                color=ACCENT, fontsize=8,
            )  # fmt: skip
        axes.set(title=task, xlabel="steps [million]", xlim=(0.0, steps[-1]))
        axes.margins(y=0.12)
        axes.spines[["top", "right"]].set_visible(False)
    panels[0].set_ylabel("return (95 % interval)")
    with replacing(path) as partial:
        figure.savefig(partial, dpi=120)
    plt.close(figure)
