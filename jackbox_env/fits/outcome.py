"""The outcome of a search: intervals of the fields, and the reasons not to trust them."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import chain

import numpy as np

from jackbox_env.exact.tangents import FIELDS
from jackbox_env.fits.faults import FAULTS, spoilt
from jackbox_env.fits.least_squares import FARTHEST, UNHEARD, WIDTH, Chain, Rows
from jackbox_env.fits.observed import IMPACT, looks_smoothed
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
_LEAST_FREE = 0.1  # variance of a residual that is used, over the noise's; less is what the start absorbs
_UNKNOWN = 1e3  # standard deviation of numbers that a fit without held-out windows does not identify
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
    bounds = np.where(parameters.logarithmic, [[-np.inf], [np.inf]], [np.zeros(len(numbers)), parameters.high])
    ends = (parameters.values(np.clip(numbers + sign * half_widths, *bounds)) for sign in (-1.0, 1.0))
    states = search.motions()
    unknown = [unidentified_sentence(parameters.fields, row) for row in unidentified]
    known = {name for name, half_width in zip(parameters.fields, half_widths, strict=True) if np.isfinite(half_width)}
    drive = parameters.start.drive
    turned = any(drive is not None if one.torques is None else one.torques.any() for one in search.recordings)
    if known & _MASSES and not turned and (drive is None or drive.force_bound == 0.0):
        unknown.append(
            "without a torque or a force on the box only ratios of masses are known: "
            f"{' and '.join(sorted(known & _MASSES))} by those that are given"
        )
    residuals = _held_out_residuals(search)
    judged = [
        (not known, "the recordings identify none of the fields"),
        (not ended, "the search did not end"),
        (
            away > _MOST_CONTRADICTED,
            f"{name}, or something else that is not fitted, is wrong: another value would fit better by {away:.1f} "
            "standard deviations",
        ),
        *_judged(search, rows, residuals),
    ]
    problems = [sentence for wrong, sentence in judged if wrong]
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
        tuple(chain.from_iterable(_bad_rows(search))),
        sum(_not_followed(search)),
    )


def _judged(search: Search, rows: Rows, held_out: Array) -> Iterator[tuple[bool, str]]:
    """Possible reasons not to trust the intervals: whether each applies, and a sentence."""
    columns, count = rows.column[rows.column >= 0], len(search.windows)
    yield {*columns} <= _PLACE, "nothing but the jack's place was observed, with which other motions may agree as well"
    misfits, unheard = int(misfitting(rows, count).sum()), int((rows.column == UNHEARD).sum())
    yield misfits > 0, f"{misfits} of {count} windows do not fit within the noise"
    yield unheard > 0, f"the fitted motion lacks {unheard} of the impacts that were heard"
    names = *STATE_NAMES, IMPACT, "all numbers together"
    correlated = ", ".join(names[k] for k in np.flatnonzero(autocorrelations(rows) > _MOST_CORRELATED))
    yield (
        bool(correlated),
        f"residuals of {correlated} are correlated in time: something that is not fitted is wrong",
    )
    recorded = zip(search.recordings, _bad_rows(search), _not_followed(search), strict=True)
    for number, (one, bad, seconds) in enumerate(recorded):
        yield (
            len(bad) > _MOST_BAD * len(one.states),
            f"{len(bad)} of {len(one.states)} rows are off the fitted path: no camera's single bad frames",
        )
        covered = one.dt * sum(window.last - window.first for window in search.windows if window.recording == number)
        yield not covered, f"no part of recording {number} agrees with the scene"
        where = f" of recording {number}" * (len(search.recordings) > 1)
        yield (
            seconds > MOST_SKIPPED * covered > 0.0,
            f"the jack moves in {seconds:.2g} s{where} that the scene does not explain",
        )
    yield (
        len(held_out) > 0 and not np.mean(held_out**2) < highest_mean_square(len(held_out)),
        "windows that were held out do not fit within the noise",
    )


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
    differentiable = (rows.jacobian != 0.0).any(axis=1, keepdims=True)  # what follows a step without shows no fault
    for name, (recordings, parameters) in cases.items():
        shooting = Shooting(recordings, parameters, search.windows)
        shooting.units = search.units
        changed = shooting.rows(shooting.unknowns(search.numbers), search.noise, slack)
        if changed is not None:  # else the small change has changed what can be followed
            columns.append((changed.residuals - rows.residuals)[:, None] / _SLIGHT * differentiable)
            names.append(name)
    if "restitution" in fields and len(search.windows) <= _FEW:
        by_restitution = rows.jacobian[:, 2 * WIDTH + fields.index("restitution")]
        columns.append(by_restitution[:, None] * (rows.window[:, None] == np.arange(len(search.windows))))
        names += [f"restitution from row {one.first} to {one.last}" for one in search.windows]
    moves = abs(Chain(rows._replace(jacobian=np.column_stack(columns)), len(search.windows)).moves(rows.fields))
    furthest = int(np.argmax(moves))
    return names[furthest], float(moves[furthest])


def _bad_rows(search: Search) -> list[list[str]]:
    """By recording the rows of windows with a number that was discounted, each in a sentence."""
    sentences = list[list[str]]()
    for number, (recording, modelled) in enumerate(zip(search.given, search.motions(), strict=True)):
        off, of = abs(recording.states - modelled), f" of recording {number}" * (len(search.recordings) > 1)
        away = np.nan_to_num(off / search.noise[:12])
        sentences.append(
            [
                f"row {row}{of}: {STATE_NAMES[column]} is {off[row, column]:.2g} {STATE_UNITS[column]} off"
                for row, column in enumerate(away.argmax(axis=1).tolist())
                if away[row, column] > FARTHEST
            ]
        )
    return sentences


def _not_followed(search: Search) -> list[float]:
    """By recording the time in which the jack moves, but in no window [s].

    It does where no foot is near a wall; where the box was not seen, in what looks like a flight.
    """
    seconds, scene = list[float](), search.parameters.scene(search.numbers)
    for modelled, recording, flights in zip(search.motions(), search.recordings, search.flights, strict=True):
        walls, feet = np.divmod(np.arange(16 * len(modelled)) % 16, 4)
        gaps = contacts_of(scene, np.repeat(recording.states, 16, axis=0), walls, feet)[0].reshape(-1, 16).min(axis=1)
        near = _NEAR * scene.box_half_width + FARTHEST * search.noise[X_JACK]
        flies = np.full(len(gaps), flights is None)
        if flights is not None:
            for first, last in zip(flights.first[flights.lasting], flights.last[flights.lasting], strict=True):
                flies[first : last + 1] = True
        moving = np.where(np.isfinite(gaps), gaps > near, flies)
        seconds.append(float((np.isnan(modelled[:, X_JACK]) & moving)[1:].sum()) * recording.dt)
    return seconds


def _held_out_residuals(search: Search) -> Array:
    """Studentised residuals of every fifth window, or the last of fewer, in fits without it."""
    numbers, windows = search.numbers.copy(), [replace(one, start=one.start.copy()) for one in search.windows]
    held_out = windows[4::5] or windows[1:][-1:]
    rest = [window for window in windows if all(window is not one for one in held_out)]
    link(rest)
    shooting = Shooting(search.recordings, search.parameters, rest)
    search.solve(shooting, LINK_SLACKS[-1])
    covariance, unidentified = identified(Chain(search.rows(shooting, LINK_SLACKS[-1]), len(rest)))
    covariance += _UNKNOWN**2 * unidentified.T @ unidentified
    residuals = [np.zeros(0)]
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
    return np.asarray(-rows.residuals[usable] / np.sqrt(variance[usable]))
