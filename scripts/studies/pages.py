"""Building blocks of the studies' pages: formatted numbers, tables, templates, labels of lines."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Mapping
from typing import Any


def figure(value: float) -> str:
    """A number with three digits, or all before the point."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def two_digits(value: float) -> str:
    """A number with two digits, or all before the point; as a power of ten below 0.001."""
    if abs(value) >= 100.0:
        return f"{value:,.0f}"
    return f"{float(f'{value:.2g}'):g}" if value == 0.0 or abs(value) >= 1e-3 else f"{value:.1e}"


def cell(row: Mapping[str, Any]) -> str:
    """A row's mean and half of its 95 % interval."""
    low, high = row["interval_95"]
    return f"{row['mean']:.1f} ± {(high - low) / 2.0:.1f}"


def rounded(value: float) -> str:
    """A number for a sentence, rounded to three digits."""
    return figure(float(f"{value:.3g}"))


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table with aligned columns."""
    lines = [list(heads), *map(list, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    head, *rest = ["| " + " | ".join(map(str.ljust, line, widths)) + " |" for line in lines]
    return "\n".join([head, "|" + "|".join("-" * (width + 2) for width in widths) + "|", *rest])


def fill(page: str, mark: str, text: str) -> str:
    """Replace the text between ``<!-- mark -->`` and ``<!-- /mark -->``.

    Raises:
        ValueError: the page has no such marks.
    """
    pattern = re.compile(rf"(<!-- {mark} -->\n).*?(<!-- /{mark} -->)", re.DOTALL)
    if not pattern.search(page):
        raise ValueError(f"the page has no place marked {mark}")
    return pattern.sub(lambda match: f"{match[1]}{text}\n{match[2]}", page)


def label_ends(axes: Any, ends: Mapping[str, tuple[float, float]], apart: float = 0.09) -> None:
    """Write the names of lines beside their ends (x, y), right of the axes and at least ``apart`` of its height.

    Both limits of the axes must be final. Thin lines lead to the labels.
    """
    from jackbox_env.commands.plots import GREY

    axes.autoscale_view()
    last = math.inf
    for name, end in sorted(ends.items(), key=lambda item: -item[1][1]):
        height = axes.transAxes.inverted().transform(axes.transData.transform(end))[1]
        last = min(height, last - apart)
        places = {"xy": end, "xytext": (1.04, last), "textcoords": "axes fraction", "annotation_clip": False}
        leader = {"arrowstyle": "-", "color": GREY, "linewidth": 0.6, "shrinkA": 1.0, "shrinkB": 3.0}
        axes.annotate(name, **places, va="center", arrowprops=leader)
