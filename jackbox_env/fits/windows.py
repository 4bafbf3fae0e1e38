"""Cut the recordings of a search into windows: between the middles of flights, or one after the other.

Windows that the model does not explain are left out, resumed when it does, and followed by others to where the jack
rests.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from jackbox_env.fits.first_guess import centre_of, starts_of
from jackbox_env.fits.observed import state_at
from jackbox_env.fits.search import MOST_SKIPPED, Search, unlink
from jackbox_env.fits.shooting import Window, end_state, next_window
from jackbox_env.model.states import RATES, Array

_SHARES = 1.0, 0.5, 0.25  # of a window that are tried until one is explained
_LEAST = 4  # steps of such a share
_SOON = 5  # rows
_REST_SKIPPED = 0.2  # [s] between trials to go on while the jack rests


def go_on(search: Search) -> None:
    """Follow the jack from where windows end that nothing is linked to, and from where windows begin that are left out.

    Until it rests, the model fails or another window begins.
    """
    seeds = [(window, window.last) for window in search.windows if not window.linked]
    seeds += [(window, window.first) for window in search.left_out]
    search.left_out = []
    for seed, first in seeds:
        recording, number, begin = search.recordings[seed.recording], seed.recording, first
        others = [one for one in search.windows if one.recording == number and one.last > first]
        if any(one.first < first for one in others):
            continue
        chain = [seed] if first == seed.last else []
        end = end_state(recording, seed, search.parameters, search.numbers) if chain else seed.start
        until = min((one.first for one in others), default=len(recording.states) - 1)
        while first < until:
            window = next_window(recording, number, first, end, search.parameters, search.numbers)
            if window is None:
                break
            window.last = min(window.last, until)
            if not _appended(search, chain, window):
                break
            first, end = window.last, end_state(recording, window, search.parameters, search.numbers)
        search.windows += [window for window in chain if window is not seed]
        search.left_out += [seed] * (first == begin == seed.first)
    search.link()


def _appended(search: Search, chain: list[Window], window: Window) -> bool:
    """Append a window to others, linked if it follows, if a fit of them explains it; return whether it does."""
    before = chain[-1:]
    for one in before:
        one.linked = (one.recording, one.last) == (window.recording, window.first)
    chain.append(window)
    free = len({*map(id, [*search.windows, *chain])}) <= search.block
    start, steps = window.start, window.last - window.first
    for share in _SHARES:
        window.start, window.last = start, window.first + max(min(_LEAST, steps), round(share * steps))
        if search.fit_block(chain[-search.block :], free):
            return True
    window.last = window.first + steps
    del chain[-1]
    unlink(before, range(len(before)))
    return False


def cut_all(search: Search) -> None:
    """Cut all recordings into windows: between flights, if there are any, else one step after the other."""
    for number, (recording, flights) in enumerate(zip(search.recordings, search.flights, strict=True)):
        if flights is not None:
            scene = search.parameters.start
            starts = starts_of(recording, scene, flights, centre_of(recording, scene, flights, search.noise))
            for (first, last), start in zip(flights.spans.values(), starts, strict=True):
                window = Window(number, first, last, start=start)
                explained = search.fit_alone(window)
                (search.windows if explained else search.left_out).append(
                    replace(window, start=window.start if explained else start)
                )
        if not any(window.recording == number for window in search.windows):
            _cut(search, number, state_at(recording))
    search.link()


def _cut(search: Search, number: int, state: Array) -> None:
    """Cut a recording into windows, each from the end of the one before it, until too much is not explained."""
    recording, parameters = search.recordings[number], search.parameters
    first, end, skipped, steps = 0, state, 0, len(recording.states) - 1
    while first < steps:
        window = next_window(recording, number, first, end, parameters, search.numbers)
        if window is None:  # at rest
            window = Window(number, first, min(first + max(1, round(_REST_SKIPPED / recording.dt)), steps), start=end)
            search.resting_steps[number] += window.last - first
            end = end_state(recording, window, parameters, search.numbers)
        elif _appended(search, search.windows, window):
            end = end_state(recording, window, parameters, search.numbers)
        else:  # the model's state is no guess, but of what is not observed soon
            skipped += window.last - first
            if skipped > MOST_SKIPPED * steps:
                return
            end, observed = end_state(recording, window, parameters, search.numbers), recording.states[window.last :]
            near = np.flatnonzero(np.isfinite(observed[:_SOON]).any(axis=0)) % RATES
            end = np.where(np.isin(np.arange(12) % RATES, near), state_at(recording, window.last), end)
        first = window.last
