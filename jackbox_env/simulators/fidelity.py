"""Names for contact models with their substeps: what ``fidelity=`` stands for.

docs/accuracy.md shows where they lie among all settings measured; :class:`jackbox_env.JackInBoxEnv` has the table.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import NamedTuple

from jackbox_env import _validation as check

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


def explicit(setting: Setting) -> Setting:
    """The same setting in one form: pymunk with its substeps by default is "balanced"."""
    return FIDELITIES["balanced"] if setting == Setting(DEFAULT) else setting


def resolve(fidelity: str | None, contact: str | None, substeps: int | None) -> Setting:
    """The contact model and substeps that the arguments mean; ``contact`` and ``substeps`` override ``fidelity``.

    Raises:
        ValueError: an unknown name, or substeps for the exact model.
    """
    if fidelity is None:
        return Setting(DEFAULT if contact is None else contact, substeps)
    named = FIDELITIES[check.choice("fidelity", fidelity, FIDELITIES)]
    if contact is not None and not (isinstance(contact, str) and contact == named.contact):
        return Setting(contact, substeps)
    if named.contact == "exact" and substeps is not None:
        raise ValueError(
            f"fidelity='exact' has no substeps, got substeps={check.shown(substeps)}; contact='pymunk' takes them"
        )
    return Setting(named.contact, named.substeps if substeps is None else substeps)
