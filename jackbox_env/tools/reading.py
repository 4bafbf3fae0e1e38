"""Reading files that may be damaged, or by somebody who is not trusted. :mod:`.files` writes files."""

from __future__ import annotations

import io
import json
import sys
import zipfile
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Weights do not compress, and Stable-Baselines3 and torch store them as they are.
_MOST_INFLATION = 4  # times the size of the file
_TEXT_ALLOWANCE = 2**20  # [bytes] beyond that, for members that are text
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others may need gigabytes to begin with


class DamagedFileError(ValueError):
    """A file that is cut short, overwritten, or of another format."""


def first_line(error: Exception) -> str:
    """The class of an error and the beginning of its message, in one line."""
    message = next(iter(str(error).splitlines()), "")[:200]
    return f"{type(error).__name__}{': ' * bool(message)}{message}"


@contextmanager
def as_value_error(problem: str, kind: type[ValueError] = ValueError) -> Iterator[None]:
    """Turn any exception in the block into a ValueError that names the problem."""
    try:
        yield
    except Exception as error:  # a damaged zip fails in dozens of ways
        raise kind(f"{problem}: {first_line(error)}") from error


def parsing(path: Path) -> AbstractContextManager[None]:
    """A block that parses the file at ``path``, in which any exception becomes a :class:`DamagedFileError`."""
    return as_value_error(f"{path} is damaged", DamagedFileError)


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
