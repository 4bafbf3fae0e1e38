"""Recordings of a jack in a box: what was seen and heard of it."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env import checks as check
from jackbox_env.states import LATEST_TIME, STATE_NAMES, Array

SHORTEST = 1e-9  # [s] between states


class Recording:
    """What was seen and heard of a jack in a box.

    Args:
        states: shape (H + 1, 12), NaN where something was not observed.
        torques: on the box [N m], each held for ``dt``, shape (H,); None: the scene's drive acted.
        dt: between states [s], from 1e-9 to 1e9.
        time: of the first state [s].
        impacts: times at which impacts were heard [s], in order; None: nobody listened.

    Attributes:
        states, torques, dt, time, impacts: the same, as arrays and floats.

    Raises:
        TypeError, ValueError: unusable values, or nothing observed.
    """

    def __init__(
        self, states: ArrayLike, torques: ArrayLike | None, dt: float, time: float = 0.0,
        impacts: ArrayLike | None = None,
    ) -> None:  # fmt: skip
        self.states: Array = np.array(check.array("states", states, "hold numbers"), dtype=np.float64)
        if self.states.ndim != 2 or self.states.shape[1] != 12 or len(self.states) < 2:
            raise ValueError(f"states must have shape (H + 1, 12) with H >= 1, got {self.states.shape}")
        if np.isinf(self.states).any():
            row, column = np.argwhere(np.isinf(self.states))[0]
            value = f"{STATE_NAMES[column]} = {self.states[row, column]} in row {row}"
            raise ValueError(f"states must be finite or NaN, got {value}")
        self.dt = check.real("dt", dt, at_least=SHORTEST, at_most=LATEST_TIME)
        self.time = check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
        steps = len(self.states) - 1
        self.torques = None if torques is None else _finite("torques", torques)
        if self.torques is not None and self.torques.shape != (steps,):
            raise ValueError(f"torques must have shape ({steps},), one for each step, got {self.torques.shape}")
        self.impacts = None if impacts is None else _finite("impacts", impacts)
        if self.impacts is not None and (self.impacts.ndim != 1 or (np.diff(self.impacts) < 0.0).any()):
            raise ValueError(f"impacts must be times in order, got {check.shown(impacts)}")
        heard = self.impacts is not None and len(self.impacts) > 0
        if not (heard or np.isfinite(self.states).any()):
            raise ValueError("states must hold something that was observed, got NaN only and no impacts")


def _finite(name: str, given: Any) -> Array:
    found = np.array(check.array(name, given, "hold numbers"), dtype=np.float64)
    if not np.isfinite(found).all():
        raise ValueError(f"{name} must be finite, got {found[~np.isfinite(found)][0]}")
    return found
