"""Simulate the scene: the state after each step and the impacts, plots, an animated page, and a film."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from jackbox_env.commands.options import add_scene_options, chosen_scene, parser_of
from jackbox_env.model.states import STATE_NAMES, Array
from jackbox_env.simulators.fidelity import COMMANDS, FIDELITIES
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import command_line, progress
from jackbox_env.tools.files import check_new, new_folder, stamped, write_json

if TYPE_CHECKING:
    from jackbox_env.recording.motion import Motion

_STEP_TOLERANCE = 1e-6  # relative, of steps of time
_MOST_ON_PAGE = 20_000  # steps: a page of some 10 MB
_LONGEST_FILM = 60.0  # [s]: 1.2 GB of frames


def _arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    text = "simulated time [s]; default: 10, or as long as the FILE of --torque"
    parser.add_argument("--seconds", type=float, metavar="S", help=text)
    text = (
        "on the box: chirp, the scene's drive; none; or a FILE with one for each control step, the column torque of "
        "a CSV file, with a unit as in torque [kN m], or the array torque of an npz file, as this command writes "
        "them; default: chirp"
    )
    parser.add_argument("--torque", default="chirp", metavar="chirp|none|FILE", help=text)
    model = parser.add_argument_group("scene and contact model")
    text = f"how impacts are computed; default: {COMMANDS}"
    model.add_argument("--fidelity", choices=FIDELITIES, default=COMMANDS, help=text)
    text = "duration of a control step [s]; default: 0.02"
    model.add_argument("--dt", type=float, default=0.02, metavar="S", help=text)
    add_scene_options(model)
    text = (
        "what to start from: numbers by name, e.g. x_jack=1,omega_jack=3, or all 12 as a JSON list, e.g. a row of "
        "states.csv; default: all 0"
    )
    parser.add_argument("--state", default="", metavar="NAME=N,...", help=text)
    files = parser.add_argument_group("files")
    text = "new folder for all that is written; default: runs/simulate-<date>-<time>"
    files.add_argument("--folder", type=Path, help=text)
    files.add_argument("--format", choices=("csv", "npz"), default="csv", help="of states and impacts; default: csv")
    text = "draw positions and velocities of the box and of the jack; default: where matplotlib is installed"
    files.add_argument("--plots", action=argparse.BooleanOptionalAction, help=text)
    text = "also write trajectory.html: animation, impacts and plots in one page that any browser opens"
    files.add_argument("--html", action="store_true", help=text)
    text = "also film it, in this new .mp4 or .gif file; needs the extra video"
    files.add_argument("--film", type=Path, metavar="FILE", help=text)
    return parser.parse_args()


def _state(text: str) -> list[Any] | dict[str, Any]:
    """The 12 numbers of --state, or numbers by name.

    Raises:
        ValueError: unusable text, or a name that comes twice.
    """
    if text.lstrip().startswith("["):
        return check.from_json("state", text, list)
    numbers = dict[str, Any]()
    for part in filter(None, text.split(",")):
        name, _, value = (word.strip() for word in part.partition("="))
        if name in numbers:
            raise ValueError(f"{name} in state must come once, got {check.shown(part)}")
        numbers[name] = value
        with suppress(ValueError):
            numbers[name] = float(value)
    return numbers


# -- torques -----------------------------------------------------------------------------------------------------------


def _torques(path: Path, dt: float) -> Array:
    """Torques of a CSV or npz file [N m], one for each control step.

    Raises:
        ValueError: unusable content, or times of another ``dt`` [s]; the message names the file.
    """
    from jackbox_env.fits.columns import rounding_of
    from jackbox_env.fits.tables import filled, in_si_units, read_table

    if not path.is_file():
        raise ValueError(f"torque must be chirp, none or a CSV or npz file, got {check.shown(str(path))}")
    table = read_table(path, "torque", "torque")
    columns, left_out = in_si_units(table, {"time": "s", "torque": "N m"}, needed=["torque"])
    if others := [header for header in left_out if header.split("[")[0].strip() not in STATE_NAMES]:
        print(f"{path}: left out: {', '.join(others)}.", file=sys.stderr)
    torques = columns["torque"]
    torques = filled(table, "torque", torques[:-1] if np.isnan(torques[-1:]).any() else torques)
    if not len(torques):
        raise ValueError(f"{path}: there must be a torque of one control step at least")
    times = filled(table, "time", columns.get("time", torques[:0])[: len(torques)])
    late = times - times[:1] - dt * np.arange(len(times))
    if len(late) > 1 and np.ptp(late) > _STEP_TOLERANCE * dt * len(late) + 0.98 * rounding_of(times):
        step = np.diff(times)[abs(np.diff(late)).argmax()]
        raise ValueError(f"{path}: times must be dt = {dt:g} s apart, got {step:g} s; choose another --dt")
    return torques


def _completed(arguments: argparse.Namespace) -> Array | None:
    """The torque of each control step [N m] from a file; None: the scene's drive acts. Completes ``arguments.seconds``.

    Raises:
        ValueError: a duration that cannot be simulated; a file that is unusable or shorter.
    """
    from jackbox_env.recording.recorder import steps_of

    dt, torques = check.real("dt", arguments.dt, above=0.0), None
    if arguments.torque not in ("chirp", "none"):
        torques = _torques(Path(arguments.torque), dt)
    if arguments.seconds is None:
        arguments.seconds = 10.0 if torques is None else len(torques) * dt
    _refuse_impossible(arguments)
    whole, rest = steps_of(arguments.seconds, dt)
    if torques is not None and len(torques) < whole + (rest > 0.0):
        lasts = f"as long as {arguments.torque} lasts"
        raise ValueError(f"seconds must be at most {len(torques) * dt:g}, {lasts}, got {arguments.seconds:g}")
    return torques


def _refuse_impossible(arguments: argparse.Namespace) -> None:
    """Raise ValueError for a duration that cannot be simulated, and for files that cannot be written."""
    check.real("seconds", arguments.seconds, above=0.0, at_most=1e6)
    steps = arguments.seconds / arguments.dt
    if arguments.html and steps > _MOST_ON_PAGE:
        raise ValueError(f"html takes at most {_MOST_ON_PAGE:,} steps, got seconds / dt = {steps:g}")
    if arguments.plots and importlib.util.find_spec("matplotlib") is None:
        raise ValueError("plots need matplotlib: pip install matplotlib, or leave --plots out")
    if arguments.film is not None:
        from jackbox_env.recording.film import check_film

        check.real("seconds of a film", arguments.seconds, at_most=_LONGEST_FILM)
        check_film(arguments.film)
        if arguments.film.absolute() in (folder := arguments.folder.absolute(), *folder.parents):
            raise ValueError(f"film must be another path than folder, got {check.shown(str(arguments.film))}")
    check_new(arguments.folder)


def _write(folder: Path, arguments: argparse.Namespace, motion: Motion) -> None:
    """Write the files that the options select."""
    from jackbox_env.recording.files import write_csv

    if arguments.format == "npz":
        motion.save(folder / "trajectory.npz")
    else:
        write_csv(motion.tables(), folder / "states.csv", folder / "impacts.csv")
        write_json(folder / "scene.json", motion.scene.as_dict())
    if arguments.html:
        from jackbox_env.recording.page import model_facts, write_page

        titles = {"chirp": "The scene's drive", "none": "No torque"}
        title = titles.get(arguments.torque, f"Torques of {arguments.torque}")
        write_page(folder / "trajectory.html", motion, title, model_facts(FIDELITIES[arguments.fidelity]))
    if arguments.plots is not False and importlib.util.find_spec("matplotlib"):
        progress("Drawing plots ...")
        from jackbox_env.commands.plots import motion_figures

        motion_figures(motion, folder)
    elif arguments.plots is None:
        print("No plots: matplotlib is not installed (pip install matplotlib)", file=sys.stderr)
    if arguments.film is not None:
        from jackbox_env.recording.film import film_motion

        film_motion(motion, arguments.film, progress=True)


@command_line
def main() -> None:
    """Parse, simulate, write."""
    arguments = _arguments()
    from jackbox_env import Scene
    from jackbox_env.recording.simulation import recorded

    arguments.folder = arguments.folder or stamped("simulate")
    torques, dt = _completed(arguments), arguments.dt
    scene = Scene.of(chosen_scene(arguments.scene, arguments))
    if arguments.torque == "none":
        scene = scene.changed(drive=None)
    setting, start = FIDELITIES[arguments.fidelity], _state(arguments.state)
    try:
        motion = recorded(scene, setting, start, 0.0, arguments.seconds, dt, torques, progress=True)
        folder = new_folder(arguments.folder, "simulate", lambda new: _write(new, arguments, motion))
    except KeyboardInterrupt:
        print("\nInterrupted: nothing was written", file=sys.stderr)
        raise
    print(f"{motion.impact_count} impacts by t = {motion.t[-1]:g} s, fidelity {arguments.fidelity}; wrote")
    for path in [*sorted(folder.iterdir()), *([arguments.film] if arguments.film else [])]:
        print(f"  {path}")
    if motion.failure:
        raise motion.failure


if __name__ == "__main__":
    main()
