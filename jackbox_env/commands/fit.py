"""Fit fields of a scene to recordings: CSV files with the columns that ``jackbox simulate`` writes."""

from __future__ import annotations

import argparse
import csv
import importlib.util
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
from jackbox_env.commands.fit_page import UNITS, sentences, table_of, write_fit_page
from jackbox_env.commands.options import parser_of
from jackbox_env.states import LATEST_TIME, STATE_NAMES, Array

if TYPE_CHECKING:
    from jackbox_env.measure.recordings import Recording
    from jackbox_env.scene import Chirp, Drive, Scene

_RECORDING = {"time": "s", **UNITS, "torque": "N m"}  # columns and their units
_IMPACTS = {"time": "s", "wall": "", "foot": "", "impulse": "N s"}
_STEP_TOLERANCE = 1e-6  # relative, of steps of time
_TORQUE_TOLERANCE = 1e-6  # relative
_LATEST = 1e10  # [s] of a row; Unix times are below


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

    If the torques are the drive's means, the drive acts instead: a constant torque of the same mean would lead
    elsewhere. Constant torques do not depend on the time, so Unix times then count from the first row.

    Raises:
        ValueError: unusable content; the message names the file, the row's line and the column.
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
    """Columns of a file by name, shape (rows,), and the rows' lines. NaN for an empty cell, which time cannot be."""
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
    by_name = dict(zip(names, columns, strict=True))
    _filled(path, lines, "time", by_name["time"])
    return by_name, lines


def _names(path: Path, header: Sequence[str], units: Mapping[str, str]) -> list[str]:
    """Names of the columns, of cells such as ``x_box`` or ``x_box [m]``."""
    names, allowed = list[str](), [f"{name} [{unit}]" if unit else name for name, unit in units.items()]
    for cell in header:
        name, _, unit = cell.strip().removesuffix("]").partition(" [")
        if name not in units or name in names or unit not in ("", units[name]):
            what = "comes twice" if name in names else f"must be one of {', '.join(allowed)}"
            raise ValueError(f"{path}, row 1: column {check.shown(cell)} {what}")
        names.append(name)
    if "time" not in names:
        raise ValueError(f"{path}, row 1: there must be a column time [s]")
    return names


def _number(path: Path, line: int, name: str, cell: str) -> float:
    """The number in a cell; NaN if it is empty."""
    try:
        value = float(cell) if cell.strip() else math.nan
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise ValueError(f"{path}, row {line}, column {name}: must be a number or empty, got {check.shown(cell)}")
    return value


def _filled(path: Path, lines: Sequence[int], name: str, values: Array) -> Array:
    """Return a column without empty cells; else raise ValueError."""
    if np.isnan(values).any():
        raise ValueError(
            f"{path}, row {lines[int(np.isnan(values).argmax())]}, column {name}: must be a number, got none"
        )
    return values


def _step(path: Path, lines: Sequence[int], times: Array) -> float:
    """The step of evenly spaced times [s]; ValueError if they are not."""
    far = abs(times) > _LATEST
    if far.any():
        row = int(far.argmax())
        raise ValueError(f"{path}, row {lines[row]}, column time: must be within +-{_LATEST:g} s, got {times[row]:g} s")
    steps = np.diff(times)
    usual, rounding = float(np.median(steps)), 4.0 * float(np.spacing(abs(times).max()))
    backward, uneven = steps <= 0.0, abs(steps - usual) > _STEP_TOLERANCE * abs(usual) + rounding
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
    """Whether torques [N m] are the means of a drive between times [s]; False if it cannot be evaluated there."""
    if drive is None:
        return False
    tolerance = _TORQUE_TOLERANCE * float(abs(torques).max())
    steps = zip(torques.tolist(), times[:-1].tolist(), np.diff(times).tolist(), strict=True)
    try:
        return all(abs(torque - 0.5 * sum(drive.torque_means(*step))) <= tolerance for torque, *step in steps)
    except ValueError:
        return False


def _noise(text: str | None) -> Any:
    """The noise from its JSON."""
    try:
        return None if text is None else json.loads(text)
    except (RecursionError, ValueError) as error:
        raise ValueError(f"noise must be a number or a JSON object, got {check.shown(text)}") from error


# -- the command -------------------------------------------------------------------------------------------------------


def _printed(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


@command_line
def main() -> None:
    """Read the recordings, fit, print the result, and write the page."""
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
    result = fit(recordings, arguments.fields, start, noise=noise)
    print(f"... took {time.perf_counter() - began:.1f} s", file=sys.stderr)
    print(_printed(table_of(result, start)), *sentences(result, recordings), sep="\n")
    if arguments.html:
        names = [str(path) for path in paths]
        new_folder(folder, "fit", lambda new: write_fit_page(new / "fit.html", result, start, recordings, names))
        print(f"Wrote {folder / 'fit.html'}")


if __name__ == "__main__":
    main()
