"""A motion: what ``jackbox_env.simulate`` returns. Files, films, pages and plots of a simulation are made of it."""

from __future__ import annotations

import json
import math
from contextlib import suppress
from functools import cached_property
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env.model.mechanics import energy_of
from jackbox_env.model.scene import Drive
from jackbox_env.model.states import Array, Counts
from jackbox_env.recording.files import Columns, by_name, frame, save
from jackbox_env.recording.record import Impacts, Record
from jackbox_env.recording.recorder import restarted
from jackbox_env.simulators.base import Impact
from jackbox_env.simulators.replay import box_energy
from jackbox_env.tools import checks as check

Side = Literal["before", "after"]


class Motion:
    """The motion of box and jack between two times; :func:`jackbox_env.simulate` returns it.

    >>> import jackbox_env
    >>> motion = jackbox_env.simulate({"drive": None}, duration=1.5)  # the jack falls 5 m
    >>> hit = motion.impacts[0]
    >>> hit["time"].round(6).item()
    1.009638
    >>> hit["before"][10].round(3).item(), hit["after"][10].round(3).item()
    (-9.905, 9.708)
    >>> motion([0.5, 1.0])[:, 4].round(6).tolist()  # heights of the jack [m]
    [-1.22625, -4.905]

    Attributes:
        scene: as simulated; a torque that is a function is its drive.
        dt: duration of a control step [s].
        t: the start, and the ends of control steps [s], shape (n,): sums of dt, as an environment's ``info["time"]``.
        states: at these times, SI units, shape (n, 12). The first is the given start: if a foot strikes there,
            ``motion(t[0])`` is the state after it. If an impact ends the motion, the last is the state after it.
        torques: constant in each control step [N m], shape (n - 1,); None: the scene's drive acts.
        impacts: a structured array in time order: ``time`` [s], ``wall``, ``foot``, ``impulse`` [N s], and the states
            ``before`` and ``after``, 12 numbers each. Feet that strike at one moment have a row each, of the same
            states. A foot at rest on a wall has a row at the end of each step, with the impulse of the whole step,
            before = after, and True in the field ``resting``; ``impact_count`` leaves it out.
            With pymunk there are only the first four fields.
        failure: the error that ended the motion early, or None.
    """

    def __init__(self, record: Record, *, begin: int | None = None, end: float = math.inf) -> None:
        """The motion of a record from its start, or from just after the impact of row ``begin``, to a time [s]."""
        self._record, impacts = record, record.impacts
        self.scene, self.dt, self.failure = record.scene, record.dt, record.failure
        first = float(record.times[0] if begin is None else impacts["time"][begin])
        last = max(first, min(float(record.times[-1]), end))
        low = max(0, min(int(np.searchsorted(record.times, first, "right")), len(record.times) - 1) - 1)
        within = (impacts["time"] <= last) & (record.steps >= low)
        if begin is not None:  # without the rows of this impact
            within[: begin + 1] = False
            within &= ~((impacts["time"] == first) & (impacts["before"] == impacts["before"][begin]).all(axis=1))
        self._rows, self._low = np.flatnonzero(within), low
        self.impacts: Impacts = impacts[self._rows]
        inner = (record.times > first) & (record.times < last)
        self.t: Array = np.concatenate([[first], record.times[inner], [last] if last > first else []])
        self.states: Array = np.empty((len(self.t), 12))
        self.states[1 : 1 + inner.sum()] = record.states[inner]
        if last == record.times[-1]:
            self.states[-1] = record.states[-1]
        else:
            self.states[-1] = self(last)
        self.states[0] = record.states[0] if begin is None else impacts["after"][begin]
        self.torques = record.torques_in(np.arange(low, low + len(self.t) - 1))

    def __repr__(self) -> str:
        """One line."""
        return (
            f"Motion(t from {self.t[0]:g} to {self.t[-1]:g} s, {len(self.t)} states, {self.impact_count} impacts, "
            f"dt = {self.dt:g} s)"
        )

    def __call__(self, t: ArrayLike, side: Side = "after") -> Array:
        """The states at any times of the motion, shape (..., 12), SI units.

        They follow the closed flight from the last impact, or from the last control step's start, and while feet are
        at rest the motion of the exact contact model's step. Equal to the stored states at control steps' ends.

        Args:
            t: times [s], of any shape.
            side: of an impact, at a time that is exactly that of an impact: "after" or "before".

        Raises:
            TypeError, ValueError: times that are no numbers of the motion, an unknown side, or a motion of another
                contact model than the exact one.
        """
        check.choice("side", side, ("after", "before"))
        times, shape = self._times(t)
        knots = self._record.knots
        index = np.searchsorted(knots.times, times, "right") - 1
        states = self._record.flown(index, times - knots.times[index])
        if side == "before" and len(self.impacts):
            struck = np.minimum(np.searchsorted(self.impacts["time"], times), len(self.impacts) - 1)
            states = np.where((self.impacts["time"][struck] == times)[:, None], self.impacts["before"][struck], states)
        return states.reshape(*shape, 12)

    def _times(self, t: ArrayLike) -> tuple[Array, tuple[int, ...]]:
        """Checked times, flat, and their shape; the ends may be passed by what is rounding of a duration."""
        self._record.refuse_no_states()
        array = check.array("t", t, "be times [s]").astype(np.float64)
        first, last = float(self.t[0]), float(self.t[-1])
        slack = self._record.slack(last - first)
        inside = (array >= first - slack) & (array <= last + slack)
        if not inside.all():
            raise ValueError(f"t must be from {first:g} to {last:g} s, got {array[~inside].flat[0]:g}")
        return np.clip(array, first, last).ravel(), array.shape

    def energy(self, t: ArrayLike | None = None, side: Side = "after") -> Array:
        """Kinetic energy plus m_j g y_jack [J] at these times, or at ``self.t``; arguments and errors as of a call."""
        states = self.states if t is None else self(t, side)
        return np.asarray(energy_of(self.scene, np.moveaxis(states, -1, 0)))

    def work(self, t: ArrayLike | None = None) -> Array:
        """Work of the drive on the box since the start [J], at these times, or at ``self.t``.

        In flight it is what the box's kinetic energy gains: only torque and side forces act on the box, because a lift
        carries its weight. While a foot is at rest it is what the energy of box and jack gains. So impacts have no part
        in it, and ``energy - work`` changes by what they dissipate.

        Raises:
            TypeError, ValueError: as of a call; also without ``t`` for another contact model than the exact one.
        """
        times, shape = self._times(self.t if t is None else t)
        return (self._worked(times) - self._worked(self.t[:1])).reshape(shape)

    def _worked(self, times: Array) -> Array:
        """Work since the record's start [J]."""
        knots = self._record.knots
        index = np.searchsorted(knots.times, times, "right") - 1
        states = self._record.flown(index, times - knots.times[index])
        return self._worked_at_knots[index] + self._gained(index, states)

    @cached_property
    def _worked_at_knots(self) -> Array:
        knots = self._record.knots
        gained = self._gained(np.arange(len(knots.times) - 1), knots.ends)
        return np.concatenate([[0.0], np.cumsum(gained)])

    def _gained(self, index: Counts, states: Array) -> Array:
        """Work between knots and states that follow them without an impact [J]."""
        start, end = self._record.knots.states[index].T, states.T
        flying = np.asarray(box_energy(self.scene, end)) - box_energy(self.scene, start)
        return np.where(
            self._record.knots.held[index], energy_of(self.scene, end) - energy_of(self.scene, start), flying
        )

    def restart(self, k: int) -> Motion:
        """Simulate again from just after impact ``k``, under the same torque, to the end of this motion: the same bits.

        A new simulation from ``impacts["after"][k]`` agrees to rounding until the next impact; its control steps begin
        at other times. This one repeats the control step of the impact from that step's start.

        Args:
            k: number of the impact, from 0; negative: from the end.

        Raises:
            TypeError, ValueError: there is no such impact.
        """
        self._record.refuse_no_states()
        count = len(self.impacts)
        if not count:
            raise ValueError(f"k must be the number of an impact, and this motion has none, got {check.shown(k)}")
        k = check.whole("k", k, at_least=-count, at_most=count - 1)
        row = int(self._rows[k])
        begin = row - int(np.searchsorted(self._record.steps, self._record.steps[row]))
        return Motion(restarted(self._record, row), begin=begin, end=float(self.t[-1]))

    @property
    def counts(self) -> Counts:
        """Number of impacts of each control step, shape (n - 1,)."""
        if len(self.t) == 1:
            return np.zeros(0, np.int64)
        steps = np.minimum(self._record.steps[self._rows] - self._low, len(self.t) - 2)
        return np.bincount(steps, minlength=len(self.t) - 1)

    @property
    def impact_count(self) -> int:
        """Number of impacts, without those of feet at rest; with pymunk, which does not distinguish them, with them."""
        return len(self.impacts) - int((self._record.held[self._rows] < 0).sum())

    @property
    def hits(self) -> list[Impact]:
        """The impacts as :class:`jackbox_env.Impact`, without states."""
        return [Impact(*row) for row in zip(*(self.impacts[name].tolist() for name in Impact._fields), strict=True)]

    @cached_property
    def mean_torques(self) -> Array:
        """Mean torque on the box over each control step [N m], shape (n - 1,)."""
        if self.torques is not None:
            return self.torques
        drive, spans = self.scene.drive or Drive(), zip(self.t[:-1].tolist(), np.diff(self.t).tolist(), strict=True)
        return np.array([sum(drive.torque_means(start, length)) / 2.0 for start, length in spans])

    def to_frame(self, table: Literal["states", "impacts"] = "states") -> Any:
        """The states as a pandas.DataFrame: columns time, the 12 names of a state, torque; a row for each of ``t``.

        A row's torque is the mean over the control step that begins there; the last row's is NaN. The table "impacts"
        has a row for each of ``impacts``, with columns as "before x_box"; ``resting`` is 1 for a foot at rest.

        Raises:
            ValueError: an unknown table.
            ImportError: pandas is not installed.
        """
        return frame(self.tables()[check.choice("table", table, ("states", "impacts")) == "impacts"])

    def save(self, path: str | Path) -> list[Path]:
        """Write a new file by the suffix of its name: .npz, .csv or .mat. With .csv the impacts have a second file.

        A file .npz or .mat has the arrays time (n,), state (n, 12), torque (n - 1,), the mean of each step, and
        impact_time (m,) and so on; and the text ``scene``, the JSON of the scene's fields, unless its drive is of
        functions.

        Returns:
            The new files.

        Raises:
            TypeError, ValueError: another suffix.
            OSError: a file exists, or cannot be written.
            ImportError: .mat without SciPy.
        """
        named = {"time": self.t, "state": self.states, "torque": self.mean_torques}
        named |= {f"impact_{name}": np.asarray(self.impacts[name]) for name in self.impacts.dtype.fields or ()}
        with suppress(ValueError):  # a drive of functions has no JSON form
            named["scene"] = np.array(json.dumps(self.scene.as_dict()))
        return save(Path(path), named, self.tables())

    def tables(self) -> tuple[Columns, Columns]:
        """The columns of states, with NaN for the torque after the last one, and those of impacts."""
        torque = np.append(self.mean_torques, np.nan)
        states = {("time", "s"): self.t, **by_name("", self.states), ("torque", "N m"): torque}
        units = {"time": "s", "impulse": "N s"}
        impacts = {(name, units.get(name, "")): self.impacts[name] for name in Impact._fields}
        if "before" in (self.impacts.dtype.names or ()):
            for side in ("before", "after"):
                impacts |= by_name(f"{side} ", self.impacts[side])
            impacts[("resting", "")] = self.impacts["resting"].astype(np.int64)
        return states, impacts
