"""Plots: what a trained agent earns, and what a simulated scene does."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib
import numpy as np

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from agents.storage import new_file
from agents.trajectory import Trajectory

if TYPE_CHECKING:
    from agents.evaluation import Returns

BOX, JACK, ACCENT = "#c23b3b", "#2f5fb3", "#666666"


def _write(figure: Figure, path: Path) -> Path:
    with new_file(path) as partial:
        figure.savefig(partial, dpi=150)
    plt.close(figure)
    return path


def learning_figure(folder: Path, rows: list[Returns], task: str) -> Path:
    """Write results.png to a run folder: returns while learning beside the final table as bars."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10.0, 4.2), layout="constrained", sharey=True)
    evaluations = folder / "evaluations.npz"
    if evaluations.exists():
        stored = np.load(evaluations)
        steps, results = stored["timesteps"] / 1e6, stored["results"]
        error = 1.96 * results.std(axis=1, ddof=1) / np.sqrt(results.shape[1]) if results.shape[1] > 1 else 0.0
        mean = results.mean(axis=1)
        left.plot(steps, mean, color=JACK, marker="o", markersize=3)
        left.fill_between(steps, mean - error, mean + error, color=JACK, alpha=0.2, linewidth=0)
    for place, row in enumerate(row for row in rows if not row.policy.startswith("PPO")):
        left.axhline(row.mean, color=ACCENT, linewidth=0.8, linestyle=":")
        at = (0.02 + 0.16 * place, row.mean)  # side by side, or equal baselines would hide each other
        left.annotate(row.policy, at, xycoords=("axes fraction", "data"), va="bottom", color=ACCENT)
    left.set(xlabel="steps [million]", ylabel=f"return on {task}", title="while learning (95 % interval)")
    left.set_xlim(left=0.0)
    names = [row.policy for row in rows]
    colors = [JACK if name.startswith("PPO") else "#b8b8b8" for name in names]
    right.bar(names, [row.mean for row in rows], yerr=[row.half_width for row in rows], color=colors, capsize=4)
    right.set(title=f"mean of {len(rows[0].returns)} episodes (95 % interval)")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    return _write(figure, folder / "results.png")


# columns of the state, and what to call them
_PLOTS = {
    "box_positions": (BOX, "Box: position and angle", ((0, "x [m]"), (1, "y [m]"), (2, "angle [rad]"))),
    "box_velocities": (BOX, "Box: velocity and rate", ((6, "vx [m/s]"), (7, "vy [m/s]"), (8, "omega [rad/s]"))),
    "jack_positions": (JACK, "Jack: position and angle", ((3, "x [m]"), (4, "y [m]"), (5, "angle [rad]"))),
    "jack_velocities": (JACK, "Jack: velocity and rate", ((9, "vx [m/s]"), (10, "vy [m/s]"), (11, "omega [rad/s]"))),
}


def trajectory_figures(trajectory: Trajectory, folder: Path) -> list[Path]:
    """Write the four plots: positions and velocities of the box and of the jack, impacts marked by thin lines."""
    paths = []
    for name, (color, title, columns) in _PLOTS.items():
        figure, rows = plt.subplots(len(columns), 1, figsize=(8.0, 6.0), sharex=True, layout="constrained")
        for axes, (column, label) in zip(rows, columns, strict=True):
            _draw_column(axes, trajectory, column, color)
            axes.set_ylabel(label)
        rows[0].set_title(f"{title}; thin lines: {len(trajectory.impacts)} impacts")
        rows[-1].set_xlabel("time [s]")
        figure.align_ylabels(rows)
        paths.append(_write(figure, folder / f"{name}.png"))
    return paths


def _draw_column(axes: Axes, trajectory: Trajectory, column: int, color: str) -> None:
    for impact in trajectory.impacts[:1000]:  # more would be one grey block
        axes.axvline(impact.time, color="#cccccc", linewidth=0.6, zorder=0)
    axes.plot(trajectory.times, trajectory.states[:, column], color=color, linewidth=1.2)
    axes.margins(x=0.0)
    axes.spines[["top", "right"]].set_visible(False)
