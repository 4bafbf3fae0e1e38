"""A first guess from recordings without a search: flights, the impacts between them, and a guess of the fields.

Between impacts the jack flies on a parabola with constant spin. So its numbers, with the fall added, are broken lines
in time. Pieces of two rows are merged while one line fits both within the noise (bottom-up segmentation; Keogh et al.
2001, "An Online Algorithm for Segmenting Time Series").
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.fits.least_squares import Indices
from jackbox_env.fits.observed import Recording
from jackbox_env.fits.shooting import brief
from jackbox_env.model.mechanics import contacts_of
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import (
    RATES,
    THETA_BOX,
    THETA_JACK,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
)

_MERGED = 45.0  # increase of the sum of squares up to which two pieces are one flight, six more numbers at the other
_JACK, _PLACE = slice(X_JACK, RATES), slice(X_JACK, THETA_JACK)
_LEAST_ROWS = 4  # of a flight that is used
_SPIKE, _SPIKE_ROWS = 6.0, 7  # times noise and what is usual around, and in how many rows that is
_FALLING = 6.0  # standard deviations of the acceleration of a flight, at least
_BENT = 0.5  # share of the fall by which a flight may be bent; rest lacks all of it
_CLOSE = 4  # rows from a flight's end to the next one's begin, at most
_STRAIGHT = 0.98  # cosine of the angle between a wall's normal and the change of velocity, at least


class Flights(NamedTuple):
    """Flights of a recording, and lines through the jack's numbers, and the box's, with fall and torque taken off."""

    first: Indices  # row, shape (n,)
    last: Indices  # row, in the flight
    lasting: NDArray[np.bool_]  # whether it lasts so long that the jack does not rest
    lines: Array  # value at the recording's begin and slope of each of six numbers, NaN if unobserved, (n, 6, 2)
    middles: Indices  # rows, of the lasting flights; of the first its begin


def falls(recording: Recording, scene: Scene) -> Array:
    """Terms that make the six positions straight between impacts when added, (H + 1, 6)."""
    times, added = np.arange(len(recording.states)) * recording.dt, np.zeros((len(recording.states), RATES))
    added[:, Y_JACK] = 0.5 * scene.gravity * times**2
    torques = recording.torques
    if torques is None and scene.drive is not None:
        begins = recording.time + times[:-1]
        torques = np.array([0.5 * sum(scene.drive.torque_means(begin, recording.dt)) for begin in begins.tolist()])
    if torques is not None:
        parts = torques.size // (len(times) - 1)  # of a step, each with a torque
        dt = recording.dt / parts
        rates = np.append(0.0, np.cumsum(torques)) * dt / scene.box_inertia
        added[1:, THETA_BOX] = -np.cumsum(0.5 * (rates[1:] + rates[:-1]))[parts - 1 :: parts] * dt
    return added


def flights_of(recording: Recording, scene: Scene, noise: Array) -> Flights | None:
    """The flights of a recording; None if the jack's three numbers were not observed together often enough."""
    if scene.drive is not None and scene.drive.force_bound > 0.0:  # pushes the box's centre
        return None
    straight = recording.states[:, :RATES] + falls(recording, scene)
    rows = np.flatnonzero(np.isfinite(straight[:, _JACK]).all(axis=1))
    if len(rows) < 0.5 * len(straight) or len(rows) < 2 * _LEAST_ROWS:
        return None
    times = rows * recording.dt
    first = _merged(times, straight[rows, _JACK] / noise[_JACK])
    ends = np.append(first[1:], len(rows))
    # Half the acceleration of a flight [m/s^2], or one that is slow in the box; and how long gives it to a sixth.
    fall = max(0.5 * scene.gravity, 1e-3 * scene.box_half_width)
    least = max(brief(scene), float((180.0 * (_FALLING * noise[Y_JACK] / fall) ** 2 * recording.dt) ** 0.2))
    enough = ends - first >= _LEAST_ROWS
    first, ends = first[enough], ends[enough]
    lasting = times[ends - 1] - times[first] >= least
    lines = np.full((len(first), RATES, 2), np.nan)
    for index, (begin, end) in enumerate(zip(first.tolist(), ends.tolist(), strict=True)):
        within = slice(begin, end)
        off = times[within] - times[within].mean()
        for column in range(RATES):
            values = straight[rows[within], column]
            known = np.isfinite(values)
            if known.sum() >= _LEAST_ROWS:
                slope, value = np.polyfit(off[known], values[known], 1)
                lines[index, column] = value - slope * times[within].mean(), slope
        if lasting[index]:
            bend = np.polyfit(off, straight[rows[within], X_JACK : Y_JACK + 1], 2)[0]
            lasting[index] = np.hypot(*bend) < _BENT * fall
    first, last = rows[first], rows[ends - 1]
    long = np.flatnonzero(lasting)
    if not len(long):
        return None
    middles = (first + last)[long] // 2
    middles[0] = first[long[0]]
    return Flights(first, last, lasting, lines, middles)


def without_spikes(recording: Recording, scene: Scene, noise: Array) -> Recording:
    """A recording, but nothing of the jack in rows in which it is off every line through two of the rows around.

    Not where that is usual: a jack that rests in a box that turns is on no line.
    """
    straight = recording.states[:, _JACK] + falls(recording, scene.changed(drive=None))[:, _JACK]
    states, rows = recording.states.copy(), np.flatnonzero(np.isfinite(straight).all(axis=1))
    while len(rows) > _SPIKE_ROWS:
        values, least = straight[rows] / noise[_JACK], np.full((len(rows), 3), np.inf)
        for one, other in ((-2, -1), (-1, 1), (1, 2)):
            at = np.arange(max(0, -one), len(rows) - max(0, other))
            share = ((rows[at] - rows[at + one]) / (rows[at + other] - rows[at + one]))[:, None]
            between = values[at] - values[at + one] * (1.0 - share) - values[at + other] * share
            least[at] = np.minimum(least[at], abs(between) / np.sqrt(1.0 + share**2 + (1.0 - share) ** 2))
        score = least.max(axis=1)
        around = np.lib.stride_tricks.sliding_window_view(np.pad(score, _SPIKE_ROWS // 2, mode="reflect"), _SPIKE_ROWS)
        peaks = (score > _SPIKE * np.maximum(1.0, np.median(around, axis=1))) & (score >= around[:, 2:5].max(axis=1))
        if not peaks.any():
            break
        states[rows[peaks], X_JACK:RATES] = states[rows[peaks], VX_JACK:] = np.nan
        rows = rows[~peaks]
    return Recording(states, recording.torques, recording.dt, recording.time, recording.impacts)


def _merged(times: Any, values: Array) -> Indices:
    """The rows at which straight pieces of values of noise 1 begin, shape (pieces,)."""
    first = np.arange(0, len(times), 2)
    products = np.column_stack([np.ones(len(times)), times, times**2, values, values * times[:, None], values**2])
    sums = np.add.reduceat(products, first, axis=0)
    while len(sums) > 1:
        both = sums[:-1] + sums[1:]
        alone = _squares(sums)
        increase = _squares(both) - alone[:-1] - alone[1:]
        less = np.minimum(np.append(np.inf, increase[:-1]), np.append(increase[1:], np.inf))
        merged = np.flatnonzero((increase <= _MERGED) & (increase < less))
        if not len(merged):
            break
        sums[merged] = both[merged]
        sums, first = np.delete(sums, merged + 1, axis=0), np.delete(first, merged + 1)
    return first


def _squares(sums: Array) -> Array:
    """Sums of squares about the best lines, from sums of products."""
    count, time, square = sums[:, :1], sums[:, 1:2], sums[:, 2:3]
    value, moment, values = np.split(sums[:, 3:], 3, axis=1)
    spread = np.maximum(square - time**2 / count, 1e-300)
    lines = value**2 / count + (moment - value * time / count) ** 2 / spread
    return np.asarray((values - lines).sum(axis=1))


def impacts_of(
    recording: Recording, scene: Scene, flights: Flights, noise: Array
) -> tuple[Array, Array, Array, Indices, Indices]:
    """The impacts between flights that follow each other closely, if a wall explains the jack's change of velocity.

    Their times since the recording's begin [s], (n,); the jack's places with the fall added, (n, 2); the states before,
    (n, 12), NaN where the box was not seen; walls and feet, (n,).
    """
    close = flights.first[1:] - flights.last[:-1] <= _CLOSE
    near = np.flatnonzero(close & (flights.lasting[1:] | flights.lasting[:-1]))
    before, after, dt = flights.lines[near], flights.lines[near + 1], recording.dt
    change = (after - before)[:, _JACK] / noise[_JACK, None]
    times = -(change[:, :, 0] * change[:, :, 1]).sum(axis=1) / np.maximum((change[:, :, 1] ** 2).sum(axis=1), 1e-300)
    late = np.maximum((flights.last[near] - 1) * dt - times, times - (flights.first[near + 1] + 1) * dt)
    places = before[:, _PLACE, 0] + before[:, _PLACE, 1] * times[:, None]
    states, kick = state_on(recording, scene, before, times), (after - before)[:, _PLACE, 1]
    walls, feet = np.divmod(np.arange(16), 4)
    centred = np.repeat(states, 16, axis=0)
    centred[:, X_BOX : Y_BOX + 1] = centred[:, X_JACK : Y_JACK + 1]
    gaps, gradients = contacts_of(scene, centred, np.tile(walls, len(near)), np.tile(feet, len(near)))
    along = np.einsum("nwi,ni->nw", gradients.reshape(-1, 16, 6)[:, :, X_JACK : Y_JACK + 1], kick)
    struck = (along / np.linalg.norm(kick, axis=1)[:, None]).round(6) * 1e6 - gaps.reshape(-1, 16) / scene.jack_arm
    contact = struck.argmax(axis=1)  # the wall by its normal, then the foot that is deepest
    usable = (late < 0.0) & (along.max(axis=1) > _STRAIGHT * np.linalg.norm(kick, axis=1))
    return times[usable], places[usable], states[usable], walls[contact][usable], feet[contact][usable]


def state_on(recording: Recording, scene: Scene, lines: Array, times: Any) -> Array:
    """States on lines, (n, 6, 2), at times since the recording's begin [s], (n, 12)."""
    added, rows = falls(recording, scene), np.arange(len(recording.states)) * recording.dt
    both = np.concatenate([added, np.gradient(added, recording.dt, axis=0, edge_order=2)], axis=1)
    offsets = np.stack([np.interp(times, rows, column) for column in both.T], axis=1)
    return np.asarray(
        np.concatenate([lines[:, :, 0] + lines[:, :, 1] * times[:, None], lines[:, :, 1]], axis=1) - offsets
    )


def centre_of(recording: Recording, scene: Scene, flights: Flights, noise: Array) -> Array:
    """The motion of the centre of box and jack together, over the box's mass and with the fall added.

    Its place at the recording's begin [m], its rate, and jack_mass / box_mass, shape (5,); a regression over impacts.

    Nothing but the jack pushes the box's centre, so that of both masses moves straight, with the fall added. At an
    impact a foot is at a wall. Both are linear in that centre's motion and the ratio of the masses.
    """
    times, places, origin, walls, feet = impacts_of(recording, scene, flights, noise)
    origin[:, X_BOX : Y_BOX + 1] = 0.0
    gaps, gradients = contacts_of(scene, origin, walls, feet)
    normals = gradients[:, :2]
    equations = normals, normals * times[:, None], -(normals * places).sum(axis=1)[:, None]
    scale = float(np.hypot(noise[X_JACK], scene.jack_arm * noise[THETA_JACK]))
    rows, known = [np.concatenate(equations, axis=1) / scale], [-gaps / scale]
    middle = 0.5 * (flights.first + flights.last) * recording.dt
    at = flights.lines[:, :, 0] + flights.lines[:, :, 1] * middle[:, None]
    for axis in range(2):
        seen = np.isfinite(at[:, axis])
        block = np.zeros((int(seen.sum()), rows[0].shape[1]))
        block[:, axis], block[:, 2 + axis], block[:, 4] = 1.0, middle[seen], -at[seen, X_JACK + axis]
        deviations = noise[axis] / np.sqrt(flights.last - flights.first + 1.0)[seen, None]
        rows.append(block / deviations)
        known.append(at[seen, axis] / deviations[:, 0])
    size, ratio = scene.box_half_width, scene.jack_mass / scene.box_mass
    begin = np.median(at[:, X_JACK : Y_JACK + 1], axis=0)
    prior = np.append(begin, [0.0, 0.0, ratio])
    widths = np.array([9.0 * size] * 2 + [9.0 * scene.speed_scale] * 2 + [2.0 * ratio])
    matrix, right = np.concatenate([*rows, np.diag(1.0 / widths)]), np.concatenate([*known, prior / widths])
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=None)[0])


def starts_of(recording: Recording, scene: Scene, flights: Flights, centre: Array) -> Array:
    """States on the lines of lasting flights in their middles, in the box that the centre leaves, (n, 12)."""
    times, lines = flights.middles * recording.dt, flights.lines[flights.lasting]
    straight, rates = lines[:, _PLACE, 0] + lines[:, _PLACE, 1] * times[:, None], lines[:, _PLACE, 1]
    states = state_on(recording, scene, lines, times)
    place, drift, ratio = centre[:2], centre[2:4], max(centre[4], 1e-9)
    states[:, X_BOX : Y_BOX + 1] = place + np.multiply.outer(times, drift) - ratio * straight
    states[:, VX_BOX : VY_BOX + 1] = drift - ratio * rates
    return states
