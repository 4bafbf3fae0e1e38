"""Recordings of a real jack in a box, or of another simulator's: observed states, torques and impact times.

``jackbox_env.fit`` fits scenes to them. Its search begins with the first state and the noise that are estimated here
without any model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env.fits.columns import evened
from jackbox_env.fits.tables import Table, stored_scene, table_of
from jackbox_env.fits.torques import TORQUE_KINDS, torques_between
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import LATEST_TIME, RATES, STATE_NAMES, Array
from jackbox_env.tools import checks as check

SHORTEST = 1e-9  # [s] between states
IMPACT = "impacts"  # the name of the noise of impacts' times
_SMALLEST_NOISE = 1e-12  # of the argument, in SI units
_FIRST_NOISE = 1e-2  # assumed without enough rows, in units of the state; of impacts' times [s]
_SMOOTH = 1.45  # times the noise; of medians and means over 3 rows and more 1.5 and more
_LEAST_DIFFERENCES = 20  # third differences, more of which give an estimate of the noise


class Recording:
    """Observed states of a jack in a box, the torques that acted, and the times at which impacts were heard.

    >>> states = np.full((3, 12), np.nan)
    >>> states[:, 4] = 1.0, 0.998, 0.992  # only the jack's height was observed
    >>> recording = Recording(states, torques=[5e3, 5e3], dt=0.02)
    >>> recording.torques, recording.impacts
    (array([5000., 5000.]), None)

    Args:
        states: shape (H + 1, 12), NaN where something was not observed.
        torques: on the box [N m], each constant for ``dt``, shape (H,), or for ``dt / K``, shape (H, K); None: the
            scene's drive acted.
        dt: between states [s], from 1e-9 to 1e9.
        time: of the first state [s].
        impacts: times at which impacts were heard [s], in order; None: nobody listened.
        torque: "held"; or ``torques`` were measured with the states, shape (H + 1,): "sampled" from a smooth curve,
            or "linear" from one to the next. The means of each quarter of a step act.

    Attributes:
        states, torques, dt, time, impacts: the same, as arrays and floats; ``torques`` are those that act.
        notes: what :meth:`from_frame` changed, each in a sentence without a full stop.

    Raises:
        TypeError, ValueError: unusable values, or nothing observed.
    """

    def __init__(
        self, states: ArrayLike, torques: ArrayLike | None, dt: float, time: float = 0.0,
        impacts: ArrayLike | None = None, torque: str = "held",
    ) -> None:  # fmt: skip
        check.choice("torque", torque, TORQUE_KINDS)
        self.states: Array = np.array(check.array("states", states, "be numbers"), dtype=np.float64)
        if self.states.ndim != 2 or self.states.shape[1] != 12 or len(self.states) < 2:
            raise ValueError(f"states must have shape (H + 1, 12) with H >= 1, got {self.states.shape}")
        if np.isinf(self.states).any():
            row, column = np.argwhere(np.isinf(self.states))[0]
            raise ValueError(
                f"states must be finite or NaN, got {STATE_NAMES[column]} = {self.states[row, column]} in row {row}"
            )
        self.dt = check.real("dt", dt, at_least=SHORTEST, at_most=LATEST_TIME)
        self.time = check.real("time", time, at_least=-LATEST_TIME, at_most=LATEST_TIME)
        count, one = (len(self.states) - 1, "step") if torque == "held" else (len(self.states), "state")
        self.torques = None if torques is None else check.finite("torques", torques)
        shape = (count,) if self.torques is None else self.torques.shape
        if shape[0] != count or len(shape) > (2 if torque == "held" else 1) or 0 in shape:
            raise ValueError(f"torques must have shape ({count},), one for each {one}, got {shape}")
        if self.torques is not None and torque != "held":
            self.torques = torques_between(self.torques, torque)
        self.impacts = None if impacts is None else check.finite("impacts", impacts)
        if self.impacts is not None and (self.impacts.ndim != 1 or (np.diff(self.impacts) < 0.0).any()):
            raise ValueError(f"impacts must be times in order, got {check.shown(impacts)}")
        heard, end = np.zeros(0) if self.impacts is None else self.impacts, self.time + count * self.dt
        if len(heard) and not ((heard >= self.time) & (heard <= end)).any():
            raise ValueError(
                f"impacts must be within the recording, from {self.time:.6g} to {end:.6g} s, got {heard[0]:.6g} s "
                "first: another clock?"
            )
        if not (len(heard) or np.isfinite(self.states).any()):
            raise ValueError("states must have an observed number, got NaN only and no impacts")
        self.notes: tuple[str, ...] = ()

    @classmethod
    def from_frame(
        cls, columns: Any, scene: Scene | Mapping[str, Any] | None = None,
        *, names: Mapping[str, str] | None = None, y_down: bool = False, impacts: ArrayLike | None = None,
        torque: str = "held", scale: float | None = None,
    ) -> Recording:  # fmt: skip
        """The recording of a table, of a camera for example.

        The columns are ``time``, any of the 12 numbers of a state, and ``torque``. A header may have a unit, as
        ``x_jack [mm]``; SI without one. Times may be off an even grid by 5 % of a step. Frames that are missing are
        left open, and the torque of the row before them goes on. Angles that stay within one turn and jump are
        unwrapped. Torques that are the means of the scene's drive, or none, mean that the drive acts.

        >>> seen = {"t [ms]": [0.0, 16.7, 50.0], "ball [mm]": [10.0, 12.0, None]}
        >>> recording = Recording.from_frame(seen, names={"time": "t", "x_jack": "ball"})
        >>> recording.states[:, 3], recording.notes
        (array([0.01 , 0.012,   nan,   nan]), ('1 of 4 frames is missing, and left open',))

        Args:
            columns: a dict of columns, a DataFrame of pandas or polars (its levels of headers are joined by spaces), or
                an array with named fields; NaN or None if something was not observed. Or
                ``np.load("trajectory.npz")``, of ``jackbox simulate --format npz``, or a
                :class:`jackbox_env.fits.tables.Table`.
            scene: whose sizes and drive the recording is compared with; None: the scene in the npz file, else the
                default scene.
            names: headers that stand for other names here, as ``{"x_jack": "ball_x", "time": "t [ms]"}``. Headers
                that are no names here are then left out.
            y_down: whether y points downwards and angles are clockwise, as in images. A torque stays.
            impacts: times at which impacts were heard [s].
            torque: whether each torque was "held" to the next row, "sampled" from a smooth curve, or "linear" to the
                next.
            scale: pixels per metre, of columns in px.

        Raises:
            TypeError, ValueError: unusable columns, and sizes that are no metres, radians or seconds.
        """
        check.flag("y_down", y_down)
        scene = Scene.of(stored_scene(columns) if scene is None else scene)
        table = (columns if isinstance(columns, Table) else table_of(columns))._replace(
            scale=None if scale is None else check.real("scale", scale, above=0.0)
        )
        impacts = None if impacts is None else check.finite("impacts", impacts)
        arguments, notes = evened(table, scene, names, y_down, impacts, torque)
        try:
            recording = cls(**arguments)
        except ValueError as error:
            raise ValueError(f"{table.source.removesuffix(', ')}: {error}" if table.source else str(error)) from error
        recording.notes = notes
        return recording


def state_at_first(recording: Recording) -> Array:
    """A guess of the state in the first row: observed numbers, rates from the next positions, else 0."""
    observed, state = recording.states, np.zeros(12)
    for column in range(RATES):
        rows = np.flatnonzero(np.isfinite(observed[:, column]))[:5]
        if len(rows):
            line = np.polyfit(rows * recording.dt, observed[rows, column], int(len(rows) > 1 and rows[-1] < 10))
            state[column], state[column + RATES] = line[-1], line[0] * (len(line) > 1)
    return np.where(np.isfinite(observed[0]) & (np.arange(12) >= RATES), observed[0], state)


def known_noise(noise: Any) -> Array:
    """Standard deviations of the 12 numbers of a state and of impacts' times, shape (13,); NaN: to be estimated."""
    names, known = (*STATE_NAMES, IMPACT), np.full(13, np.nan)
    by_name = noise if isinstance(noise, Mapping) else {} if noise is None else dict.fromkeys(names, noise)
    check.known_keys("noise", by_name, names)
    for name, value in by_name.items():
        known[names.index(name)] = check.real(f"noise of {name}", value, at_least=_SMALLEST_NOISE)
    return known


def rough_noise(recordings: Sequence[Recording], units: Array) -> Array:
    """Noise of the state's numbers and of impacts' times, shape (13,), from third differences, about 0 in free flight.

    They are divided differences of the rows that were observed, over their standard deviation at unit noise.
    """
    noise = _FIRST_NOISE * units
    for column in range(12):
        differences = abs(np.concatenate([_third_differences(one.states[:, column]) for one in recordings]))
        if len(differences) > _LEAST_DIFFERENCES:
            noise[column] = max(float(np.median(differences)) / 0.6745, 1e-6 * units[column])
    return noise


def looks_smoothed(recordings: Sequence[Recording]) -> bool:
    """Whether each position has more noise by every second row than by all, as no white noise has."""
    columns = [column for one in recordings for column in one.states[:, :RATES].T]
    both = [(_third_differences(values), _third_differences(values[::2])) for values in columns]
    enough = [(every, second) for every, second in both if len(second) > _LEAST_DIFFERENCES]
    more = [np.median(abs(second)) > _SMOOTH * np.median(abs(every)) for every, second in enough]
    return bool(more) and all(more)


def _third_differences(values: Array) -> Array:
    """Third divided differences of the values that are not NaN, of variance 1 if the values have; at most (n - 3,)."""
    rows = np.flatnonzero(np.isfinite(values))
    if len(rows) < 4:
        return np.zeros(0)
    four = np.lib.stride_tricks.sliding_window_view(rows, 4).astype(np.float64)
    weights = 1.0 / np.prod(four[:, :, None] - four[:, None, :] + np.eye(4), axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    return np.asarray((weights * np.lib.stride_tricks.sliding_window_view(values[rows], 4)).sum(axis=1))
