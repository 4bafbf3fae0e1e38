"""The pictures of docs/accuracy.md: time errors against cost, and of each impact. ``accuracy.py`` draws them."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure

from jackbox_env.commands.plots import GREY  # this import sets the style of all plots
from jackbox_env.tools.files import replacing
from scripts.studies.accuracy.measured import (
    BATCH,
    COST,
    DETECTION,
    EXACT,
    PREDICTABLE,
    PYMUNK,
    REFERENCE,
    Results,
    impact,
    of_fidelity,
    pymunk,
)
from scripts.studies.pages import two_digits

_COLOURS = {EXACT: "C0", BATCH: "C0", PYMUNK: "C2", DETECTION: "C3", "box2d": "0.5", "mujoco": "0.5"}
_MARKERS = {EXACT: "D", BATCH: "D", PYMUNK: "o", DETECTION: "X", "box2d": "s", "mujoco": "^"}
_LABELS = {  # at the points: text, offset [points], alignment
    EXACT: ("exact", (7, 0), "left"),
    BATCH: ("exact,\nin a batch", (7, 12), "left"),
    of_fidelity("coarse"): ("coarse", (-6, 0), "right"),
    of_fidelity("balanced"): ("balanced", (-6, -7), "right"),
    of_fidelity("fine"): ("fine", (-7, -7), "right"),
    pymunk(1).name: ("pymunk, 1 substep", (-9, 2), "right"),
    pymunk(256).name: ("256 substeps", (-3, -12), "right"),
    f"{DETECTION}, RK4 at 0.01 s": ("threshold\ndetection", (3, 40), "left"),
    "mujoco, 64 substeps": ("■ Box2D\n▲ MuJoCo", (5, 72), "right"),
}
_LEAST = 1e-16  # where a logarithmic axis shows zero
_LATE = 1e-8  # first impacts [s]: later of all settings with fixed steps, earlier of all that locate impacts


def points(results: Results, quantity: str) -> dict[str, dict[str, list[Any]]]:
    """Settings, their costs, and median and worst of a quantity, by family, in the order of the sweep."""
    lines: dict[str, dict[str, list[Any]]] = {}
    for name in results.settings:
        cost, row = results.some(name, "cost", quantity)
        if row.n:
            line = lines.setdefault(cost.family, {"setting": [], "cost": [], "median": [], "worst": []})
            for column, value in zip(
                line.values(), (name, cost.median, max(row.median, _LEAST), row.worst), strict=True
            ):
                column.append(value)
    return lines


_SCRIPT = """<style>[id^=ring] { opacity: 0 }</style>
<script>
const texts = [...document.querySelectorAll("#title text")], usual = texts.map((text) => text.textContent);
const rings = Object.entries(LINES).map(([id, lines]) => ({ ring: document.getElementById(id), lines }));
addEventListener("pointermove", (event) => {
  for (const one of rings) {
    const { x, y, width, height } = one.ring.getBoundingClientRect();
    one.away = Math.hypot(event.clientX - x - width / 2, event.clientY - y - height / 2);
  }
  const near = rings.reduce((best, one) => (best.away > one.away ? one : best), { away: 25, lines: usual }); // [px]
  for (const one of rings) one.ring.style.opacity = one === near ? 1 : 0;
  texts.forEach((text, line) => (text.textContent = near.lines[line]));
});
</script>
</svg>"""


def draw(results: Results, path: Path) -> None:
    """Draw it, legible at 390 pixels; its title shows the numbers of the setting under the pointer."""
    figure = Figure(figsize=(4.0, 4.8), dpi=200, layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3.4, 1.0))
    for axis in (upper, lower):
        axis.set(xscale="log", yscale="log")
        axis.grid()
        _plot(axis, points(results, "first_1"))
    title = "How far off is the first impact?\nPoint: median. Line: to the worst case."
    figure.suptitle(title, x=0.04, ha="left", fontsize="medium", gid="title")  # lines of any length
    upper.set(ylim=(1.5e-5, 0.1))
    upper.set_yticks([1e-4, 1e-3, 1e-2], ["0.1 ms", "1 ms", "10 ms"])
    upper.spines.bottom.set_visible(False)
    upper.tick_params(axis="x", which="both", length=0)
    lower.set(ylim=(_LEAST, 1e-11), xlabel="computing time per simulated second")
    lower.set_yticks([1e-15, 1e-12], ["$10^{-15}$ s", "$10^{-12}$ s"])
    lower.set_xticks([1e1, 1e2, 1e3, 1e4], ["10 µs", "0.1 ms", "1 ms", "10 ms"])
    lower.spines.top.set(visible=True, linestyle=(0, (4, 4)))  # the axis is cut here
    lines = _add_rings(results, upper, lower)
    with replacing(path) as partial, matplotlib.rc_context({"svg.fonttype": "none", "svg.hashsalt": path.name}):
        figure.savefig(partial, metadata={"Date": None})
        script = _SCRIPT.replace("LINES", json.dumps(lines))
        partial.write_text(partial.read_text().replace("</svg>", script))


def _add_rings(results: Results, *axes: Any) -> dict[str, list[str]]:
    """Draw an invisible ring around each point; return its two lines of text: setting and cost, and error."""
    lines = dict[str, list[str]]()
    for name in results.settings:
        error, cost = results.some(name, "first_1", "cost")
        point = cost.median, max(error.median, _LEAST)
        for axis in axes:
            low, high = axis.get_ylim()
            if low <= point[1] <= high and cost.family in _COLOURS:
                ring = f"ring-{len(lines)}"
                axis.plot(*point, "o", markersize=9, fillstyle="none", color=GREY, gid=ring)
                late = f"{_seconds(error.median)} late, at worst {_seconds(error.worst)}"
                lines[ring] = [f"{name}: {_seconds(1e-6 * cost.median)} of computing", late]
    return lines


def _seconds(value: float) -> str:
    """A time in the largest unit in which it is at least 1."""
    unit, size = next(((unit, size) for unit, size in (("ms", 1e-3), ("µs", 1e-6)) if value >= size), ("s", 1.0))
    return f"{two_digits(value / size)} {unit}"


def _plot(axis: Any, lines: dict[str, dict[str, list[Any]]]) -> None:
    """Plot the lines of the families, with their labels."""
    for family, line in lines.items():
        colour = _COLOURS.get(family)  # none: variants of another family, which would lie on its points
        if colour:
            style = {"marker": _MARKERS[family], "markersize": 7 if family == DETECTION else 4, "color": colour}
            axis.plot("cost", "median", data=line, zorder=3 if family == DETECTION else 2, **style)
            axis.vlines("cost", "median", "worst", data=line, color=colour, alpha=0.4)
        for name, *point in zip(line["setting"], line["cost"], line["median"], strict=True):
            text, offset, aligned = _LABELS.get(name, ("", (0, 0), "left"))
            axis.annotate(text, point, xytext=offset, textcoords="offset points", color=colour, ha=aligned, va="center")


def draw_impacts(results: Results, settings: Sequence[str], path: Path) -> None:
    """Draw the median error of the k-th impact's time against k: a line for each setting, of the proven cases.

    Settings that find impacts at their time are below, those of fixed steps above, on an axis of its own.
    """
    figure = Figure(figsize=(5.0, 7.2), layout="constrained")
    panels = figure.subplots(2, 1)
    for marker, dashes, name in zip("osv^D<>ph", ("-", "--", ":") * 3, settings, strict=False):
        rows = [results.of(name, impact(number).name, REFERENCE) for number in range(1, PREDICTABLE + 1)]
        errors = [max(row.median, _LEAST) for row in rows if row.n]
        axis = panels[int(rows[0].median < _LATE)]
        colour = _COLOURS.get(rows[0].family, "C1")
        style = {"marker": marker, "linestyle": dashes, "markersize": 5, "color": colour}
        axis.plot(range(1, len(errors) + 1), errors, label=name, **style)
    for axis, which in zip(panels, ("fixed steps", "located impacts"), strict=True):
        axis.set(
            yscale="log", xlim=(0.5, PREDICTABLE + 0.5), xticks=range(1, PREDICTABLE + 1), xlabel="number of the impact"
        )
        axis.set_title(f"Median error of a correct impact's time [s]: {which}", loc="left", fontsize="medium")
        axis.grid()
        axis.legend(fontsize="small", frameon=False, loc="upper left", bbox_to_anchor=(0.0, -0.18), ncols=2)
    with replacing(path) as partial:
        figure.savefig(partial, dpi=150, format="png", metadata={"Software": None})


_LINES = {  # of the diagram of engines: marker, colour, label of the finest setting, its offset [points], alignment
    EXACT: ("D", "C0", "exact", (8, 0), "left"),
    PYMUNK: ("o", "C2", "pymunk", (-8, 2), "right"),
    "Box2D v3": ("s", "C1", "Box2D v3", (8, 5), "left"),
    "Rapier": ("^", "C4", "Rapier", (8, -5), "left"),
    "matter.js": ("v", "C5", "matter.js", (6, -10), "left"),
    "Drake": ("P", "C6", "Drake", (0, 9), "center"),
    "solve_ivp": ("*", GREY, "SciPy", (-4, 9), "center"),
    "box2d": ("s", GREY, "Box2D 2.3", (0, 10), "center"),
    "mujoco": ("X", GREY, "MuJoCo", (8, -2), "left"),
    DETECTION: ("x", "C3", "threshold detection", (4, -11), "center"),
}


def draw_engines(results: Results, settings: Sequence[str], path: Path) -> None:
    """Draw the share of correct impacts against the cost: a line for each engine, from coarse to fine settings."""
    lines: dict[str, list[tuple[float, float]]] = {}
    for name in settings:
        correct, known, cost = (results.of(name, quantity, REFERENCE) for quantity in ("prefix", "known", COST))
        lines.setdefault(correct.family, []).append((cost.median, 100.0 * correct.total / known.total))
    figure = Figure(figsize=(5.0, 4.4), layout="constrained")
    axes = figure.subplots()
    for family, points in lines.items():
        marker, colour, text, offset, aligned = _LINES[family]
        x, y = zip(*sorted(points, key=lambda point: point[1]), strict=True)
        axes.plot(x, y, marker=marker, color=colour, markersize=6)
        axes.annotate(text, (x[-1], y[-1]), offset, textcoords="offset points", color=colour, ha=aligned, va="center")
    axes.set(
        xscale="log",
        xlim=(8e1, 1e6),
        ylim=(0.0, 100.0),
        xlabel="computing time per simulated second",
        ylabel="correct impacts [%]",
    )
    axes.set_xticks([1e2, 1e3, 1e4, 1e5, 1e6], ["0.1 ms", "1 ms", "10 ms", "0.1 s", "1 s"])
    axes.set_title("Proven impacts that are right, against computing time", loc="left", fontsize="medium")
    axes.grid()
    with replacing(path) as partial:
        figure.savefig(partial, dpi=150, format="png", metadata={"Software": None})
