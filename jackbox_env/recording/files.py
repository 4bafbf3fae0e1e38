"""Files and tables of a motion: npz, csv, mat, and a pandas.DataFrame. Columns have a name, and files their units."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env.model.states import STATE_NAMES, STATE_UNITS, Array
from jackbox_env.tools import checks as check
from jackbox_env.tools.files import new_file

_ROWS = 10_000  # that are written together
Columns = dict[tuple[str, str], NDArray[Any]]  # by name and unit, "" without


def save(path: Path, arrays: dict[str, Any], tables: tuple[Columns, Columns]) -> list[Path]:
    """Write the arrays of a motion to a new .npz or .mat file, or its tables of states and impacts to two .csv files.

    Raises:
        TypeError, ValueError, OSError, ImportError: as of ``Motion.save``.
    """
    suffix = check.choice("the suffix of path", path.suffix, (".npz", ".csv", ".mat"))
    if suffix == ".csv":
        return write_csv(tables, path, path.with_stem(f"{path.stem}_impacts"))
    with new_file(path) as partial, partial.open("wb") as file, check.extra(".mat files", "SciPy", "train"):
        if suffix == ".npz":
            np.savez(file, **arrays)
        else:
            import scipy.io

            scipy.io.savemat(file, arrays)
    return [path]


def frame(columns: Columns) -> Any:
    """A pandas.DataFrame of columns, without units."""
    with check.extra("to_frame", "pandas", "all"):
        import pandas  # type: ignore[import-untyped]
    return pandas.DataFrame({name: numbers for (name, _), numbers in columns.items()})


def write_csv(tables: tuple[Columns, Columns], *paths: Path) -> list[Path]:
    """Write the tables of states (time, the 12 numbers, torque) and impacts to new CSV files; return their paths.

    Digits are in full, names and units in the first line, NaN is an empty cell. A row's torque is the mean over the
    step that begins there; the last row's is empty.

    Raises:
        FileExistsError: a file is there already.
    """
    for columns, path in zip(tables, paths, strict=True):
        with new_file(path) as partial, partial.open("w", newline="") as file:
            writer = csv.writer(file)
            writer.writerow([f"{name} [{unit}]" if unit else name for name, unit in columns])
            for first in range(0, len(next(iter(columns.values()))), _ROWS):
                rows = zip(*(numbers[first : first + _ROWS].tolist() for numbers in columns.values()), strict=True)
                writer.writerows(["" if cell != cell else cell for cell in row] for row in rows)
    return [*paths]


def by_name(prefix: str, states: Array) -> Columns:
    """The columns of states, shape (n, 12)."""
    pairs = zip(STATE_NAMES, STATE_UNITS, states.T, strict=True)
    return {(f"{prefix}{name}", unit): numbers for name, unit, numbers in pairs}
