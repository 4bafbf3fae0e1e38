"""Simulate the scene: the state after each step and the impacts, plots, an animated page, and a film."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

from jackbox_env.commands.options import add_scene_options, chosen_scene, parser_of
from jackbox_env.simulators.fidelity import COMMANDS, FIDELITIES
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import command_line, progress
from jackbox_env.tools.files import check_new, new_folder, stamped, write_json

if TYPE_CHECKING:
    from jackbox_env.recording.motion import Motion

_MOST_ON_PAGE = 20_000  # steps: a page of some 10 MB
_LONGEST_FILM = 60.0  # [s]: 1.2 GB of frames


def _arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="simulated time [s]; default: 10")
    model = parser.add_argument_group("scene and contact model")
    model.add_argument(
        "--fidelity", choices=FIDELITIES, default=COMMANDS, help=f"how impacts are computed; default: {COMMANDS}"
    )
    model.add_argument(
        "--dt", type=float, default=0.02, metavar="S", help="duration of a control step [s]; default: 0.02"
    )
    add_scene_options(model)
    parser.add_argument(
        "--state",
        default="{}",
        metavar="JSON",
        help=(
            "what to start from: numbers by name, as JSON, e.g. '{\"x_jack\": 1}', or all 12 as a list, e.g. a row of "
            "states.csv; default: all 0"
        ),
    )
    files = parser.add_argument_group("files")
    files.add_argument(
        "--folder", type=Path, help="new folder for all that is written; default: runs/simulate-<date>-<time>"
    )
    files.add_argument("--format", choices=("csv", "npz"), default="csv", help="of states and impacts; default: csv")
    files.add_argument(
        "--plots",
        action=argparse.BooleanOptionalAction,
        help="draw positions and velocities of the box and of the jack; default: where matplotlib is installed",
    )
    files.add_argument(
        "--html",
        action="store_true",
        help="also write trajectory.html: animation, impacts and plots in one page that any browser opens",
    )
    files.add_argument(
        "--film", type=Path, metavar="FILE", help="also film it, in this new .mp4 or .gif file; needs the extra video"
    )
    return parser.parse_args()


def _refuse_impossible(arguments: argparse.Namespace) -> None:
    """Raise ValueError for a duration that cannot be simulated, and for files that cannot be written."""
    check.real("seconds", arguments.seconds, above=0.0, at_most=1e6)
    steps = arguments.seconds / check.real("dt", arguments.dt, above=0.0)
    if arguments.html and steps > _MOST_ON_PAGE:
        raise ValueError(f"html takes at most {_MOST_ON_PAGE:,} steps, got seconds / dt = {steps:g}")
    if arguments.plots and importlib.util.find_spec("matplotlib") is None:
        raise ValueError("plots need matplotlib: pip install matplotlib, or leave --plots out")
    if arguments.film is not None:
        from jackbox_env.recording.film import check_film

        check.real("seconds of a film", arguments.seconds, at_most=_LONGEST_FILM)
        check_film(arguments.film)
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

        title = "The scene's drive" if motion.scene.drive else "No torque"
        write_page(folder / "trajectory.html", motion, title, model_facts(FIDELITIES[arguments.fidelity]))
    if arguments.plots is not False and importlib.util.find_spec("matplotlib"):
        progress("Drawing plots ...")
        from jackbox_env.commands.plots import motion_figures

        motion_figures(motion, folder)
    elif arguments.plots is None:
        print("No plots: matplotlib is not installed (pip install matplotlib)", file=sys.stderr)
    if arguments.film is not None:
        from jackbox_env.recording.film import film_motion

        film_motion(motion, arguments.film)


@command_line
def main() -> None:
    """Parse, simulate, write."""
    arguments = _arguments()
    from jackbox_env import Scene
    from jackbox_env.recording.simulation import recorded

    arguments.folder = arguments.folder or stamped("simulate")
    _refuse_impossible(arguments)
    scene, setting = Scene.of(chosen_scene(arguments.scene, arguments)), FIDELITIES[arguments.fidelity]
    kind: Any = list if arguments.state.lstrip().startswith("[") else dict
    start = check.from_json("state", arguments.state, kind)
    motion = recorded(scene, setting, start, 0.0, arguments.seconds, arguments.dt, None, progress=True)
    folder = new_folder(arguments.folder, "simulate", lambda new: _write(new, arguments, motion))
    print(f"{motion.impact_count} impacts by t = {motion.t[-1]:g} s, fidelity {arguments.fidelity}; wrote")
    for path in [*sorted(folder.iterdir()), *([arguments.film] if arguments.film else [])]:
        print(f"  {path}")
    if motion.failure:
        raise motion.failure


if __name__ == "__main__":
    main()
