"""Model files are zip files of zip files: what they inflate to is bounded before any of it is inflated.

So it is with the zip files that numpy makes of arrays.
"""

from __future__ import annotations

import io
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Weights do not compress, and Stable-Baselines3 and torch store them as they are.
_MOST_TIMES = 4  # the size of a file that it may inflate to
_SPARE = 2**20  # [bytes] beyond that, for members that are text
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others may take gigabytes to begin with
_TENSORS = ".pth"  # what a member with tensors ends with: a zip file of torch


def unpacked_tensors(path: Path) -> io.BytesIO:
    """The members of a model file that hold tensors, as a model file in memory in which they are only stored.

    Raises:
        ValueError: the file, or a member with tensors, would inflate to many times its size.
        zipfile.BadZipFile: it is no zip file, or a member is damaged, longer than it says, or no zip file where it
            holds tensors.
    """
    stored = io.BytesIO()
    with zipfile.ZipFile(path) as archive, zipfile.ZipFile(stored, "w") as copy:
        _refuse_inflation(archive, path.stat().st_size, str(path))
        for member in archive.infolist():
            if member.filename.endswith(_TENSORS):
                content = read_member(archive, member)
                with zipfile.ZipFile(io.BytesIO(content)) as tensors:
                    _refuse_inflation(tensors, len(content), f"{member.filename} in {path}")
                copy.writestr(member.filename, content)
    stored.seek(0)
    return stored


def unpacked_arrays(content: bytes, name: str) -> dict[str, NDArray[Any]]:
    """The arrays in an npz file called ``name``; nothing is unpickled.

    Raises:
        ValueError: it would inflate to many times its size. Damage raises whatever numpy raises.
    """
    with zipfile.ZipFile(io.BytesIO(content)) as archive:
        _refuse_inflation(archive, len(content), name)
        return {
            member.filename.removesuffix(".npy"): np.lib.format.read_array(io.BytesIO(read_member(archive, member)))
            for member in archive.infolist()
        }


def _refuse_inflation(archive: zipfile.ZipFile, size: int, name: str) -> None:
    """Refuse an archive whose members declare too much in sum."""
    if any(member.compress_type not in _METHODS for member in archive.infolist()):
        raise ValueError(f"{name} must be stored or deflated")
    inflated, most = sum(member.file_size for member in archive.infolist()), _MOST_TIMES * size + _SPARE
    if inflated > most:
        raise ValueError(f"{name} must inflate to at most {most:,} bytes, got {inflated:,}")


def read_member(archive: zipfile.ZipFile, member: zipfile.ZipInfo) -> bytes:
    """Read no more than a member's declared size: a full read would first inflate all that it holds beyond that."""
    with archive.open(member) as file:
        return file.read(member.file_size)
