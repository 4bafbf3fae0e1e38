"""Multiple shooting: recordings cut into windows of a few impacts, whose starts are unknowns beside the scene's fields.

A window's motion is the exact model's from its start. Where one window follows another, its end must be the other's
start, within a slack that a fit tightens step by step. So no error grows through more than a few impacts on the way to
the solution (Bock 1983, "Recent advances in parameter identification techniques for O.D.E."; MuJoCo's ``sysid`` plays
whole recordings instead). Derivatives are those of ``linearize``, and its steps without a derivative end what a window
tells.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.measure.recordings import Recording
from jackbox_env.planning.linearization import linearize
from jackbox_env.scene import Scene
from jackbox_env.simulators import JackLostError
from jackbox_env.states import Array

Places = NDArray[np.intp]

_AHEAD = 2.0  # [s] that a window is looked for in
_APART = 0.05  # [s] between impacts of one window and of the next
_SHORTEST = 0.06  # [s] of a window; the bounces of a pile leave less
_TOGETHER = 4  # impacts in a window, at most: more are the end of a pile, in which nothing can be told
_NEAR = 0.5  # [s] within which an impact that was heard may be the model's
_LOGARITHMIC = ("box_mass", "box_inertia", "jack_mass", "jack_inertia", "jack_arm", "box_half_width")
_WIDEST = math.log(1e3)  # logarithm of how far from the start's a mass or a length may be


@dataclass
class Window:
    """A stretch of a recording."""

    recording: int
    first: int  # step
    last: int  # step that it ends before
    linked: bool = False  # whether the next window goes on from it
    start: Array = field(default_factory=lambda: np.zeros(12))


class Motion(NamedTuple):
    """A window's motion by the model."""

    states: Array  # (steps + 1, 12)
    by: Array  # of the states by the window's start and the fields, (steps + 1, 12, 12 + F); 0 where there is none
    smooth: int  # steps before the first that has no derivative
    times: Array  # of impacts in these steps [s], (m,)
    times_by: Array  # (m, 12 + F)


class Parameters:
    """The fields as numbers to be searched: logarithms of what is above 0, gravity over 9.81, restitution as it is."""

    def __init__(self, fields: Sequence[str], start: Scene) -> None:
        self.fields, self.start = tuple(fields), start
        self.logarithmic = np.array([name in _LOGARITHMIC for name in fields], dtype=bool)
        self._unit = np.array([9.81 if name == "gravity" else 1.0 for name in fields])
        first = self.of(start)
        self.low = np.where(self.logarithmic, first - _WIDEST, 0.0)
        self.high = np.where(self.logarithmic, first + _WIDEST, np.inf)
        self.high[np.array(fields) == "restitution"] = 1.0

    def of(self, scene: Scene) -> Array:
        """The numbers of a scene, shape (F,)."""
        values = np.array([getattr(scene, name) for name in self.fields])
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, values, 1.0)), values / self._unit)

    def values(self, numbers: Array) -> Array:
        """The fields' values, shape (F,)."""
        with np.errstate(over="ignore"):  # to infinity, where nothing is told
            return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, numbers, 0.0)), numbers * self._unit)

    def scene(self, numbers: Array) -> Scene:
        """The scene of these numbers; an inertia that was not given follows.

        Raises:
            ValueError: there is no such scene.
        """
        return self.start.changed(**dict(zip(self.fields, self.values(numbers).tolist(), strict=True)))

    def slopes(self, numbers: Array) -> Array:
        """How the fields' values change with the numbers, shape (F,)."""
        return np.where(self.logarithmic, self.values(numbers), self._unit)


def units(scene: Scene) -> Array:
    """Units of the 12 numbers of a state: L, v0, v0 / L, and v0 / l of the jack's rate."""
    length, speed = scene.box_half_width, scene.speed_scale
    rates = speed, speed, speed / length, speed, speed, speed / scene.jack_arm
    return np.array([length, length, 1.0, length, length, 1.0, *rates])


def motion(recording: Recording, window: Window, parameters: Parameters, numbers: Array) -> Motion | None:
    """The motion of a window from its start; None if the model cannot follow it."""
    steps, count = slice(window.first, window.last), window.last - window.first
    inside = (numbers >= parameters.low) & (numbers <= parameters.high)  # beyond it nothing changes
    numbers = np.clip(numbers, parameters.low, parameters.high)
    torques = None if recording.torques is None else recording.torques[steps]
    time = recording.time + window.first * recording.dt
    try:
        lin = linearize(
            parameters.scene(numbers), window.start, torques, recording.dt, time, fields=parameters.fields,
            steps=count if torques is None else None, num_threads=1,
        )  # fmt: skip
    except (ValueError, JackLostError):
        return None
    smooth = count if lin.smooth.all() else int(np.argmin(lin.smooth[0]))
    by = np.zeros((count + 1, 12, 12 + len(numbers)))
    by[0, :, :12] = np.eye(12)
    slopes = parameters.slopes(numbers) * inside
    for k in range(smooth):
        by[k + 1] = lin.A[0, k] @ by[k]
        by[k + 1, :, 12:] += lin.P[0, k] * slopes
    within, since, derivatives = lin.impacts(0)
    told = within < smooth
    within, since, derivatives = within[told], since[told], derivatives[told]
    times_by = np.einsum("mi,mij->mj", derivatives[:, :12], by[within])
    times_by[:, 12:] += derivatives[:, 13:] * slopes
    return Motion(lin.trajectories[0], by, smooth, time + within * recording.dt + since, times_by)


def nearest_pairs(heard: Array, times: Array) -> tuple[Places, Places]:
    """Numbers of impacts that were heard and of the model's that may be the same, each at most once, in order."""
    pairs, taken = [], -1
    for number, time in enumerate(heard):
        later = np.arange(taken + 1, len(times))
        if len(later):
            nearest = int(later[np.argmin(abs(times[later] - time))])
            if abs(times[nearest] - time) < _NEAR:
                pairs.append((number, nearest))
                taken = nearest
    found = np.array(pairs, dtype=np.intp).reshape(-1, 2)
    return found[:, 0], found[:, 1]


LINK, UNHEARD = -1, -2


class Rows(NamedTuple):
    """Residuals, their derivatives by all unknowns, and what each is of: a number of the state, 12 an impact's time."""

    residuals: Array  # (modelled - observed) / noise
    by: Array  # (rows, unknowns)
    column: Places  # 0 to 12; LINK, or UNHEARD: an impact that the model does not have
    window: Places  # number of the window


class Shooting:
    """Windows of recordings and the scene's numbers, all in one vector of unknowns: fields first, then starts.

    ``anchor`` holds the first of these unknowns near a place, with standard deviations, while little is known.
    """

    def __init__(
        self, recordings: Sequence[Recording], parameters: Parameters, windows: Sequence[Window],
        anchor: tuple[Array, Array] | None = None,
    ) -> None:  # fmt: skip
        self.recordings, self.parameters, self.windows = recordings, parameters, list(windows)
        self.units, self._anchor = units(parameters.start), anchor

    def unknowns(self, numbers: Array) -> Array:
        """The vector of unknowns: the fields' numbers, and the windows' starts in their units."""
        return np.concatenate([numbers, *(window.start / self.units for window in self.windows)])

    def put(self, unknowns: Array) -> Array:
        """Put starts into the windows; return the fields' numbers."""
        count = len(self.parameters.fields)
        for window, start in zip(self.windows, unknowns[count:].reshape(-1, 12), strict=True):
            window.start = start * self.units
        return unknowns[:count]

    def rows(self, unknowns: Array, noise: Array, slack: float) -> Rows | None:
        """Everything that should be 0; None if a motion cannot be followed.

        Args:
            unknowns: of :meth:`unknowns`.
            noise: standard deviations of the 12 numbers of a state and of impacts' times [s], shape (13,).
            slack: of a link, in units of the state.
        """
        numbers, made = self.put(unknowns), list[Rows]()
        for place, window in enumerate(self.windows):
            found = motion(self.recordings[window.recording], window, self.parameters, numbers)
            if found is None:
                return None
            made.append(self._observed(place, window, found, noise))
            if window.linked:
                made.append(self._link(place, window, found, slack))
        if self._anchor is not None:
            anchor, width = self._anchor
            off, count = (unknowns[: len(anchor)] - anchor) / width, len(anchor)
            made.append(Rows(off, np.eye(count, len(unknowns)) / width[:, None], *[np.full(count, LINK)] * 2))
        return Rows(*(np.concatenate(parts) for parts in zip(*made, strict=True)))

    def _spread(self, place: int, by: Array) -> Array:
        """Derivatives by a window's start and the fields, in the columns of all unknowns."""
        fields = len(self.parameters.fields)
        whole = np.zeros((len(by), fields + 12 * len(self.windows)))
        whole[:, :fields] = by[:, 12:]
        whole[:, fields + 12 * place : fields + 12 * place + 12] = by[:, :12] * self.units
        return whole

    def _observed(self, place: int, window: Window, found: Motion, noise: Array) -> Rows:
        recording = self.recordings[window.recording]
        until = window.last + (0 if window.linked else 1)  # the last row belongs to the next window
        seen = recording.states[window.first : until]
        sample, column = np.nonzero(np.isfinite(seen))
        off = (found.states[sample, column] - seen[sample, column]) / noise[column]
        by = found.by[sample, column] / noise[column, None]
        if recording.impacts is not None:
            begin, end = (recording.time + step * recording.dt for step in (window.first, window.last))
            heard = recording.impacts[(recording.impacts >= begin) & (recording.impacts < end)]
            one, other = nearest_pairs(heard, found.times)
            late, late_by = np.full(len(heard), _NEAR), np.zeros((len(heard), by.shape[1]))
            late[one], late_by[one] = found.times[other] - heard[one], found.times_by[other]
            off, by = np.concatenate([off, late / noise[12]]), np.concatenate([by, late_by / noise[12]])
            column = np.concatenate([column, np.where(np.isin(np.arange(len(heard)), one), 12, UNHEARD)])
        return Rows(off, self._spread(place, by), column, np.full(len(off), place))

    def _link(self, place: int, window: Window, found: Motion, slack: float) -> Rows:
        scale = slack * self.units
        by = self._spread(place, found.by[-1] / scale[:, None])
        fields = len(self.parameters.fields)
        by[:, fields + 12 * place + 12 : fields + 12 * place + 24] -= np.eye(12) / slack
        off = (found.states[-1] - self.windows[place + 1].start) / scale
        return Rows(off, by, np.full(12, LINK), np.full(12, place))


def next_window(
    recording: Recording, number: int, first: int, start: Array, parameters: Parameters, numbers: Array
) -> Window | None:
    """The window from a step and a state on, with one impact, or some that follow each other closely.

    It ends half way to the next impact. None where the jack comes to rest, or cannot be followed.
    """
    most = len(recording.states) - 1
    ahead = math.ceil(_AHEAD / recording.dt)
    while True:
        last = min(most, first + ahead)
        window = Window(number, first, last, start=start)
        found = motion(recording, window, parameters, numbers)
        if found is None:
            return None
        apart = np.flatnonzero(np.diff(found.times) > _APART)
        count = int(apart[0]) + 1 if len(apart) else len(found.times)
        if count > _TOGETHER or (found.smooth < last - first and not len(apart)):
            return None
        if len(apart):
            middle = 0.5 * (found.times[count - 1] + found.times[count])
            window.last = first + max(1, round((middle - recording.time) / recording.dt) - first)
            return window if window.last - first > _SHORTEST / recording.dt else None
        if last == most:
            return window
        ahead *= 2
