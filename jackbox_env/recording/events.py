"""Events that end a simulation early: a number of impacts, or a function of the state that changes its sign."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from jackbox_env.model.states import Array, State
from jackbox_env.recording.record import Record
from jackbox_env.tools import checks as check

Event = Callable[[Record], float | None]  # the time at which it happens in a part of a simulation [s]; None: not yet
POINTS = 8  # at which a flight is sampled


def event_of(until: Any) -> Event | None:
    """The event that ``until`` of :func:`jackbox_env.simulate` means; it is called with one part after the other.

    Raises:
        TypeError, ValueError: it means none.
    """
    if until is None:
        return None
    if isinstance(until, str) and until == "impact":
        return ImpactCount(1)
    if callable(until):
        return SignChange(until)
    if isinstance(until, int | np.integer) and not isinstance(until, bool) and until > 0:
        return ImpactCount(int(until))
    kind = ValueError if isinstance(until, str | int | np.integer) and not isinstance(until, bool) else TypeError
    what = "None, 'impact', a number of impacts above 0, or a function of the state"
    raise kind(f"until must be {what}, got {check.shown(until)}")


class ImpactCount:
    """The last of a number of impacts; the impulses of feet at rest do not count."""

    def __init__(self, count: int) -> None:
        self._left = count

    def __call__(self, part: Record) -> float | None:
        """The time of the event in the next part of a simulation [s], if it is there."""
        jumps = part.impacts["time"][part.held >= 0]
        if len(jumps) >= self._left:
            return float(jumps[self._left - 1])
        self._left -= len(jumps)
        return None


class SignChange:
    """A change of sign of a function of the state, in flight or by an impact."""

    def __init__(self, function: Callable[[State], float]) -> None:
        self._function, self._sign = function, 0.0

    def __call__(self, part: Record) -> float | None:
        """The time of the event in the next part of a simulation [s], if it is there."""
        knots = part.knots
        lengths = np.diff(knots.times)
        flights, shares = np.arange(len(lengths)), np.arange(1.0, POINTS) / POINTS
        between = part.flown(np.repeat(flights, POINTS - 1), np.outer(lengths, shares).ravel())
        for flight in flights.tolist():
            states = [knots.states[flight], *between[(POINTS - 1) * flight :][: POINTS - 1], knots.ends[flight]]
            for number, state in enumerate(states):
                if self._changed(state):
                    low, high = (max(number - 1, 0) / POINTS * lengths[flight], number / POINTS * lengths[flight])
                    return float(knots.times[flight]) + self._located(part, flight, float(low), float(high))
        if self._changed(knots.states[-1]):  # by an impact at the part's very end
            return float(knots.times[-1])
        return None

    def _changed(self, state: Array) -> bool:
        """Whether the sign at the next state differs from the last one that was not 0."""
        sign = self._sign_at(state)
        changed = sign * self._sign < 0.0
        if not changed:
            self._sign = sign or self._sign
        return changed

    def _sign_at(self, state: Array) -> float:
        value = check.real("until(state)", self._function(State(*state.tolist())))
        return math.copysign(1.0, value) if value else 0.0

    def _located(self, part: Record, flight: int, low: float, high: float) -> float:
        """The moment at which the sign has changed [s] after the flight's start, by bisection."""
        while low < (middle := 0.5 * (low + high)) < high:
            (state,) = part.flown(np.array([flight]), np.array([middle]))
            if self._sign_at(state) * self._sign < 0.0:
                high = middle
            else:
                low = middle
        return high
