"""What the studies' pages are made of: numbers in words, tables, templates, bars."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path


def figure(value: float) -> str:
    """A number with three digits, or all before the point."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def rough(value: float) -> str:
    """A number for a sentence, rounded to three digits."""
    return figure(float(f"{value:.3g}"))


def table(heads: Iterable[str], rows: Iterable[Iterable[str]]) -> str:
    """A Markdown table with aligned columns."""
    lines = [list(heads), *map(list, rows)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    head, *rest = ["| " + " | ".join(map(str.ljust, line, widths)) + " |" for line in lines]
    return "\n".join([head, "|" + "|".join("-" * (width + 2) for width in widths) + "|", *rest])


def fill(page: str, mark: str, text: str) -> str:
    """Replace what stands between ``<!-- mark -->`` and ``<!-- /mark -->``.

    Raises:
        ValueError: the page has no such marks.
    """
    pattern = re.compile(rf"(<!-- {mark} -->\n).*?(<!-- /{mark} -->)", re.DOTALL)
    if not pattern.search(page):
        raise ValueError(f"the page has no place marked {mark}")
    return pattern.sub(lambda match: f"{match[1]}{text}\n{match[2]}", page)


def bars(path: Path, what: str, rows: Mapping[str, float], log: bool = False) -> None:
    """Draw a bar for each row, and write its value beside it."""
    from matplotlib.figure import Figure

    drawn = Figure(figsize=(7.0, 1.0 + 0.36 * len(rows)), layout="constrained")
    axes = drawn.subplots()
    axes.bar_label(axes.barh([name.replace("`", "") for name in rows], list(rows.values())), fmt=rough, padding=3)
    axes.set(xlabel=what, xscale="log" if log else "linear")
    axes.margins(x=0.15)
    axes.invert_yaxis()
    axes.spines[["top", "right"]].set_visible(False)
    drawn.savefig(path, dpi=110)
