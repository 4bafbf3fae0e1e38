"""The record of a simulation: states at the ends of control steps, impacts with the states before and after them.

:mod:`jackbox_env.recording.recorder` fills it in, and :mod:`jackbox_env.recording.motion` reads it.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.exact.late import with_all
from jackbox_env.exact.motion import Moments, coast, fly_to
from jackbox_env.exact.workspace import new_workspaces
from jackbox_env.jit.compiler import compiled
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, Counts, Flags
from jackbox_env.simulators.exact import NO_TABLE, WITH_PIECES, drive_kind, joined, pieces_for

#: Of an impact: time [s], wall, foot, impulse [N s].
IMPACT = [("time", "f8"), ("wall", "i8"), ("foot", "i8"), ("impulse", "f8")]
#: With the states just before and just after it, and whether it is the impulse of a foot at rest in its step instead.
JUMP = [*IMPACT, ("before", "f8", 12), ("after", "f8", 12), ("resting", "?")]

_ROOM = 64  # rows of feet at rest in a step
ONLY_EXACT = "between them and at impacts there are states with fidelity='exact'"

Impacts = NDArray[Any]  # structured


@dataclass(frozen=True)
class Record:
    """A simulation in n control steps with m impacts.

    Attributes:
        scene: the scene.
        dt: duration of a step [s].
        rest: duration of the last step if it is shorter [s], else 0.
        times: at the ends of steps, the start first [s], shape (n + 1,).
        states: SI units, shape (n + 1, 12).
        torques: constant in each step [N m], n of them or more; None: the scene's drive acts.
        impacts: structured, shape (m,), in time order; without the states of ``JUMP`` if the contact model has none.
        steps: in which each impact is, shape (m,).
        held: number of feet at rest before each impact in its step, -1 for the impulse of a foot at rest; shape (m,).
        failure: the error that ended it early.
    """

    scene: Scene
    dt: float
    rest: float
    times: Array
    states: Array
    torques: Array | None
    impacts: Impacts
    steps: Counts
    held: Counts
    failure: Exception | None = None

    def slack(self, duration: float) -> float:
        """The difference [s] up to which two times are the same: rounding of a duration, and of the sums of ``dt``."""
        latest = max(abs(float(self.times[0])), abs(float(self.times[-1])))
        return slack_of(duration, self.dt) + len(self.times) * math.ulp(latest)

    def torques_in(self, steps: Counts) -> Array | None:
        """The torque in each of some steps [N m]; None: the scene's drive acts."""
        return None if self.torques is None else self.torques[steps]

    def same_impact(self) -> Flags:
        """Whether the foot of each row of ``impacts`` strikes together with that of the row before."""
        rows = self.impacts
        same = (rows["time"][1:] == rows["time"][:-1]) & (self.held[1:] >= 0) & (self.held[:-1] >= 0)
        same &= (rows["before"][1:] == rows["before"][:-1]).all(axis=1)
        return np.concatenate([np.zeros(len(rows[:1]), np.bool_), same])

    @cached_property
    def knots(self) -> Knots:
        """The moments at which flights begin."""
        jumps = np.flatnonzero((self.held >= 0) & ~self.same_impact())
        number = np.concatenate([np.arange(len(self.times)), self.steps[jumps]])
        order = np.argsort(number, kind="stable")  # the start of a step, then its jumps
        times = np.concatenate([self.times, self.impacts["time"][jumps]])[order]
        states = np.concatenate([self.states, self.impacts["after"][jumps]])[order]
        arrived = np.concatenate([self.states, self.impacts["before"][jumps]])[order]
        ends = np.zeros(len(self.times), np.bool_)
        ends[self.steps[self.held < 0] + 1] = True  # at the end of these steps a foot is at rest
        ended = np.concatenate([ends, self.held[jumps] > 0])[order]
        return Knots(times, states, arrived[1:], number[order], np.append(ended[1:], False))

    def refuse_no_states(self) -> None:
        """Raise ValueError unless there are states between control steps."""
        if "before" not in (self.impacts.dtype.names or ()):
            raise ValueError(f"this motion has states at the ends of control steps only: {ONLY_EXACT}")

    def flown(self, indices: Counts, durations: Array) -> Array:
        """The states some time after knots [s], shape (n, 12), before the next knot."""
        knots = self.knots
        states: Array = knots.states[indices].copy()
        held = knots.held[indices]
        for resting in (False, True):
            if (moved := np.flatnonzero((durations > 0.0) & (held == resting))).size:
                states[moved] = self._moved(indices[moved], durations[moved], resting)
        return states

    def _moved(self, indices: Counts, durations: Array, resting: bool) -> Array:
        """:func:`flown` by free flight, or by steps, in which feet may be ``resting``."""
        knots, scene = self.knots, self.scene
        kind, count = drive_kind(scene.drive, self.torques is not None), len(indices)
        unique, number = np.unique(indices, return_inverse=True)
        table, ends = NO_TABLE, np.zeros(len(unique) + 1, np.int64)
        if kind in WITH_PIECES:
            spans = zip(
                knots.times[unique].tolist(), (knots.times[unique + 1] - knots.times[unique]).tolist(), strict=True
            )
            held = None if self.torques is None else 0.0  # any number
            table, _, ends = joined([pieces_for(scene.drive, *span, held) for span in spans], ends[:1])
        torques = self.torques_in(knots.steps[indices])
        torques = np.zeros(count) if torques is None else torques
        moments = Moments(
            knots.states[indices], knots.times[indices], torques, durations, table, ends[number], ends[number + 1]
        )
        states: Array = np.empty((count, 12))
        loop = compiled(fly_to) if resting else compiled(fly_to, advance=coast)
        failed = loop(np.array(scene.numbers), kind, moments, states, with_all(new_workspaces()), np.zeros((_ROOM, 4)))
        if failed >= 0:
            raise RuntimeError(f"the flight after t = {knots.times[indices[failed]]:g} s cannot be evaluated")
        return states


def slack_of(duration: float, dt: float) -> float:
    """The part of a duration in steps of ``dt`` that is rounding [s]; it makes no step."""
    return 1e-6 * dt + 1e-12 * duration


class Knots(NamedTuple):
    """The moments at which flights begin: starts of steps, then the impacts within them, and the end."""

    times: Array  # [s], (n,)
    states: Array  # after an impact, (n, 12)
    ends: Array  # states at the next one, before its impact, (n - 1, 12)
    steps: Counts  # (n,)
    held: Flags  # whether a foot may be at rest before the next one, (n,)
