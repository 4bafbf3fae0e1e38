"""Text files of numbers as trackers, loggers and spreadsheets write them: encoding, delimiter, headers, units.

A file is read if its form is certain; otherwise a sentence names the form. :mod:`jackbox_env.fits.tables` turns its
cells into numbers.
"""

from __future__ import annotations

import csv
import io
import math
import re
import unicodedata
from collections import Counter
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import accumulate, pairwise
from pathlib import Path

DELIMITERS = {",": "commas", ";": "semicolons", "\t": "tabs", "|": "bars", " ": "spaces"}
# No number: of C, Excel and Julia too.
_MISSING = r"|--?|\?|#?n/?a|<na>|[-+]?nan(\([a-z]*\))?|null|none|missing|#(div/0|num|value|ref)!"
NUMBER = re.compile(r"\s*[-+\u2212]?(\d+\.?|\d*[.,]\d+)([de][-+]?\d+)?\s*", re.ASCII | re.IGNORECASE)
VALUE = re.compile(rf"{NUMBER.pattern}|\s*({_MISSING})\s*", re.ASCII | re.IGNORECASE)
_COMMENT = re.compile(  # no #N/A in a first cell
    r"\s*(#(?!(n/?a|(div/0|num|value|ref)!)\s*[,;|\s])|%|//|sep=.\s*$|[|+:\s]*-{3,}[-|+:\s]*$)", re.IGNORECASE
)
_THOUSANDS = re.compile(r"(?<=\d)[\u00a0\u202f'\u2019](?=\d{3}(?!\d))")  # that can be nothing else
_END_OF_SETTINGS = "***End_of_Header***"  # of LabVIEW, which may repeat it
_PAIR = r"[^,]*\w\s*[:=]\s*[-+.\d]+"  # name and number
_FORMS = {  # that are refused, of the cells of the first row, of the headers in the next line, and of those between
    r"scorer,": "this is a table of DeepLabCut, of frames and pixels; write one row of headers, a column time, and "
    "positions in a unit",
    r"\s*<": "this is a page of HTML or XML; open it in a spreadsheet and save its table as CSV",
    r"\s*[{[]\s*([{[\"\d]|\n)": "this is JSON; write a row of names and then rows of numbers, or give "
    "Recording.from_frame a dict of columns",
    rf".*\n{_PAIR}(,{_PAIR})*(?m:$)": "names must be in a row above the numbers, not before each number",
    r"(?is).*indegrees=yes": "angles are in degrees; give the unit, as in theta_box [deg], and remove inDegrees=yes",
    r".*\n\s*\d\d:\d\d:\d\d": "must have names of columns, and times in seconds",
}
_TRIED = 200  # lines that show the delimiter
_TURN = 2.0 * math.pi  # [rad]
_DEGREE = _TURN / 360.0  # [rad]
OTHER_UNITS = {  # in SI units, by the SI unit
    "s": {"ms": 1e-3, "us": 1e-6, "µs": 1e-6, "ns": 1e-9, "min": 60.0, "seconds": 1.0},
    "m": {"cm": 1e-2, "mm": 1e-3, "um": 1e-6, "µm": 1e-6},
    "m/s": {"cm/s": 1e-2, "mm/s": 1e-3},
    "rad": {"deg": _DEGREE, "°": _DEGREE, "mrad": 1e-3, "degrees": _DEGREE, "turns": _TURN, "rev": _TURN},
    "rad/s": {"deg/s": _DEGREE, "°/s": _DEGREE, "rpm": _TURN / 60.0, "rev/s": _TURN},
    "N m": {"Nm": 1.0, "N mm": 1e-3, "Nmm": 1e-3, "N cm": 1e-2, "mN m": 1e-3, "kN m": 1e3, "kNm": 1e3},
    "N s": {},
}
_WORDS = {
    "sec": "s", "second": "s", "seconds": "s", "msec": "ms", "millisecond": "ms", "milliseconds": "ms",
    "meter": "m", "meters": "m", "metre": "m", "metres": "m", "millimeter": "mm", "millimeters": "mm", "micron": "um",
    "microns": "um", "radian": "rad", "radians": "rad", "degree": "deg", "degrees": "deg",
}  # fmt: skip


def read_rows(path: Path) -> tuple[list[str], list[int], list[list[str]], str, int, tuple[str, ...]]:
    """Headers, the lines of the further rows and their cells, delimiter, the line of the headers, and notes.

    Comments, empty rows and rows before the headers are left out; the notes name the last, each in a sentence without
    a full stop.

    Raises:
        OSError: the file cannot be read.
        ValueError: it is no text, has no headers, or a cell of more than 131,072 characters.
    """
    text = list(io.StringIO(_decoded(path), newline=""))
    comments = {number: line for number, line in enumerate(text, start=1) if _COMMENT.match(line)}
    settings = max((n for n, line in enumerate(text, start=1) if line.startswith(_END_OF_SETTINGS)), default=0)
    text = ["" if number in comments or number <= settings else line for number, line in enumerate(text, start=1)]
    delimiter = max(DELIMITERS, key=lambda one: _fitness([row for _, row in _split(path, text[:_TRIED], one)]))
    rows = _split(path, text, delimiter)
    index = _header([row for _, row in rows])
    if index is None:
        rows, index = [*_commented(path, comments, rows, delimiter), *rows], 0
    if rows and all(map(VALUE.fullmatch, rows[0][1])):
        raise ValueError(f"{path}, row {rows[0][0]}: must have names of columns, got {', '.join(rows[0][1])[:80]}")
    shown = "\n".join(",".join(rows[n][1]) for n in (0, index, *range(1, index)) if rows)
    for form, sentence in _FORMS.items():
        if re.match(form, shown):
            raise ValueError(f"{path}, row {rows[0][0]}: {sentence}")
    headers, used = _joined([row for _, row in rows[: index + 1]])
    before = ", ".join(f"row {line}" for line, _ in rows[: max(0, index + 1 - used)])
    lines, cells = [line for line, _ in rows[index + 1 :]], [row for _, row in rows[index + 1 :]]
    notes = (f"left out, because it is before the headers: {before}",) * bool(before)
    return headers, lines, cells, delimiter, rows[index][0] if rows else 1, notes


def _decoded(path: Path) -> str:
    """The characters of a file: UTF-8, UTF-16, or Excel's code page 1252."""
    data = path.read_bytes()
    wide = "utf-16" if data[:2] in (b"\xff\xfe", b"\xfe\xff") else ("", "utf-16-be", "utf-16-le")[data[:2].find(0) + 1]
    try:
        text = data.decode(wide or "utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    if "\0" in text or data.startswith((b"PK\3\4", b"\xd0\xcf\x11\xe0", b"\x1f\x8b")):
        raise ValueError(f"{path}: must be a text file or an npz file; save a spreadsheet as CSV")
    return _THOUSANDS.sub("", text)


def _split(path: Path, text: Iterable[str], delimiter: str) -> list[tuple[int, list[str]]]:
    """Lines and cells of the rows that are not empty."""
    lines = (" ".join(line.split()) for line in text) if delimiter == " " else text
    reader = csv.reader(lines, delimiter=delimiter)
    try:
        return [(reader.line_num, row) for row in reader if any(cell.strip() for cell in row)]
    except csv.Error as error:
        raise ValueError(f"{path}, row {reader.line_num}: {error}") from error


# -- headers -----------------------------------------------------------------------------------------------------------


def _width(rows: Sequence[Sequence[str]]) -> int:
    """The usual number of cells, without empty ones at the end."""
    widths = (max((n for n, cell in enumerate(row, start=1) if cell.strip()), default=0) for row in rows)
    return max(Counter(widths).most_common(1), default=(0, 0))[0]


def _fitness(rows: Sequence[Sequence[str]]) -> tuple[bool, float, float]:
    """The fitness of a delimiter that makes several columns: headers, shares of usual rows and of values in them."""
    width, index = _width(rows), _header(rows)
    below = rows[(index or 0) + 1 :]
    usual = [row for row in below if len(row) >= width > 1]
    values = [VALUE.fullmatch(cell) is not None for row in usual for cell in row]
    return bool(usual) and index is not None, len(usual) / max(1, len(below)), sum(values) / max(1, len(values))


def _header(rows: Sequence[Sequence[str]]) -> int | None:
    """The last row of text before the first five rows of numbers, or before most of fewer; None if there is none."""
    width = _width(rows)
    kinds = [any(map(NUMBER.fullmatch, row)) or all(map(VALUE.fullmatch, row)) for row in rows]  # of numbers
    names = [n for n, row in enumerate(rows) if not kinds[n] and _width([row]) >= width]
    if not names or any(_width([row]) >= width and all(map(VALUE.fullmatch, row)) for row in rows[: names[0]]):
        return None
    lengths = [end - start for start, end in pairwise([*names, len(rows)])]
    first = next(n for n, length in zip(names, lengths, strict=True) if length > min(4, max(lengths) // 2))
    return first + next((n for n, of_numbers in enumerate(kinds[first:]) if of_numbers), 1) - 1


def _commented(
    path: Path, comments: Mapping[int, str], rows: Sequence[tuple[int, list[str]]], delimiter: str
) -> list[tuple[int, list[str]]]:
    """The last comment before the first row, if it has a name for each column, as NumPy writes."""
    lines = [line for line in comments if rows and line < rows[0][0]][-1:]
    named = _split(path, [comments[line].strip().lstrip("#%/ ") for line in lines], delimiter)
    return [(line, row) for line, (_, row) in zip(lines, named, strict=False) if len(row) == len(rows[0][1])]


def _joined(levels: Sequence[Sequence[str]]) -> tuple[list[str], int]:
    """One row of headers of the last rows of text, and of how many of them.

    Units below names are added, and groups above names that come twice.
    """
    names, above, used = ([*levels] or [[]])[-1], [*levels[:-1]], 1
    named = [name.strip() for name in names if name.strip()]
    known = [plain(name.strip("[]()")) in KNOWN for name in named]
    if above and (known[0] or named[0][0] in "[(") and 2 * sum(known) > len(known):
        units = [unit.strip().strip("[]()") for unit in (*names, *[""] * len(above[-1]))]
        used, names = 2, [f"{name} [{unit}]" if unit else name for name, unit in zip(above.pop(), units, strict=False)]
    for number, level in enumerate(reversed(above), start=used + 1):
        groups: Iterator[str] = accumulate([*level, *[""] * len(names)], lambda group, cell: cell.strip() or group)
        joined = [
            f"{group} {name}".strip() if name.strip() and names.count(name) > 1 else name
            for group, name in zip(groups, names, strict=False)
        ]
        if len({*joined}) > len({*names}) and not any(map(NUMBER.fullmatch, level)):
            used, names = number, joined
    return list(names), used


# -- units in headers --------------------------------------------------------------------------------------------------


def plain(unit: str) -> str:
    """A unit as it is compared: one kind of mu, no spaces, no signs of multiplication, m/s for m s^-1, m for Meters."""
    bare = re.sub(r"[\s·⋅*.]", "", unicodedata.normalize("NFKC", unit))
    return re.sub(r"(.)s\^?[-\u2212]1$", r"\1/s", _WORDS.get(bare.lower(), bare))


KNOWN = {plain(unit) for si, others in OTHER_UNITS.items() for unit in (si, *others)}


def parts(header: str, names: Collection[str] = ()) -> tuple[str, str | None]:
    """Name and unit of ``x_box [mm]``, ``x_box (mm)`` and ``x_box / mm``; None without a unit.

    What is in parentheses or after a slash is a unit if it is known as one, or follows one of the names.
    """
    header = header.strip()
    match = re.fullmatch(r"(.*?)\s*(?:\[([^][]*)\]|\(([^()]*)\)|/\s*(.+))", header)
    if match is None:
        return header, None
    name, unit = match[1], next(text for text in match.groups()[1:] if text is not None)
    return (name, unit.strip()) if match[2] is not None or name in names or plain(unit) in KNOWN else (header, None)
