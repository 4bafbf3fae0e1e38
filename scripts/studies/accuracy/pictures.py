"""Work-precision diagrams: a picture, and a page that tells of each point under the mouse."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

from agents.storage import replacing, write_text
from scripts.studies.accuracy.cases import DIGITS
from scripts.studies.accuracy.settings import BATCH, EXACT
from scripts.studies.accuracy.summary import ALL

LEAST = 1e-16  # where a logarithmic axis shows zero
COST = "cost [microseconds per simulated second]"


class Panel(NamedTuple):
    """A quantity against cost."""

    name: str  # in the results
    title: str
    logarithmic: bool = True


PANELS = (
    Panel("first_1", "time error of the first impact [s]"),
    Panel("local", "pose error 0.1 s after a restart, over an impact [m]"),
    Panel("depth", "deepest penetration [m]"),
    Panel("prefix", "impacts predicted before the first wrong one", logarithmic=False),
)


class Point(NamedTuple):
    """A setting in a panel."""

    name: str
    cost: float
    median: float
    worst: float
    n: int


def shown(results: dict[str, Any], name: str, quantity: str) -> dict[str, Any]:
    """A quantity of a setting over the cases that tell most.

    The exact model is the others' reference over the seeds, so its errors are taken over the 60-digit trajectories;
    what needs no reference, and how many impacts it is sure of, over the seeds like everybody's.
    """
    alone = quantity in ("prefix", "depth", "imbalance", "escaped")
    kind = DIGITS if name in (EXACT, BATCH) and not alone else ALL
    found: dict[str, Any] = results["settings"][EXACT if name == BATCH else name]["kinds"][kind]
    return found


def points(results: dict[str, Any], panel: Panel) -> dict[str, list[Point]]:
    """The points of a panel by family, cheapest first; settings without a value are left out."""
    lines: dict[str, list[Point]] = {}
    for name, entry in results["settings"].items():
        spread = shown(results, name, panel.name)[panel.name]
        if spread["n"]:
            median, worst = (_visible(spread[part], panel) for part in ("median", "worst"))
            point = Point(name, entry["cost"]["median"], median, worst, spread["n"])
            lines.setdefault(entry["family"], []).append(point)
    return {family: sorted(line, key=lambda point: point.cost) for family, line in lines.items()}


def _visible(value: float, panel: Panel) -> float:
    value = float(value)
    return max(value, LEAST) if panel.logarithmic and not math.isnan(value) else value


def draw(results: dict[str, Any], path: Path) -> None:
    """The four panels as a PNG: medians, with a line up (or down) to the worst."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(13.0, 9.5), layout="constrained")
    axes = figure.subplots(2, 2).flat
    for axis, panel in zip(axes, PANELS, strict=True):
        for index, (family, line) in enumerate(points(results, panel).items()):
            costs = [point.cost for point in line]
            colour, marker = f"C{index % 10}", "osD^vPX*<>"[index % 10]
            axis.plot(costs, [point.median for point in line], marker=marker, color=colour, label=family)
            low = [min(point.median, point.worst) for point in line]
            high = [max(point.median, point.worst) for point in line]
            axis.vlines(costs, low, high, color=colour, alpha=0.35, linewidth=1.0)
            for point in line if len(line) > 2 and "iterations" not in family else ():
                label = point.name.split(", ")[-1].split()[0]
                axis.annotate(
                    label,
                    (point.cost, point.median),
                    textcoords="offset points",
                    xytext=(4, 4),
                    fontsize=7,
                    color=colour,
                )
        axis.set_xscale("log")
        axis.set_yscale("log" if panel.logarithmic else "linear")
        axis.set_xlabel(COST)
        axis.set_ylabel(panel.title)
        axis.grid(alpha=0.3)
    handles, labels = figure.axes[0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=4, fontsize=9)
    figure.suptitle(
        "Speed against accuracy: left is cheaper, low is better but for the last. Points: medians, lines: to the worst "
        "case; numbers: substeps",
        fontsize=10,
    )
    with replacing(path) as partial:
        figure.savefig(partial, dpi=110)


def interactive(results: dict[str, Any], path: Path) -> None:
    """The same as a page that needs nothing else: a tab per quantity, details under the mouse, families to hide."""
    from bokeh.embed import file_html
    from bokeh.models import HoverTool, TabPanel, Tabs
    from bokeh.palettes import Category10
    from bokeh.plotting import figure
    from bokeh.resources import INLINE

    tabs = []
    for panel in PANELS:
        plot = figure(
            x_axis_type="log",
            y_axis_type="log" if panel.logarithmic else "linear",
            x_axis_label=COST,
            y_axis_label=panel.title,
            width=1000,
            height=620,
            tools="pan,wheel_zoom,box_zoom,reset,save",
        )
        dots: list[Any] = []
        for index, (family, line) in enumerate(points(results, panel).items()):
            data = {field: [getattr(point, field) for point in line] for field in Point._fields}
            colour = Category10[10][index % 10]
            plot.line(data["cost"], data["median"], color=colour, legend_label=family)
            plot.segment(data["cost"], data["median"], data["cost"], data["worst"], color=colour, alpha=0.4)
            dots.append(plot.scatter("cost", "median", source=data, size=9, color=colour, legend_label=family))
        tips = [("", "@name"), ("cost", "@cost{0,0} us per simulated s"), ("median", "@median{%.3g}")]
        tips += [("worst", "@worst{%.3g}"), ("n", "@n")]
        plot.add_tools(HoverTool(renderers=dots, tooltips=tips, formatters={"@median": "printf", "@worst": "printf"}))
        plot.legend.click_policy = "hide"
        plot.add_layout(plot.legend[0], "right")
        tabs.append(TabPanel(child=plot, title=panel.title))
    write_text(path, file_html(Tabs(tabs=tabs), INLINE, "jackbox: speed against accuracy"))
