"""Files that may be damaged, and folders that one process holds. :mod:`jackbox_env.recording.files` writes them.

A folder is held by ``flock`` on its file ``lock``. The kernel lets go of it when the process ends, however it ends, so
a lock left behind holds nobody up. Windows has no such lock: there a folder is not held, and standard error says so.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

LOCK = "lock"


class DamagedFileError(ValueError):
    """A file that is cut short, overwritten, or never was what its name says."""


class FolderInUseError(RuntimeError):
    """Another process works in the folder."""


# -- reading ----------------------------------------------------------------------------------------------------------


@contextmanager
def parsing(path: Path) -> Iterator[None]:
    """Take any failure in the block for damage of the file at ``path``.

    Raises:
        DamagedFileError: it failed.
    """
    try:
        yield
    except Exception as error:  # a damaged zip fails in dozens of ways
        reason = next(iter(str(error).splitlines()), "")[:200]
        raise DamagedFileError(f"{path} is damaged ({type(error).__name__}{': ' * bool(reason)}{reason})") from error


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


# -- holding ----------------------------------------------------------------------------------------------------------


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a folder against every other process, and against a second use within this one.

    Raises:
        FolderInUseError: it is held already.
        OSError: its lock is a link, or cannot be opened.
    """
    with open_own(folder / LOCK) as file:
        try:
            _lock(file)
        except BlockingIOError as error:
            raise FolderInUseError(f"{folder} is in use by another process: wait until it ends, or end it") from error
        except OSError:
            print(f"{folder} cannot be locked on this system: take care that nothing else works in it", file=sys.stderr)
        yield


def open_own(path: Path) -> BinaryIO:
    """Open a file to read and to append to, which is made where it is missing.

    Raises:
        OSError: it is a link, so that what is written would be written elsewhere.
    """
    if path.is_symlink():
        raise OSError(f"{path} must be a plain file of its own, no link: remove it, or put a copy in its place")
    return path.open("ab+")


def _lock(file: BinaryIO) -> None:
    """Lock a file until it is closed, or its process ends however it ends; OSError where there are no locks."""
    try:
        import fcntl
    except ModuleNotFoundError as error:
        raise OSError("there are no locks on this system") from error
    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
