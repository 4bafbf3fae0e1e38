"""Commands run in this process, seconds faster than in another one, because the libraries are loaded."""

from __future__ import annotations

import io
import runpy
import sys
from contextlib import redirect_stderr, redirect_stdout
from pathlib import Path
from typing import NamedTuple

import pytest

ROOT = Path(__file__).parents[1]


class Done(NamedTuple):
    stdout: str
    stderr: str


def script(name: str, *arguments: str, cwd: Path, status: int = 0) -> Done:
    """Run a command of a checkout, with standard input as it is."""
    out, errors = io.StringIO(), io.StringIO()
    file = str(ROOT / "scripts" / f"{name}.py")
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(errors):
        patch.chdir(cwd)
        patch.setattr(sys, "argv", [file, *arguments])
        patch.setattr(sys, "path", [*sys.path])
        ended = 0
        try:
            runpy.run_path(file, run_name="__main__")
        except SystemExit as end:
            ended = end.code  # type: ignore[assignment]
    assert (ended or 0) == status, errors.getvalue()
    return Done(out.getvalue(), errors.getvalue())


def jackbox(*arguments: str, cwd: Path, status: int = 0) -> Done:
    """Run ``python -m jackbox_env``."""
    return script("../jackbox_env/__main__", *arguments, cwd=cwd, status=status)
