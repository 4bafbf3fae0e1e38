"""Plots of returns: while learning, and compared with scripted policies."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from jackbox_env.commands.plots import GREY, JACK, write_figure

if TYPE_CHECKING:
    from agents.evaluation.returns import Returns

ACCENT = GREY


def learning_figure(folder: Path, rows: list[Returns], task: str) -> Path:
    """Write results.png to a run folder: returns while learning, and the final table as bars."""
    figure = Figure(figsize=(10.0, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2, sharey=True)
    evaluations = folder / "evaluations.npz"
    if evaluations.exists():
        stored = np.load(evaluations)
        steps, results = stored["timesteps"] / 1e6, stored["results"]
        error = 1.96 * results.std(axis=1, ddof=1) / np.sqrt(results.shape[1]) if results.shape[1] > 1 else 0.0
        mean = results.mean(axis=1)
        left.plot(steps, mean, color=JACK, marker="o", markersize=3)
        left.fill_between(steps, mean - error, mean + error, color=JACK, alpha=0.2, linewidth=0)
    for index, row in enumerate(row for row in rows if not row.policy.startswith("PPO")):
        left.axhline(row.mean, color=ACCENT, linewidth=0.8, linestyle=":")
        position = (0.02 + 0.16 * index, row.mean)  # side by side, or equal baselines would hide each other
        left.annotate(row.policy, position, xycoords=("axes fraction", "data"), va="bottom", color=ACCENT)
    left.set(xlabel="steps [million]", ylabel=f"return on {task}", title="while learning (95 % interval)")
    left.set_xlim(left=0.0)
    names = [row.policy for row in rows]
    colors = [JACK if name.startswith("PPO") else "#b8b8b8" for name in names]
    errors = {"yerr": [row.half_width for row in rows], "ecolor": GREY, "capsize": 4}
    right.bar(names, [row.mean for row in rows], color=colors, **errors)
    right.set(title=f"mean of {len(rows[0].returns)} episodes (95 % interval)")
    return write_figure(figure, folder / "results.png")
