"""Files that may be damaged, and folders that one process locks. :mod:`jackbox_env.recording.files` writes them.

A folder is locked by a lock on its file ``lock``: ``flock``, or on Windows ``LockFile`` of its first byte. The system
lets go of it when the process ends, however it ends. So a file left behind holds nobody up.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

if sys.platform == "win32":
    import msvcrt

    def _claim(descriptor: int) -> None:
        """Lock an open file until it is closed, or raise PermissionError."""
        msvcrt.locking(descriptor, msvcrt.LK_NBLCK, 1)
else:
    import fcntl

    def _claim(descriptor: int) -> None:
        """Lock an open file until it is closed, or raise BlockingIOError; OSError where there are no locks."""
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)


LOCK = "lock"


class DamagedFileError(ValueError):
    """A file that is cut short, overwritten, or never was what its name says."""


class FolderInUseError(RuntimeError):
    """Another process works in the folder."""


@contextmanager
def parsing(path: Path) -> Iterator[None]:
    """Take any failure in the block for damage of the file at ``path``.

    Raises:
        DamagedFileError: it failed.
    """
    try:
        yield
    except Exception as error:  # a damaged zip fails in dozens of ways
        raise DamagedFileError(f"{path} is damaged ({first_line(error)})") from error


def first_line(error: Exception) -> str:
    """The kind of an error, and the beginning of what it says, in one line."""
    said = next(iter(str(error).splitlines()), "")[:200]
    return f"{type(error).__name__}{': ' * bool(said)}{said}"


def read_bounded(path: Path, most: int) -> bytes:
    """The content of a file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it has more than ``most`` bytes.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path.parent} holds no {path.name}")
    if path.stat().st_size > most:
        raise ValueError(f"{path} must be at most {most:,} bytes, got {path.stat().st_size:,}")
    return path.read_bytes()


def read_json(path: Path) -> Any:
    """What a JSON file holds.

    Raises:
        DamagedFileError: it is cut short, or not JSON.
    """
    content = path.read_bytes()
    with parsing(path):
        return json.loads(content)


def say_skipped(error: DamagedFileError) -> None:
    """Say on standard error that a damaged file was skipped."""
    print(f"Skipped: {error}", file=sys.stderr)


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Lock a folder against every other process, and against a second use within this one.

    Raises:
        FolderInUseError: another process has locked it.
        OSError: its lock is a link, or cannot be opened.
    """
    descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT | getattr(os, "O_NOFOLLOW", 0), 0o666)
    try:
        try:
            _claim(descriptor)
        except (BlockingIOError, PermissionError) as error:
            raise FolderInUseError(f"{folder} is in use by another process: wait until it ends, or end it") from error
        except OSError:  # a disk of a cluster, perhaps, that has no locks
            said = f"{folder} cannot be locked on this system: take care that nothing else works in it"
            print(said, file=sys.stderr)
        yield
    finally:
        os.close(descriptor)
