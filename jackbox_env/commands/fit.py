"""Fit fields of a scene to recordings: CSV files of a camera, or CSV or npz files of `jackbox simulate`."""

from __future__ import annotations

import argparse
import importlib.util
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jackbox_env.commands.fit_page import sentences, table_of, write_fit_page
from jackbox_env.commands.options import add_scene_options, chosen_scene, parser_of
from jackbox_env.fits.torques import TORQUE_KINDS
from jackbox_env.model.states import RATES, STATE_NAMES, X_JACK
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import command_line

if TYPE_CHECKING:
    from jackbox_env.fits.observed import Recording
    from jackbox_env.model.scene import Scene

_FIELDS = ("jack_mass", "restitution")


def _arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    parser.add_argument(
        "recordings",
        nargs="+",
        type=Path,
        metavar="FILE",
        help=(
            "files of one scene: time, any of the 12 numbers of a state (an empty cell: not observed), and torque, "
            "held from each row to the next; the scene's drive acts if there is none, or if it is the drive's; headers "
            "may have units, as in x_jack [mm], theta_box [deg], time [ms]; or npz files of jackbox simulate"
        ),
    )
    parser.add_argument(
        "--fields",
        nargs="+",
        default=_FIELDS,
        metavar="FIELD",
        help=(
            "what to fit: gravity, box_mass, box_inertia, jack_mass, jack_inertia, jack_arm, box_half_width, "
            f"restitution; default: {' '.join(_FIELDS)}"
        ),
    )
    parser.add_argument(
        "--columns",
        metavar="NAMES",
        help="headers by the names they stand for: x_jack=ball_x,time=t_ms; a unit may follow, as in time=t [ms]",
    )
    parser.add_argument(
        "--y-down", action="store_true", help="y points downwards and angles are clockwise, as in images"
    )
    parser.add_argument("--scale", type=float, help="pixels per metre, of columns in px, as in x_jack=ball_x [px]")
    parser.add_argument(
        "--torque",
        choices=("drive", "none"),
        default="drive",
        help=(
            "what turns the box in files without a column torque: drive, the scene's, a chirp unless --scene has "
            "another; or none; default: drive"
        ),
    )
    text = (
        "whether each torque in a file was held to the next row, sampled from a smooth curve, or changes linearly to "
        "the next row; default: held, and a note if another fits better"
    )
    parser.add_argument("--torque-column", choices=TORQUE_KINDS, help=text)
    text = (
        "where the search starts, and all that is not fitted; without --scene that of the npz file, or of scene.json "
        "in the folder of the files, with the options of single fields"
    )
    add_scene_options(parser.add_argument_group("scene", text))
    text = (
        """standard deviation of what was observed: a number, or by name, e.g. '{"x_jack": 0.01, "impacts": 0.001}'"""
    )
    parser.add_argument("--noise", metavar="JSON", help=f"{text}; default: estimated")
    parser.add_argument(
        "--impacts",
        nargs="+",
        type=Path,
        default=[],
        metavar="FILE",
        help=(
            "times at which impacts were heard: for each recording a file with the column time, like impacts.csv, or "
            "an npz file of jackbox simulate"
        ),
    )
    parser.add_argument(
        "--html",
        action="store_true",
        help="also write fit.html: recordings against the fit, and residuals, in one page that any browser opens",
    )
    parser.add_argument(
        "--folder", type=Path, help="new folder for the page, with --html; default: runs/fit-<date>-<time>"
    )
    return parser.parse_args()


# -- recordings --------------------------------------------------------------------------------------------------------


def read_recording(
    path: Path, scene: Scene, impacts: Path | None = None, names: Mapping[str, str] | None = None, **options: Any
) -> Recording:
    """The recording of a CSV or npz file, and of another with the times of impacts that were heard.

    The options are those of ``Recording.from_frame``.

    Raises:
        ValueError: unusable content; the message names the file, the row's line and the column.
    """
    from jackbox_env.fits.observed import Recording
    from jackbox_env.fits.tables import filled, in_si_units, read_table
    from jackbox_env.fits.text import parts

    heard = None
    if impacts is not None:
        table = read_table(impacts, "impact_time")
        columns, others, _ = in_si_units(table, {"time": "s"})
        heard = filled(table, "time", columns["time"])
        if states := [header for header in others if parts(header)[0] in STATE_NAMES]:
            raise ValueError(f"{impacts}: must have times of impacts, got states with a column {states[0]!r}")
    table = read_table(path, "state", (names or {}).get("time", "time"))
    return Recording.from_frame(table, scene, names=names, impacts=heard, **options)


def column_names(text: str | None) -> dict[str, str]:
    """Headers by the names they stand for, of ``x_jack=ball_x,time=t [ms]``."""
    pairs = [one.partition("=") for one in (text or "").split(",") if one.strip()]
    names = {name.strip(): header.strip() for name, _, header in pairs}
    if len(names) < len(pairs) or not all({*names, *names.values()}):
        raise ValueError(f"columns must be like x_jack=ball_x,time=t_ms, each name once, got {check.shown(text)}")
    return names


def _noise(text: str | None) -> Any:
    """The noise from its JSON."""
    try:
        return None if text is None else json.loads(text)
    except (RecursionError, ValueError) as error:
        raise ValueError(f"noise must be a number or a JSON object, got {check.shown(text)}") from error


def _stored_scene(paths: Sequence[Path]) -> dict[str, Any]:
    """The scene that ``jackbox simulate`` has written with the recordings; no field if there is none.

    Raises:
        ValueError: the recordings have different ones, or one is damaged.
    """
    from jackbox_env import Scene
    from jackbox_env.fits.tables import read_arrays, stored_scene

    files = dict.fromkeys(path if path.suffix == ".npz" else path.with_name("scene.json") for path in paths)
    stored = list[dict[str, Any]]()
    for file in files:
        if file.suffix == ".npz":
            stored.append(stored_scene(read_arrays(file), f"{file}, ") or {})
        elif file.is_file():
            stored.append(check.from_json(str(file), file.read_text(encoding="utf-8", errors="replace"), dict))
        try:
            Scene.of(stored[-1] if stored else {})
        except (TypeError, ValueError) as error:
            raise ValueError(f"{file}: {error}") from error
    if any(fields != stored[0] for fields in stored):
        raise ValueError(f"the recordings must be of one scene, got different ones in {' and '.join(map(str, files))}")
    return stored[0] if stored else {}


# -- the command -------------------------------------------------------------------------------------------------------


def _printed(rows: Sequence[Sequence[str]]) -> str:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return "\n".join("  ".join(map(str.ljust, row, widths)).rstrip() for row in rows)


@command_line
def main() -> None:
    """Read the recordings, fit, print the result, and write the page."""
    arguments = _arguments()
    from jackbox_env import Chirp, Scene
    from jackbox_env.tools.files import check_new, new_folder, stamped

    paths, folder = arguments.recordings, arguments.folder or stamped("fit")
    if arguments.impacts and len(arguments.impacts) != len(paths):
        raise ValueError(f"impacts must be {len(paths)} files, one for each recording, got {len(arguments.impacts)}")
    if arguments.folder and not arguments.html:
        raise ValueError("folder goes with --html, without which nothing is written")
    if arguments.html and importlib.util.find_spec("matplotlib") is None:
        raise ValueError("html needs matplotlib: pip install matplotlib, or leave --html out")
    if arguments.html:
        check_new(folder)
    stored = _stored_scene(paths) if arguments.scene == "{}" else {}
    start, noise = Scene.of({**stored, **chosen_scene(arguments.scene, arguments)}), _noise(arguments.noise)
    start = start.changed(drive=None) if arguments.torque == "none" else start
    impacts, names = arguments.impacts or [None] * len(paths), column_names(arguments.columns)

    def read(torque: str) -> list[Recording]:
        return [
            read_recording(path, start, heard, names, y_down=arguments.y_down, torque=torque, scale=arguments.scale)
            for path, heard in zip(paths, impacts, strict=True)
        ]

    recordings = read(arguments.torque_column or "held")
    for path, recording in zip(paths, recordings, strict=True):
        for note in recording.notes:
            print(f"{path}: {note}.", file=sys.stderr)
        if arguments.torque == "none" and recording.torques is not None:
            raise ValueError(f"{path}: --torque none is for files without a column torque")
    if arguments.torque_column not in (None, "held") and all(one.torques is None for one in recordings):
        raise ValueError("--torque-column goes with a column torque, which no file has")
    if stored:
        file = paths[0] if paths[0].suffix == ".npz" else paths[0].with_name("scene.json")
        print(f"The search starts at the scene of {file}.", file=sys.stderr)
    if start.drive is not None and any(one.torques is None for one in recordings):
        most = f", a chirp of up to {abs(start.drive.amplitude):,g} N m" if isinstance(start.drive, Chirp) else ""
        print(f"The scene's drive turns the box{most}; --torque none if nothing does.", file=sys.stderr)
    steps = sum(len(np.asarray(one.states)) - 1 for one in recordings)
    print(f"Fitting {', '.join(arguments.fields)} to {steps} steps ...", file=sys.stderr, flush=True)
    from jackbox_env.fits.fitting import fit  # takes a while

    began = time.perf_counter()
    result = fit(recordings, arguments.fields, start, noise=noise)
    print(f"... took {time.perf_counter() - began:.1f} s", file=sys.stderr)
    print(_printed(table_of(result, start)), *sentences(result, recordings), sep="\n")
    jack_seen = [one for one in recordings if np.isfinite(one.states[:, X_JACK:RATES]).any()]
    if not (result.converged or arguments.torque_column) and any(one.torques is not None for one in jack_seen):
        results = {"held": result}
        for kind in TORQUE_KINDS[1:]:
            with suppress(ValueError):  # a file without a torque in its last row, or that no motion can follow
                results[kind] = fit(read(kind), arguments.fields, start, noise=noise)
        better = [(one.converged, -one.left_out, -math.prod(one.noise.values())) for one in results.values()]
        best = [*results][better.index(max(better))]
        if best != "held":
            print(f"The torques fit better with --torque-column {best}.", file=sys.stderr)
    if arguments.html:
        titles = [str(path) for path in paths]
        new_folder(folder, "fit", lambda new: write_fit_page(new / "fit.html", result, start, recordings, titles))
        print(f"Wrote {folder / 'fit.html'}")


if __name__ == "__main__":
    main()
