"""Reading files that may be damaged, importing objects by name, and locking folders; for runs, policies and sweeps.

A folder is locked by a system lock on its file ``lock`` (filelock), which ends with its process, however that ends.
:mod:`jackbox_env.tools.files` writes files.
"""

from __future__ import annotations

import hashlib
import importlib.util
import io
import json
import sys
import tempfile
import zipfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

LOCK = "lock"

# Weights do not compress, and Stable-Baselines3 and torch store them as they are.
_MOST_INFLATION = 4  # times the size of the file
_TEXT_ALLOWANCE = 2**20  # [bytes] beyond that, for members that are text
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others may need gigabytes to begin with


class DamagedFileError(ValueError):
    """A file that is cut short, overwritten, or of another format."""


class FolderInUseError(RuntimeError):
    """Another process uses the folder."""


@contextmanager
def parsing(path: Path) -> Iterator[None]:
    """A block that parses the file at ``path``.

    Raises:
        DamagedFileError: the block raised an exception.
    """
    try:
        yield
    except Exception as error:  # a damaged zip fails in dozens of ways
        raise DamagedFileError(f"{path} is damaged ({first_line(error)})") from error


def first_line(error: Exception) -> str:
    """The class of an error and the beginning of its message, in one line."""
    message = next(iter(str(error).splitlines()), "")[:200]
    return f"{type(error).__name__}{': ' * bool(message)}{message}"


@contextmanager
def as_value_error(problem: str) -> Iterator[None]:
    """Turn any exception in the block into a ValueError that names the problem."""
    try:
        yield
    except Exception as error:
        raise ValueError(f"{problem}: {first_line(error)}") from error


trusted = set[str]()  # names of objects
_received = dict[str, Path]()  # files of other machines by their paths there


def is_object(value: Any) -> bool:
    """Whether a setting names an object of one's own, ``file.py:name`` or ``module:name``."""
    return isinstance(value, str) and ":" in value


def trust_names(names: Iterable[str]) -> None:
    """Allow :func:`imported` to run the code of these objects, in this process."""
    trusted.update(names)


def texts_of(names: Iterable[str]) -> dict[str, str]:
    """The texts of the files among objects' names, by path, for :func:`receive` in another process."""
    sources = {source for source, _, _ in (name.rpartition(":") for name in names) if source.endswith(".py")}
    return {source: Path(source).read_text(encoding="utf-8") for source in sorted(sources)}


def receive(texts: dict[str, str]) -> None:
    """Let :func:`imported` use these texts of files, which this machine may lack or have in another version."""
    for source, text in texts.items():
        here = Path(source)
        if not here.is_file() or here.read_text(encoding="utf-8") != text:
            here = Path(_scratch().name) / hashlib.sha256(text.encode()).hexdigest()[:16] / here.name
            here.parent.mkdir(exist_ok=True)
            here.write_text(text, encoding="utf-8")
        _received[source] = here


@cache
def _scratch() -> tempfile.TemporaryDirectory[str]:
    """A folder that lasts as long as this process."""
    return tempfile.TemporaryDirectory()


def imported(name: str) -> Any:
    """The object that ``file.py:name`` or ``module:name`` names, from a file or a module whose code runs once.

    Raises:
        ValueError: there is none, or it is not trusted.
    """
    if name not in trusted:
        raise ValueError(f"{name} is code, which runs only with --trust")
    source, _, attribute = name.rpartition(":")
    with as_value_error(f"{name} cannot be imported"):
        if source.endswith(".py"):
            return getattr(_module_in(_received.get(source, Path(source)).resolve()), attribute)
        return getattr(_module(source), attribute)


@cache
def _module_in(file: Path) -> Any:
    spec: Any = importlib.util.spec_from_file_location(file.stem, file)
    module = importlib.util.module_from_spec(spec)
    with _importing_from(file.parent):
        spec.loader.exec_module(module)
    return module


def _module(name: str) -> Any:
    with _importing_from(Path.cwd()):
        return importlib.import_module(name)


@contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))


def read_bounded(path: Path, max_bytes: int) -> bytes:
    """The content of a file.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: it has more than ``max_bytes`` bytes.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path.parent} has no {path.name}")
    if path.stat().st_size > max_bytes:
        raise ValueError(f"{path} must be at most {max_bytes:,} bytes, got {path.stat().st_size:,}")
    return path.read_bytes()


def read_json(path: Path) -> Any:
    """The parsed content of a JSON file.

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
        members, max_bytes = archive.infolist(), _MOST_INFLATION * len(content) + _TEXT_ALLOWANCE
        if any(member.compress_type not in _METHODS for member in members):
            raise ValueError(f"{name} must be stored or deflated")
        inflated = sum(member.file_size for member in members)
        if inflated > max_bytes:
            raise ValueError(f"{name} must inflate to at most {max_bytes:,} bytes, got {inflated:,}")
        # a read without a size would also inflate what lies beyond the declared size
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


def report_skipped(error: DamagedFileError) -> None:
    """Print on standard error that a damaged file was skipped."""
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
