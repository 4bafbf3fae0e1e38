"""Files that may be damaged, and folders that one process holds. :mod:`jackbox_env.recording.files` writes them.

A folder is held by ``flock`` on its file ``lock``. The kernel lets go of it when the process ends, however it ends, so
a lock left behind holds nobody up. Windows has no such lock: there a folder is not held, and standard error says so.
"""

from __future__ import annotations

import errno
import json
import os
import stat
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

if sys.platform != "win32":
    import fcntl

LOCK = "lock"
_PATIENCE = 1.0  # for a process that has just taken a lock to write its number down [s]
_IN_PLACE = sum(getattr(os, name, 0) for name in ("O_RDWR", "O_CREAT", "O_NOFOLLOW", "O_NONBLOCK", "O_BINARY"))
_held: set[int] = set()  # descriptors of the locks that this process holds


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


# -- files that are written in place ----------------------------------------------------------------------------------


def own_file(path: Path) -> int:
    """A descriptor to read and write a file in place, which is made where it is missing.

    Raises:
        OSError: it is a link, or no plain file: what is written there would be written elsewhere.
    """
    if not path.is_symlink():
        descriptor = os.open(path, _IN_PLACE, 0o666)
        found = os.fstat(descriptor)
        if stat.S_ISREG(found.st_mode) and found.st_nlink <= 1:
            return descriptor
        os.close(descriptor)
    raise OSError(f"{path} must be a plain file of its own, no link: remove it, or put a copy in its place")


# -- holding ----------------------------------------------------------------------------------------------------------


@contextmanager
def held(folder: Path) -> Iterator[None]:
    """Hold a folder against every other process, and against a second use within this one.

    Raises:
        FolderInUseError: another process holds it.
        OSError: its lock is a link, or cannot be opened.
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
    descriptor = own_file(folder / LOCK)
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
