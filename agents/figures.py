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

from agents.storage import new_file, replacing
from agents.trajectory import Trajectory

if TYPE_CHECKING:
    from agents.evaluation import Returns
    from agents.inference import Estimate

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
    left.set(xlabel="environment steps [million]", ylabel=f"return on {task}", title="while learning (95 % interval)")
    left.set_xlim(left=0.0)
    names = [row.policy for row in rows]
    colors = [JACK if name.startswith("PPO") else "#b8b8b8" for name in names]
    right.bar(names, [row.mean for row in rows], yerr=[row.half_width for row in rows], color=colors, capsize=4)
    right.set(title=f"mean of {len(rows[0].returns)} episodes (95 % interval)")
    for axes in (left, right):
        axes.spines[["top", "right"]].set_visible(False)
    return _write(figure, folder / "results.png")


_FIDELITY_COLORS = ("#d95f02", "#e6ab02", "#1b9e77", "#2f5fb3", "#7570b3")


def transfer_figure(
    path: Path, task: str, rows: dict[str, list[Estimate]], seeds: dict[str, list[list[float]]],
    scripted: dict[str, list[float]],
) -> None:  # fmt: skip
    """Write (again) a dot plot: returns with intervals over the fidelity run on, colours for the one trained on.

    Args:
        path: the picture to write.
        task: what was rewarded.
        rows: fidelity trained on -> return on each fidelity, in the order of the keys.
        seeds: likewise, the mean return of each training: small dots.
        scripted: policy -> mean return on each.
    """
    figure, axes = plt.subplots(figsize=(8.0, 4.4), layout="constrained")
    places = np.arange(len(rows))
    for number, (name, estimates) in enumerate(rows.items()):
        offset = 0.6 * ((number + 0.5) / len(rows) - 0.5)
        means, halves = zip(*estimates, strict=True)
        half_widths = [half if np.isfinite(half) else 0.0 for half in halves]  # one training has no interval
        color = _FIDELITY_COLORS[number % len(_FIDELITY_COLORS)]
        axes.errorbar(places + offset, means, yerr=half_widths, fmt="o", color=color, capsize=3, label=f"PPO, {name}")
        own = list(rows).index(name)
        axes.plot(own + offset, means[own], "o", markersize=12, markerfacecolor="none", color=color)
        for place, dots in zip(places + offset + 0.06, seeds[name], strict=True):
            axes.plot([place] * len(dots), dots, ".", color=color, markersize=4, alpha=0.7)
    for (name, returns), style in zip(scripted.items(), ("--", "-.", ":"), strict=False):
        for place, mean in zip(places, returns, strict=True):
            label = name if place == 0 else None
            axes.plot([place - 0.4, place + 0.4], [mean, mean], style, color=ACCENT, linewidth=1.0, label=label)
    shown = [
        mean for means in [*scripted.values(), *(dots for each in seeds.values() for dots in each)] for mean in means
    ]
    margin = 0.25 * (max(shown) - min(shown)) or 1.0
    axes.set_ylim(min(shown) - margin, max(shown) + margin)  # an interval of few trainings may go on beyond
    axes.set_xticks(places, [f"run on {name}" for name in rows])
    axes.set(
        ylabel=f"return on {task} (95 % interval)", title="ringed: run where it was trained; small dots: trainings"
    )
    axes.legend(title="policy, trained on", loc="center left", bbox_to_anchor=(1.0, 0.5), frameon=False)
    axes.spines[["top", "right"]].set_visible(False)
    with replacing(path) as partial:
        figure.savefig(partial, dpi=150)
    plt.close(figure)


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
