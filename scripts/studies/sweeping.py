"""Run a study's trials as a sweep, so that the same command continues an interrupted study."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from agents.sweep import TABLE, Runner, Work, carry_out, new_sweep, read_sweep


def swept(
    folder: Path, trials: list[dict[str, Any]], work: Work, runner: Runner, progress: bool
) -> list[dict[str, Any]]:
    """Run the unfinished trials in ``folder``, and return the rows of its table, in the order of ``trials``.

    Raises:
        RuntimeError: some trials failed.
        ValueError: the folder's sweep was begun with other trials or other code.
    """
    if not folder.exists():
        new_sweep(folder, trials)
    elif read_sweep(folder)[0] != trials:
        raise ValueError(f"{folder} was begun with other arguments: choose another folder")
    try:
        rows = carry_out(folder, trials, work, runner, progress)
    except KeyboardInterrupt:
        print(f"\nInterrupted. Finished trials are in {folder}; --runs continues there", file=sys.stderr)
        raise
    failed = sum(row["error"] is not None for row in rows)
    if failed:
        raise RuntimeError(f"{failed} of {len(trials)} trials failed, marked in {folder / TABLE}")
    return rows
