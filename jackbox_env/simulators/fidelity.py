"""The fidelities: names for contact models with their settings.

docs/accuracy.md shows where they lie among all settings measured.
"""

from __future__ import annotations

from numbers import Real
from types import MappingProxyType
from typing import Any, NamedTuple

from jackbox_env.tools import checks as check

DEFAULT = "pymunk"  # contact model by default


class Setting(NamedTuple):
    """A contact model and its settings, as the environment's keywords: ``**setting._asdict()``; None: the default."""

    contact: str
    substeps: int | None = None  # engine steps of pymunk per control step; None: 4


KEYWORDS = ("fidelity", *Setting._fields)  # which choose how impacts are computed
FURTHER = Setting._fields[2:]  # keywords that environments accept as **settings
FIDELITIES = MappingProxyType(
    {
        "coarse": Setting("pymunk", 2),
        "balanced": Setting("pymunk", 4),
        "fine": Setting("pymunk", 64),
        "exact": Setting("exact"),
    }
)


COMMANDS = "exact"  # fidelity of commands by default


def explicit(setting: Setting) -> Setting:
    """The setting with its defaults filled in: pymunk without substeps is "balanced"."""
    return FIDELITIES["balanced"] if setting == Setting(DEFAULT) else setting


def resolve(fidelity: str | None = None, contact: str | None = None, **settings: Any) -> Setting:
    """The contact model and settings that :data:`KEYWORDS` mean.

    Raises:
        TypeError, ValueError: an unknown fidelity, or a contact model or settings that conflict with it.
    """
    if fidelity is None:
        return Setting(DEFAULT if contact is None else contact, **settings)
    named = FIDELITIES[check.choice("fidelity", fidelity, FIDELITIES)]
    for name, value in {"contact": contact, **settings}.items():
        implied = getattr(named, name)
        if value is not None and not (isinstance(value, str | Real) and value == implied):
            raise ValueError(
                f"fidelity={fidelity!r} stands for {name}={implied!r}, got {name}={check.shown(value)} beside it: "
                "leave one of them out"
            )
    return named


def chosen(by: object) -> dict[str, Any]:
    """The :data:`KEYWORDS` among an object's attributes that are not None; without any, the fidelity of commands."""
    values = {name: getattr(by, name) for name in KEYWORDS if getattr(by, name) is not None}
    return values or {"fidelity": COMMANDS}


def named(setting: Setting) -> dict[str, Any]:
    """The keywords of a setting: its fidelity's name if it has one, else the contact model and its settings."""
    names = [name for name, one in FIDELITIES.items() if one == explicit(setting)]
    return {"fidelity": names[0]} if names else setting._asdict()


def words(setting: Setting) -> str:
    """A setting as :func:`named` has it: "fidelity exact", "contact pymunk, substeps 8"."""
    return ", ".join(f"{name} {value}" for name, value in named(setting).items())
