"""Zip files of models and arrays: what they inflate to is bounded before any of it is inflated."""

from __future__ import annotations

import io
import zipfile
from typing import Any

import numpy as np
from numpy.typing import NDArray

# Weights do not compress, and Stable-Baselines3 and torch store them as they are.
_MOST_TIMES = 4  # the size of a file that it may inflate to
_SPARE = 2**20  # [bytes] beyond that, for members that are text
_METHODS = (zipfile.ZIP_STORED, zipfile.ZIP_DEFLATED)  # others may take gigabytes to begin with


def unpacked(content: bytes, name: str) -> dict[str, bytes]:
    """The members of a zip file called ``name``, every byte of them checked.

    Raises:
        ValueError: it would inflate to many times its size.
        zipfile.BadZipFile: it is no zip file, or a member is damaged or longer than it says.
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
