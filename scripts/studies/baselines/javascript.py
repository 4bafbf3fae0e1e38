"""Run rapier.js and matter.js, which play the proven cases in Node and write what the referee reads."""

from __future__ import annotations

import json
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from scripts.referee import IMPACTS, STATES, Table, read_table

FOLDER = Path(__file__).parent


def version(package: str) -> str:
    """The version of a package in node_modules above this file or in NODE_PATH; empty if Node does not find it."""
    command = [
        shutil.which("node") or "false", "--print",
        f"require(require.resolve.paths({package!r}).map((path) => `${{path}}/{package}/package.json`)"
        ".find(fs.existsSync)).version",
    ]  # fmt: skip
    return subprocess.run(command, cwd=FOLDER, capture_output=True, text=True).stdout.strip()


def play(adapter: str, settings: Mapping[str, Any]) -> tuple[Table, Table, dict[str, Any]]:
    """The states and impacts of the proven cases, and what the adapter prints: its speed.

    Raises:
        RuntimeError: the adapter failed.
    """
    with tempfile.TemporaryDirectory() as folder:
        command = ["node", str(FOLDER / f"{adapter}.js"), json.dumps(settings), folder]
        ended = subprocess.run(command, capture_output=True, text=True)
        if ended.returncode:
            raise RuntimeError(f"{adapter}.js failed: {ended.stderr.strip()}")
        states = read_table(Path(folder) / "states.csv", STATES)
        return states, read_table(Path(folder) / "impacts.csv", IMPACTS), json.loads(ended.stdout)
