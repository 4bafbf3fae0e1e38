"""What each named fidelity does to a learner: train on each, run on all, compare long-run statistics, write a page."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from jackbox_env import _validation as check
from jackbox_env.commands.common import command_line
from scripts.studies.transfer.study import StudySettings


@dataclass(frozen=True)
class Arguments:
    """Train on each named fidelity, run every policy on all of them, and write the page."""

    settings: Annotated[StudySettings, tyro.conf.arg(name="")]
    folder: Path | None = None
    """Folder to make for the trainings; None: runs/transfer-<date>-<time>."""
    resume: Path | None = None
    """Folder of an earlier study to continue with its own settings; finished parts are not repeated."""
    page_from: Path | None = None
    """learning.json of a finished study: write its page again, train and run nothing."""
    processes: int = 2
    """Trainings side by side."""
    address: str | None = None
    """Train and run with Ray on a cluster: the address of its head, or auto on one of its machines. The study's folder
    must be on a disk that all machines share. None: on this machine, without Ray."""
    out: Path | None = None
    """Folder of learning.md, learning.json and learning.png. None: the study's, or that of --page-from."""
    progress: bool = True
    """Show progress bars."""


@command_line
def main() -> None:
    """Parse, train, run, write."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.files import held
    from agents.sweeps.on_ray import OnRay
    from jackbox_env.recording.files import remove_partials
    from scripts.studies.transfer import study
    from scripts.studies.transfer.page import SCRIPT, gather, read_data, write

    check.whole("processes", arguments.processes, at_least=1, at_most=1000)  # before a folder is made
    if arguments.out is not None and not arguments.out.is_dir():
        raise FileNotFoundError(f"{arguments.out} is no folder to write a page in")
    given = [arguments.resume, arguments.page_from, arguments.folder]
    if len(given) - given.count(None) > 1 or (given[:2] != [None, None] and arguments.settings != StudySettings()):
        raise ValueError("--resume and --page-from use the settings of the study named: give no other settings")
    runner = None if arguments.address is None else OnRay(address=arguments.address)
    if arguments.page_from is not None:
        print(write(read_data(arguments.page_from), arguments.out or arguments.page_from.parent))
        return
    settings = arguments.settings if arguments.resume is None else study.read_study(arguments.resume)
    folder = arguments.resume or study.new_study(arguments.folder, settings)
    with held(folder):
        remove_partials(folder, folder / "cells", folder / "longrun")
        try:
            study.train_all(folder, settings, arguments.processes, arguments.progress, runner)
            shown = arguments.progress, runner
            results = {task: study.run_all(folder, settings, task, *shown) for task in settings.tasks}
            runs = study.run_statistics(folder, settings, *shown)
        except KeyboardInterrupt:
            print(f"\nInterrupted. Go on with: {SCRIPT} --resume {folder}", file=sys.stderr)
            raise
        print(write(gather(folder, settings, results, runs), arguments.out or folder))


if __name__ == "__main__":
    main()
