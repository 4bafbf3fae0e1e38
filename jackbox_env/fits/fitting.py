"""Fit fields of a scene to recordings, with confidence intervals.

``fit`` cuts recordings into windows (:mod:`jackbox_env.fits.windows`), each fitted with the few before it. Then it fits
all windows together (:mod:`jackbox_env.fits.search`), goes on from there to where the jack rests, tightens the links
between windows and estimates the noise. Intervals and problems come last (:mod:`jackbox_env.fits.outcome`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from jackbox_env.exact.tangents import FIELDS
from jackbox_env.fits.observed import Recording, known_noise, looks_smoothed
from jackbox_env.fits.outcome import outcome_of
from jackbox_env.fits.result import Fit
from jackbox_env.fits.search import LINK_SLACKS, Search
from jackbox_env.fits.shooting import Parameters, Shooting
from jackbox_env.fits.windows import cut_all, go_on
from jackbox_env.model.scene import Scene
from jackbox_env.tools import checks as check

_LEAST_SEEN = 10  # rows and impacts; fewer determine no field and no noise


def fit(
    recordings: Recording | Sequence[Recording], fields: Sequence[str], start: Scene | Mapping[str, Any] | None = None,
    *, noise: float | Mapping[str, float] | None = None,
) -> Fit:  # fmt: skip
    """Fit fields of a scene to recordings, by multiple shooting with exact derivatives (``fits/shooting.py``).

    The intervals are those of the linearised problem, in logarithms of masses, lengths and inertias.

    >>> from jackbox_env import rollout
    >>> torques = np.repeat([2e4, -3e4, 1e4, -1e4], 40)  # [N m]
    >>> states = rollout(Scene(jack_mass=6.0), 0.3 * np.eye(12)[5], torques, dt=0.02)[0]
    >>> found = fit(Recording(states, torques, dt=0.02), ["jack_mass"])
    >>> round(found.scene.jack_mass, 6), found.converged
    (6.0, True)

    Args:
        recordings: one or several, of the same scene.
        fields: names of the numbers to fit: any of gravity, box_mass, box_inertia, jack_mass, jack_inertia, jack_arm,
            box_half_width, restitution. An inertia that the scene derives follows its mass and length.
        start: where the search begins. Its other fields and its drive stay.
        noise: standard deviations of what was observed: one number, or by name ("x_jack", "impacts" [s]). None, and
            names left out: estimated from the residuals. An estimate needs some dozens of observations of a kind, so
            give the noise of a handful of impacts' times.

    Raises:
        TypeError, ValueError: unusable values; recordings that no motion of the scene at the start can follow.
    """
    several = [recordings] if isinstance(recordings, Recording) else recordings
    if not isinstance(several, Sequence) or not several or not all(isinstance(one, Recording) for one in several):
        raise TypeError(f"recordings must be a Recording or several, got {check.shown(recordings)}")
    listed = isinstance(fields, Sequence) and not isinstance(fields, str)
    if not (listed and 0 < len({*map(str, fields)}) == len(fields)):
        raise ValueError(f"fields must be different names, at least one, got {check.shown(fields)}")
    check.known_keys("fields", fields, FIELDS)
    search = Search(list(several), Parameters(fields, Scene.of(start)), known_noise(noise))
    seen = sum(
        int(np.isfinite(one.states).any(axis=1).sum()) + (0 if one.impacts is None else len(one.impacts))
        for one in several
    )
    if seen < _LEAST_SEEN:
        raise ValueError(
            f"recordings must have at least {_LEAST_SEEN} rows in which something was observed, or impacts that were "
            f"heard, got {seen}"
        )
    cut_all(search)
    if not search.windows:
        smooth = ", or the track, which looks smoothed" * looks_smoothed(search.recordings)
        raise ValueError(
            "no part of the recording agrees with the start scene: check that y points up (--y-down), units, sizes, "
            f"masses, gravity and drive, a noise that you gave{smooth}, or whether the jack moves"
        )
    for slack in (LINK_SLACKS[0], LINK_SLACKS[1], LINK_SLACKS[1]):
        search.settle(slack)
        search.without_misfits(slack)
        go_on(search)
    for slack in (*LINK_SLACKS, LINK_SLACKS[-1]):
        ended = search.settle(slack)
        if search.without_misfits(slack):
            ended = search.settle(slack)
        shooting = Shooting(search.recordings, search.parameters, search.windows)
        search.estimate_noise(search.rows(shooting, slack))
    return outcome_of(search, ended)
