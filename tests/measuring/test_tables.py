"""Files of columns and arrays: damage is refused in a sentence with the file, and unread columns are not checked."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from jackbox_env import Recording, Scene
from jackbox_env.fits.tables import read_table

TIMES = 0.02 * np.arange(5)
ARRAYS = {"time": TIMES, "state": np.ones((5, 12)), "torque": np.arange(4.0), "impact_time": TIMES[:2]}


def packed(save: Callable[..., None] = np.savez_compressed) -> bytes:
    """An npz file of the arrays."""
    file = io.BytesIO()
    save(file, **ARRAYS)
    return file.getvalue()


def claiming(shape: str) -> bytes:
    """An npz file whose first array has a header of this shape, and no numbers."""
    file, header = io.BytesIO(), f"{{'descr': '<f8', 'fortran_order': False, 'shape': {shape}, }}"
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("time.npy", b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode())
    return file.getvalue()


_BEGIN = 30 + len("time.npy") + 20  # of the first array, after its header in the zip
DAMAGED = {
    "no deflated block": packed()[:_BEGIN] + b"\xff" + packed()[_BEGIN + 1 :],  # zlib.error
    "cut": packed()[:-30],
    "terabytes": claiming("(1000000000000, 12)"),
    "more than addresses": claiming(f"({10**30},)"),
    "deep": claiming("(" * 5000 + ")" * 5000),
    "no zip": b"PK\x03\x04" + bytes(200),
    "one array": packed(lambda file, **arrays: np.save(file, arrays["time"])),
    "text": b"time,torque\n0,1\n",
    "nothing": b"",
}


def refusal(path: Path) -> str:
    """The sentence that refuses a file; empty if it is read."""
    try:
        Recording.from_frame(read_table(path, "state"), Scene())
    except (TypeError, ValueError) as error:
        return str(error)
    return ""


@pytest.mark.parametrize("save", [np.savez, np.savez_compressed])
def test_no_flipped_bit_and_no_cut_of_an_npz_file_is_another_error(
    save: Callable[..., None], tmp_path: Path, cases: Callable[[int], int]
) -> None:
    path, whole, rng = tmp_path / "bad.npz", packed(save), np.random.default_rng(0)
    for number in range(cases(200)):
        at, damaged = int(rng.integers(len(whole))), bytearray(whole)
        damaged[at] ^= 1 << int(rng.integers(8))
        path.write_bytes(damaged[:at] if number % 4 == 0 else damaged)
        sentence = refusal(path)
        assert sentence.startswith(str(path)) or not sentence
        assert "\n" not in sentence
