"""A small function whose compiled code is kept, and processes that load it."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any
from unittest.mock import patch

import pytest

from jackbox_env.compiled import compiler as _compiled

# One line for the results' bits, one for how often kept code was loaded, then the warnings.
CALL = """
import warnings
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.impacts import quarter
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    turn = compiled(quarter)
    print([[x.hex() for x in turn(0.8, 0.6, number)] for number in range(-5, 6)])
    print(sum(turn.stats.cache_hits.values()))
    for warning in said:
        print(warning.message)
"""


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only place for compiled code."""
    place = tmp_path / "place"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(place))
    monkeypatch.setattr(_compiled, "PACKAGE", tmp_path / "package")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    return place


def fresh(function: Callable[..., Any]) -> Any:
    """``function`` compiled as in a process that has not compiled it yet."""
    assert isinstance(function, FunctionType)
    with patch.dict(_compiled._made, clear=True):
        return _compiled._compile_now(function, (), True)


def found(made: Any) -> int:
    """How often kept code was loaded in place of compiling."""
    return sum(made.stats.cache_hits.values())


def files(place: Path, kind: str = "kept") -> list[Path]:
    return sorted(place.glob(f"compiled-*/*.{kind}"))


def start(place: Path, code: str = CALL, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(place), **environment},
    )  # fmt: skip
