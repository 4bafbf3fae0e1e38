"""The dot plot of docs/learning.md."""

from __future__ import annotations

from pathlib import Path

import matplotlib
import numpy as np

matplotlib.use("Agg")

from matplotlib import pyplot as plt

from agents.figures import ACCENT
from agents.storage import replacing
from scripts.studies.transfer.inference import Estimate

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
