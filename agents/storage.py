"""Files that outlive kills: written beside their place and renamed into it, and folders that one process holds.

A process killed at any moment, or a machine without power, leaves the old file or the new one: the new one is on the
disk before it takes its name. What a killed process was writing stays behind as ``.<name>.<process>.partial``, which
nobody reads and :func:`remove_partials` removes.

A folder is held by ``flock`` on its file ``lock``. The kernel lets go of it when the process ends, however it ends, so
a lock left behind holds nobody up. Windows has no such lock: there a folder is not held, and standard error says so.
"""

from __future__ import annotations

import errno
import json
import os
import re
import shutil
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

if sys.platform != "win32":
    import fcntl

LOCK = "lock"
_PARTIAL = re.compile(r"\..+\.\d+\.partial(\..+)?")
_PATIENCE = 1.0  # for a process that has just taken a lock to write its number down [s]
_held: set[int] = set()  # descriptors of the locks that this process holds


class DamagedFileError(ValueError):
    """A file that is cut short, overwritten, or never was what its name says."""


class FolderInUseError(RuntimeError):
    """Another process works in the folder."""


# -- writing ----------------------------------------------------------------------------------------------------------


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
    """Make a folder together with what ``fill`` writes into it, in one stroke."""
    make_folder(path.parent)
    making = path.with_name(f".{path.name}.{os.getpid()}.partial")
    shutil.rmtree(making, ignore_errors=True)  # of a killed process that had the same number
    try:
        making.mkdir()
        fill(making)
        making.rename(path)
    except BaseException:
        shutil.rmtree(making, ignore_errors=True)
        raise
    _sync(path.parent)


def remove_partials(*folders: Path) -> None:
    """Remove what killed processes were writing; only for folders that nobody else writes to."""
    for folder in folders:
        for path in folder.glob(".*"):
            if _PARTIAL.fullmatch(path.name):
                shutil.rmtree(path) if path.is_dir() else path.unlink()


def _sync(path: Path) -> None:
    """Flush a file, or the list of names of a folder, to the disk; Windows does not open folders."""
    if path.is_dir() and os.name == "nt":
        return
    descriptor = os.open(path, os.O_RDONLY if path.is_dir() else os.O_RDWR)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def check_writable(folder: Path, room: int = 0) -> None:
    """Try whether files can be written to a folder, and look whether its disk has ``room`` bytes free.

    Raises:
        FileNotFoundError: it is no folder.
        OSError: nothing can be written to it, or its disk is too full.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} is no folder to write to")
    try:
        with tempfile.TemporaryFile(dir=folder):
            pass
    except OSError as error:
        raise OSError(f"{folder} cannot be written to: {error.strerror}") from error
    free = shutil.disk_usage(folder).free
    if free < room:
        raise OSError(
            f"{folder} must have {room / 1e6:,.0f} MB free for what will be written, got {free / 1e6:,.0f} MB"
        )


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
        reason = next(iter(str(error).splitlines()), "")[:100]
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
        FolderInUseError: another process holds it.
    """
    descriptor = _locked(folder)
    if descriptor is None:
        print(f"{folder} cannot be locked on this system: take care that nothing else works in it", file=sys.stderr)
        yield
        return
    _held.add(descriptor)
    try:
        os.ftruncate(descriptor, 0)
        os.pwrite(descriptor, f"{os.getpid()}\n".encode(), 0)
        yield
    finally:
        if descriptor in _held:  # not in a forked child
            os.ftruncate(descriptor, 0)
            _held.remove(descriptor)
            os.close(descriptor)


def _locked(folder: Path) -> int | None:
    """A descriptor of the folder's lock, taken; None where the system, or the disk's, has no such lock."""
    if sys.platform == "win32":
        return None
    deadline = time.monotonic() + _PATIENCE
    descriptor = os.open(folder / LOCK, os.O_RDWR | os.O_CREAT, 0o666)
    try:
        while True:
            try:
                fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                holder = _process(os.pread(descriptor, 32, 0))
                if holder is None and time.monotonic() < deadline:
                    time.sleep(0.01)  # it has not written its number yet
                    continue
                name = f"process {holder}" if holder else "another process"
                raise FolderInUseError(f"{folder} is in use by {name}: wait until it ends, or end it") from error
            except OSError as error:
                if error.errno not in (errno.ENOLCK, errno.ENOTSUP, errno.ENOSYS):
                    raise
                os.close(descriptor)
                return None
            return descriptor
    except BaseException:
        os.close(descriptor)
        raise


def _process(written: bytes) -> int | None:
    """The number of a process that lives."""
    try:
        number = int(written)
        os.kill(number, 0)
    except PermissionError:  # another user's
        return number
    except (ValueError, OverflowError, OSError):  # not written yet; or that of a holder before, which was killed
        return None
    return number if number > 0 else None


def _let_go() -> None:
    """In a forked child: close the parent's locks, or a child that outlives it would hold them."""
    while _held:
        os.close(_held.pop())


if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_let_go)
