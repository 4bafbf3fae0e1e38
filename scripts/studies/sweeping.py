"""Studies whose trials are a sweep's: what has finished is kept, and the same command goes on."""

from __future__ import annotations

import csv
import sys
from pathlib import Path

from agents.sweeps.in_process import Runner, Trial, Work
from agents.sweeps.results_log import TABLE, carry_out, new_sweep, read_sweep


def swept(folder: Path, trials: list[Trial], work: Work, runner: Runner, progress: bool) -> list[dict[str, str]]:
    """Run what has not finished of the trials in ``folder``, and return the rows of its table, in their order.

    Raises:
        RuntimeError: some trials failed.
        ValueError: the folder's sweep was begun with other trials or other code.
    """
    if not folder.exists():
        new_sweep(folder, {}, trials)
    elif [trial.key for trial in read_sweep(folder)[1]] != [trial.key for trial in trials]:
        raise ValueError(f"{folder} was begun with other arguments: choose another folder")
    try:
        outcome = carry_out(folder, trials, work, runner, progress)
    except KeyboardInterrupt:
        print(f"\nInterrupted; what has finished is kept in {folder}, where --folder goes on", file=sys.stderr)
        raise
    if outcome.failed:
        raise RuntimeError(f"{len(outcome.failed)} of {len(trials)} trials failed: {folder / TABLE} says which")
    csv.field_size_limit(sys.maxsize)  # a result may be long
    with (folder / TABLE).open(newline="") as file:
        return list(csv.DictReader(file))
