"""Work-precision diagrams: a small picture that decides, and an interactive page with every setting."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from jackbox_env.recording.files import replacing, write_text
from scripts.studies.accuracy.cases import LOSS
from scripts.studies.accuracy.results import Results
from scripts.studies.accuracy.settings import BATCH, EXACT, NAIVE, PYMUNK, of_fidelity, pymunk

PICTURE, WITH_LOSS, INTERACTIVE = "work_precision.png", "work_precision_loss.png", "work_precision.html"
TABS = {
    "first_1": "time error of the first impact [s]",
    "local": "pose error 0.1 s after a restart, over an impact [m]",
    "depth": "deepest that a foot was in a wall [m]",
    "prefix": "right impacts before the first wrong one",
}
LOSS_TABS = {
    "first_3": "with loss: time error, first 3 [s]",
    "local": "with loss: pose error, restart [m]",
}
_COLOURS = {EXACT: "C0", BATCH: "C0", PYMUNK: "C2", NAIVE: "C3", "box2d": "0.5", "mujoco": "0.5"}
_LABELS = {  # at the points: text, offset [points], alignment
    EXACT: ("exact", (7, 0), "left"),
    BATCH: ("exact,\nin a batch", (7, -4), "left"),
    of_fidelity("coarse"): ("coarse", (-6, 0), "right"),
    of_fidelity("balanced"): ("balanced", (-6, -7), "right"),
    of_fidelity("fine"): ("fine", (-7, -7), "right"),
    pymunk(1).name: ("pymunk, 1 substep", (-6, 2), "right"),
    pymunk(256).name: ("256 substeps", (-3, -12), "right"),
    f"{NAIVE}, RK4 at 0.01 s": ("usual way", (3, 40), "left"),
    "mujoco, 64 substeps": ("Box2D,\nMuJoCo", (5, 72), "right"),
}
_LEAST = 1e-16  # where a logarithmic axis shows zero


def points(results: Results, quantity: str, kind: str | None = None) -> dict[str, dict[str, list[Any]]]:
    """Settings, their costs and a quantity of theirs: columns by family, in the order of the sweep."""
    lines: dict[str, dict[str, list[Any]]] = {}
    for name in results.settings:
        if kind and (name, kind, quantity) not in results.rows:
            continue
        cost, row = results.of(name, "cost"), results.of(name, quantity, kind)
        if row.n:
            line = lines.setdefault(cost.family, {"setting": [], "cost": [], "median": [], "worst": [], "n": []})
            for column, value in zip(
                line.values(), (name, cost.median, max(row.median, _LEAST), row.worst, row.n), strict=True
            ):
                column.append(value)
    return lines


def draw(results: Results, path: Path) -> None:
    """The first impact's time error against cost, to be read at 390 pixels."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.0, 4.8), dpi=200, layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3.4, 1.0))
    for axis in (upper, lower):
        axis.set(xscale="log", yscale="log")
        axis.grid(alpha=0.3)
        _plot(axis, points(results, "first_1"))
    upper.set(ylim=(1.5e-5, 0.1), title="How far off is the first impact?\nPoint: median. Line: to the worst case.")
    upper.set_yticks([1e-4, 1e-3, 1e-2], ["0.1 ms", "1 ms", "10 ms"])
    upper.spines.bottom.set_visible(False)
    upper.tick_params(axis="x", which="both", length=0)
    lower.set(ylim=(_LEAST, 1e-14), xlabel="computing time per simulated second")
    lower.set_yticks([1e-15], ["$10^{-15}$ s"])
    lower.set_xticks([1e1, 1e2, 1e3, 1e4], ["10 µs", "0.1 ms", "1 ms", "10 ms"])
    lower.spines.top.set_linestyle((0, (4, 4)))  # the axis is cut here
    with replacing(path) as partial:
        figure.savefig(partial)


def draw_loss(results: Results, path: Path) -> None:
    """The pose error over an impact against cost: elastic filled, with loss hollow."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(4.0, 4.8), dpi=200, layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3.0, 1.4))
    for axis in (upper, lower):
        axis.set(xscale="log", yscale="log")
        axis.grid(alpha=0.3)
        for kind, face in ((None, None), (LOSS, "white")):
            for family, line in points(results, "local", kind).items():
                colour = _COLOURS.get(family)
                if colour and family in (EXACT, PYMUNK, "box2d"):
                    style = "-" if kind is None else "--"
                    axis.plot("cost", "median", f"o{style}", data=line, markersize=4, color=colour, mfc=face or colour)
    upper.set(ylim=(1e-5, 1.0), title="Pose error 0.1 s after a restart,\nover an impact. Points: medians.")
    upper.set_ylabel("filled: elastic; hollow: with loss")
    upper.set_yticks([1e-4, 1e-3, 1e-2, 1e-1], ["0.1 mm", "1 mm", "1 cm", "10 cm"])
    for family, place in ((PYMUNK, (0.12, 0.6)), ("box2d", (0.72, 0.75))):
        upper.annotate(family.replace("box2d", "Box2D"), place, xycoords="axes fraction", color=_COLOURS[family])
    lower.annotate(EXACT, (0.1, 0.5), xycoords="axes fraction", color=_COLOURS[EXACT])
    lower.set(ylim=(_LEAST, 1e-12), xlabel="computing time per simulated second")
    lower.set_yticks([1e-15, 1e-13], ["$10^{-15}$ m", "$10^{-13}$ m"])
    lower.set_xticks([1e1, 1e2, 1e3, 1e4], ["10 µs", "0.1 ms", "1 ms", "10 ms"])
    with replacing(path) as partial:
        figure.savefig(partial)


def _plot(axis: Any, lines: dict[str, dict[str, list[Any]]]) -> None:
    """Lines of the families, labelled where they are."""
    for family, line in lines.items():
        colour = _COLOURS.get(family)  # none: variants of another family, which would lie on its points
        if colour:
            axis.plot("cost", "median", "o-", data=line, markersize=4, color=colour)
            axis.vlines("cost", "median", "worst", data=line, color=colour, alpha=0.4)
        for name, *place in zip(line["setting"], line["cost"], line["median"], strict=True):
            text, offset, aligned = _LABELS.get(name, ("", (0, 0), "left"))
            axis.annotate(text, place, xytext=offset, textcoords="offset points", color=colour, ha=aligned, va="center")


def interactive(results: Results, path: Path) -> None:
    """A page that needs nothing else: a tab per quantity, details under the mouse, families to hide."""
    from bokeh.embed import file_html
    from bokeh.models import HoverTool, TabPanel, Tabs
    from bokeh.palettes import Category10
    from bokeh.plotting import figure
    from bokeh.resources import INLINE

    tabs = []
    of_loss = [(quantity, title, LOSS) for quantity, title in LOSS_TABS.items()]
    for quantity, title, kind in [*((*tab, None) for tab in TABS.items()), *of_loss]:
        scale: Any = "linear" if quantity == "prefix" else "log"
        axes: Any = {"x_axis_type": "log", "y_axis_type": scale, "x_axis_label": "cost [µs per simulated second]"}
        plot = figure(**axes, y_axis_label=title, width=1000, height=620, tools="pan,wheel_zoom,box_zoom,reset,save")
        dots: list[Any] = []
        for colour, (family, line) in zip(Category10[10], points(results, quantity, kind).items(), strict=False):
            plot.line("cost", "median", source=line, color=colour, legend_label=family)
            plot.segment("cost", "median", "cost", "worst", source=line, color=colour, alpha=0.4)
            dots.append(plot.scatter("cost", "median", source=line, size=9, color=colour, legend_label=family))
        tips = [("", "@setting"), ("cost", "@cost{0,0} µs per simulated s"), ("median", "@median{%.3g}")]
        tips += [("worst", "@worst{%.3g}"), ("n", "@n")]
        plot.add_tools(HoverTool(renderers=dots, tooltips=tips, formatters={"@median": "printf", "@worst": "printf"}))
        plot.legend.click_policy = "hide"
        plot.add_layout(plot.legend[0], "right")
        tabs.append(TabPanel(child=plot, title=title))
    write_text(path, file_html(Tabs(tabs=tabs), INLINE, "jackbox: speed against accuracy"))
