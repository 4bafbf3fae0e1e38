"""Tables of numbers: CSV and npz files, dicts and DataFrames, with headers as other programs write them.

The one reader of ``Recording.from_frame`` and ``jackbox fit``. A table's values become numbers in :func:`in_si_units`,
so a column that nobody reads may hold anything.
"""

from __future__ import annotations

import math
import re
from collections.abc import Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.fits.text import (
    DELIMITERS,
    KNOWN,
    NUMBER,
    OTHER_UNITS,
    PIXELS,
    VALUE,
    is_named,
    parts,
    plain,
    read_rows,
)
from jackbox_env.model.states import STATE_NAMES, STATE_UNITS, Array
from jackbox_env.tools import checks as check

UNITS = {"time": "s", **dict(zip(STATE_NAMES, STATE_UNITS, strict=True)), "torque": "N m"}  # columns and their units
# ISO 8601, whose zone is left out, or a clock's h:mm:ss.ff.
_MOMENT = re.compile(
    r"\s*(?:(\d{4}-\d\d-\d\d)[T ])?([01]?\d|2[0-3])(:[0-5]\d:[0-5]\d(?:\.\d{1,9})?)(?:Z|[-+]\d\d:?\d\d)?\s*", re.ASCII
)
_THOUSANDS = re.compile(r"[-+\u2212]?[1-9]\d{0,2}(,\d{3})+")


class Table(NamedTuple):
    """Columns with their headers, and where they come from, for messages."""

    columns: Sequence[tuple[str, Any]]  # headers, and values as they were read
    source: str = ""  # a file and ", "
    lines: Sequence[int] | None = None  # of the text file, of each row
    at_line: int = 1  # of the headers
    scale: float | None = None  # pixels per metre

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
    return Table(
        [
            (" ".join(map(str, name)) if isinstance(name, tuple) else str(name), columns[name])
            for name in (columns if listed is None else listed)
        ],
        source,
    )


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


def read_table(path: Path, array: str, named: str = "time") -> Table:
    """The columns of a text file, of which one is ``named``, or the arrays of an npz file with this ``array``.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is damaged, or something else; the message names the file, and the row if it is text.
    """
    if path.suffix == ".npz":
        arrays = read_arrays(path)
        if array not in arrays:
            raise ValueError(f"{path}: there must be an array {array}, got {', '.join(arrays)}")
        return table_of({"time": arrays[array]} if array == "impact_time" else arrays, f"{path}, ")
    headers, lines, rows, delimiter, at_line = read_rows(path, named)
    width = len(headers)
    for line, row in zip(lines, rows, strict=True):
        if len(row) < width or any(cell.strip() for cell in row[width:]):
            raise ValueError(
                f"{path}, row {line}: must have {width} cells like row {at_line}, with {DELIMITERS[delimiter]} between "
                f"and points in numbers, got {len(row)}"
            )
    columns = zip(*(row[:width] for row in rows), strict=True) if rows else [()] * width
    return Table(list(zip(headers, columns, strict=True)), f"{path}, ", lines, at_line)


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
    table: Table, units: Mapping[str, str], names: Mapping[str, str] | None = None
) -> tuple[dict[str, Array], tuple[str, ...], tuple[str, ...]]:
    """Columns by their names here, in SI units; headers that are left out; and chosen ones without a unit.

    No name stands for those that are left out. Those without a unit have another name here, and are read in SI units.

    Args:
        table: with headers such as ``x_box``, ``x_box [mm]`` or one of ``names``.
        units: the columns that may be there, and their SI units.
        names: headers, with or without a unit, by the names here.

    Raises:
        TypeError, ValueError: a missing column, one that comes twice, an unknown unit, something else than finite
            numbers and NaN, or columns of different lengths.
    """
    names = names or {}
    check.known_keys("names", names, units)
    if len({*map(str, names.values())}) < len(names):
        raise ValueError(f"{table.source}names must be of different headers, got {check.shown(dict(names))}")
    plainly = [parts(header)[0] for header, _ in table.columns]
    numbered = [  # if there are several
        f"{header} #{plainly[: n + 1].count(plainly[n])}" if plainly.count(plainly[n]) > 1 else header
        for n, (header, _) in enumerate(table.columns)
    ]
    chosen = dict[str, tuple[str, float, bool, Any]]()
    bare = list[str]()
    for name, si in units.items():
        text = str(names.get(name, name))
        found = _named(table, numbered, text, name in names)
        if found:
            factor, unit = _factor(table, found[0], text, si)
            bare += [found[0]] * (unit is None and name in names and name != "time")
            chosen[name] = found[0], factor, unit in PIXELS.values(), found[1]
        elif name in names or name == "time":
            which = f"{text!r}, which is to be {name}," if name in names else f"{name} [{si}]"
            raise ValueError(f"{table.header()} {which} must be one of {', '.join(map(repr, numbered)) or 'none'}")
    if table.scale is not None and not any(scaled for _, _, scaled, _ in chosen.values()):
        raise ValueError(f"{table.source}scale goes with columns in px, which no header has")
    decimal_commas = table.lines is not None and _decimal_commas(table, [values for *_, values in chosen.values()])
    columns = {
        name: factor * _numbers(table, header, values, decimal_commas, 1.0 / factor if units[name] == "s" else None)
        for name, (header, factor, _, values) in chosen.items()
    }
    if len({len(column) for column in columns.values()}) > 1:
        raise ValueError(
            f"{table.source}columns must have the same number of rows, got "
            f"{', '.join(f'{name} {len(column)}' for name, column in columns.items())}"
        )
    others = (one for one in table.columns if not any(one[1] is values for *_, values in chosen.values()))
    return columns, tuple(header for header, _ in others if header.strip()), tuple(bare)


def _named(table: Table, numbered: Sequence[str], text: str, chosen: bool) -> tuple[str, Any] | None:
    """The column of a name; None if there is none, ValueError if there are several. ``chosen``: not by its default."""
    found = [one for one in table.columns if chosen and one[0].strip() == text.strip()]
    found = found or [
        one for one, also in zip(table.columns, numbered, strict=True) if is_named(one[0], text) or is_named(also, text)
    ]
    if len(found) > 1:
        remedy = f"; choose one as {text} #1" * chosen
        raise ValueError(f"{table.header()} {check.shown(found[1][0])} comes twice{remedy}")
    return found[0] if found else None


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
    if table.lines is not None and second and values and all(map(_MOMENT.fullmatch, values)):
        found = [match.groups() for match in map(_MOMENT.fullmatch, values) if match]
        values = np.array([f"{day or '1970-01-01'}T{hour:0>2}{rest}" for day, hour, rest in found], "datetime64[ns]")
    elif table.lines is not None:
        cells = [cell.strip().replace("\u2212", "-").replace("," * decimal_commas or ".", ".") for cell in values]
        for row, cell in enumerate(cells):
            if "," in cell or not VALUE.fullmatch(cell):
                raise ValueError(
                    f"{table.at(row)}, column {header}: must be a number or empty, got "
                    f"{check.shown(values[row].strip())}"
                )
        values = [float(cell) if NUMBER.fullmatch(cell) else math.nan for cell in cells]
    array = np.ma.filled(values.astype(np.float64), math.nan) if np.ma.isMaskedArray(values) else np.asarray(values)
    try:
        if second and hasattr(next(iter(array), None), "timestamp"):  # with a zone
            array = np.array([one.timestamp() * second for one in array])
        if second and array.dtype.kind in "mM":  # since 1970, or durations
            array = (array - np.zeros((), array.dtype)) / np.timedelta64(1, "s") * second
        numbers = np.array(array, dtype=np.float64) if array.dtype.kind in "fiuO" else None
    except (TypeError, ValueError):  # an object that is no number
        numbers = None
    if numbers is None or numbers.ndim != 1:
        raise TypeError(f"{table.source}column {header!r} must be numbers, got {check.shown(values)}")
    if np.isinf(numbers).any():
        row = int(np.isinf(numbers).argmax())
        raise ValueError(f"{table.at(row)}, column {header}: must be a finite number or NaN, got inf")
    return numbers


def _factor(table: Table, header: str, name: str, si: str) -> tuple[float, str | None]:
    """The unit of a column [si]: that of its ``name``, its header's, also after the last underscore; else 1, for SI.

    Also that unit's name; None without one.
    """
    factors = {si: 1.0, **OTHER_UNITS[si]} | ({PIXELS[si]: 1.0 / table.scale} if table.scale and si in PIXELS else {})
    known = {plain(one): factor for one, factor in factors.items()}
    of_name, of_header, ending = parts(name)[1], parts(header)[1], header.strip().rpartition("_")[2]
    of_name = None if header.strip() == name.strip() else of_name
    if of_name is not None and of_header is not None and plain(of_name) != plain(of_header) in KNOWN:
        raise ValueError(f"{table.header()} {check.shown(header)} has another unit than {name!r}, chosen for it")
    of_ending = ending if plain(ending) in known else None
    unit = next((one for one in (of_name, of_header, of_ending) if one is not None), None)
    if unit is None:
        return 1.0, None
    if plain(unit) not in known:
        scale = "; --scale (in Python scale=) gives pixels per metre" * (plain(unit) in PIXELS.values())
        raise ValueError(
            f"{table.header()} {check.shown(header)} must be in one of the units {', '.join(factors)}, got "
            f"{unit!r}{scale}"
        )
    return known[plain(unit)], plain(unit)


def filled(table: Table, name: str, values: Array) -> Array:
    """Return a column without empty cells; else raise ValueError."""
    if np.isnan(values).any():
        raise ValueError(f"{table.at(int(np.isnan(values).argmax()))}, column {name}: must be a number, got none")
    return values
