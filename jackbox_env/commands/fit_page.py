"""A fit in words, as a table, and as a page that shows the recordings against it.

The command ``jackbox fit`` (:mod:`jackbox_env.commands.fit`) prints the table and the sentences, and writes the page.
"""

from __future__ import annotations

import html
import io
import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from jackbox_env.model.states import STATE_NAMES, STATE_UNITS, THETA_BOX, X_JACK, Y_JACK, Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jackbox_env.fits.observed import Recording
    from jackbox_env.fits.result import Fit
    from jackbox_env.model.scene import Scene

UNITS = dict(zip(STATE_NAMES, STATE_UNITS, strict=True))
_ROWS = 10  # that are listed as discounted
_EDGE = 10.0  # of the noise: residuals are drawn no farther out, so that a bad row sets no scale
_MOST_DOTS = 2000  # of a column; more are drawn as pixels
_PAGE = """<!DOCTYPE html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<meta name="color-scheme" content="light dark">
<title>jackbox fit</title>
<style>
body {{ font: 15px/1.5 system-ui, sans-serif; max-width: 960px; margin: 0 auto; padding: 12px 20px; }}
h2 {{ font-size: 17px; margin-top: 32px; }}
table {{ border-collapse: collapse; font-variant-numeric: tabular-nums; }}
th, td {{ padding: 4px 28px 4px 0; text-align: left; border-bottom: 1px solid #787e8660; }}
th {{ font-weight: 500; color: #787e86; }}
figure {{ margin: 8px 0 20px; }}
svg {{ width: 100%; height: auto; }}
</style>
<h1>A scene fitted to {recordings}</h1>
{body}
</html>
"""


def table_of(result: Fit, start: Scene) -> list[tuple[str, ...]]:
    """Rows of the table: field, fitted value, 95 % interval, value at the start."""
    rows: list[tuple[str, ...]] = [("field", "fitted", "95 % interval", "start")]
    for name, (low, high) in result.intervals.items():
        width, value = high - low, getattr(result.scene, name)
        shape = f".{min(max(1 - math.floor(math.log10(width)), 0), 15)}f" if 0.0 < width < math.inf else ".6g"
        rows.append((name, f"{value:{shape}}", f"{low:{shape}} to {high:{shape}}", f"{getattr(start, name):g}"))
    return rows


def sentences(result: Fit, recordings: Sequence[Recording]) -> list[str]:
    """A fit's outcome in sentences."""
    lines = [f"{one[0].upper()}{one[1:]}." for one in result.unidentified]
    if len(result.residuals):
        rms = float(np.sqrt(np.mean(result.residuals**2)))
        text = f"Held out: {len(result.residuals)} residuals, rms {rms:.2f}"
        lines.append(f"{text} (about 1 where the model is right).")
    else:
        lines.append("Held out: nothing, there are too few windows of free motion.")
    noise = (f"{name} {value:.3g} {UNITS.get(name, 's')}" for name, value in result.noise.items())
    whole = sum((len(one.states) - 1) * one.dt for one in recordings)
    left_out = sum(
        np.isnan(motion[1:, X_JACK]).sum() * one.dt for motion, one in zip(result.motions, recordings, strict=True)
    )
    lines.append(f"Noise (standard deviations): {', '.join(noise)}.")
    reasons = f"{left_out - result.unexplained:.2f} s where the jack rests or its bounces pile up"
    unexplained = f"{result.unexplained:.2f} s that the scene does not explain"
    lines.append(f"Left out of {whole:.2f} s: {reasons}, and {unexplained}.")
    lines += [f"Discounted, {one}." for one in result.bad_rows[:_ROWS]]
    lines += [f"Discounted, {len(result.bad_rows) - _ROWS} more rows."] * (len(result.bad_rows) > _ROWS)
    if result.converged:
        lines.append("Converged: the search ended, every window fits within the noise, and the residuals are white.")
    else:
        lines.append(f"Not converged, do not trust the intervals: {'; '.join(result.problems)}.")
    return lines


def write_fit_page(
    path: Path, result: Fit, start: Scene, recordings: Sequence[Recording], names: Sequence[str]
) -> None:
    """Write a fit as a page.

    Args:
        path: of the file.
        result: the fit.
        start: where the search began.
        recordings: that were fitted.
        names: of the recordings.
    """
    head, *rows = ("".join(f"<td>{cell}</td>" for cell in row) for row in table_of(result, start))
    body = [f"<table><tr>{head.replace('td>', 'th>')}</tr>", *(f"<tr>{row}</tr>" for row in rows), "</table>"]
    body += [f"<p>{html.escape(one)}</p>" for one in sentences(result, recordings)]
    for number, (recording, name) in enumerate(zip(recordings, names, strict=True)):
        times = impact_times(result.scene, recording, result.motions[number])
        text = "Dots: observed. Lines: fitted; gaps are what was left out. Thin lines: impacts of the fit"
        heard = "" if recording.impacts is None else "; strokes at the lower edge: impacts that were heard"
        body += [f"<h2>{html.escape(name)}</h2>", _figure(_compared(recording, result.motions[number], times))]
        body += [f"<p>{text}{heard}.</p>", _figure(_residuals(result, recording, result.motions[number], times))]
        beyond = f"points at the edge of {_EDGE:g} lie there or beyond"
        body.append(f"<p>(Observed - fitted) over the noise; about 95 % should lie within the band of 2; {beyond}.</p>")
    what = names[0] if len(names) == 1 else f"{len(names)} recordings"
    path.write_text(_PAGE.format(recordings=html.escape(what), body="\n".join(body)), encoding="utf-8")


def _figure(figure: Figure) -> str:
    """A figure as HTML."""
    file = io.StringIO()
    figure.savefig(file, format="svg", dpi=150, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    text = file.getvalue()
    return f"<figure>{text[text.index('<svg') :]}</figure>"


def impact_times(scene: Scene, recording: Recording, motion: Array) -> list[float]:
    """Times of the impacts of a fitted motion, shape (H + 1, 12) [s]."""
    from jackbox_env.simulators import make_simulator

    simulator, times = make_simulator(scene, contact="exact"), list[float]()
    torques = np.full(len(motion) - 1, None) if recording.torques is None else np.asarray(recording.torques)
    torques = torques.reshape(len(motion) - 1, -1)  # equal parts of each step
    for step in np.flatnonzero(np.isfinite(motion[:-1] + motion[1:]).all(axis=1)):
        simulator.reset(motion[step], recording.time + step * recording.dt)
        for torque in torques[step]:
            times += [hit.time for hit in simulator.step(recording.dt / torques.shape[1], torque).impacts]
    return times


def _compared(recording: Recording, motion: Array, impacts: Sequence[float]) -> Figure:
    """Observed against fitted: the first six columns that were observed."""
    from matplotlib.figure import Figure

    from jackbox_env.commands.plots import BOX, GREY, JACK

    states = np.asarray(recording.states)
    times = recording.time + recording.dt * np.arange(len(states))
    columns = np.flatnonzero(np.isfinite(states).any(axis=0))[:6].tolist() or [THETA_BOX, X_JACK, Y_JACK]
    figure = Figure(figsize=(9.0, 0.6 + 1.7 * math.ceil(len(columns) / 2)), layout="constrained")
    panels = figure.subplots(math.ceil(len(columns) / 2), 2, sharex=True, squeeze=False)
    for axes in panels.flat[len(columns) :]:
        axes.axis("off")
    for axes, column in zip(panels.flat, columns, strict=False):
        for moment in impacts[:1000]:  # more would be one grey block
            axes.axvline(moment, color=GREY, alpha=0.4, linewidth=0.6, zorder=0)
        color = BOX if column % 6 < 3 else JACK
        many = len(states) > _MOST_DOTS
        axes.plot(times, states[:, column], ".", color=GREY, alpha=0.6, markersize=5.0, mew=0.0, rasterized=many)
        axes.plot(times, motion[:, column], color=color, linewidth=1.0)
        if recording.impacts is not None:
            heard = np.asarray(recording.impacts)
            edge = axes.get_xaxis_transform()
            axes.plot(heard, np.full(len(heard), 0.03), "|", color=color, markersize=8, transform=edge)
        axes.set_ylabel(f"{STATE_NAMES[column]} [{STATE_UNITS[column]}]")
        axes.set_xlim(times[0], times[-1])
    for axes in panels.flat[max(len(columns) - 2, 0) : len(columns)]:
        axes.set_xlabel("time [s]")
        axes.xaxis.set_tick_params(labelbottom=True)
    return figure


def _residuals(result: Fit, recording: Recording, motion: Array, impacts: Sequence[float]) -> Figure:
    """(Observed - fitted) over the noise, in time."""
    from matplotlib.figure import Figure

    from jackbox_env.commands.plots import BOX, GREY, JACK
    from jackbox_env.fits.shooting import nearest_pairs

    figure = Figure(figsize=(9.0, 2.4), layout="constrained")
    axes = figure.subplots()
    states = np.asarray(recording.states)
    times = recording.time + recording.dt * np.arange(len(states))
    noise = np.array([result.noise.get(name, np.nan) for name in STATE_NAMES])
    scaled = np.clip((states - motion) / noise, -_EDGE, _EDGE)
    axes.axhspan(-2.0, 2.0, color=GREY, alpha=0.15, linewidth=0.0)
    for edge in (-2.0, 2.0):
        axes.axhline(edge, color=GREY, linewidth=0.8, zorder=3)
    for body, color in (("box", BOX), ("jack", JACK)):
        columns = [number for number, name in enumerate(STATE_NAMES) if name.endswith(body)]
        if np.isfinite(scaled[:, columns]).any():
            points, many = scaled[:, columns], len(states) > _MOST_DOTS
            axes.plot(
                np.tile(times, 6), points.T.ravel(), ".", color=color, markersize=2.5, label=body, rasterized=many
            )
    if recording.impacts is not None and "impacts" in result.noise:
        heard, fitted = np.asarray(recording.impacts), np.array(impacts)
        heard = heard[np.isfinite(np.interp(heard, times, motion[:, 0]))]  # where there is a fit
        of_heard, of_fit = nearest_pairs(heard, fitted)
        errors = np.clip((heard[of_heard] - fitted[of_fit]) / result.noise["impacts"], -_EDGE, _EDGE)
        axes.plot(heard[of_heard], errors, "x", color=GREY, markersize=5, label="impacts", zorder=4)
    if len(axes.lines) > 2:  # than the edges
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, markerscale=2.0)
    axes.set(xlabel="time [s]", ylabel="residual / noise", xlim=(times[0], times[-1]))
    return figure
