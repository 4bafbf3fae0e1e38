"""Plain functions, compiled by numba together with the plain functions of this package that they call.

The functions stay plain Python where they are written: readable, importable without numba, and testable without it.
"""

from __future__ import annotations

import hashlib
import os
import shutil
import sys
import threading
import warnings
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from types import FunctionType
from typing import Any, TypeVar, cast

PACKAGE = Path(__file__).parents[1]
F = TypeVar("F", bound=Callable[..., Any])
_LOCK = threading.RLock()  # numba is told of the folder by a variable that all threads share
_KEPT = 8  # folders of compiled code, of as many states of the source


def compiled(function: F) -> F:
    """Return ``function`` compiled, without the global interpreter lock, kept on disk for later processes.

    Arithmetic is IEEE float64 in the order written, so every caller gets the same bits; a division by zero gives an
    infinity.
    """
    return cast(F, _compile(cast(FunctionType, function)))


def compiled_with(function: F, **instead: Any) -> F:
    """Return ``function`` compiled with other functions or constants in place of those of these names, for comparisons.

    Not kept on disk.
    """
    return cast(F, _compile(cast(FunctionType, function), tuple(instead.items()), keep=False))


def _compile(
    function: FunctionType, instead: tuple[tuple[str, Any], ...] = (), keep: bool = True
) -> Callable[..., Any]:
    with _LOCK:
        return _compile_once(function, instead, keep)


@cache
def _compile_once(function: FunctionType, instead: tuple[tuple[str, Any], ...], keep: bool) -> Callable[..., Any]:
    from numba import njit

    known = {**function.__globals__, **dict(instead)}
    for name in function.__code__.co_names:
        if isinstance(known.get(name), FunctionType) and _is_ours(known[name]):
            known[name] = _compile(known[name], instead, keep=False)  # what is kept of a caller holds what it calls
    twin = FunctionType(function.__code__, known, function.__name__, function.__defaults__, function.__closure__)
    twin.__qualname__, twin.__module__, twin.__doc__ = function.__qualname__, function.__module__, function.__doc__
    # Without the runtime that counts references to arrays: nothing compiled here makes any, and counting them took
    # two thirds of a step.
    settings: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
    if not keep:
        return cast(Callable[..., Any], njit(**settings)(twin))
    with _cache_folder() as folder:
        return cast(Callable[..., Any], njit(cache=folder is not None, **settings)(twin))


def _is_ours(function: FunctionType) -> bool:
    return function.__module__.split(".")[0] in (__name__.split(".")[0], "scripts")


@cache
def _digest() -> str:
    """Of the package's whole source: numba itself sees only changes of the file that a kept function stands in."""
    digest = hashlib.sha256()
    for path in sorted(PACKAGE.rglob("*.py")):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _cache_places() -> Iterator[Path]:
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        yield Path(given)
    yield PACKAGE / "__pycache__"
    yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "jackbox"


def _tidy(place: Path) -> None:
    """Remove what was compiled from states of the source that are long gone."""
    folders = sorted(place.glob("compiled-*"), key=lambda folder: folder.stat().st_mtime, reverse=True)
    for folder in folders[_KEPT:]:
        shutil.rmtree(folder, ignore_errors=True)


@contextmanager
def _cache_folder() -> Iterator[Path | None]:
    """Where what is compiled now is kept: the first place that can be written, a folder for each state of the source.

    None, with a warning, if there is none.
    """
    from numba import config

    for place in _cache_places():
        folder = place / f"compiled-{_digest()}"
        try:
            if not folder.is_dir():
                folder.mkdir(parents=True, exist_ok=True)
                _tidy(place)
                print("jackbox compiles its exact contact model, once: about 15 s", file=sys.stderr)
        except OSError:
            continue
        if os.access(folder, os.W_OK):
            break
    else:
        warnings.warn(
            "no folder to keep compiled code in can be written, so each process compiles it anew, which takes some "
            "15 s; set NUMBA_CACHE_DIR to one that can",
            stacklevel=2,
        )
        yield None
        return
    before = config.CACHE_DIR  # type: ignore[attr-defined]
    config.CACHE_DIR = str(folder)  # type: ignore[attr-defined]
    try:
        yield folder
    finally:
        config.CACHE_DIR = before  # type: ignore[attr-defined]
