"""Files and tables of a motion: npz, csv, mat, and a pandas.DataFrame. Columns have a name, and files their units."""

from __future__ import annotations

import csv
import importlib
import json
from contextlib import suppress
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env.model.states import STATE_NAMES, STATE_UNITS, Array
from jackbox_env.recording.motion import Motion
from jackbox_env.simulators.base import Impact
from jackbox_env.tools import checks as check
from jackbox_env.tools.files import new_file

if TYPE_CHECKING:
    import pandas

Columns = dict[tuple[str, str], NDArray[Any]]  # by name and unit, "" without


def save(motion: Motion, path: Path) -> list[Path]:
    """:meth:`Motion.save`."""
    suffix = check.choice("the suffix of path", path.suffix, (".npz", ".csv", ".mat"))
    if suffix == ".csv":
        return write_csv(motion, path, path.with_stem(f"{path.stem}_impacts"))
    write: Any = np.savez
    if suffix == ".mat":
        scipy: Any = _library("scipy.io", ".mat files", "SciPy", "train")
        write = scipy.savemat
    arrays = _arrays(motion)
    with new_file(path) as partial:
        write(partial, arrays) if suffix == ".mat" else write(partial, **arrays)
    return [path]


def frame(motion: Motion) -> pandas.DataFrame:
    """:meth:`Motion.to_frame`."""
    library: Any = _library("pandas", "to_frame", "pandas", "tables")
    return library.DataFrame({name: numbers for (name, _), numbers in _states(motion).items()})


def write_csv(motion: Motion, states: Path, impacts: Path) -> list[Path]:
    """Write a file of states (time, the 12 numbers, torque) and one of impacts, to new files; return them.

    Digits are in full. The first line names each column with its unit. A row's torque is the mean over the step that
    begins there; the last row's is empty.

    Raises:
        FileExistsError: a file is there already.
    """
    for path, columns in ((states, _states(motion)), (impacts, _impacts(motion))):
        names = [f"{name} [{unit}]" if unit else name for name, unit in columns]
        rows = zip(*(numbers.tolist() for numbers in columns.values()), strict=True)
        with new_file(path) as partial, partial.open("w", newline="") as file:
            csv.writer(file).writerows([names, *(["" if cell != cell else cell for cell in row] for row in rows)])
    return [states, impacts]


def _states(motion: Motion) -> Columns:
    torque = np.append(motion.mean_torques, np.nan)
    return {("time", "s"): motion.t, **_by_name("", motion.states), ("torque", "N m"): torque}


def _impacts(motion: Motion) -> Columns:
    units = {"time": "s", "impulse": "N s"}
    columns = {(name, units.get(name, "")): motion.impacts[name] for name in Impact._fields}
    for side in motion.impacts.dtype.names[len(columns) :]:
        columns |= _by_name(f"{side} ", motion.impacts[side])
    return columns


def _by_name(prefix: str, states: Array) -> Columns:
    """The columns of states, shape (n, 12)."""
    pairs = zip(STATE_NAMES, STATE_UNITS, states.T, strict=True)
    return {(f"{prefix}{name}", unit): numbers for name, unit, numbers in pairs}


def _arrays(motion: Motion) -> dict[str, NDArray[Any]]:
    """time (n,), state (n, 12), torque (n - 1,), impact_time (m,) and so on, and the JSON of the scene's fields.

    Without the scene if its drive is of functions, which have no JSON form.
    """
    named = {"time": motion.t, "state": motion.states, "torque": motion.mean_torques}
    named |= {f"impact_{name}": np.asarray(motion.impacts[name]) for name in motion.impacts.dtype.names}
    with suppress(ValueError):
        named["scene"] = np.array(json.dumps(motion.scene.as_dict()))
    return named


def _library(module: str, what: str, package: str, extra: str) -> Any:
    try:
        return importlib.import_module(module)
    except ImportError as error:
        raise ImportError(check.extra_needed(what, package, extra)) from error
