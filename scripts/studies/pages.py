"""Building blocks of the studies' pages: formatted numbers, tables, templates, dot plots."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from pathlib import Path


def figure(value: float) -> str:
    """A number with three digits, or all before the point."""
    return f"{value:,.0f}" if abs(value) >= 100.0 else f"{value:.3g}"


def two_digits(value: float) -> str:
    """A number with two digits, or all before the point; as a power of ten below 0.001."""
    if abs(value) >= 100.0:
        return f"{value:,.0f}"
    return f"{float(f'{value:.2g}'):g}" if value == 0.0 or abs(value) >= 1e-3 else f"{value:.1e}"


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


def dots(path: Path, title: str, rows: Mapping[str, float]) -> None:
    """Draw a dot for each row on a logarithmic axis, the largest value on top, with its value."""
    from matplotlib.figure import Figure

    from jackbox_env.commands.plots import GREY, JACK

    shown = sorted(rows.items(), key=lambda row: row[1])
    drawn = Figure(figsize=(5.0, 0.8 + 0.32 * len(rows)), layout="constrained")
    axes = drawn.subplots()
    for line, (_, value) in enumerate(shown):
        axes.plot(value, line, "o", color=JACK)
        axes.annotate(rounded(value), (value, line), xytext=(8, 0), textcoords="offset points", va="center")
    axes.set_yticks(range(len(shown)), [name.replace("`", "") for name, _ in shown])
    drawn.suptitle(title, x=0.02, ha="left", fontsize="medium")
    axes.set_xscale("log")
    axes.margins(x=0.15)
    left, _ = axes.set_xlim(axes.get_xlim())
    axes.hlines(range(len(shown)), left, [value for _, value in shown], color=GREY, alpha=0.3)
    drawn.savefig(path, dpi=150)
