"""Multiple shooting: the residuals of recordings that are cut into windows of a few impacts, and their Jacobian.

The unknowns are the scene's fields and the windows' first states. A window's motion is the exact model's from its first
state. If one window follows another, its end must be the other's start, within a slack that
:mod:`jackbox_env.fits.fitting` tightens step by step. So no error grows through more than a few impacts on the way
to the solution (Bock 1983, "Recent advances in parameter identification techniques for O.D.E."; MuJoCo's ``sysid``
plays whole recordings instead). Derivatives are those of ``linearize``; after its first step without one they are 0.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from jackbox_env.fits.least_squares import FAR, FARTHEST, LINK, UNHEARD, WIDTH, Indices, Rows
from jackbox_env.fits.observed import Recording
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array
from jackbox_env.planning.linearization import linearize
from jackbox_env.simulators import JackLostError

_AHEAD = 2.0  # [s] simulated to locate a window's end
_APART = 0.05  # [s] between impacts of one window and of the next, in all but small boxes; a window lasts longer
_SMALL = 0.15  # [s], sqrt(L / g) of boxes below which that shrinks
MOST_IMPACTS = 4  # in a window; more are bounces that pile up, which identify nothing
_GROUPED = 8  # steps, by less than which windows that are played together differ in length
_NEAR = 0.5  # [s] within which an impact that was heard may be the model's
_LOGARITHMIC = ("box_mass", "box_inertia", "jack_mass", "jack_inertia", "jack_arm", "box_half_width")
_WIDEST = math.log(1e3)  # logarithm of how far from the start's a mass or a length may be


@dataclass
class Window:
    """A stretch of a recording."""

    recording: int
    first: int  # step
    last: int  # step that it ends before
    linked: bool = False  # whether the next window starts from its end
    start: Array = field(default_factory=lambda: np.zeros(12))


class WindowMotion(NamedTuple):
    """A window's motion by the model."""

    states: Array  # (steps + 1, 12)
    jacobians: Array  # of the states by the window's start and the fields, (steps + 1, 12, 12 + F); 0 if not smooth
    smooth: int  # steps before the first that is not differentiable
    times: Array  # of impacts in these steps [s], (m,)
    times_jacobian: Array  # (m, 12 + F)


class Parameters:
    """The fields as search variables: logarithms of masses, lengths and inertias, gravity over 9.81, restitution."""

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
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, numbers, 0.0)), numbers * self._unit)

    def scene(self, numbers: Array) -> Scene:
        """The scene of these numbers; an inertia that was not given follows.

        Raises:
            ValueError: there is no such scene.
        """
        return self.start.changed(**dict(zip(self.fields, self.values(numbers).tolist(), strict=True)))

    def slopes(self, numbers: Array) -> Array:
        """Derivatives of the fields' values by the numbers, shape (F,)."""
        return np.where(self.logarithmic, self.values(numbers), self._unit)


def units(scene: Scene) -> Array:
    """Units of the 12 numbers of a state: L, v0, v0 / L, and v0 / l of the jack's rate."""
    length, speed = scene.box_half_width, scene.speed_scale
    rates = speed, speed, speed / length, speed, speed, speed / scene.jack_arm
    return np.array([length, length, 1.0, length, length, 1.0, *rates])


def motions(
    recordings: Sequence[Recording], windows: Sequence[Window], parameters: Parameters, numbers: Array
) -> list[WindowMotion | None]:
    """The motions of windows from their starts; None for those that the model cannot follow.

    Windows of about the same length, of a recording, are played in one call: each as long as the longest.
    """
    groups, results = dict[tuple[int, int], list[int]](), dict[int, WindowMotion | None]()
    for index, window in enumerate(windows):
        groups.setdefault((window.recording, (window.last - window.first) // _GROUPED), []).append(index)
    for (recording, _), members in groups.items():
        played: Sequence[WindowMotion | None] | None = _played(
            recordings[recording], [windows[index] for index in members], parameters, numbers
        )
        if played is None:  # what comes after a shorter one may be at fault
            played = [motion(recordings[recording], windows[index], parameters, numbers) for index in members]
        results.update(zip(members, played, strict=True))
    return [results[index] for index in range(len(windows))]


def _played(
    recording: Recording, windows: Sequence[Window], parameters: Parameters, numbers: Array
) -> list[WindowMotion] | None:
    """The motions of windows of a recording; None if the model cannot follow one."""
    torques = recording.torques
    parts = 1 if torques is None else torques.size // len(torques)  # of a step
    counts, dt = [parts * (window.last - window.first) for window in windows], recording.dt / parts
    longest = max(counts)
    if torques is not None:
        steps = np.add.outer([parts * window.first for window in windows], np.arange(longest))
        torques = torques.ravel()[np.minimum(steps, torques.size - 1)]
    times = [recording.time + window.first * recording.dt for window in windows]
    try:
        lin = linearize(
            parameters.scene(numbers), [window.start for window in windows], torques, dt, times,
            fields=parameters.fields, steps=longest if torques is None else None, num_threads=1,
        )  # fmt: skip
    except (ValueError, JackLostError):
        return None
    smooth = np.where(lin.smooth.all(axis=1), longest, np.argmin(lin.smooth, axis=1))
    jacobians = np.zeros((longest + 1, len(windows), 12, 12 + len(numbers)))
    jacobians[0, :, :, :12] = np.eye(12)
    slopes = parameters.slopes(numbers)
    followed = (np.arange(longest) < smooth[:, None])[:, :, None, None]
    by_state, by_field = np.where(followed, lin.A, 0.0), np.where(followed, lin.P * slopes, 0.0)
    for k in range(int(smooth.max())):
        np.matmul(by_state[:, k], jacobians[k], out=jacobians[k + 1])
        jacobians[k + 1, :, :, 12:] += by_field[:, k]
    results = list[WindowMotion]()
    for row, (count, time) in enumerate(zip(counts, times, strict=True)):
        step, since, gradients = lin.impacts(row)
        usable = step < min(smooth[row], count)
        step, since, gradients = step[usable], since[usable], gradients[usable]
        by_start = jacobians[: count + 1, row]
        times_jacobian = np.einsum("mi,mij->mj", gradients[:, :12], by_start[step])
        times_jacobian[:, 12:] += gradients[:, 13:] * slopes
        states, at = lin.trajectories[row, : count + 1 : parts], time + step * dt + since
        results.append(
            WindowMotion(states, by_start[::parts], min(int(smooth[row]), count) // parts, at, times_jacobian)
        )
    return results


def motion(recording: Recording, window: Window, parameters: Parameters, numbers: Array) -> WindowMotion | None:
    """The motion of a window from its start; None if the model cannot follow it."""
    return next(iter(_played(recording, [window], parameters, numbers) or ()), None)


def nearest_pairs(heard: Array, times: Array) -> tuple[Indices, Indices]:
    """Match times of heard impacts with the model's, each at most once and in order: indices into both."""
    away = abs(np.subtract.outer(heard, np.append(times, np.inf)))
    nearest = away.argmin(axis=1)
    first = np.unique(nearest, return_index=True)[1]
    of_heard = first[away[first, nearest[first]] < _NEAR]
    return of_heard, nearest[of_heard]


class Shooting:
    """Windows of recordings and the scene's numbers, all in one vector of unknowns: fields first, then starts.

    ``prior``: mean and standard deviation of the first of these unknowns, while little is known; None: no prior.
    """

    def __init__(
        self, recordings: Sequence[Recording], parameters: Parameters, windows: Sequence[Window],
        prior: tuple[Array, Array] | None = None,
    ) -> None:  # fmt: skip
        self.recordings, self.parameters, self.windows = recordings, parameters, list(windows)
        self.units, self._prior = units(parameters.start), prior
        self.not_followed = list[int]()  # windows, at the last unknowns

    def unknowns(self, numbers: Array) -> Array:
        """The vector of unknowns: the fields' numbers, and the windows' starts in their units."""
        return np.concatenate([numbers, *(window.start / self.units for window in self.windows)])

    def set_starts(self, unknowns: Array) -> Array:
        """Set the windows' starts; return the fields' numbers."""
        count = len(self.parameters.fields)
        for window, start in zip(self.windows, unknowns[count:].reshape(-1, 12), strict=True):
            window.start = start * self.units
        return unknowns[:count]

    def rows(self, unknowns: Array, noise: Array, slack: float) -> Rows | None:
        """All residuals; None if a motion cannot be followed.

        Args:
            unknowns: as :meth:`unknowns` returns them.
            noise: standard deviations of the 12 numbers of a state and of impacts' times [s], shape (13,).
            slack: of a link, in units of the state.
        """
        numbers, parts = self.set_starts(unknowns), list[Rows]()
        if self._prior is not None:
            mean, width = self._prior
            count = len(mean)
            fields = count - WIDTH
            jacobian = np.zeros((count, 2 * WIDTH + fields))
            jacobian[:fields, 2 * WIDTH :], jacobian[fields:, :WIDTH] = np.eye(fields), np.eye(WIDTH)
            columns = np.full(count, LINK), np.zeros(count, np.intp)
            parts.append(Rows((unknowns[:count] - mean) / width, jacobian / width[:, None], *columns))
        played = motions(self.recordings, self.windows, self.parameters, numbers)
        self.not_followed = [index for index, modelled in enumerate(played) if modelled is None]
        for index, (window, modelled) in enumerate(zip(self.windows, played, strict=True)):
            if modelled is None:
                return None
            parts.append(self._observed(index, window, modelled, noise))
            if window.linked:
                parts.append(self._link(index, modelled, slack))
        return Rows(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))

    def _spread(self, jacobian: Array) -> Array:
        """Derivatives by a window's start and the fields as rows of a chain."""
        whole = np.zeros((len(jacobian), WIDTH + jacobian.shape[1]))
        whole[:, :WIDTH], whole[:, 2 * WIDTH :] = jacobian[:, :WIDTH] * self.units, jacobian[:, WIDTH:]
        return whole

    def _observed(self, index: int, window: Window, modelled: WindowMotion, noise: Array) -> Rows:
        recording = self.recordings[window.recording]
        until = window.last + (0 if window.linked else 1)  # the last row belongs to the next window
        observed = recording.states[window.first : until]
        row, column = np.nonzero(np.isfinite(observed))
        off = (modelled.states[row, column] - observed[row, column]) / noise[column]
        away = np.maximum(abs(off), FARTHEST)
        least = FARTHEST * np.sqrt(1.0 + 2.0 * np.log(away / FARTHEST))  # a robust loss; itself up to the farthest
        slopes = FARTHEST**2 / (away * least)
        off, jacobian = off * least / away, modelled.jacobians[row, column] * (slopes / noise[column])[:, None]
        column = np.where(away > FARTHEST, FAR, column)
        if recording.impacts is not None:
            begin, end = (recording.time + step * recording.dt for step in (window.first, window.last))
            heard = recording.impacts[(recording.impacts >= begin) & (recording.impacts < end)]
            of_heard, of_model = nearest_pairs(heard, modelled.times)
            late, gradients = np.full(len(heard), _NEAR), np.zeros((len(heard), jacobian.shape[1]))
            late[of_heard] = modelled.times[of_model] - heard[of_heard]
            gradients[of_heard] = modelled.times_jacobian[of_model]
            off = np.concatenate([off, late / noise[12]])
            jacobian = np.concatenate([jacobian, gradients / noise[12]])
            column = np.concatenate([column, np.where(np.isin(np.arange(len(heard)), of_heard), 12, UNHEARD)])
        return Rows(off, self._spread(jacobian), column, np.full(len(off), index))

    def _link(self, index: int, modelled: WindowMotion, slack: float) -> Rows:
        scale = slack * self.units
        jacobian = self._spread(modelled.jacobians[-1] / scale[:, None])
        jacobian[:, WIDTH : 2 * WIDTH] = -np.eye(WIDTH) / slack
        off = (modelled.states[-1] - self.windows[index + 1].start) / scale
        return Rows(off, jacobian, np.full(12, LINK), np.full(12, index))


def brief(scene: Scene) -> float:
    """The least time between impacts of different windows [s]; what follows sooner may pile up."""
    return _APART * min(1.0, math.sqrt(scene.box_half_width / max(scene.gravity, 1e-9)) / _SMALL)


def next_window(
    recording: Recording, number: int, first: int, start: Array, parameters: Parameters, numbers: Array
) -> Window | None:
    """The window that starts from a state at a step, with one impact, or some that follow each other closely.

    It ends half way to the next impact. None if the jack comes to rest, or cannot be followed.
    """
    window = Window(
        number, first, min(len(recording.states) - 1, first + math.ceil(_AHEAD / recording.dt)), start=start
    )
    modelled = motion(recording, window, parameters, numbers)
    if modelled is None:
        return None
    apart = np.flatnonzero(np.diff(modelled.times) > brief(parameters.start))
    count = int(apart[0]) + 1 if len(apart) else len(modelled.times)
    if count > MOST_IMPACTS or (modelled.smooth < window.last - first and not len(apart)):
        return None
    if len(apart):
        middle = 0.5 * (modelled.times[count - 1] + modelled.times[count])
        window.last = first + max(1, round((middle - recording.time) / recording.dt) - first)
        return window if window.last - first > 1.2 * brief(parameters.start) / recording.dt else None
    return window


def end_state(recording: Recording, window: Window, parameters: Parameters, numbers: Array) -> Array:
    """The model's state at a window's end; its start if the model cannot follow."""
    modelled = motion(recording, window, parameters, numbers)
    return window.start if modelled is None else modelled.states[-1]
