"""Files that survive kills: each is written under another name in the same folder, then renamed.

A process killed at any moment, or a power cut, leaves the old file or the new one: the new one is on the disk before
it is renamed. A killed process leaves ``.<name>.<process>.partial`` behind. Nobody reads such files, and
:func:`remove_partials` removes them.
"""

from __future__ import annotations

import datetime
import json
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Yield a path to write to; at the end of the block that file replaces ``path`` in one stroke."""
    partial = _partial(path, path.suffix)  # writers depend on the suffix
    try:
        yield partial
        with partial.open("rb+") as file:
            os.fsync(file.fileno())
        partial.replace(path)
    except OSError as error:
        if error.errno is not None and error.filename in (None, str(partial)):  # the error of a full disk has no name
            error.filename = str(path)
        raise
    finally:
        partial.unlink(missing_ok=True)


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """Yield a path to write to, as :func:`replacing` does; an existing file is never overwritten.

    Raises:
        FileExistsError: there is something at ``path``.
    """
    _refuse_existing(path)
    with replacing(path) as partial:
        yield partial
        _refuse_existing(path)  # what has appeared meanwhile


def write_bytes(path: Path, content: bytes) -> None:
    """Write a file in one stroke."""
    with replacing(path) as partial:
        partial.write_bytes(content)


def write_text(path: Path, content: str) -> None:
    """Write text in one stroke."""
    write_bytes(path, content.encode())


def write_json(path: Path, content: Any) -> None:
    """Write JSON in one stroke."""
    write_text(path, json.dumps(content, indent=2) + "\n")


def new_folder(path: Path | None, kind: str, fill: Callable[[Path], object] = lambda folder: None) -> Path:
    """Make a run folder together with what ``fill`` writes into it, in one stroke.

    Args:
        path: to make; None: ``runs/<kind>-<date>-<time>``.
        kind: of run.
        fill: called with the folder to write into; by default writes nothing.

    Raises:
        OSError: as :func:`check_new`.
    """
    path = path or stamped(kind)
    check_new(path)
    partial = _partial(path)
    shutil.rmtree(partial, ignore_errors=True)  # of a killed process that had the same number
    try:
        partial.mkdir(parents=True, exist_ok=True)
        fill(partial)
        _refuse_existing(path)  # another process may have made it
        partial.rename(path)
    finally:
        shutil.rmtree(partial, ignore_errors=True)
    return path


def stamped(kind: str) -> Path:
    """The folder ``runs/<kind>-<date>-<time>`` of this second."""
    return Path("runs") / f"{kind}-{datetime.datetime.now():%Y%m%d-%H%M%S}"


def remove_partials(*folders: Path) -> None:
    """Remove what killed processes were writing; only for folders that nobody else writes to."""
    for path in [path for folder in folders for path in folder.glob(".*.partial*")]:
        shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def check_writable(folder: Path) -> None:
    """Check that files can be written to a folder.

    Raises:
        OSError: it is no folder, or nothing can be written to it.
    """
    try:
        tempfile.TemporaryFile(dir=folder).close()
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(folder)) from error


def check_new(path: Path) -> None:
    """Check that ``path`` can be made, with the missing folders above it.

    Raises:
        FileExistsError: there is something at ``path``.
        OSError: nothing can be made there.
    """
    _refuse_existing(path)
    check_writable(next(folder for folder in path.absolute().parents if os.path.lexists(folder)))


def check_new_file(path: Path) -> None:
    """Check that a file ``path`` can be written, before anything is computed for it.

    Raises:
        FileExistsError: there is something at ``path``.
        OSError: its folder is missing, or nothing can be written to it.
    """
    check_writable(path.parent)
    _refuse_existing(path)


def _refuse_existing(path: Path) -> None:
    """Raise FileExistsError if there is something at ``path``."""
    if os.path.lexists(path):
        raise FileExistsError(f"{path} exists, and is never overwritten: choose another place")


def _partial(path: Path, suffix: str = "") -> Path:
    """The path where this process writes before it renames to ``path``."""
    return path.with_name(f".{path.name}.{os.getpid()}.partial{suffix}")
