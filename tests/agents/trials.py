"""Trials of tests, in a module that imports nothing heavy: each process of a sweep imports it."""

from __future__ import annotations

import os
import signal
import time
from pathlib import Path
from typing import Any

GRID = [{"name": name, "number": number} for name in ("one", "other") for number in range(5)]


def shares(settings: dict[str, Any]) -> dict[str, Any]:
    """A trial that is instant, with floats that need all their digits."""
    return {"share": (settings["number"] + len(settings["name"])) / 7.0, "list": [1, settings["name"]]}


def fragile(notes: Path, settings: dict[str, Any]) -> dict[str, Any]:
    """The same, but at first one trial hangs, one fails, and another kills its process."""
    note = notes / f"{settings['name']} {settings['number']}"
    if settings["number"] in (0, 2) and not note.exists():
        note.touch()
        assert os.environ["OPENBLAS_NUM_THREADS"] == "1"  # which nobody else sets
        if settings == GRID[0]:
            time.sleep(1000.0)
        if settings == GRID[2]:
            os.kill(os.getpid(), signal.SIGKILL)
        if settings == GRID[7]:
            raise ValueError("number must not be 2\nthe first time")
    return shares(settings)
