"""What each named fidelity does to a learner: train on each, run on all, compare long-run statistics, write a page."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from agents.transfer import StudySettings
from scripts.common import command_line


@dataclass(frozen=True)
class Arguments:
    """Train on each named fidelity, run every policy on all of them, and write what it comes to."""

    settings: Annotated[StudySettings, tyro.conf.arg(name="")]
    folder: Path | None = None
    """Folder to make for the trainings; None: runs/transfer-<date>-<time>."""
    resume: Path | None = None
    """Folder of an earlier study to go on with, by its own settings; what is finished in it is not done again."""
    processes: int = 2
    """Trainings side by side."""
    out: Path = Path("docs")
    """Folder of the page, its data and its pictures: learning.md, learning.json, learning_<task>.png."""
    progress: bool = True
    """Show progress bars."""


@command_line
def main() -> None:
    """Parse, train, run, write."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.transfer import new_study, read_study, train_all

    if not arguments.out.is_dir():
        raise FileNotFoundError(f"{arguments.out} is no folder to write a page in")
    if arguments.resume is not None:
        if arguments.settings != StudySettings() or arguments.folder is not None:
            raise ValueError("--resume goes on by the settings of its folder: give no other setting beside it")
        folder, settings = arguments.resume, read_study(arguments.resume)
    else:
        settings = arguments.settings
        folder = new_study(arguments.folder, settings)
    try:
        train_all(folder, settings, arguments.processes, arguments.progress)
    except KeyboardInterrupt:
        print(f"\nInterrupted. Go on with: python scripts/transfer.py --resume {folder}", file=sys.stderr)
        raise


if __name__ == "__main__":
    main()
