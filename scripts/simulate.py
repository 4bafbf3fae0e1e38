"""Simulate the scene under its own drive: states and impacts as CSV or npz, and four plots."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from scripts.common import command_line


@dataclass(frozen=True)
class Arguments:
    """Simulate the scene under its own drive."""

    seconds: float = 10.0
    """Simulated time [s]."""
    dt: float = 0.02
    """Time between stored states [s]."""
    contact: str | None = None
    """Contact model: pymunk or exact; None: the fidelity's, or pymunk."""
    substeps: int | None = None
    """Engine steps per dt; None: the fidelity's, or the contact model's default."""
    scene: str = "{}"
    """Fields of the scene that differ from the default, as JSON, e.g. '{"gravity": 1.62}'."""
    state: str | None = None
    """The 12 numbers to start from, as a JSON list; None: box and jack at rest at the origin."""
    time: float = 0.0
    """Time at the start [s], which the drive sees."""
    fidelity: str | None = None
    """A name for contact and substeps: coarse, balanced, fine or exact; contact and substeps override it."""
    folder: Path | None = None
    """New folder for the files; None: runs/simulate-<date>-<time>."""
    format: Literal["csv", "npz"] = "csv"
    """Files of states and impacts."""
    plots: bool = True
    """Draw positions and velocities of the box and of the jack."""


@command_line
def main() -> None:
    """Parse, simulate, write."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.runs import new_folder
    from agents.settings import EnvSettings
    from agents.trajectory import simulate, write_csv, write_npz
    from jackbox_env import Scene, make_simulator
    from jackbox_env import _validation as check
    from jackbox_env.simulators.fidelity import resolve
    from jackbox_env.states import as_start

    check.real("seconds", arguments.seconds, above=0.0, at_most=1e6)
    check.real("dt", arguments.dt, above=0.0)
    if arguments.dt > arguments.seconds:
        raise ValueError(f"dt must be at most seconds = {arguments.seconds:g}, got {arguments.dt:g}")
    if arguments.seconds / arguments.dt > 1e8:
        raise ValueError(f"seconds / dt must be at most 1e8 steps, got {arguments.seconds / arguments.dt:g}")
    setting = resolve(arguments.fidelity, arguments.contact, arguments.substeps)
    scene = Scene.of(EnvSettings(scene=arguments.scene).scene_fields)
    simulator = make_simulator(scene, **setting._asdict())
    if arguments.state is not None:
        try:
            state = json.loads(arguments.state)
        except json.JSONDecodeError as error:
            raise ValueError(f"state must be a JSON list of 12 numbers, got {arguments.state!r}") from error
    else:
        state = [0.0] * 12
    simulator.reset(as_start(scene, state), arguments.time)
    folder = new_folder(arguments.folder, "simulate")
    trajectory = simulate(simulator, arguments.seconds, arguments.dt)
    paths = write_csv(trajectory, folder) if arguments.format == "csv" else write_npz(trajectory, folder)
    if arguments.plots:
        from agents.figures import trajectory_figures

        paths += trajectory_figures(trajectory, folder)
    print(f"{len(trajectory.impacts)} impacts by t = {simulator.time:g} s; wrote")
    for path in paths:
        print(f"  {path}")
    if trajectory.failure:
        raise RuntimeError(trajectory.failure)


if __name__ == "__main__":
    main()
