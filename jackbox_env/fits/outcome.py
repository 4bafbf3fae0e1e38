"""The outcome of a search: intervals of the fields, and the reasons not to trust them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jackbox_env.exact.tangents import FIELDS
from jackbox_env.fits.faults import FAULTS, spoilt
from jackbox_env.fits.least_squares import LINK, UNHEARD, WIDTH, Chain, Rows
from jackbox_env.fits.observed import IMPACT, looks_smoothed, pushed
from jackbox_env.fits.residuals import (
    autocorrelations,
    highest_mean_square,
    identified,
    misfitting,
    unidentified_sentence,
)
from jackbox_env.fits.result import Fit
from jackbox_env.fits.search import LINK_SLACKS, MOST_SKIPPED, Search, link
from jackbox_env.fits.shooting import Parameters, Shooting
from jackbox_env.model.mechanics import contacts_of
from jackbox_env.model.states import (
    RATES,
    STATE_NAMES,
    STATE_UNITS,
    VX_JACK,
    VY_JACK,
    X_JACK,
    Y_JACK,
    Array,
)
from jackbox_env.tools import checks as check

with check.extra("jackbox_env.fit", "scipy", "train"):
    from scipy import linalg, stats

_MOST_CORRELATED = 4.5  # autocorrelation of white residuals, in standard deviations
_WIDEST_JUMP = 0.01  # between linked windows, in standard deviations of the noise; below 1e-4 where a search ends
_LEAST_FREE = 0.1  # variance of a residual that is used, over the noise's; less is what the start absorbs
_UNKNOWN = 1e3  # standard deviation of numbers that a fit without held-out windows does not identify
_FAR = 6.0  # standard deviations of a row that is bad
_NEAR = 0.05  # half widths of a foot that may rest on a wall; no higher bounce piles up
_MOST_BAD = 0.05  # share of such rows, at most
_MASSES = {"box_mass", "box_inertia", "jack_mass", "jack_inertia"}
_PLACE = {X_JACK, Y_JACK, VX_JACK, VY_JACK}
_FEW = 20  # windows
_SLIGHT = 1e-6  # size of a fault, of which derivatives are differences
_USUAL = 2.0  # the same of the furthest if all is right; what is further widens the intervals
_MOST_CONTRADICTED = 3.7  # standard deviations of a field that is not fitted, from where it would fit best


def outcome_of(search: Search, ended: bool) -> Fit:
    """The result of a search that has ended or not."""
    numbers, parameters, count = search.numbers.copy(), search.parameters, len(search.windows)
    rows = search.rows(Shooting(search.recordings, parameters, search.windows), LINK_SLACKS[-1])
    covariance, unidentified = identified(Chain(rows, count))
    name, away = _contradicted(search, rows)
    estimated = (rows.column >= 0) & ~np.isfinite(search.known_noise[rows.column])
    freedom = search.free_share(rows) * estimated.sum() if estimated.any() else 1e9
    half_widths = stats.t.ppf(0.975, max(freedom, 1.0)) * np.sqrt(np.diag(covariance)) * max(1.0, away / _USUAL)
    half_widths[(abs(unidentified) > 0.05).any(axis=0)] = np.inf
    least = np.where(parameters.logarithmic, -np.inf, 0.0)
    most = np.where(parameters.logarithmic, np.inf, parameters.high)
    ends = (parameters.values(np.clip(numbers + sign * half_widths, least, most)) for sign in (-1.0, 1.0))
    states = search.motions()
    unknown = [unidentified_sentence(parameters.fields, row, parameters.logarithmic) for row in unidentified]
    known = {name for name, half_width in zip(parameters.fields, half_widths, strict=True) if np.isfinite(half_width)}
    if known & _MASSES and not any(pushed(one, parameters.start) for one in search.recordings):
        others = "without a torque or a force on the box only ratios of masses are known"
        unknown.append(f"{others}: {' and '.join(sorted(known & _MASSES))} by those that are given")
    problems = ["the recordings identify none of the fields"] * (not known)
    problems += ["the search did not end"] * (not ended)
    if away > _MOST_CONTRADICTED:
        wrong = f"{name}, or something else that is not fitted, is wrong"
        problems.append(f"{wrong}: another value would fit better by {away:.1f} standard deviations")
    residuals = _held_out_residuals(search)
    problems += _problems(search, rows, residuals)
    if problems and looks_smoothed(search.recordings):
        problems.insert(0, "the track looks smoothed: fit what was measured")
    return Fit(
        parameters.scene(numbers),
        {name: (float(low), float(high)) for name, low, high in zip(parameters.fields, *ends, strict=True)},
        residuals,
        tuple(unknown),
        {name: float(search.noise[k]) for k, name in enumerate((*STATE_NAMES, IMPACT)) if (rows.column == k).any()},
        states,
        sum(int(np.isnan(one[1:, X_JACK]).sum()) for one in states),
        tuple(problems),
        tuple(_bad_row_sentences(search)),
        sum(_not_followed(search)),
    )


def _problems(search: Search, rows: Rows, held_out: Array) -> Iterator[str]:
    """What in the last rows is a reason not to trust the intervals, in sentences."""
    if {*np.unique(rows.column[rows.column >= 0])} <= _PLACE:
        yield "nothing but the jack's place was observed, with which other motions may agree as well"
    gaps = LINK_SLACKS[-1] * abs(rows.residuals[rows.column == LINK])
    if (gaps > _WIDEST_JUMP).any():
        yield f"links between windows are open, by up to {gaps.max():.2g} of the noise: the motion jumps"
    misfits, unheard = int(misfitting(rows, len(search.windows)).sum()), int((rows.column == UNHEARD).sum())
    if misfits:
        yield f"{misfits} of {len(search.windows)} windows do not fit within the noise"
    if unheard:
        yield f"the fitted motion lacks {unheard} of the impacts that were heard"
    names = *STATE_NAMES, IMPACT, "all numbers together"
    correlated = [name for name, value in zip(names, autocorrelations(rows), strict=True) if value > _MOST_CORRELATED]
    if correlated:
        yield f"residuals of {', '.join(correlated)} are correlated in time: something that is not fitted is wrong"
    for bad, one in zip(search.bad_rows, search.recordings, strict=True):
        if len(bad) > _MOST_BAD * len(one.states):
            yield f"{len(bad)} of {len(one.states)} rows are off the jack's path: no camera's single bad frames"
    for number, (one, seconds) in enumerate(zip(search.recordings, _not_followed(search), strict=True)):
        covered = one.dt * sum(window.last - window.first for window in search.windows if window.recording == number)
        if not covered:
            yield f"no part of recording {number} agrees with the scene"
        elif seconds > MOST_SKIPPED * covered:
            where = f" of recording {number}" * (len(search.recordings) > 1)
            yield f"the jack moves in {seconds:.2g} s{where} that the scene does not explain"
    if len(held_out) and not np.mean(held_out**2) < highest_mean_square(len(held_out)):
        yield "windows that were held out do not fit within the noise"


def _contradicted(search: Search, rows: Rows) -> tuple[str, float]:
    """The field or fault that would move furthest if it was fitted, too, and by how many standard deviations.

    Each is tried by itself: an inertia alone, but a mass or a length with the inertias that follow it. If few impacts
    were used, so is the restitution of each, because one that was followed wrongly decides much there.
    """
    fields, right = search.parameters.fields, search.recordings
    present, slack = search.parameters.scene(search.numbers), search.scaled_slack(LINK_SLACKS[-1])
    less = {name: (1.0 - _SLIGHT) * getattr(present, name) for name in FIELDS if name not in fields}
    cases = {name: (right, Parameters(fields, present.changed(**{name: value}))) for name, value in less.items()}
    cases |= {fault: ([spoilt(one, fault, _SLIGHT) for one in right], search.parameters) for fault in FAULTS}
    columns, names = [rows.jacobian], list[str]()
    for name, (recordings, parameters) in cases.items():
        shooting = Shooting(recordings, parameters, search.windows)
        shooting.units = search.units
        changed = shooting.rows(shooting.unknowns(search.numbers), search.noise, slack)
        if changed is not None:  # else the small change has changed what can be followed
            columns.append((changed.residuals - rows.residuals)[:, None] / _SLIGHT)
            names.append(name)
    if "restitution" in fields and len(search.windows) <= _FEW:
        by_restitution = rows.jacobian[:, 2 * WIDTH + fields.index("restitution")]
        columns.append(by_restitution[:, None] * (rows.window[:, None] == np.arange(len(search.windows))))
        names += [f"restitution from row {one.first} to {one.last}" for one in search.windows]
    moves = abs(Chain(rows._replace(jacobian=np.column_stack(columns)), len(search.windows)).moves(rows.fields))
    furthest = int(np.argmax(moves))
    return names[furthest], float(moves[furthest])


def _bad_row_sentences(search: Search) -> Iterator[str]:
    """The rows that were left out, and how far the jack is off; not rows in which it is on no or on the fitted path."""
    for number, (rows, states) in enumerate(zip(search.bad_rows, search.motions(), strict=True)):
        off = abs(search.recorded[number].states - states)[:, X_JACK:RATES]
        away, recording = off / search.noise[X_JACK:RATES], f" of recording {number}" * (len(search.bad_rows) > 1)
        for row in sorted(rows):
            if (away[row] > _FAR).any():
                column = X_JACK + int(np.nanargmax(away[row]))
                text = f"{STATE_NAMES[column]} is {off[row, column - X_JACK]:.2g} {STATE_UNITS[column]} off"
                yield f"row {row}{recording}: {text}"


def _not_followed(search: Search) -> list[float]:
    """By recording the time in which the jack moves, but in no window [s]."""
    seconds, scene = list[float](), search.parameters.scene(search.numbers)
    for modelled, recording, flights in zip(search.motions(), search.recordings, search.flights, strict=True):
        walls, feet = np.divmod(np.arange(16 * len(modelled)) % 16, 4)
        gaps = contacts_of(scene, np.repeat(recording.states, 16, axis=0), walls, feet)[0].reshape(-1, 16).min(axis=1)
        near = _NEAR * scene.box_half_width + _FAR * search.noise[X_JACK]
        moving = ~(gaps <= near) if flights is None else gaps > near  # where it is not known: as if it moved, or not
        for first, last in flights.flown if flights else ():
            moving[first + 1 : last + 1] = True
        seconds.append(float((np.isnan(modelled[:, X_JACK]) & moving)[1:].sum()) * recording.dt)
    return seconds


def _held_out_residuals(search: Search) -> Array:
    """Studentised residuals of every fifth window, or the last of fewer, in fits without it."""
    numbers, windows = search.numbers.copy(), [replace(one, start=one.start.copy()) for one in search.windows]
    held_out = windows[4::5] or windows[1:][-1:]
    if not held_out:
        return np.zeros(0)
    rest = [window for window in windows if all(window is not one for one in held_out)]
    link(rest)
    shooting = Shooting(search.recordings, search.parameters, rest)
    search.solve(shooting, LINK_SLACKS[-1])
    covariance, unidentified = identified(Chain(search.rows(shooting, LINK_SLACKS[-1]), len(rest)))
    covariance += _UNKNOWN**2 * unidentified.T @ unidentified
    residuals = []
    for window in held_out:
        link([window])
        alone = Shooting(search.recordings, search.parameters, [window], search.prior([window], free=False))
        search.solve(alone, LINK_SLACKS[-1])
        residuals.append(studentised(search.rows(alone, LINK_SLACKS[-1]), covariance))
    search.numbers = numbers
    return np.concatenate(residuals)


def studentised(rows: Rows, covariance: Array) -> Array:
    """(observed - fitted) over its standard deviation, of one window whose start was fitted to it, the fields not."""
    lengths = np.linalg.norm(rows.jacobian[:, :WIDTH], axis=0)
    basis = linalg.orth(rows.jacobian[:, :WIDTH] / np.where(lengths > 0.0, lengths, 1.0), rcond=1e-9)
    jacobian = rows.jacobian[:, 2 * WIDTH :]
    jacobian = jacobian - basis @ (basis.T @ jacobian)
    variance = 1.0 - (basis**2).sum(axis=1) + np.einsum("if,fg,ig->i", jacobian, covariance, jacobian)
    usable = (rows.column >= 0) & (variance > _LEAST_FREE)
    result: Array = -rows.residuals[usable] / np.sqrt(variance[usable])
    return result
