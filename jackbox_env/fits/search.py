"""The search of a fit: least squares over windows of recordings, the fields' numbers and the noise.

:mod:`jackbox_env.fits.windows` finds the windows, :mod:`jackbox_env.fits.fitting` tightens their links, and
:mod:`jackbox_env.fits.outcome` derives intervals and problems from what a search ends with.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from jackbox_env.fits.first_guess import flights_of, without_spikes
from jackbox_env.fits.least_squares import FAR, WIDTH, Indices, Rows, minimise
from jackbox_env.fits.observed import Recording, rough_noise
from jackbox_env.fits.residuals import mean_squares, misfitting
from jackbox_env.fits.shooting import Parameters, Shooting, Window, motions, units
from jackbox_env.model.states import THETA_JACK, Array

_NOISE_FLOOR = 1e-9  # of an estimate, in units of the state; rounding grows to about this within a window
_LEAST_SHARE = 0.05  # of observations that the unknowns leave
LINK_SLACKS = (1.0, 0.01, 1e-4)  # from loose to tight, over the smallest noise
BLOCK = 6  # windows fitted together while a recording is cut
_PRIOR_WIDTH, _PRIOR_ANGLE = 1.0, 0.5  # standard deviations, of logarithms of fields, of an unobserved angle [rad]
_FIXED = 1e-9  # the same of fields that are not free
_PRIOR_START_WIDTH = 0.02  # of the other numbers of a first state, in units of the state
_MOST_SETTLED = 12  # searches with one slack
_MOST_STEPS = 30  # of a search from near its end; windows that need more block it
# Steps that are evaluated at most, per second and per step of the recordings, and what a step of a drive counts as.
# They take about as long as the recordings; half of the fits that converge need a tenth of that time.
_MOST_OF_SECOND, _MOST_OF_STEP, _LEAST_SECONDS, _OF_DRIVE = 2.5e4, 320, 4.0, 3
MOST_SKIPPED = 0.5  # time in which the jack moves unexplained, over the time in windows


class Search:
    """One fit: its windows, and the present values of the fields' numbers and of the noise."""

    def __init__(self, recordings: list[Recording], parameters: Parameters, known_noise: Array) -> None:
        seconds, steps = sum(len(one.states) * one.dt for one in recordings), sum(len(one.states) for one in recordings)
        # Steps that may still be evaluated.
        self.work: float = _MOST_OF_SECOND * max(_LEAST_SECONDS, seconds) + _MOST_OF_STEP * steps
        self.given, self.parameters, self.known_noise = recordings, parameters, known_noise
        self.units = units(parameters.start)
        rough = rough_noise(recordings, np.append(self.units, 1.0))
        self.noise = np.where(np.isfinite(known_noise), known_noise, rough)
        self.recordings = [without_spikes(one, parameters.start, self.noise) for one in recordings]
        self.flights = [  # which need gravity
            None if "gravity" in parameters.fields else flights_of(one, parameters.start, self.noise)
            for one in self.recordings
        ]
        self.windows: list[Window] = []
        self.left_out: list[Window] = []  # that the model does not explain
        self.numbers = parameters.of(parameters.start)

    def settle(self, slack: float) -> bool:
        """Optimise all windows, without those that block the search; return whether it ended."""
        for _ in range(_MOST_SETTLED):
            shooting = Shooting(self.recordings, self.parameters, self.windows)
            ended, blocking = self.solve(shooting, slack, most=_MOST_STEPS)
            if ended or not 0 < len(blocking) < len(self.windows):
                break
            self.drop(blocking.tolist())
        return ended

    def drop(self, indices: Sequence[int]) -> None:
        """Leave windows out, for :func:`jackbox_env.fits.windows.go_on`."""
        self.left_out += [self.windows[index] for index in indices]
        self.windows = [window for index, window in enumerate(self.windows) if index not in indices]
        link(self.windows)

    def scaled_slack(self, slack: float) -> float:
        """A slack in units of the state, over the smallest noise."""
        return slack * float((self.noise[:12] / self.units).min())

    def rows(self, shooting: Shooting, slack: float) -> Rows:
        """The residuals as they are, with links of a slack."""
        rows = shooting.rows(shooting.unknowns(self.numbers), self.noise, self.scaled_slack(slack))
        assert rows is not None  # the search has evaluated them here
        return rows

    def solve(self, shooting: Shooting, slack: float, most: int = 60) -> tuple[bool, Indices]:
        """Optimise the windows' starts and the fields, while work is left.

        Returns whether the search ended, and the windows that block it or that the model could not follow at last.
        """
        first, noise, scaled_slack = shooting.unknowns(self.numbers), self.noise, self.scaled_slack(slack)
        work = sum(
            (one.last - one.first) * (_OF_DRIVE if self.recordings[one.recording].torques is None else 1)
            for one in shooting.windows
        )

        def evaluate(unknowns: Array) -> Rows | None:
            self.work -= work
            return shooting.rows(unknowns, noise, scaled_slack)

        bounds, most = (self.parameters.low, self.parameters.high), most if self.work > 0.0 else 0
        unknowns, ended, blocking = minimise(evaluate, first, len(shooting.windows), most, *bounds)
        self.numbers = shooting.set_starts(unknowns)
        return ended, blocking if len(blocking) else np.array(shooting.not_followed, dtype=np.intp)

    def free_share(self, rows: Rows) -> float:
        """The share of the observations that the unknowns leave: fields, and the starts that no link determines."""
        counts = np.bincount(rows.window[rows.column >= 0], minlength=len(self.windows))
        free = np.array([True, *(not one.linked for one in self.windows[:-1])])
        unknowns = rows.fields + np.minimum(counts, WIDTH)[free].sum()
        return max(_LEAST_SHARE, 1.0 - float(unknowns) / max(1.0, float(counts.sum())))

    def estimate_noise(self, rows: Rows) -> None:
        """Estimate the unknown noise from residuals, with as many degrees of freedom as the unknowns leave."""
        share, least = self.free_share(rows), _NOISE_FLOOR * np.append(self.units, 1.0)
        for column in np.flatnonzero(~np.isfinite(self.known_noise)):
            residuals = rows.residuals[rows.column == column]
            if len(residuals):
                scale = math.sqrt(float((residuals**2).mean()) / share)
                self.noise[column] = max(scale * self.noise[column], least[column])

    def fit_block(self, windows: list[Window], free: bool) -> bool:
        """Fit windows together, the fields too if they are ``free``; return whether the last window is explained.

        Not if it is as it is; if it never is, all stays as it was.
        """
        block = Shooting(self.recordings, self.parameters, windows, self.prior(windows, free))
        before = block.unknowns(self.numbers)
        rows = block.rows(before, self.noise, 1.0)
        if rows is None or _explained(rows, len(windows) - 1):
            return rows is not None
        self.solve(block, LINK_SLACKS[0], most=20)
        explained = _explained(self.rows(block, LINK_SLACKS[0]), len(windows) - 1)
        if not explained:
            self.numbers = block.set_starts(before)
        return explained

    def prior(self, windows: list[Window], free: bool) -> tuple[Array, Array]:
        """Mean and standard deviation of the fields' numbers, which stay if not ``free``, and of the first start."""
        count = len(self.numbers)
        mean = np.concatenate([self.numbers, windows[0].start / self.units])
        width = np.full(count + 12, _PRIOR_START_WIDTH if free else np.inf)
        width[:count], width[count + THETA_JACK] = (_PRIOR_WIDTH, _PRIOR_ANGLE) if free else (_FIXED, np.inf)
        return mean, width

    def without_misfits(self, slack: float) -> bool:
        """Drop the windows that a fit does not explain, unless it explains none; return whether it did."""
        shooting = Shooting(self.recordings, self.parameters, self.windows)
        misfits = np.flatnonzero(misfitting(self.rows(shooting, slack), len(self.windows))).tolist()
        if not 0 < len(misfits) < len(self.windows):
            return False
        self.drop(misfits)
        return True

    def motions(self) -> tuple[Array, ...]:
        """The fitted motion of each recording, (H + 1, 12), NaN in no window."""
        states = tuple(np.full(one.states.shape, np.nan) for one in self.recordings)
        played = motions(self.recordings, self.windows, self.parameters, self.numbers)
        for window, modelled in zip(self.windows, played, strict=True):
            assert modelled is not None  # the search has evaluated it here
            states[window.recording][window.first : window.last + 1] = modelled.states
        return states


def _explained(rows: Rows, window: int) -> bool:
    """Whether a window fits within the noise, without a bad number: in a short one a wrong path may look like some."""
    square, most = mean_squares(rows, window + 1)
    return bool(square[window] < most[window]) and not (rows.column[rows.window == window] == FAR).any()


def link(windows: list[Window]) -> None:
    """Sort windows, and link each to the next one if that begins where it ends."""
    windows.sort(key=lambda one: (one.recording, one.first))
    for window, after in zip(windows, [*windows[1:], None], strict=False):
        window.linked = after is not None and (window.recording, window.last) == (after.recording, after.first)
