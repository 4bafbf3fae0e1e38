"""Run a grid of policies or of trainings over tasks, settings, scenes and seeds, and write one table.

It runs in this process, on this machine's cores, or on a cluster with Ray (the extra `scale`), with the same table.
"""

from __future__ import annotations

import os
import shlex
import sys
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is imported: one thread for each trial

from jackbox_env.tools.command_line import command_line


@dataclass(frozen=True)
class Grid:
    """The trials: every combination."""

    policy: tuple[str, ...] = ("level", "ppo")
    """Policies as in scripts/evaluate.py: names, run folders, exported ones."""
    train: str | None = None
    (
        "In place of policies: settings of scripts/train.py as JSON, each with a list of values, e.g. "
        '\'{"total_steps": [100000], "learning_rate": [0.0005, 0.001]}\'. The best model of each training is evaluated.'
    )
    task: tuple[str, ...] = ("juggle",)
    """The tasks: juggle, spin, rattle, or your own, file.py:name."""
    setting: tuple[str, ...] = ("exact",)
    (
        "Fidelities, or settings of the environment as JSON, e.g. '{\"control_dt\": 0.05}'; with "
        "--train, and for functions and model files, also observation, action (or your file.py:name) and action_repeat."
    )
    scene: tuple[str, ...] = ("{}",)
    """Fields of the scene that differ from the default, as JSON, e.g. '{"gravity": 1.62}'."""
    seeds: int = 1
    """Number of seeds, from 0 on: of the starts of a policy's episodes, or of a training."""
    episodes: int = 16
    """Episodes of each trial."""


@dataclass(frozen=True)
class Arguments:
    """Run a sweep."""

    grid: Grid
    folder: Path | None = None
    """New folder for all that is written; None: runs/sweep-<date>-<time>."""
    resume: Path | None = None
    """Folder of a sweep to continue: runs unfinished and failed trials."""
    workers: int | None = None
    """Number of trials at a time, each in a separate process; None: one after the other in this process."""
    trust: bool = False
    """Run code as in scripts/evaluate.py; with --resume, also that in the sweep's folder."""
    address: str | None = None
    """Address of the head of a Ray cluster, or auto on one of its machines."""
    progress: bool = True
    """Show a progress bar."""


@command_line
def main() -> None:
    """Parse, run the trials, print the failures and the path of the table."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__, config=(tyro.conf.OmitArgPrefixes,))
    from agents.sweep import LOG, TABLE, Code, carry_out, code_named, grid, new_sweep, read_sweep, run_trial
    from agents.sweep_ray import runner_for
    from jackbox_env.tools.user_code import texts_of

    runner = runner_for(arguments.workers, arguments.address)
    if arguments.grid.train is not None and arguments.grid.policy != Grid.policy:
        raise ValueError("--train runs trainings in place of policies: leave out --policy")
    if arguments.resume is None:
        trials = grid(**asdict(arguments.grid), trust=arguments.trust)
        folder = new_sweep(arguments.folder, trials)
        code = Code(texts_of(code_named(trials)), tuple(code_named(trials)), arguments.trust)
    elif arguments.grid == Grid() and arguments.folder is None:
        folder, (trials, code) = arguments.resume, read_sweep(arguments.resume, arguments.trust)
    else:
        raise ValueError("--resume continues the sweep of its folder: leave out other settings")
    trust = ["--trust"] if code.names or code.trust else []
    command = shlex.join(["python", "scripts/sweep.py", "--resume", str(folder), *trust])
    try:
        rows = carry_out(folder, trials, partial(run_trial, folder.resolve(), code), runner, arguments.progress)
    except KeyboardInterrupt:
        print(f"\nInterrupted. Continue with: {command}", file=sys.stderr)
        raise
    print(f"{len(rows)} trials: {folder / TABLE}")
    failed = sum(row["error"] is not None for row in rows)
    if failed:
        message = (
            f"{failed} of {len(trials)} trials failed, marked in {folder / TABLE}, with tracebacks in {folder / LOG}"
        )
        print(f"{message}. Try them again with: {command}", file=sys.stderr)
        sys.exit(1)


if __name__ == "__main__":
    main()
