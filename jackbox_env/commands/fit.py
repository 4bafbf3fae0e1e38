"""Fit fields of a scene to recordings: CSV files with the columns that ``jackbox simulate`` writes."""

from __future__ import annotations

import argparse
import csv
import html
import importlib.util
import io
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jackbox_env import checks as check
from jackbox_env.command_line import command_line
from jackbox_env.commands.options import parser_of
from jackbox_env.states import LATEST_TIME, STATE_NAMES, STATE_UNITS, THETA_BOX, X_JACK, Y_JACK, Array

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from jackbox_env.measure.fitting import Fit
    from jackbox_env.measure.recordings import Recording
    from jackbox_env.scene import Chirp, Drive, Scene

_UNITS = dict(zip(STATE_NAMES, STATE_UNITS, strict=True))
_RECORDING = {"time": "s", **_UNITS, "torque": "N m"}  # columns and their units
_IMPACTS = {"time": "s", "wall": "", "foot": "", "impulse": "N s"}
_EVEN = 1e-6  # relative, of steps of time
_SAME = 1e-6  # relative, of torques
_LATEST = 1e10  # [s] of a row; Unix times are below
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


def _arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    text = "files of one scene: time, any of the 12 numbers of a state (an empty cell: not observed), and torque, held "
    text += "from each row to the next; the scene's drive acts if there is none, or if it is the drive's"
    parser.add_argument("recordings", nargs="+", type=Path, metavar="CSV", help=text)
    text = "what to fit: gravity, box_mass, box_inertia, jack_mass, jack_inertia, jack_arm, box_half_width, restitution"
    parser.add_argument("--fields", nargs="+", required=True, metavar="FIELD", help=text)
    text = "where the search starts, and all that is not fitted: fields that differ from the default, as JSON"
    parser.add_argument("--scene", default="{}", metavar="JSON", help=text)
    text = (
        """standard deviation of what was observed: a number, or by name, e.g. '{"x_jack": 0.01, "impacts": 0.001}'"""
    )
    parser.add_argument("--noise", metavar="JSON", help=f"{text}; default: estimated")
    text = "times at which impacts were heard: for each recording a file with the column time, like impacts.csv"
    parser.add_argument("--impacts", nargs="+", type=Path, default=[], metavar="CSV", help=text)
    text = "also write fit.html: recordings against the fit, and residuals, in one page that any browser opens"
    parser.add_argument("--html", action="store_true", help=text)
    text = "new folder for all that is written; default: runs/fit-<date>-<time>"
    parser.add_argument("--folder", type=Path, help=text)
    return parser.parse_args()


# -- recordings --------------------------------------------------------------------------------------------------------


def read_recording(path: Path, drive: Chirp | Drive | None, impacts: Path | None = None) -> Recording:
    """The recording of a CSV file, and of another with the times of impacts that were heard.

    If the torques are the drive's means, the drive acts: a torque held at its mean through a step leads elsewhere.
    Held torques do not depend on the time, so Unix times then count from the first row.

    Raises:
        ValueError: a file holds something else; the sentence names the file, the row's line and the column.
    """
    from jackbox_env.measure.recordings import Recording

    columns, lines = _columns(path, _RECORDING)
    times, torques, heard = columns["time"], columns.get("torque"), None
    if len(times) < 2:
        raise ValueError(f"{path}, row {lines[-1] if lines else 1}: there must be two rows of numbers at least")
    dt = _step(path, lines, times)
    if torques is not None:
        torques = _filled(path, lines, "torque", torques[:-1])
        torques = None if _is_of(drive, times, torques) else torques
    if impacts is not None:
        heard = _columns(impacts, _IMPACTS)[0]["time"]
    if torques is not None and abs(times).max() > LATEST_TIME:
        times, heard = times - times[0], None if heard is None else heard - times[0]
    nothing = np.full(len(times), np.nan)
    states = np.column_stack([columns.get(name, nothing) for name in STATE_NAMES])
    try:
        return Recording(states, torques, dt, float(times[0]), heard)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from error


def _columns(path: Path, units: Mapping[str, str]) -> tuple[dict[str, Array], list[int]]:
    """Columns of a file by name, shape (rows,), NaN where a cell is empty, time in each row; and the rows' lines."""
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        reader = csv.reader(file)
        try:
            names = _names(path, next(reader, []), units)
            rows = [(reader.line_num, row) for row in reader if row]
        except csv.Error as error:
            raise ValueError(f"{path}, row {reader.line_num}: {error}") from error
    for line, row in rows:
        if len(row) != len(names):
            raise ValueError(f"{path}, row {line}: must have {len(names)} cells like row 1, got {len(row)}")
    cells = [[_number(path, line, *pair) for pair in zip(names, row, strict=True)] for line, row in rows]
    lines, columns = [line for line, _ in rows], np.array(cells, dtype=np.float64).reshape(-1, len(names)).T
    found = dict(zip(names, columns, strict=True))
    _filled(path, lines, "time", found["time"])
    return found, lines


def _names(path: Path, header: Sequence[str], units: Mapping[str, str]) -> list[str]:
    """Names of the columns, of cells such as ``x_box`` or ``x_box [m]``."""
    names, known = list[str](), [f"{name} [{unit}]" if unit else name for name, unit in units.items()]
    for cell in header:
        name, _, unit = cell.strip().removesuffix("]").partition(" [")
        if name not in units or name in names or unit not in ("", units[name]):
            what = "comes twice" if name in names else f"must be one of {', '.join(known)}"
            raise ValueError(f"{path}, row 1: column {check.shown(cell)} {what}")
        names.append(name)
    if "time" not in names:
        raise ValueError(f"{path}, row 1: there must be a column time [s]")
    return names


def _number(path: Path, line: int, name: str, cell: str) -> float:
    """What a cell holds; NaN where it is empty."""
    try:
        value = float(cell) if cell.strip() else math.nan
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise ValueError(f"{path}, row {line}, column {name}: must be a number or empty, got {check.shown(cell)}")
    return value


def _filled(path: Path, lines: Sequence[int], name: str, values: Array) -> Array:
    """A column, if no cell of it is empty."""
    if np.isnan(values).any():
        raise ValueError(
            f"{path}, row {lines[int(np.isnan(values).argmax())]}, column {name}: must be a number, got none"
        )
    return values


def _step(path: Path, lines: Sequence[int], times: Array) -> float:
    """The step of evenly spaced times [s]."""
    far = abs(times) > _LATEST
    if far.any():
        row = int(far.argmax())
        raise ValueError(f"{path}, row {lines[row]}, column time: must be within +-{_LATEST:g} s, got {times[row]:g} s")
    steps = np.diff(times)
    usual, rounding = float(np.median(steps)), 4.0 * float(np.spacing(abs(times).max()))
    backward, uneven = steps <= 0.0, abs(steps - usual) > _EVEN * abs(usual) + rounding
    if backward.any():
        row = int(backward.argmax())
        raise ValueError(
            f"{path}, row {lines[row + 1]}, column time: must increase, got {times[row + 1]:.10g} s after "
            f"{times[row]:.10g} s"
        )
    if uneven.any():
        row = int(uneven.argmax())
        raise ValueError(
            f"{path}, row {lines[row + 1]}, column time: must increase evenly, by {usual:g} s in most rows and by "
            f"{steps[row]:g} s here; a row that was not observed stays, with empty cells"
        )
    return float(times[-1] - times[0]) / len(steps)


def _refuse_coarse(path: Path, recording: Recording, scene: Scene) -> None:
    """Raise ValueError if a jack at the scene's speed scale would cross half the box in one step."""
    coarsest, end = scene.box_half_width / scene.speed_scale, recording.dt * (len(recording.states) - 1)
    if recording.dt > coarsest:
        raise ValueError(
            f"{path}, column time: rows must be at most {coarsest:.2g} s apart, got {end:g} s in steps of "
            f"{recording.dt:g} s; is the time in milliseconds?"
        )


def _is_of(drive: Chirp | Drive | None, times: Array, torques: Array) -> bool:
    """Whether torques [N m] are the means of a drive between times [s]; not, if the drive cannot be evaluated there."""
    if drive is None:
        return False
    tolerance = _SAME * float(abs(torques).max())
    steps = zip(torques.tolist(), times[:-1].tolist(), np.diff(times).tolist(), strict=True)
    try:
        return all(abs(torque - 0.5 * sum(drive.torque_means(*step))) <= tolerance for torque, *step in steps)
    except ValueError:
        return False


def _noise(text: str | None) -> Any:
    """The noise that was given as JSON."""
    try:
        return None if text is None else json.loads(text)
    except (RecursionError, ValueError) as error:
        raise ValueError(f"noise must be a number or a JSON object, got {check.shown(text)}") from error


# -- what was found ----------------------------------------------------------------------------------------------------


def table_of(found: Fit, start: Scene) -> list[tuple[str, ...]]:
    """Rows of the table: field, fitted value, 95 % interval, value at the start."""
    rows: list[tuple[str, ...]] = [("field", "fitted", "95 % interval", "start")]
    for name, (low, high) in found.intervals.items():
        width, value = high - low, getattr(found.scene, name)
        shape = f".{min(max(1 - math.floor(math.log10(width)), 0), 15)}f" if 0.0 < width < math.inf else ".6g"
        rows.append((name, f"{value:{shape}}", f"{low:{shape}} to {high:{shape}}", f"{getattr(start, name):g}"))
    return rows


def sentences(found: Fit, recordings: Sequence[Recording]) -> list[str]:
    """What is to be said of a fit."""
    said = [f"{one[0].upper()}{one[1:]}." for one in found.unidentified]
    if len(found.residuals):
        rms = float(np.sqrt(np.mean(found.residuals**2)))
        text = f"Held out: {len(found.residuals)} residuals, rms {rms:.2f}"
        said.append(f"{text} (about 1 where the model is right).")
    else:
        said.append("Held out: nothing, there are too few windows of free motion.")
    noise = (f"{name} {value:.3g} {_UNITS.get(name, 's')}" for name, value in found.noise.items())
    steps = sum(len(np.asarray(one.states)) - 1 for one in recordings)
    said.append(f"Noise (standard deviations): {', '.join(noise)}.")
    said.append(f"Left out: {found.left_out} of {steps} steps, where the jack rests or could not be followed.")
    if found.converged:
        said.append("Converged: the search ended, every window fits within the noise, and the residuals are white.")
    else:
        said.append(f"Not converged, do not trust the intervals: {'; '.join(found.problems)}.")
    return said


def _printed(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


# -- the page ----------------------------------------------------------------------------------------------------------


def write_fit_page(path: Path, found: Fit, start: Scene, recordings: Sequence[Recording], names: Sequence[str]) -> Path:
    """Write a fit as a page.

    Args:
        path: of the new file.
        found: the fit.
        start: where the search began.
        recordings: what was fitted.
        names: what to call each of them.

    Raises:
        FileExistsError: there is something at ``path``.
    """
    from jackbox_env.files import new_file

    head, *rows = ("".join(f"<td>{cell}</td>" for cell in row) for row in table_of(found, start))
    body = [f"<table><tr>{head.replace('td>', 'th>')}</tr>", *(f"<tr>{row}</tr>" for row in rows), "</table>"]
    body += [f"<p>{html.escape(one)}</p>" for one in sentences(found, recordings)]
    for number, (recording, name) in enumerate(zip(recordings, names, strict=True)):
        times = impact_times(found.scene, recording, found.motions[number])
        text = "Dots: observed. Lines: fitted; gaps are what was left out. Thin lines: impacts of the fit"
        heard = "" if recording.impacts is None else "; strokes at the lower edge: impacts that were heard"
        body += [f"<h2>{html.escape(name)}</h2>", _figure(_compared(recording, found.motions[number], times))]
        body += [f"<p>{text}{heard}.</p>", _figure(_residuals(found, recording, found.motions[number], times))]
        body.append("<p>(Observed - fitted) over the noise; about 95 % should lie within the band of 2.</p>")
    what = names[0] if len(names) == 1 else f"{len(names)} recordings"
    with new_file(path) as partial:
        partial.write_text(_PAGE.format(recordings=html.escape(what), body="\n".join(body)), encoding="utf-8")
    return path


def _figure(figure: Figure) -> str:
    """A figure as a part of a page."""
    file = io.StringIO()
    figure.savefig(file, format="svg", dpi=150, metadata=dict.fromkeys(("Creator", "Date", "Format", "Type")))
    drawn = file.getvalue()
    return f"<figure>{drawn[drawn.index('<svg') :]}</figure>"


def impact_times(scene: Scene, recording: Recording, motion: Array) -> list[float]:
    """Times of the impacts of a fitted motion, shape (H + 1, 12) [s]."""
    from jackbox_env.simulators import make_simulator

    simulator, times = make_simulator(scene, contact="exact"), list[float]()
    torques = np.full(len(motion) - 1, None) if recording.torques is None else np.asarray(recording.torques).tolist()
    for step in np.flatnonzero(np.isfinite(motion[:-1] + motion[1:]).all(axis=1)):
        simulator.reset(motion[step], recording.time + step * recording.dt)
        simulator.step(recording.dt, torques[step])
        times += [hit.time for hit in simulator.impacts]
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


def _residuals(found: Fit, recording: Recording, motion: Array, impacts: Sequence[float]) -> Figure:
    """(Observed - fitted) over the noise, in time."""
    from matplotlib.figure import Figure

    from jackbox_env.commands.plots import BOX, GREY, JACK
    from jackbox_env.measure.shooting import nearest_pairs

    figure = Figure(figsize=(9.0, 2.4), layout="constrained")
    axes = figure.subplots()
    states = np.asarray(recording.states)
    times = recording.time + recording.dt * np.arange(len(states))
    noise = np.array([found.noise.get(name, np.nan) for name in STATE_NAMES])
    scaled = (states - motion) / noise
    axes.axhspan(-2.0, 2.0, color=GREY, alpha=0.15, linewidth=0.0)
    for edge in (-2.0, 2.0):
        axes.axhline(edge, color=GREY, linewidth=0.8, zorder=3)
    for body, color in (("box", BOX), ("jack", JACK)):
        columns = [number for number, name in enumerate(STATE_NAMES) if name.endswith(body)]
        if np.isfinite(scaled[:, columns]).any():
            own, many = scaled[:, columns], len(states) > _MOST_DOTS
            axes.plot(np.tile(times, 6), own.T.ravel(), ".", color=color, markersize=2.5, label=body, rasterized=many)
    if recording.impacts is not None and "impacts" in found.noise:
        heard, fitted = np.asarray(recording.impacts), np.array(impacts)
        heard = heard[np.isfinite(np.interp(heard, times, motion[:, 0]))]  # where there is a fit
        ours, theirs = nearest_pairs(heard, fitted)
        left = (heard[ours] - fitted[theirs]) / found.noise["impacts"]
        axes.plot(heard[ours], left, "x", color=GREY, markersize=5, label="impacts", zorder=4)
    if len(axes.lines) > 2:  # than the edges
        axes.legend(loc="lower right", bbox_to_anchor=(1.0, 1.0), ncols=3, frameon=False, markerscale=2.0)
    axes.set(xlabel="time [s]", ylabel="residual / noise", xlim=(times[0], times[-1]))
    return figure


@command_line
def main() -> None:
    """Read, fit, tell, and write the page."""
    arguments = _arguments()
    from jackbox_env import Scene
    from jackbox_env.files import check_new, new_folder, stamped
    from jackbox_env.measure.fitting import fit

    paths, folder = arguments.recordings, arguments.folder or stamped("fit")
    if arguments.impacts and len(arguments.impacts) != len(paths):
        raise ValueError(f"impacts must be {len(paths)} files, one for each recording, got {len(arguments.impacts)}")
    if arguments.folder and not arguments.html:
        raise ValueError("folder goes with --html, without which nothing is written")
    if arguments.html and importlib.util.find_spec("matplotlib") is None:
        raise ValueError("html needs matplotlib: pip install matplotlib, or leave --html out")
    if arguments.html:
        check_new(folder)
    start, noise = Scene.of(check.from_json("scene", arguments.scene, dict)), _noise(arguments.noise)
    impacts = arguments.impacts or [None] * len(paths)
    recordings = [read_recording(path, start.drive, heard) for path, heard in zip(paths, impacts, strict=True)]
    for path, recording in zip(paths, recordings, strict=True):
        _refuse_coarse(path, recording, start)
    steps = sum(len(np.asarray(one.states)) - 1 for one in recordings)
    print(f"Fitting {', '.join(arguments.fields)} to {steps} steps ...", file=sys.stderr, flush=True)
    began = time.perf_counter()
    found = fit(recordings, arguments.fields, start, noise=noise)
    print(f"... took {time.perf_counter() - began:.1f} s", file=sys.stderr)
    print(_printed(table_of(found, start)), *sentences(found, recordings), sep="\n")
    if arguments.html:
        names = [str(path) for path in paths]
        new_folder(folder, "fit", lambda made: write_fit_page(made / "fit.html", found, start, recordings, names))
        print(f"Wrote {folder / 'fit.html'}")


if __name__ == "__main__":
    main()
