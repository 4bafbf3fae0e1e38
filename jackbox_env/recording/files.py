"""Files that outlive kills: written beside their place and renamed into it.

A process killed at any moment, or a machine without power, leaves the old file or the new one: the new one is on the
disk before it takes its name. What a killed process was writing stays behind as ``.<name>.<process>.partial``, which
nobody reads and :func:`remove_partials` removes.
"""

from __future__ import annotations

import datetime
import json
import os
import re
import shutil
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

_PARTIAL = re.compile(r"\..+\.\d+\.partial(\..+)?")


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Give a path to write to; at the end of the block that file takes the place of ``path`` in one stroke."""
    partial = path.with_name(f".{path.name}.{os.getpid()}.partial{path.suffix}")  # writers look at the suffix
    try:
        yield partial
        _sync(partial)
        os.replace(partial, path)
    except BaseException as error:
        if isinstance(error, OSError) and error.filename is None:  # a full disk does not say which file it was
            error.filename = str(path)
        partial.unlink(missing_ok=True)
        raise
    _sync(path.parent)


@contextmanager
def new_file(path: Path) -> Iterator[Path]:
    """As :func:`replacing`, for a file that is never overwritten.

    Raises:
        FileExistsError: there is something at ``path``.
    """
    if path.exists():
        raise FileExistsError(f"{path} exists, and is never overwritten: choose another place")
    with replacing(path) as partial:
        yield partial


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


def make_folder(path: Path) -> None:
    """Make a folder, and those above it, where they are missing."""
    if not path.is_dir():
        make_folder(path.parent)
        path.mkdir(exist_ok=True)
        _sync(path.parent)


def make_filled_folder(path: Path, fill: Callable[[Path], None]) -> None:
    """Make a folder together with what ``fill`` writes into it, in one stroke.

    Raises:
        FileExistsError: somebody else has made it meanwhile.
    """
    make_folder(path.parent)
    making = path.with_name(f".{path.name}.{os.getpid()}.partial")
    shutil.rmtree(making, ignore_errors=True)  # of a killed process that had the same number
    try:
        making.mkdir()
        fill(making)
        if path.exists():
            raise FileExistsError(f"{path} has been made by somebody else meanwhile: choose another folder")
        making.rename(path)
    except BaseException:
        shutil.rmtree(making, ignore_errors=True)
        raise
    _sync(path.parent)


def _nothing(folder: Path) -> None:
    """Leave a folder empty."""


def new_folder(path: Path | None, kind: str, fill: Callable[[Path], None] = _nothing) -> Path:
    """Make a run folder together with what ``fill`` writes into it; None: ``runs/<kind>-<date>-<time>``.

    Raises:
        OSError: as :func:`check_new`.
    """
    path = path or stamped(kind)
    check_new(path)
    make_filled_folder(path, fill)
    return path


def stamped(kind: str) -> Path:
    """The folder ``runs/<kind>-<date>-<time>`` of this second."""
    return Path("runs") / f"{kind}-{datetime.datetime.now():%Y%m%d-%H%M%S}"


def remove_partials(*folders: Path) -> None:
    """Remove what killed processes were writing; only for folders that nobody else writes to."""
    for folder in folders:
        for path in folder.glob(".*"):
            if _PARTIAL.fullmatch(path.name):
                shutil.rmtree(path) if path.is_dir() and not path.is_symlink() else path.unlink()


def _sync(path: Path) -> None:
    """Flush a file, or the list of names of a folder, to the disk; Windows does not open folders."""
    if path.is_dir() and os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_writable(folder: Path) -> None:
    """Try whether files can be written to a folder.

    Raises:
        FileNotFoundError: it is no folder.
        OSError: nothing can be written to it.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is no folder to write to")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(f"{folder} cannot be written to: {error.strerror}") from error


def check_new(path: Path, what: str = "runs", place: str = "folder") -> None:
    """Try whether something new can be made at ``path``, together with the folders above it that are missing.

    Args:
        path: of the new file or folder.
        what: is never overwritten, in the plural.
        place: "file" or "folder": of what another one is to be chosen.

    Raises:
        FileExistsError: there is something at ``path``.
        OSError: nothing can be made there.
    """
    try:
        path.lstat()
    except (FileNotFoundError, NotADirectoryError):
        pass
    except OSError as error:
        raise OSError(f"{path} cannot be made: {error.strerror}") from error
    else:
        raise FileExistsError(f"{path} exists, and {what} are never overwritten: choose another {place}")
    above = next(folder for folder in path.absolute().parents if os.path.lexists(folder))
    if not above.is_dir():
        raise NotADirectoryError(f"{path} cannot be made: {above} is no folder")
    check_writable(above)
