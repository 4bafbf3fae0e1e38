"""Cut the recordings of a search into windows: between the middles of flights, or one after the other.

Windows that the model does not explain are left out, resumed when it does, and followed by others to where the jack
rests.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from jackbox_env.fits.first_guess import Guess, guess_of, starts_of
from jackbox_env.fits.observed import state_at
from jackbox_env.fits.search import MOST_SKIPPED, Search
from jackbox_env.fits.shooting import MOST_IMPACTS, Window, end_state, followed, motion, next_start, next_window
from jackbox_env.model.states import THETA_JACK, Array

_SHORTENED = 0.5, 0.25  # shares of a window that are tried if the whole is not explained
_LEAST = 4  # steps of such a share
_REST_SKIPPED = 0.2  # [s] between trials to go on while the jack rests
# [rad] of a jack whose angle was not observed; it repeats every quarter turn
_TRIAL_ANGLES = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8)
_SURE = 0.25  # relative standard deviation of a guess that replaces the start, at most
_FEW_SKIPPED = 0.02  # steps, over those of a recording; other guesses of its start are tried if there are more


def resume(search: Search) -> None:
    """Take back windows that the model explains by now: from the ends of those before them, or from flights."""
    before = {(window.recording, window.last): window for window in search.windows}
    for window in sorted(search.left_out, key=lambda one: (one.recording, one.first)):
        previous, start = before.get((window.recording, window.first)), window.start
        if previous is not None:
            recording = search.recordings[window.recording]
            window.start = end_state(recording, previous, search.parameters, search.numbers)
        explained = search.fit_alone(window)
        if not explained and previous is not None:
            window.start = start
            explained = search.fit_alone(window)
        if explained:
            search.left_out.remove(window)
            search.windows.append(window)
            before[window.recording, window.last] = window
    search.link()


def go_on(search: Search) -> None:
    """Follow the jack from where windows end that nothing is linked to, until it rests or the model fails."""
    for window in [one for one in search.windows if not one.linked and search.flights[one.recording] is not None]:
        recording, number = search.recordings[window.recording], window.recording
        until = min(
            (one.first for one in search.windows if one.recording == number and one.first >= window.last),
            default=len(recording.states) - 1,
        )
        chain = [window]
        while chain[-1].last < until:
            end = end_state(recording, chain[-1], search.parameters, search.numbers)
            new = next_window(recording, number, chain[-1].last, end, search.parameters, search.numbers)
            if new is None or new.last > until:
                break
            if not followed(new, motion(recording, new, search.parameters, search.numbers), MOST_IMPACTS):
                break
            chain[-1].linked = True
            chain.append(new)
            if not search.fit_block(chain[-search.block :], free=False):
                del chain[-1]
                chain[-1].linked = False
                break
        search.windows += chain[1:]
    search.link()


def cut_all(search: Search) -> None:
    """Cut all recordings into windows.

    Between flights, if there are any: from the guess of all recordings together, or from the one of a single recording
    if that explains more. Recordings without windows are then cut one step after the other.
    """
    scene, fields = search.parameters.start, search.parameters.fields
    guesses = [
        None if flights is None else guess_of(one, scene, flights, search.noise, fields)
        for one, flights in zip(search.recordings, search.flights, strict=True)
    ]
    known = [[one] for one in guesses if one is not None]
    candidates = [_combined(search, some) for some in ([one for (one,) in known], *(known if len(known) > 1 else ()))]
    furthest = -1
    for numbers, width in candidates:
        search.numbers, search.first_width, search.windows, search.left_out = numbers, width, [], []
        for number, guess in enumerate(guesses):
            if guess is not None:
                _cut_between(search, number, guess)
        covered = sum(window.last - window.first for window in search.windows)
        if covered > furthest:
            furthest, best = covered, (numbers, width, search.windows, search.left_out)
        if len({window.recording for window in search.windows}) == len(known):
            break
    search.numbers, search.first_width, search.windows, search.left_out = best
    _cut_others(search)


def _cut_others(search: Search) -> None:
    """Cut the recordings that have no windows yet, one step after the other."""
    cut = {window.recording for window in search.windows}
    search.left_out = [window for window in search.left_out if window.recording in cut]
    for number in [one for one in range(len(search.recordings)) if one not in cut]:
        numbers, before = search.numbers, len(search.windows)
        if before:
            _cut(search, number, state_at(search.recordings[number]))
        else:
            _cut_first(search, number)
        if len(search.windows) == before:
            search.numbers = numbers
    search.link()


def _combined(search: Search, guesses: list[Guess]) -> tuple[Array, Array]:
    """The fields' numbers by the surest of guesses, or the start's, and their widths."""
    scene, fields, best = search.parameters.start, search.parameters.fields, dict[str, tuple[float, float]]()
    for guess in guesses:
        for name, value in guess.values.items():
            best[name] = min(best.get(name, value), value, key=lambda one: one[1])
    deviations = np.array([best.get(name, (0.0, np.inf))[1] for name in fields])
    sure = {name: best[name][0] for name, deviation in zip(fields, deviations, strict=True) if deviation < _SURE}
    if "restitution" in sure:
        sure["restitution"] = min(sure["restitution"], 1.0)
    numbers = np.clip(search.parameters.of(scene.changed(**sure)), search.parameters.low, search.parameters.high)
    return numbers, 3.0 * deviations


def _cut_between(search: Search, number: int, guess: Guess) -> None:
    """Cut a recording into windows between the middles of flights, those which the model explains."""
    recording, numbers, flights = search.recordings[number], search.numbers, search.flights[number]
    assert flights is not None
    starts = starts_of(recording, search.parameters.scene(numbers), flights, guess)
    for (first, last), start in zip(flights.spans.values(), starts, strict=True):
        window = Window(number, first, last, start=start)
        (search.windows if search.fit_alone(window) else search.left_out).append(window)
    search.link()


def _cut_first(search: Search, number: int) -> None:
    """Cut the first recording from several guesses, until one gets to its end; keep the furthest."""
    furthest, best = -1, (search.numbers, search.windows, 0)
    for numbers, state in _first_guesses(search, number):
        search.numbers, search.windows, search.resting_steps[number] = numbers, [], 0
        search.progress.reset()
        complete = _cut(search, number, state)
        covered = sum(window.last - window.first for window in search.windows)
        if covered > furthest:
            furthest, best = covered, (search.numbers, search.windows, search.resting_steps[number])
        if complete:
            break
    search.numbers, search.windows, search.resting_steps[number] = best


def _first_guesses(search: Search, number: int) -> Iterator[tuple[Array, Array]]:
    """Guesses of the fields' numbers and of the first state."""
    first, numbers, positive = state_at(search.recordings[number]), search.numbers, search.parameters.logarithmic
    for angle in (0.0,) if np.isfinite(search.recordings[number].states[0, THETA_JACK]) else _TRIAL_ANGLES:
        yield numbers, first + angle * np.eye(12)[THETA_JACK]
    for factor in (0.7, 1.4):
        scaled = np.clip(numbers * factor, 0.0, search.parameters.high)
        yield np.where(positive, numbers + math.log(factor), scaled), first


def _cut(search: Search, number: int, state: Array) -> bool:
    """Cut a recording into windows, each from the end of the one before it; return whether its end was reached."""
    recording = search.recordings[number]
    first, end, linked, skipped, shown = 0, state, False, 0, 0
    while first < len(recording.states) - 1:
        search.progress.update(first - shown)
        shown = first
        window = next_window(recording, number, first, end, search.parameters, search.numbers)
        if window is None:  # at rest
            pause = max(1, round(_REST_SKIPPED / recording.dt))
            window = Window(number, first, min(first + pause, len(recording.states) - 1), start=end)
            search.resting_steps[number] += window.last - first
            end, first, linked = end_state(recording, window, search.parameters, search.numbers), window.last, False
            continue
        if linked:
            search.windows[-1].linked = True
        search.windows.append(window)
        whole, explained = window.last, _fit_last(search)
        for share in () if explained or whole - first < 2 * _LEAST else _SHORTENED:
            search.windows[-1] = replace(window, last=first + max(_LEAST, round(share * (whole - first))), start=end)
            explained = _fit_last(search)
            if explained:
                break
        if not explained:
            del search.windows[-1]
            if linked:
                search.windows[-1].linked = False
            skipped += whole - first
            if skipped > MOST_SKIPPED * len(recording.states):
                return False
        first, linked = search.windows[-1].last if explained else whole, explained
        last = search.windows[-1] if explained else window
        end = next_start(recording, last, search.parameters, search.numbers, explained)
    return skipped <= _FEW_SKIPPED * len(recording.states)


def _fit_last(search: Search) -> bool:
    """Fit the last window, with those before it; return whether it is explained."""
    return search.fit_block(search.windows[-search.block :], len(search.windows) <= search.block)
