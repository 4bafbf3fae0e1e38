"""Run a grid of policies or of trainings over tasks, settings, scenes and seeds: one table, whatever it ran on.

In this process, or with Ray (the extra `scale`) on this machine's cores or on a cluster, with the same results.
"""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is there: one thread for each trial

from agents.settings import TaskName
from jackbox_env.commands.common import command_line, tyro


@dataclass(frozen=True)
class Grid:
    """What is run: every combination."""

    policy: tuple[str, ...] = ("level", "ppo")
    """As in scripts/evaluate.py: names, run folders, exported policies."""
    train: str | None = None
    """In place of policies: settings of scripts/train.py as JSON, each with a list of values, e.g.
    '{"total_steps": [100000], "learning_rate": [0.0005, 0.001]}'. The best model of each training is evaluated."""
    task: tuple[TaskName, ...] = ("juggle",)
    """What is rewarded."""
    setting: tuple[str, ...] = ("exact",)
    """Fidelities, or settings of the environment as JSON, e.g. '{"contact": "pymunk", "substeps": 8}'."""
    scene: tuple[str, ...] = ("{}",)
    """Fields of the scene that differ from the default, as JSON, e.g. '{"gravity": 1.62}'."""
    seeds: int = 1
    """Seeds 0, 1, ... of each: of the starts of a policy's episodes, or of a training."""
    episodes: int = 16
    """Episodes of each trial."""


@dataclass(frozen=True)
class Arguments:
    """Run a sweep."""

    grid: Annotated[Grid, tyro.conf.arg(name="")]
    folder: Path | None = None
    """Folder to make; None: runs/sweep-<date>-<time>."""
    resume: Path | None = None
    """Folder of a sweep to go on with: what has not finished, and what has failed."""
    workers: int | None = None
    """With Ray on this machine, so many trials side by side; None: in this process, without Ray."""
    address: str | None = None
    """With Ray on a cluster: the address of its head, or auto on one of its machines."""
    progress: bool = True
    """Show a progress bar."""


@command_line
def main() -> None:
    """Parse, run what is to be run, say what failed and where the table is."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.sweeps import trials as kinds
    from agents.sweeps.on_ray import runner_for
    from agents.sweeps.results_log import LOG, TABLE, carry_out, new_sweep, read_sweep

    runner = runner_for(arguments.workers, arguments.address)
    if arguments.grid.train is not None and arguments.grid.policy != Grid.policy:
        raise ValueError("--train runs trainings in place of policies: give no --policy")
    if arguments.resume is None:
        trials = kinds.grid_trials(**asdict(arguments.grid))
        folder = new_sweep(arguments.folder, asdict(arguments.grid), trials)
    else:
        if arguments.grid != Grid() or arguments.folder is not None:
            raise ValueError("--resume runs the sweep of its folder: give no other grid")
        folder = arguments.resume
        _, trials = read_sweep(folder, kinds.check_trial)
    work = partial(kinds.run_trial, folder.resolve())
    command = shlex.join(["python", "scripts/sweep.py", "--resume", str(folder)])
    try:
        outcome = carry_out(folder, trials, work, runner, arguments.progress)
    except KeyboardInterrupt:
        print(f"\nInterrupted. Go on with: {command}", file=sys.stderr)
        raise
    if len(outcome.processors) > 1:
        print(f"Ran on {len(outcome.processors)} kinds of processor, so the last bits may differ from one kind's")
    print(f"{outcome.finished} trials: {folder / TABLE}")
    if outcome.failed:
        said = f"{len(outcome.failed)} of {len(trials)} trials failed: {folder / TABLE} says which"
        print(f"{said}, {folder / LOG} where. Try them again with: {command}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
