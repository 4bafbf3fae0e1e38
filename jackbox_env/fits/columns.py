"""Recordings from columns as cameras and loggers write them: wrapped angles, dropped frames, sizes that are no metres.

``Recording.from_frame`` and ``jackbox fit`` use it. :mod:`jackbox_env.fits.tables` reads the columns.
"""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jackbox_env.fits.tables import UNITS, Table, filled, in_si_units
from jackbox_env.fits.torques import without_gaps
from jackbox_env.model.scene import Chirp, Drive, Scene
from jackbox_env.model.states import (
    LATEST_TIME,
    RATES,
    STATE_NAMES,
    STATE_UNITS,
    THETA_BOX,
    THETA_JACK,
    X_BOX,
    X_JACK,
    Y_JACK,
    Array,
)
from jackbox_env.tools import checks as check

EVEN = 0.05  # of a step, by which times may be off an even grid
_LATE = 3600.0  # [s] at which no drive of a scene begins without a torque in the rows: the time of day
_LATEST = 1e10  # [s] of a row, Unix times are below
_USUAL = 0.2  # quantile of the steps of time: more than every second frame may be missing
_MOST_MISSING = 10  # frames for each row
_COARSE = 0.4  # of a step: rounding below leaves no doubt about missing frames
_FEW_MISSING, _LEAST_ROWS = 1.05, 20  # frames for each row, rows: with fewer there is no doubt about dropped frames
_TORQUE_TOLERANCE = 1e-6  # relative
_FARTHEST = 2.0  # half widths that a jack may be from the box's centre
_FASTEST, _OFTEN = 10.0, 0.8  # v0, v0 / L or v0 / l, and the quantile of rates that is no higher in SI units
_TORQUE = re.compile(  # in headers of torques; no momentum, and no place "in m"
    r"(?i:torque|(?<![a-z])tau|moment(?!um|a))|(?<![A-Za-z])[kM]?N[ ·*._-]?m{1,2}(?![A-Za-z])"
)
_LARGEST_STEP = 5.0 * math.tau  # from row to row


def evened(
    table: Table, scene: Scene, names: Mapping[str, str] | None = None, y_down: bool = False,
    impacts: Array | None = None, torque: str = "held",
) -> tuple[dict[str, Any], tuple[str, ...]]:  # fmt: skip
    """Arguments of a Recording, and sentences about what was changed.

    In SI units and y upwards, with a row for each frame, and angles that do not wrap.

    If the torques are the drive's means, the drive acts instead: a constant torque of the same mean would lead
    elsewhere. If nothing depends on the time, Unix times count from the first row.

    Raises:
        TypeError, ValueError: unusable content; the message names row and column.
    """
    columns, left_out, bare = in_si_units(table, UNITS, names)
    if impacts is None and not columns.keys() & {*STATE_NAMES}:
        raise ValueError(
            f"{table.header()}s must have one of the 12 numbers of a state; --columns (in Python names=) maps other "
            f"headers, got {', '.join(header for header, _ in table.columns)}"
        )
    steps = times, rows, dt = _frames(table, columns["time"], scene)
    frames, missing = rows[-1] + 1, rows[-1] + 1 - len(rows)
    notes = [f"what is above the headers, in row {table.at_line}, was left out"] * (table.at_line > 1)
    notes += [f"left out, because no name stands for them: {', '.join(left_out)}"] * bool(left_out)
    notes += [f"read in SI units, because no unit was found: {', '.join(bare)}"] * bool(bare)
    notes += [f"{missing} of {frames} frames {'is' if missing == 1 else 'are'} missing, and left open"] * bool(missing)
    states = _states(columns, rows, y_down, notes)
    _refuse_sizes(table, scene, states, dt)
    torques, begin = _torques(table, scene, columns.get("torque"), left_out, steps, torque), float(times[0])
    of_clock = begin > _LATE and "torque" not in columns and scene.drive is not None
    if of_clock or abs(times).max() > LATEST_TIME:
        if scene.drive is not None and (torques is None or scene.drive.force_bound > 0.0):
            raise ValueError(
                f"{table.source}column time: begins at {begin:.10g} s, and the scene's drive depends on the time: give "
                "the drive's times; --torque none if nothing turns the box"
            )
        notes.append(f"times count from the first row, at {begin:.10g} s")
        begin, impacts = 0.0, None if impacts is None else impacts - times[0]
    return {
        "states": states, "torques": torques, "dt": dt, "time": begin, "impacts": impacts, "torque": torque,
    }, tuple(notes)  # fmt: skip


def _states(columns: Mapping[str, Array], rows: Any, y_down: bool, notes: list[str]) -> Array:
    """States of columns in rows, (H + 1, 12), y upwards, unwrapped, NaN in lost frames; appends to the notes."""
    states = np.full((rows[-1] + 1, 12), np.nan)
    for index, name in enumerate(STATE_NAMES):
        if name in columns:
            values, jumps, turn = unwrapped(columns[name]) if name.startswith("theta") else (columns[name], 0, "")
            notes += [f"{name} wraps: {jumps} jumps of {turn} were taken out"] * bool(jumps)
            states[rows, index] = -values if y_down and index % 3 else values
    lost = (states[:, X_JACK:THETA_JACK] == 0.0).all(axis=1) & (np.arange(len(states)) > 0)  # 0: a simulation's begin
    if 0 < lost.sum() < 0.5 * len(states):
        states[lost, X_JACK : THETA_JACK + 1] = np.nan
        notes.append(f"x_jack and y_jack are 0 in {lost.sum()} rows, as of lost frames, which are left open")
    return states


def _torques(
    table: Table, scene: Scene, torques: Array | None, left_out: Sequence[str], steps: tuple[Array, Any, float],
    kind: str,
) -> Array | None:  # fmt: skip
    """The torques of a recording, of those in rows; None if the scene's drive acts."""
    times, rows, dt = steps
    turning = [header for header in left_out if _TORQUE.search(header)]
    if torques is None and turning and scene.drive is not None:
        raise ValueError(
            f"{table.header()} {check.shown(turning[0])} is left out, and the scene's drive would turn the box: name "
            "it as that of torque, or leave the drive out (--torque none)"
        )
    if torques is None or kind != "held":
        return None if torques is None else without_gaps(filled(table, "torque", torques), rows)
    torques = filled(table, "torque", torques[:-1])
    return None if _is_of(scene.drive, times, dt, torques) else np.repeat(torques, np.diff(rows))


def unwrapped(angles: Array) -> tuple[Array, int, str]:
    """Angles [rad] without jumps of a turn, how many there were, and of what turn: only of angles that stay within one.

    A cross and a box look the same after a quarter turn, a line after half of one, so trackers may report no more.
    """
    seen = np.isfinite(angles)
    values = angles[seen]
    for turn, period in ("a quarter turn", 0.25 * math.tau), ("half a turn", 0.5 * math.tau), ("a turn", math.tau):
        jumps = int((abs(np.diff(values)) > 0.5 * period).sum())
        if len(values) and jumps and np.ptp(values) <= period * (1.0 + 1e-6):
            result = angles.copy()
            result[seen] = np.unwrap(values, period=period)
            return result, jumps, turn
    return angles, 0, ""


def _frames(table: Table, times: Array, scene: Scene) -> tuple[Array, Any, float]:
    """Even times of the rows, the frame of each row, and the time between frames; ValueError if there are none."""
    filled(table, "time", times)
    if len(times) < 2:
        raise ValueError(
            f"{table.source}row {table.lines[-1] if table.lines else 1}: there must be two rows of numbers at least"
        )
    steps = np.diff(times)
    wrong = (steps <= 0.0) | (np.maximum(abs(times[1:]), abs(times[:-1])) > _LATEST)
    if wrong.any():
        row = int(wrong.argmax())
        raise ValueError(
            f"{table.at(row + 1)}, column time: must increase up to {_LATEST:g} s, got {times[row + 1]:.10g} s after "
            f"{times[row]:.10g} s"
        )
    spacing = 4.0 * float(np.spacing(abs(times).max()))
    rounding = rounding_of(times)
    gaps = _gaps(table, steps, rounding)
    dt = float(steps.sum() / gaps.sum())
    coarsest = scene.box_half_width / scene.speed_scale  # half the box in one step
    if dt > coarsest:
        raise ValueError(
            f"{table.source}column time: time runs to {times[-1]:,.6g} s in steps of {dt:.3g} s, which must be at most "
            f"{coarsest:.2g} s: numbers of frames, or milliseconds?"
        )
    if gaps.sum() > _MOST_MISSING * len(times):
        raise ValueError(
            f"{table.source}column time: {gaps.sum() + 1 - len(times):g} frames are missing between {len(times)} rows; "
            "give stretches as recordings of their own"
        )
    rows = np.concatenate([[0], np.cumsum(gaps)]).astype(np.int64)
    dt, begin = float(times[-1] - times[0]) / max(int(rows[-1]), 1), float(times[0])
    if abs(times - begin - dt * rows).max() > 1e-6 * dt + spacing:  # rounded times: all of them count
        dt, shift = (float(number) for number in np.polyfit(rows, times - begin, 1))
        begin += shift
    even = np.float64(begin) + dt * rows.astype(np.float64)
    uneven = (abs(times - even) > EVEN * dt + 0.5 * rounding + spacing) | np.append(False, np.diff(rows) < 1)
    if uneven.any():
        usual = float(np.quantile(steps, _USUAL, method="lower"))
        row = int(abs(steps / usual - np.round(steps / usual)).argmax())
        raise ValueError(
            f"{table.at(row + 1)}, column time: must increase evenly, to {EVEN:.0%} of a step, by {usual:g} s or a "
            f"multiple where frames are missing, got {steps[row]:g} s"
        )
    return even, rows, dt


def rounding_of(times: Array) -> float:
    """The power of ten to which all times are rounded [s], down to 1 us; else what a double rounds them to."""
    spacing = 4.0 * float(np.spacing(abs(times).max()))
    digits = (n for n in range(7) if (abs(times - np.round(times, n)) <= spacing).all())
    return next((10.0**-n for n in digits), spacing)


def _gaps(table: Table, steps: Array, rounding: float) -> Array:
    """The number of frames in each step of time; ValueError if times are rounded too coarsely to know."""
    usual = float(np.quantile(steps, _USUAL, method="lower"))
    gaps = np.round(steps / steps[abs(steps - usual) < 0.5 * usual].mean())
    if len(steps) < _LEAST_ROWS or gaps.mean() < _FEW_MISSING or rounding < _COARSE * usual:
        return np.asarray(gaps)
    even = np.arange(len(steps) + 1)
    times = np.cumsum([0.0, *steps])
    dt = np.polyfit(even, times, 1)[0]
    if np.ptp(times - dt * even) < 2.0 * EVEN * dt + rounding:
        return np.ones(len(steps))
    raise ValueError(
        f"{table.source}column time: is rounded to {rounding:g} s, too coarsely to know which frames are missing"
    )


# -- sizes -------------------------------------------------------------------------------------------------------------


def _refuse_sizes(table: Table, scene: Scene, states: Array, dt: float) -> None:
    """Raise ValueError for positions and angles that are no metres and radians, and rates that are not by seconds."""
    half = scene.box_half_width
    reach = np.nanmax(abs(states[:, X_JACK:THETA_JACK] - states[:, X_BOX:THETA_BOX]), initial=0.0)
    if reach > _FARTHEST * half:
        raise ValueError(
            f"{table.source}the jack is up to {reach:,.4g} m from the centre of a box of half width {half:g} m: "
            "are unit and box_half_width right?"
        )
    wrong = "minutes, hours, days, millimetres or pixels", "degrees"
    for column, unit in ((X_JACK, 1.0), (Y_JACK, 1.0), (THETA_BOX, half), (THETA_JACK, scene.jack_arm)):
        rows, rates = np.flatnonzero(np.isfinite(states[:, column])), states[:, column + RATES]
        steps = abs(np.diff(states[rows, column]))
        angle, name, fastest = (
            column in (THETA_BOX, THETA_JACK),
            STATE_NAMES[column],
            _FASTEST * scene.speed_scale / unit,
        )
        if _often(steps / (np.diff(rows) * dt)) > fastest or (angle and steps.max(initial=0.0) > _LARGEST_STEP):
            raise ValueError(
                f"{table.source}column {name}: {name} changes by up to {steps.max():,.4g} {STATE_UNITS[column]} from "
                f"row to row, in {dt:.3g} s: {wrong[angle]}?"
            )
        if _often(abs(rates[np.isfinite(rates)])) > fastest:
            raise ValueError(
                f"{table.source}column {STATE_NAMES[column + RATES]}: is often above {fastest:,.4g} "
                f"{STATE_UNITS[column + RATES]}: {wrong[angle]}?"
            )


def _often(rates: Array) -> float:
    """What rates are often below."""
    return float(np.quantile(rates, _OFTEN)) if len(rates) else 0.0


def _is_of(drive: Chirp | Drive | None, times: Array, dt: float, torques: Array) -> bool:
    """Whether torques [N m] are the means of a drive in steps that begin at times [s]; False if it has none there."""
    tolerance = _TORQUE_TOLERANCE * float(abs(torques).max())
    try:
        return drive is not None and all(
            abs(torque - 0.5 * sum(drive.torque_means(time, dt))) <= tolerance
            for torque, time in zip(torques.tolist(), times[:-1].tolist(), strict=True)
        )
    except ValueError:
        return False
