"""What each named fidelity does to a learner: train on each, run on all, compare long-run statistics, write a page."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import tyro

from scripts.common import command_line
from scripts.studies.transfer.study import StudySettings

if TYPE_CHECKING:
    from scripts.studies.transfer.longrun import Episodes
    from scripts.studies.transfer.study import Cells


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
    out: Path | None = None
    """Folder of the page, its data and its pictures: learning.md, learning.json, learning_<task>.png. None: the
    study's."""
    progress: bool = True
    """Show progress bars."""


def write(
    folder: Path,
    settings: StudySettings,
    results: list[Cells],
    runs: dict[str, dict[str, Episodes]],
    out: Path | None,
) -> str:
    """Write page, data and pictures into ``out``, None for the study's folder; return the page."""
    import json

    import numpy as np

    from agents.storage import write_text
    from scripts.studies.transfer.inference import crossed_estimate
    from scripts.studies.transfer.page import as_json, page
    from scripts.studies.transfer.pictures import transfer_figure
    from scripts.studies.transfer.verdict import compare

    place = folder if out is None else out
    samples = {condition: {name: one.values for name, one in each.items()} for condition, each in runs.items()}
    comparisons = compare(samples, np.random.default_rng(0))
    for cells in results:
        rows = {name: [crossed_estimate(row[other]) for other in row] for name, row in cells.trained.items()}
        scripted = {name: [float(row[other].mean()) for other in row] for name, row in cells.baselines.items()}
        seeds = {name: [row[other].mean(axis=1).tolist() for other in row] for name, row in cells.trained.items()}
        transfer_figure(place / f"learning_{cells.task}.png", cells.task, rows, seeds, scripted)
    text = page(folder, settings, results, runs, comparisons, out)
    data = as_json(folder, settings, results, runs, comparisons)
    write_text(place / "learning.json", json.dumps(data) + "\n")
    write_text(place / "learning.md", text)
    return text


@command_line
def main() -> None:
    """Parse, train, run, write."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from scripts.studies.transfer.study import (
        checked_processes,
        new_study,
        read_study,
        run_all,
        run_statistics,
        train_all,
    )

    checked_processes(arguments.processes)  # before a folder is made
    if arguments.out is not None and not arguments.out.is_dir():
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
        results = [run_all(folder, settings, task, arguments.progress) for task in settings.tasks]
        runs = run_statistics(folder, settings, arguments.progress)
    except KeyboardInterrupt:
        print(
            f"\nInterrupted. Go on with: python scripts/studies/transfer/transfer.py --resume {folder}", file=sys.stderr
        )
        raise
    print(write(folder, settings, results, runs, arguments.out))


if __name__ == "__main__":
    main()
