"""Studies whose trials are a sweep's: what has finished is kept, and the same command goes on."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

from agents.sweep import TABLE, Runner, Work, carry_out, new_sweep, read_sweep


def swept(
    folder: Path, trials: list[dict[str, Any]], work: Work, runner: Runner, progress: bool
) -> list[dict[str, Any]]:
    """Run what has not finished of the trials in ``folder``, and return the rows of its table, in their order.

    Raises:
        RuntimeError: some trials failed.
        ValueError: the folder's sweep was begun with other trials or other code.
    """
    if not folder.exists():
        new_sweep(folder, trials)
    elif read_sweep(folder) != trials:
        raise ValueError(f"{folder} was begun with other arguments: choose another folder")
    try:
        rows = carry_out(folder, trials, work, runner, progress)
    except KeyboardInterrupt:
        print(f"\nInterrupted; what has finished is kept in {folder}, where --runs goes on", file=sys.stderr)
        raise
    failed = sum(row["error"] is not None for row in rows)
    if failed:
        raise RuntimeError(f"{failed} of {len(trials)} trials failed: {folder / TABLE} says which")
    return rows
