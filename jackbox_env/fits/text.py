"""Text files of numbers as trackers, loggers and spreadsheets write them: encoding, delimiter, headers, units.

:mod:`jackbox_env.fits.tables` turns the cells into numbers.
"""

from __future__ import annotations

import csv
import io
import math
import re
import unicodedata
from itertools import zip_longest
from pathlib import Path

from jackbox_env.tools import checks as check

DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
# No number: of C, Excel and Julia too.
_MISSING = r"|--?|\?|#?n/?a|<na>|[-+]?nan(\([a-z]*\))?|null|none|missing|#(div/0|num|value|ref)!"
NUMBER = re.compile(r"[-+\u2212]?(\d+\.?|\d*[.,]\d+)(e[-+]?\d+)?", re.ASCII | re.IGNORECASE)
VALUE = re.compile(rf"{NUMBER.pattern}|{_MISSING}", re.ASCII | re.IGNORECASE)
_COMMENT = re.compile(r"\s*(#\s|#?%|//)")  # no #N/A in a first cell
_DEGREE = math.tau / 360.0  # [rad]
OTHER_UNITS = {  # in SI units, by the SI unit
    "s": {
        "ms": 1e-3,
        "us": 1e-6,
        "µs": 1e-6,
        "ns": 1e-9,
        "min": 60.0,
        "sec": 1.0,
        "seconds": 1.0,
        "milliseconds": 1e-3,
    },
    "m": {
        "cm": 1e-2,
        "mm": 1e-3,
        "um": 1e-6,
        "µm": 1e-6,
        "meters": 1.0,
        "metres": 1.0,
        "micron": 1e-6,
        "microns": 1e-6,
    },
    "m/s": {"cm/s": 1e-2, "mm/s": 1e-3},
    "rad": {"deg": _DEGREE, "°": _DEGREE, "mrad": 1e-3, "degrees": _DEGREE, "radians": 1.0, "rev": math.tau},
    "rad/s": {"deg/s": _DEGREE, "°/s": _DEGREE, "rpm": math.tau / 60.0, "rev/s": math.tau},
    "N m": {"Nm": 1.0, "N mm": 1e-3, "Nmm": 1e-3, "N cm": 1e-2, "mN m": 1e-3, "kN m": 1e3, "kNm": 1e3},
}


def read_rows(path: Path, named: str) -> tuple[list[str], list[int], list[list[str]], str, int]:
    """Headers, the lines of the rows below and their cells, the delimiter, and the line of the headers.

    The headers are the first row in which one is the one that is ``named``, with the units of a row below. What is
    above them is left out, and so are comments, empty rows, and the same headers again.

    Raises:
        OSError: the file cannot be read.
        ValueError: it has no such row, or a cell of more than 131,072 characters.
    """
    text = _decoded(path)
    # In the bytes of a spreadsheet headers stand only by chance.
    for delimiter in () if text.startswith("PK\3\4") else DELIMITERS:
        rows = _split(path, text, delimiter)
        for index, (line, row) in enumerate(rows):
            row = row[row[0] in ("#", "%") :]
            headers = [row[0].lstrip("#% "), *row[1:]]
            if any(is_named(header, one) for header in headers for one in (named, re.sub(r" #\d+", "", named))):
                below = [one for one in rows[index + 1 :] if one[1] != rows[index][1]]
                units = [cell.strip("[]()#% ") for cell in below[0][1]] if below else []
                if KNOWN.intersection(map(plain, units)) and not any(map(NUMBER.fullmatch, units)):
                    pairs = zip_longest(headers, units, fillvalue="")
                    headers, below = [f"{name} [{unit}]" if unit else name for name, unit in pairs], below[1:]
                below = [one for one in below if not _COMMENT.match(one[1][0])]
                return headers, [at for at, _ in below], [cells for _, cells in below], delimiter, line
    raise ValueError(
        f"{path}: there must be a row of headers, {named} among them, and rows of numbers below, got "
        f"{check.shown(text[:60])}; save a spreadsheet as CSV in UTF-8; Recording.from_frame accepts what pandas reads"
    )


def _decoded(path: Path) -> str:
    """The characters of a file: UTF-8, UTF-16 with a mark, or Excel's code page 1252."""
    data = path.read_bytes()
    try:
        text = data.decode("utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    if "indegrees=yes" in text.lower():
        raise ValueError(
            f"{path}: angles are in degrees; give the unit, as in theta_box [deg], and remove inDegrees=yes"
        )
    return text


def _split(path: Path, text: str, delimiter: str) -> list[tuple[int, list[str]]]:
    """Lines and cells of the rows that are not empty."""
    lines = (" ".join(line.split()) if delimiter == " " else line for line in io.StringIO(text, newline=""))
    reader = csv.reader(lines, delimiter=delimiter)
    try:
        return [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise ValueError(f"{path}, row {reader.line_num}: {error}") from error


# -- units in headers --------------------------------------------------------------------------------------------------


def plain(unit: str) -> str:
    """A unit as it is compared: one kind of mu, no spaces, no signs of multiplication, m/s for m s^-1, small words."""
    bare = re.sub(r"[\s·⋅*.]", "", unicodedata.normalize("NFKC", unit))
    bare = re.sub(r"(.)s\^?[-\u2212]1$", r"\1/s", bare)
    return bare.lower() if len(bare) > len("kN m") else bare


PIXELS = {"m": "px", "m/s": "px/s"}  # of a table with a scale
KNOWN = {plain(unit) for si, others in OTHER_UNITS.items() for unit in (si, *others)} | {*PIXELS.values()}


def parts(header: str) -> tuple[str, str | None]:
    """Name and unit of ``x_box [mm]``, ``x_box (mm)``, ``x_box / mm`` and ``x_box (mm) Run 1``; None without a unit."""
    match = re.fullmatch(r"(.*?)\s*(?:\[([^][]*)\]|\(([^()]*)\))([^][()]*)", header.strip())
    if match is not None:
        return match[1] + match[4], (match[3] if match[2] is None else match[2]).strip()
    name, _, unit = header.partition("/")
    return (name.strip(), unit.strip()) if plain(unit) in KNOWN else (header.strip(), None)


def is_named(header: str, name: str) -> bool:
    """Whether a header is a name, which may have a unit, too; capitals do not count."""
    return header.strip() in (name.strip(), parts(name)[0]) or parts(header)[0].lower() == parts(name)[0].lower()
