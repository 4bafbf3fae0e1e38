"""The law of the jack in a box: gaps, impact maps, energy. It is stated in :mod:`jackbox_env.model.mechanics`."""

from jackbox_env.model.mechanics import (
    contacts_of,
    energy,
    energy_of,
    gap_jacobian,
    gaps,
    impact_map,
    impact_maps,
    simultaneous_impact_map,
)

__all__ = [
    "contacts_of",
    "energy",
    "energy_of",
    "gap_jacobian",
    "gaps",
    "impact_map",
    "impact_maps",
    "simultaneous_impact_map",
]
