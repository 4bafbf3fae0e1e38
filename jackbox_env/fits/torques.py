"""Torques that were measured while they changed, as constant ones of parts of a step."""

from __future__ import annotations

import numpy as np

from jackbox_env.model.states import Array

TORQUE_KINDS = ("held", "sampled", "linear")
_PARTS = 4  # of a step: with 2, a fifth of the fits fail at 12 samples for each turn of a motor


def torques_between(samples: Array, kind: str) -> Array:
    """The mean torque in each quarter of the steps between samples, shape (H + 1,) -> (H, 4).

    The torque is "linear" between samples, or "sampled" from a smooth curve: cubic, with the slope at each sample that
    its neighbours give (Catmull and Rom 1974).
    """
    rises, slopes = np.diff(samples), np.gradient(samples)
    first, last = (rises, rises) if kind == "linear" else (slopes[:-1], slopes[1:])
    u = np.linspace(0.0, 1.0, _PARTS + 1)
    integrals = u - u**3 + u**4 / 2, u**3 - u**4 / 2, u**2 / 2 - 2 * u**3 / 3 + u**4 / 4, u**4 / 4 - u**3 / 3
    return np.asarray(np.column_stack([samples[:-1], samples[1:], first, last]) @ (_PARTS * np.diff(integrals)))


def without_gaps(samples: Array, rows: Array) -> Array:
    """Samples of the rows from 0 on, from the smooth curve through those of ``rows``."""
    frames, rises, lengths = np.arange(rows[-1] + 1), np.diff(samples), np.diff(rows)
    before = np.minimum(np.searchsorted(rows, frames, side="right"), len(rows) - 1) - 1
    u, slopes = (frames - rows[before]) / lengths[before], np.gradient(samples, rows)
    bend = (1.0 - u) * (lengths * slopes[:-1] - rises)[before] + u * (rises - lengths * slopes[1:])[before]
    return np.asarray(samples[before] + u * (rises[before] + (1.0 - u) * bend))
