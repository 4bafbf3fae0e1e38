"""Cut the recordings of a search into windows, each from the end of the one before it: from flights, or from row 0.

A window that the model does not explain ends that. What is left out is tried again when the fields are known better.
"""

from __future__ import annotations

from jackbox_env.fits.first_guess import centre_of, starts_of
from jackbox_env.fits.observed import state_at_first
from jackbox_env.fits.search import BLOCK, Search, link
from jackbox_env.fits.shooting import Window, end_state, next_window

_SHARES = 1.0, 0.5, 0.25  # of a window that are tried until one is explained
_LEAST = 4  # steps of such a share


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
        if any(one.first <= first for one in others):
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
    link(search.windows)


def _appended(search: Search, chain: list[Window], window: Window) -> bool:
    """Append a window to others, linked if it follows, if a fit of them explains it; return whether it does."""
    chain.append(window)
    link(chain)
    few = len({*map(id, [*search.windows, *chain])}) <= BLOCK
    start, steps = window.start, window.last - window.first
    for share in _SHARES:
        window.start, window.last = start, window.first + max(min(_LEAST, steps), round(share * steps))
        if search.fit_block(chain[-BLOCK:], free=few):
            return True
    del chain[-1]
    link(chain)
    return False


def cut_all(search: Search) -> None:
    """Cut all recordings into windows: from flights on, if there are any, else one step after the other."""
    for number, (recording, flights) in enumerate(zip(search.recordings, search.flights, strict=True)):
        seeds = [Window(number, 0, len(recording.states) - 1, start=state_at_first(recording))]
        if flights is not None:
            scene = search.parameters.start
            starts = starts_of(recording, scene, flights, centre_of(recording, scene, flights, search.noise))
            middles = zip(flights.middles.tolist(), starts, strict=True)
            seeds = [Window(number, first, first + 1, start=start) for first, start in middles] + seeds
        windows, left_out = search.windows, search.left_out
        search.numbers, search.windows, search.left_out = search.parameters.of(search.parameters.start), [], seeds
        go_on(search)
        search.windows, search.left_out = [*windows, *search.windows], [*left_out, *search.left_out]
