"""Tables of numbers: CSV and npz files, dicts and DataFrames, with headers as other programs write them.

The one reader of ``Recording.from_frame``, ``jackbox fit`` and ``jackbox simulate --torque``. A table's values become
numbers in :func:`in_si_units`, so a column that nobody reads may hold anything.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.fits.text import DELIMITERS, KNOWN, NUMBER, OTHER_UNITS, VALUE, parts, plain, read_rows
from jackbox_env.model.states import STATE_NAMES, STATE_UNITS, Array
from jackbox_env.tools import checks as check

UNITS = {"time": "s", **dict(zip(STATE_NAMES, STATE_UNITS, strict=True)), "torque": "N m"}  # columns and their units
# ISO 8601; a zone is left out.
_MOMENT = re.compile(r"\s*(\d{4}-\d\d-\d\d[T ]\d\d:\d\d:\d\d(?:\.\d{1,9})?)(?:Z|[-+]\d\d:?\d\d)?\s*", re.ASCII)
_THOUSANDS = re.compile(r"[-+\u2212]?[1-9]\d{0,2}(,\d{3})+")


class Table(NamedTuple):
    """Columns with their headers, and where they come from, for messages."""

    columns: Sequence[tuple[str, Any]]  # headers, and values as they were read
    source: str = ""  # a file and ", "
    lines: Sequence[int] | None = None  # of the text file, of each row
    at_line: int = 1  # of the headers
    notes: tuple[str, ...] = ()  # what was left out, each in a sentence without a full stop

    def at(self, row: int) -> str:
        """A row, in words."""
        return f"{self.source}row {row if self.lines is None else self.lines[row]}"

    def header(self) -> str:
        """Begins a sentence about a header."""
        return f"{self.source}row {self.at_line}: column" if self.source else "column"


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
    headers, lines, rows, delimiter, at_line, notes = read_rows(path)
    # LabVIEW's rows lack the last cell, of a comment.
    width = min(len(headers), max(map(len, rows), default=len(headers)) if delimiter == "\t" else len(headers))
    if without := ", ".join(header for header in headers[width:] if header.strip()):
        notes = (*notes, f"left out, because no row has a cell for them: {without}")
    for line, row in zip(lines, rows, strict=True):
        if len(row) < width or any(cell.strip() for cell in row[width:]):
            needed = f"{width} cells like row {at_line}, with {DELIMITERS[delimiter]} between and points in numbers"
            raise ValueError(f"{path}, row {line}: must have {needed}, got {len(row)}")
    columns = zip(*(row[:width] for row in rows), strict=True) if rows else [()] * width
    return Table(list(zip(headers[:width], columns, strict=True)), f"{path}, ", lines, at_line, notes)


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
    chosen, left_out = _chosen(table, units, names or {}, strict)
    decimal_commas = table.lines is not None and _decimal_commas(table, [values for _, _, values in chosen.values()])
    columns = {
        name: factor * _numbers(table, header, values, decimal_commas, 1.0 / factor if units[name] == "s" else None)
        for name, (header, factor, values) in chosen.items()
    }
    listed = ", ".join(repr(header) for header, _ in table.columns)
    for name in (*(names or {}), *needed):
        if name not in columns:
            what = f"there must be a column {name} [{units[name]}], got {listed or 'none'}"
            if name in (names or {}):
                text = parts((names or {})[name], units)[0]
                for header, _ in table.columns:
                    if parts(header, {text})[0] == text:  # its unit is unknown: raise
                        _factor(table, header, None, None, units[name])
                what = f"column {text!r}, which is to be {name}, must be one of {listed}"
            raise ValueError(f"{table.header().removesuffix('column')}{what}")
    if len({len(column) for column in columns.values()}) > 1:
        lengths = ", ".join(f"{name} {len(column)}" for name, column in columns.items())
        raise ValueError(f"{table.source}columns must have the same number of rows, got {lengths}")
    return columns, tuple(left_out)


def _chosen(
    table: Table, units: Mapping[str, str], names: Mapping[str, str], strict: bool
) -> tuple[dict[str, tuple[str, float, Any]], list[str]]:
    """Headers, units [SI] and values by the names here, and the headers that are left out."""
    headers = {header.strip() for header, _ in table.columns}
    by_text = {text.strip() if text.strip() in headers else parts(text, units)[0]: name for name, text in names.items()}
    chosen, left_out = dict[str, tuple[str, float, Any]](), list[str]()
    for header, values in table.columns:
        bare, unit = parts(header, units)
        name = by_text.get(header.strip(), by_text.get(bare, ""))
        bare = bare.lower() if bare.lower() in units else bare
        if not name and (not bare or ((names or not strict) and (bare not in units or bare in names))):
            left_out.append(header)
            continue
        name = name or bare
        if name not in units or name in chosen:
            allowed = ", ".join(f"{one} [{of}]" if of else one for one, of in units.items())
            others = "; --columns (in Python names=) reads other headers" * (units is UNITS)
            what = "comes twice" if name in chosen else f"must be one of {allowed}{others}"
            raise ValueError(f"{table.header()} {check.shown(header)} {what}")
        of_names = parts(names.get(name, ""), units)[1]
        chosen[name] = header, _factor(table, header, unit, of_names, units[name]), values
    return chosen, left_out


def _decimal_commas(table: Table, columns: Collection[Sequence[str]]) -> bool:
    """Whether the numbers of a text file have decimal commas; ValueError if they may be thousands."""
    cells = [cell.strip() for column in columns for cell in column]
    commas = [cell for cell in cells if "," in cell and NUMBER.fullmatch(cell)]
    if commas and (any("." in cell for cell in cells) or all(map(_THOUSANDS.fullmatch, commas))):
        raise ValueError(
            f"{table.source.removesuffix(', ')}: commas must be in all decimal numbers or in none, and in no "
            f"thousands, got {check.shown(commas[0])}"
        )
    return bool(commas)


def _numbers(table: Table, header: str, values: Any, decimal_commas: bool, second: float | None) -> Array:
    """The numbers of a column; NaN for an empty cell or a marker like NA.

    In a column of times, of which a ``second`` has so many units, moments and durations become numbers too.
    """
    moments = [_MOMENT.fullmatch(cell) for cell in values] if second and table.lines is not None else [None]
    if all(moments):
        values = np.array([moment[1] for moment in moments if moment], dtype="datetime64[ns]")
    elif table.lines is not None:
        cells = [cell.strip().replace("\u2212", "-").replace("," * decimal_commas or ".", ".") for cell in values]
        numerals = [cell if NUMBER.fullmatch(cell) and "," not in cell else "nan" for cell in cells]
        read = np.array([float(one.lower().replace("d", "e")) for one in numerals])
        for line, cell in enumerate(cells):
            if math.isinf(read[line]) or "," in cell or not VALUE.fullmatch(cell):
                what = f"must be a number or empty, got {check.shown(values[line].strip())}"
                raise ValueError(f"{table.at(line)}, column {header}: {what}")
        return read
    array = np.ma.filled(values.astype(np.float64), math.nan) if np.ma.isMaskedArray(values) else np.asarray(values)
    try:
        if second and array.dtype.kind in "mM":
            array = (array - np.zeros((), array.dtype)) / np.timedelta64(1, "s") * second
        elif second and hasattr(next(iter(array), None), "timestamp"):  # with a zone
            array = np.array([one.timestamp() * second for one in array])
        numbers = np.array(array, dtype=np.float64) if array.dtype.kind in "fiuO" else None
    except (TypeError, ValueError):  # an object that is no number
        numbers = None
    if numbers is None or numbers.ndim != 1:
        raise TypeError(f"{table.source}column {header!r} must be numbers, got {check.shown(values)}")
    if np.isinf(numbers).any():
        row = np.isinf(numbers).argmax()
        raise ValueError(f"{table.source}column {header!r} must be finite numbers or NaN, got inf in row {row}")
    return numbers


def _factor(table: Table, header: str, unit: str | None, of_names: str | None, si: str) -> float:
    """The unit of a column [si], which the header or ``names`` have."""
    factors = {si: 1.0, **OTHER_UNITS.get(si, {})}
    known = {plain(one): factor for one, factor in factors.items()}
    if unit is None:  # it may be within, as in Position (mm) Run #1
        unit = next((one for one in re.findall(r"[(\[]([^][()]*)[)\]]", header) if plain(one) in KNOWN), None)
    if unit is not None and of_names is not None and plain(unit) != plain(of_names):
        raise ValueError(f"{table.header()} {check.shown(header)} has another unit than {of_names!r}, chosen for it")
    in_parentheses = re.search(r"\(([^()]*)\)\s*$", header)
    ending = header.strip().rpartition("_")[2]  # of box_angle_deg
    others = of_names, in_parentheses and in_parentheses[1], ending if plain(ending) in known else si
    unit = next(one for one in (unit, *others) if one is not None)
    factor = known.get(plain(unit))
    if factor is None:
        allowed = ", ".join(factors) if si else "none"
        raise ValueError(f"{table.header()} {check.shown(header)} must be in one of the units {allowed}, got {unit!r}")
    return factor


def filled(table: Table, name: str, values: Array) -> Array:
    """Return a column without empty cells; else raise ValueError."""
    if np.isnan(values).any():
        raise ValueError(f"{table.at(int(np.isnan(values).argmax()))}, column {name}: must be a number, got none")
    return values
