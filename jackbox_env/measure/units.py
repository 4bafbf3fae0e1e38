"""Units in headers, as other programs write them: ``x_jack [mm]``, ``torque (N·m)``, ``time / ms``."""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Collection

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


def plain(unit: str) -> str:
    """A unit as it is compared: one kind of mu, no spaces and no signs of multiplication."""
    return re.sub(r"[\s·⋅*]", "", unicodedata.normalize("NFKC", unit))


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


def factor_of(unit: str | None, si: str) -> float | None:
    """A unit [si]; None if it is unknown."""
    factors = {plain(one): factor for one, factor in ((si, 1.0), *OTHER_UNITS.get(si, {}).items())}
    return factors.get(plain(si if unit is None else unit))
