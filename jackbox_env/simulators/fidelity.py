"""Names for contact models with their substeps: what ``fidelity=`` stands for.

docs/accuracy.md shows where they lie among all settings measured.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from jackbox_env import checks as check

DEFAULT = "pymunk"  # the contact model where none is named


class Setting(NamedTuple):
    """A contact model and its substeps, as the environment's keywords: ``**setting._asdict()``."""

    contact: str
    substeps: int | None = None


FIDELITIES = MappingProxyType(
    {
        "coarse": Setting("pymunk", 2),
        "balanced": Setting("pymunk", 4),
        "fine": Setting("pymunk", 64),
        "exact": Setting("exact"),
    }
)


COMMANDS = "exact"  # the fidelity of commands where none is named


def explicit(setting: Setting) -> Setting:
    """The same setting in one form: pymunk with its substeps by default is "balanced"."""
    return FIDELITIES["balanced"] if setting == Setting(DEFAULT) else setting


def resolve(fidelity: str | None, contact: str | None, substeps: int | None) -> Setting:
    """The contact model and substeps that the arguments mean.

    Raises:
        TypeError, ValueError: an unknown fidelity, or one that stands for another contact model or other substeps than
            those that are given beside it.
    """
    if fidelity is None:
        return Setting(DEFAULT if contact is None else contact, substeps)
    named = FIDELITIES[check.choice("fidelity", fidelity, FIDELITIES)]
    for name, given, meant in (("contact", contact, named.contact), ("substeps", substeps, named.substeps)):
        if given is not None and not (isinstance(given, str | int | np.integer) and given == meant):
            raise ValueError(
                f"fidelity={fidelity!r} stands for {name}={meant!r}, got {name}={check.shown(given)} beside it: leave "
                "one of them out"
            )
    return named


def as_stored(stored: Mapping[str, Any]) -> dict[str, Any]:
    """Stored settings in which fidelity, contact and substeps mean what they meant in all earlier versions.

    A contact model or substeps beside a fidelity overrode it, and without all three it was "balanced".
    """
    fidelity, contact, substeps = (stored.get(name) for name in ("fidelity", "contact", "substeps"))
    if (fidelity, contact, substeps) == (None, None, None):
        return {**stored, "fidelity": "balanced"}
    if isinstance(fidelity, str) and fidelity in FIDELITIES and (contact, substeps) != (None, None):
        named = FIDELITIES[fidelity]
        if contact in (None, named.contact):
            contact, substeps = named.contact, named.substeps if substeps is None else substeps
        return {**stored, "fidelity": None, "contact": contact, "substeps": substeps}
    return dict(stored)


def words(setting: Setting) -> str:
    """A setting by its fidelity's name if it has one: "fidelity exact", "contact pymunk, substeps 8"."""
    found = [name for name, named in FIDELITIES.items() if named == explicit(setting)]
    contact, substeps = setting
    return f"fidelity {found[0]}" if found else f"contact {contact}, substeps {substeps}"
