"""Tables of numbers: CSV and npz files, dicts and DataFrames, with headers as other programs write them.

The one reader of ``Recording.from_frame``, ``jackbox fit`` and ``jackbox simulate --torque``. A table's values become
numbers in :func:`in_si_units`, so a column that nobody reads may hold anything.
"""

from __future__ import annotations

import csv
import math
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.model.states import STATE_NAMES, STATE_UNITS, Array
from jackbox_env.tools import checks as check

UNITS = {"time": "s", **dict(zip(STATE_NAMES, STATE_UNITS, strict=True)), "torque": "N m"}  # columns and their units
_TURN = 2.0 * math.pi  # [rad]
_OTHER_UNITS = {  # in SI units, by the SI unit
    "s": {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0},
    "m": {"cm": 1e-2, "mm": 1e-3},
    "m/s": {"cm/s": 1e-2, "mm/s": 1e-3},
    "rad": {"deg": _TURN / 360.0, "°": _TURN / 360.0, "mrad": 1e-3, "turns": _TURN, "rev": _TURN},
    "rad/s": {"deg/s": _TURN / 360.0, "°/s": _TURN / 360.0, "rpm": _TURN / 60.0, "rev/s": _TURN},
    "N m": {"Nm": 1.0, "N mm": 1e-3, "Nmm": 1e-3, "kN m": 1e3, "kNm": 1e3},
}


class Table(NamedTuple):
    """Columns with their headers, and where they come from, for messages."""

    columns: Sequence[tuple[str, Any]]  # headers, and values as they were read
    source: str = ""  # a file and ", "
    lines: Sequence[int] | None = None  # of the text file, of each row

    def at(self, row: int) -> str:
        """A row, in words."""
        return f"{self.source}row {row if self.lines is None else self.lines[row]}"

    def header(self) -> str:
        """Begins a sentence about a header."""
        return f"{self.source}row 1: column" if self.source else "column"


# -- files and frames --------------------------------------------------------------------------------------------------


def table_of(columns: Any, source: str = "") -> Table:
    """The table of a dict, a DataFrame, an array with named fields, or the arrays of ``jackbox simulate --format npz``.

    Raises:
        TypeError, ValueError: something else; states of another shape.
    """
    if isinstance(columns, Mapping) and ("state" in columns or "torque" in columns):
        columns = _columns_of(columns, source)
    listed = getattr(columns, "columns", None)
    listed = getattr(getattr(columns, "dtype", None), "names", None) if listed is None else listed
    if listed is None and not isinstance(columns, Mapping):
        raise TypeError(f"columns must be a dict of columns or a DataFrame, got {check.shown(columns)}")
    return Table([(str(name), columns[name]) for name in (columns if listed is None else listed)], source)


def _columns_of(arrays: Mapping[str, Any], source: str) -> dict[str, Any]:
    """Columns of arrays: of time (n,) and state (n, 12); a torque (n - 1,) gets an empty last row."""
    columns = dict(arrays)
    if "state" in arrays:
        if np.ndim(arrays["state"]) != 2 or np.shape(arrays["state"])[1] != 12:
            raise ValueError(f"{source}state must have shape (n, 12), got {np.shape(arrays['state'])}")
        columns = {name: arrays[name] for name in ("time", "torque") if name in arrays}
        columns |= zip(STATE_NAMES, np.transpose(arrays["state"]), strict=True)
    if {"time", "torque"} <= {*columns} and np.size(columns["torque"]) == np.size(columns["time"]) - 1:
        columns["torque"] = np.append(columns["torque"], np.nan)
    return columns


def read_table(path: Path, array: str) -> Table:
    """The columns of a CSV file; or of an npz file that has this array: state, torque or impact_time.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is damaged, or something else; the message names the file, and the row if it is text.
    """
    if path.suffix == ".npz":
        arrays = read_arrays(path)
        if array not in arrays:
            raise ValueError(f"{path}: there must be an array {array}, got {', '.join(arrays)}")
        return table_of({"time": arrays[array]} if array == "impact_time" else arrays, f"{path}, ")
    headers, lines, rows = read_rows(path)
    for line, row in zip(lines, rows, strict=True):
        if len(row) != len(headers):
            needed = f"{len(headers)} cells like row 1, with commas between and points in numbers"
            raise ValueError(f"{path}, row {line}: must have {needed}, got {len(row)}")
    columns = zip(*rows, strict=True) if rows else [()] * len(headers)
    return Table(list(zip(headers, columns, strict=True)), f"{path}, ", lines)


def read_arrays(path: Path) -> dict[str, Any]:
    """The arrays of an npz file.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is damaged, or something else.
    """
    with path.open("rb") as file:
        try:
            with np.load(file, allow_pickle=False) as arrays:
                return {**arrays}
        except Exception as error:  # a damaged zip fails in dozens of ways, MemoryError and zlib.error among them
            reason = " ".join(str(error).split()) or type(error).__name__
            raise ValueError(f"{path}: must be an npz file of jackbox simulate, got {reason}") from error


def read_rows(path: Path) -> tuple[list[str], list[int], list[list[str]]]:
    """Headers of a CSV file, the lines of its further rows, and their cells; empty lines are left out.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no CSV, or has a cell of more than 131,072 characters.
    """
    with path.open(newline="", encoding="utf-8-sig", errors="replace") as file:
        reader = csv.reader(file)
        try:
            headers = next(reader, [])
            rows = [(reader.line_num, row) for row in reader if row]
        except csv.Error as error:
            raise ValueError(f"{path}, row {reader.line_num}: {error}") from error
    return headers, [line for line, _ in rows], [row for _, row in rows]


def stored_scene(arrays: Any, source: str = "") -> dict[str, Any] | None:
    """The fields of the scene among the arrays of ``jackbox simulate --format npz``; None if there is none."""
    if not isinstance(arrays, Mapping) or "scene" not in arrays:
        return None
    return check.from_json(f"{source}scene", str(np.asarray(arrays["scene"])), dict)


# -- numbers, names and units ------------------------------------------------------------------------------------------


def in_si_units(
    table: Table, units: Mapping[str, str], names: Mapping[str, str] | None = None,
    needed: Collection[str] = ("time",), strict: bool = True,
) -> tuple[dict[str, Array], tuple[str, ...]]:  # fmt: skip
    """Columns by their names here, in SI units, and the headers that are left out.

    Args:
        table: with headers such as ``x_box``, ``x_box [mm]`` or a name of ``names``.
        units: the columns that may be there, and their SI units.
        names: headers, with or without a unit, by the names here. Headers that are no names here are then left out.
        needed: columns that must be there.
        strict: False: headers that are no names here are left out without ``names``, too.

    Raises:
        TypeError, ValueError: an unknown or missing column, one that comes twice, an unknown unit, something else than
            finite numbers and NaN, or columns of different lengths.
    """
    check.known_keys("names", names or {}, units)
    wanted = {name: _parts(text) for name, text in (names or {}).items()}
    columns, left_out = dict[str, Array](), list[str]()
    for header, values in table.columns:
        bare, unit = _parts(header)
        by_name = [name for name, (text, _) in wanted.items() if text == bare]
        name = by_name[0] if by_name else bare
        if (names or not strict) and not by_name and (bare not in units or bare in wanted):
            left_out.append(header)
            continue
        if name not in units or name in columns:
            allowed = ", ".join(f"{one} [{of}]" if of else one for one, of in units.items())
            what = "comes twice" if name in columns else f"must be one of {allowed}"
            raise ValueError(f"{table.header()} {check.shown(header)} {what}")
        factor = _factor(table, header, unit or wanted.get(name, ("", ""))[1], units[name])
        columns[name] = factor * _numbers(table, header, values)
    listed = ", ".join(repr(header) for header, _ in table.columns)
    for name, (text, _) in wanted.items():
        if name not in columns:
            raise ValueError(f"{table.header()} {text!r}, which is to be {name}, must be one of {listed}")
    for name in needed:
        if name not in columns:
            where = f"{table.source}{'row 1: ' if table.source else ''}"
            raise ValueError(f"{where}there must be a column {name} [{units[name]}], got {listed or 'none'}")
    if len({len(column) for column in columns.values()}) > 1:
        lengths = ", ".join(f"{name} {len(column)}" for name, column in columns.items())
        raise ValueError(f"{table.source}columns must have the same number of rows, got {lengths}")
    return columns, tuple(left_out)


def _numbers(table: Table, header: str, values: Any) -> Array:
    """The numbers of a column; NaN for an empty cell."""
    if table.lines is not None:
        return np.array([_number(table, row, header, cell) for row, cell in enumerate(values)], dtype=np.float64)
    array = np.asarray(values)
    try:
        numbers = np.array(array, dtype=np.float64) if array.dtype.kind in "fiuO" else None
    except (TypeError, ValueError):  # an object that is no number
        numbers = None
    if numbers is None or numbers.ndim != 1:
        raise TypeError(f"{table.source}column {header!r} must be numbers, got {check.shown(values)}")
    if np.isinf(numbers).any():
        row = np.isinf(numbers).argmax()
        raise ValueError(f"{table.source}column {header!r} must be finite numbers or NaN, got inf in row {row}")
    return numbers


def _number(table: Table, row: int, header: str, cell: str) -> float:
    try:
        value = float(cell) if cell.strip() else math.nan
    except ValueError:
        value = math.inf
    if math.isinf(value):
        raise ValueError(f"{table.at(row)}, column {header}: must be a number or empty, got {check.shown(cell)}")
    return value


def _parts(header: str) -> tuple[str, str]:
    """Name and unit of ``x_box [mm]``; no unit is ""."""
    match = re.fullmatch(r"(.*?)\s*\[([^][]*)\]", header.strip())
    return (match[1], match[2].strip()) if match else (header.strip(), "")


def _factor(table: Table, header: str, unit: str, si: str) -> float:
    if unit in ("", si):
        return 1.0
    factors = _OTHER_UNITS.get(si, {})
    if unit not in factors:
        allowed = ", ".join((si, *factors)) if si else "none"
        raise ValueError(f"{table.header()} {check.shown(header)} must be in one of the units {allowed}, got {unit!r}")
    return factors[unit]


def filled(table: Table, name: str, values: Array) -> Array:
    """Return a column without empty cells; else raise ValueError."""
    if np.isnan(values).any():
        raise ValueError(f"{table.at(int(np.isnan(values).argmax()))}, column {name}: must be a number, got none")
    return values
