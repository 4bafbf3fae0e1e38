"""Simulate the scene under its own drive: the state after each step and the impacts, plots, and an animated page."""

from __future__ import annotations

import argparse
import importlib.util
import sys
from pathlib import Path
from typing import TYPE_CHECKING

from jackbox_env import checks as check
from jackbox_env.command_line import command_line
from jackbox_env.commands.options import add_model_options, chosen_setting, parser_of
from jackbox_env.files import check_new, new_folder, stamped

if TYPE_CHECKING:
    from jackbox_env.recording.trajectory import Trajectory
    from jackbox_env.scene import Scene
    from jackbox_env.simulators.fidelity import Setting

_MOST_ON_PAGE = 20_000  # steps: a page of some 10 MB


def _arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    parser.add_argument("--seconds", type=float, default=10.0, metavar="S", help="simulated time [s]; default: 10")
    add_model_options(parser)
    start = parser.add_argument_group("start")
    text = "the 12 numbers to start from, as a JSON list, e.g. a row of states.csv; default: all 0"
    start.add_argument("--state", default=str([0.0] * 12), metavar="JSON", help=text)
    text = "time at the start [s], which the drive sees; default: 0"
    start.add_argument("--time", type=float, default=0.0, metavar="S", help=text)
    files = parser.add_argument_group("files")
    text = "new folder for all that is written; default: runs/simulate-<date>-<time>"
    files.add_argument("--folder", type=Path, help=text)
    files.add_argument("--format", choices=("csv", "npz"), default="csv", help="of states and impacts; default: csv")
    text = "draw positions and velocities of the box and of the jack; default: where matplotlib is installed"
    files.add_argument("--plots", action=argparse.BooleanOptionalAction, help=text)
    text = "also write trajectory.html: animation, impacts and plots in one page that any browser opens"
    files.add_argument("--html", action="store_true", help=text)
    return parser.parse_args()


def _refuse_impossible(arguments: argparse.Namespace) -> None:
    """Raise ValueError for a duration that cannot be simulated, and for files that cannot be written."""
    check.real("seconds", arguments.seconds, above=0.0, at_most=1e6)
    check.real("dt", arguments.dt, above=0.0)
    if arguments.dt > arguments.seconds:
        raise ValueError(f"dt must be at most seconds = {arguments.seconds:g}, got {arguments.dt:g}")
    steps = arguments.seconds / arguments.dt
    if steps > 1e8:
        raise ValueError(f"seconds / dt must be at most 1e8 steps, got {steps:g}")
    if arguments.html and steps > _MOST_ON_PAGE:
        raise ValueError(f"html takes at most {_MOST_ON_PAGE:,} steps, got seconds / dt = {steps:g}")
    if arguments.plots and importlib.util.find_spec("matplotlib") is None:
        raise ValueError("plots need matplotlib: pip install matplotlib, or leave --plots out")
    check_new(arguments.folder)


def _write(folder: Path, arguments: argparse.Namespace, scene: Scene, setting: Setting, trajectory: Trajectory) -> None:
    """Write the files that the options select."""
    from jackbox_env.recording.trajectory import write_csv, write_npz

    (write_csv if arguments.format == "csv" else write_npz)(trajectory, folder)
    if arguments.html:
        from jackbox_env.recording.page import model_facts, write_page

        write_page(folder / "trajectory.html", scene, trajectory, "The scene's drive", model_facts(setting))
    if arguments.plots is not False and importlib.util.find_spec("matplotlib"):
        from jackbox_env.commands.plots import trajectory_figures

        trajectory_figures(trajectory, folder)
    elif arguments.plots is None:
        print("No plots: matplotlib is not installed (pip install matplotlib)", file=sys.stderr)


@command_line
def main() -> None:
    """Parse, simulate, write."""
    arguments = _arguments()
    from jackbox_env import Scene, make_simulator
    from jackbox_env.recording.trajectory import simulate
    from jackbox_env.simulators.fidelity import words

    arguments.folder = arguments.folder or stamped("simulate")
    _refuse_impossible(arguments)
    setting = chosen_setting(arguments)
    scene = Scene.of(check.from_json("scene", arguments.scene, dict))
    simulator = make_simulator(scene, **setting._asdict())
    simulator.reset(check.from_json("state", arguments.state, list), arguments.time)
    try:
        trajectory = simulate(simulator, arguments.seconds, arguments.dt)
        folder = new_folder(
            arguments.folder, "simulate", lambda new: _write(new, arguments, scene, setting, trajectory)
        )
    except KeyboardInterrupt:
        print("\nInterrupted: nothing was written", file=sys.stderr)
        raise
    print(f"{len(trajectory.impacts)} impacts by t = {simulator.time:g} s, {words(setting)}; wrote")
    for path in sorted(folder.iterdir()):
        print(f"  {path}")
    if trajectory.failure:
        raise RuntimeError(trajectory.failure)


if __name__ == "__main__":
    main()
