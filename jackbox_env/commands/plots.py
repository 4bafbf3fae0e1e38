"""Plots of a motion by matplotlib, which is optional; the style is that of all the project's plots."""

from __future__ import annotations

from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from jackbox_env.recording.motion import Motion
from jackbox_env.tools.colours import JACK as JACK_COLOUR
from jackbox_env.tools.colours import WALL, hexed
from jackbox_env.tools.files import new_file

BOX, JACK, GREY = hexed(WALL), hexed(JACK_COLOUR), "#787e86"

# Importing this file sets transparent figures, readable on a white page and on a dark one.
matplotlib.rcParams.update(
    {
        "figure.facecolor": "none", "axes.facecolor": "none", "text.color": GREY,
        "axes.edgecolor": GREY, "axes.labelcolor": GREY, "xtick.color": GREY, "ytick.color": GREY,
        "axes.spines.top": False, "axes.spines.right": False, "grid.color": GREY, "grid.alpha": 0.3,
        "boxplot.boxprops.color": GREY, "boxplot.whiskerprops.color": GREY, "boxplot.capprops.color": GREY,
        "boxplot.flierprops.markeredgecolor": GREY,
    }
)  # fmt: skip

# columns of the state, and their labels
_PLOTS = {
    "box_positions": (BOX, "Box: position and angle", ((0, "x [m]"), (1, "y [m]"), (2, "angle [rad]"))),
    "box_velocities": (BOX, "Box: velocity and rate", ((6, "vx [m/s]"), (7, "vy [m/s]"), (8, "omega [rad/s]"))),
    "jack_positions": (JACK, "Jack: position and angle", ((3, "x [m]"), (4, "y [m]"), (5, "angle [rad]"))),
    "jack_velocities": (JACK, "Jack: velocity and rate", ((9, "vx [m/s]"), (10, "vy [m/s]"), (11, "omega [rad/s]"))),
}


def write_figure(figure: Figure, path: Path) -> Path:
    """Write a figure to a new file."""
    with new_file(path) as partial:
        figure.savefig(partial, dpi=150)
    return path


def motion_figures(motion: Motion, folder: Path) -> None:
    """Write the four plots: positions and velocities of the box and of the jack, impacts marked by thin lines."""
    for name, (color, title, columns) in _PLOTS.items():
        figure = Figure(figsize=(8.0, 6.0), layout="constrained")
        rows = figure.subplots(len(columns), 1, sharex=True)
        for axes, (column, label) in zip(rows, columns, strict=True):
            for time in motion.impacts["time"][:1000]:  # more would be one grey block
                axes.axvline(time, color=GREY, alpha=0.4, linewidth=0.6, zorder=0)
            axes.plot(motion.t, motion.states[:, column], color=color, linewidth=1.2)
            axes.margins(x=0.0)
            axes.set_ylabel(label)
        rows[0].set_title(f"{title}; thin lines: {motion.impact_count} impacts")
        rows[-1].set_xlabel("time [s]")
        figure.align_ylabels(rows)
        write_figure(figure, folder / f"{name}.png")
