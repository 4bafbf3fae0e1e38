"""Files that may be damaged, and folders that one process locks. :mod:`jackbox_env.files` writes them.

A folder is locked by a system lock on its file ``lock`` (filelock), which ends with its process, however that ends.
"""

from __future__ import annotations

import io
import json
import sys
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LOCK = "lock"

# Weights do not compress, and Stable-Baselines3 and torch store them as they are.
_MOST_TIMES = 4  # the size of a file that it may inflate to
_SPARE = 2**20  # [bytes] beyond that, for members that are text
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others may take gigabytes to begin with


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


def unpacked(content: bytes, name: str) -> dict[str, bytes]:
    """The members of a zip file called ``name``, every byte of them checked.

    Raises:
        ValueError: it would inflate to many times its size.
        zipfile.BadZipFile: it is no zip file, or a member is damaged or longer than declared.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        members, most = archive.infolist(), _MOST_TIMES * len(content) + _SPARE
        if any(member.compress_type not in _METHODS for member in members):
            raise ValueError(f"{name} must be stored or deflated")
        inflated = sum(member.file_size for member in members)
        if inflated > most:
            raise ValueError(f"{name} must inflate to at most {most:,} bytes, got {inflated:,}")
        # no more than a declared size: a full read would first inflate all that there is beyond it
        return {member.filename: archive.open(member).read(member.file_size) for member in members}


def unpacked_arrays(content: bytes, name: str) -> dict[str, NDArray[Any]]:
    """The arrays in an npz file called ``name``; nothing is unpickled.

    Raises:
        ValueError: it would inflate to many times its size. Damage raises whatever numpy raises.
    """
    return {
        member.removesuffix(".npy"): np.lib.format.read_array(io.BytesIO(array))
        for member, array in unpacked(content, name).items()
    }


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
    from filelock import FileLock, Timeout  # of the extra train, which shipped networks do not need

    lock = FileLock(folder / LOCK, timeout=0)
    try:
        lock.acquire()
    except Timeout as error:
        raise FolderInUseError(f"{folder} is in use by another process: wait until it ends, or end it") from error
    try:
        yield
    finally:
        lock.release()
