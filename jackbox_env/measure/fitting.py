"""Fit fields of a scene to recordings, with confidence intervals.

``fit`` cuts recordings into windows (:mod:`jackbox_env.measure.shooting`): between the middles of flights, if these
determine the fields (:mod:`jackbox_env.measure.flights`), else one after the other, each fitted with the few before it.
Then it fits all windows together, while it tightens the links between them and estimates the noise, and goes on from
there to where the jack rests. Intervals and problems come from residuals (:mod:`jackbox_env.measure.residuals`).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env.exact.tangents import FIELDS
from jackbox_env.measure.chain import UNHEARD, WIDTH, Chain, Indices, Rows, minimise
from jackbox_env.measure.flights import Guess, flights_of, guess_of, spikes_of, starts_of
from jackbox_env.measure.recordings import IMPACT, Recording, known_noise, pushed, rough_noise, state_at
from jackbox_env.measure.residuals import (
    autocorrelations,
    degrees_of_freedom,
    highest_mean_square,
    identified,
    jumps,
    leverage,
    misfitting,
    relative_masses,
    studentised,
    unidentified_sentence,
)
from jackbox_env.measure.result import Fit
from jackbox_env.measure.shooting import (
    Parameters,
    Shooting,
    Window,
    end_state,
    followed,
    motion,
    motions,
    next_start,
    next_window,
    units,
)
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import RATES, STATE_NAMES, STATE_UNITS, THETA_JACK, X_JACK, Y_JACK, Array
from jackbox_env.tools import checks as check

try:
    from scipy import stats
    from tqdm import tqdm
except ImportError as error:
    raise ImportError(check.extra_needed("jackbox_env.fit", "scipy", "train")) from error

_NOISE_FLOOR = 1e-9  # of an estimate, in units of the state; rounding grows to about this within a window
_NOISE_WITHOUT_STATES = 1e-4  # that scales the links' slack if only impacts were heard, in units of the state
_LINK_SLACKS = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-4)  # from loose to tight, over the smallest noise
_FIRST_SLACKS = 0.3, 0.1, 0.03, 0.01  # before windows are added that follow
_BLOCK, _INCOMPLETE_BLOCK = 4, 12  # windows fitted together while a recording is cut; the second if numbers are missing
_SHORTENED = 0.5, 0.25  # shares of a window that are tried if the whole is not explained
_REST_SKIPPED = 0.2  # [s] between trials to go on while the jack rests
# [rad] of a jack whose angle was not observed; it repeats every quarter turn
_TRIAL_ANGLES = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8)
_FAR, _MOST_BAD = 6.0, 0.05  # standard deviations of a row that is bad, and the share of such rows
_SURE = 0.25  # relative standard deviation of a guess that replaces the start, at most
_PRIOR_WIDTH = 0.5  # standard deviation, of logarithms of fields and of an unobserved jack's angle [rad]
_PRIOR_FLIGHT_WIDTH = 0.003  # of the numbers of a state on a flight, in units of the state
_PRIOR_START_WIDTH = 0.02  # of the other numbers of a first state, in units of the state
_MOST_CORRELATED = 4.5  # autocorrelation of white residuals, in standard deviations
_MOST_SETTLED = 12  # searches with one slack
_MAY_DROP, _MOST_DROPPED = 2, 0.1  # windows, or their share, that may turn out not to fit as links are tightened
_WIDEST_JUMP = 0.01  # between linked windows, in standard deviations of the noise; below 1e-4 where a search ends
_MOST_CONTRADICTED = 3.7  # standard deviations of a field that is not fitted, from where it would fit best
_FEW_SKIPPED = 0.02  # steps, over those of a recording; other guesses of its start are tried if there are more
_MOST_SKIPPED = 0.2  # steps that could not be followed, over the steps in windows


def fit(
    recordings: Recording | Sequence[Recording], fields: Sequence[str], start: Scene | Mapping[str, Any] | None = None,
    *, noise: float | ArrayLike | Mapping[str, float] | None = None, progress: bool = False,
) -> Fit:  # fmt: skip
    """Fit fields of a scene to recordings, by multiple shooting with exact derivatives (``measure/shooting.py``).

    The intervals are those of the linearised problem, in logarithms of masses, lengths and inertias.

    >>> from jackbox_env import rollout
    >>> torques = np.repeat([2e4, -3e4, 1e4, -1e4], 40)  # [N m]
    >>> states = rollout(Scene(jack_mass=6.0), 0.3 * np.eye(12)[THETA_JACK], torques, dt=0.02)[0]
    >>> found = fit(Recording(states, torques, dt=0.02), ["jack_mass"])
    >>> round(found.scene.jack_mass, 6), found.converged
    (6.0, True)

    Args:
        recordings: one or several, of the same scene.
        fields: names of the numbers to fit: any of gravity, box_mass, box_inertia, jack_mass, jack_inertia, jack_arm,
            box_half_width, restitution. An inertia that the scene derives follows its mass and length.
        start: where the search begins. Its other fields and its drive stay.
        noise: standard deviations of what was observed: one number, 12 in the order of a state, or by name ("x_jack",
            "impacts" [s]). None, and names left out: estimated from the residuals. An estimate needs some dozens of
            observations of a kind, so give the noise of a handful of impacts' times.
        progress: whether to show a bar, which tqdm draws on a terminal.

    Raises:
        TypeError, ValueError: unusable values; recordings that no motion of the scene at the start can follow.
    """
    several = [recordings] if isinstance(recordings, Recording) else recordings
    if not isinstance(several, Sequence) or not several or not all(isinstance(one, Recording) for one in several):
        raise TypeError(f"recordings must be a Recording or several, got {check.shown(recordings)}")
    if isinstance(fields, str) or not isinstance(fields, Sequence) or not len(fields):
        raise ValueError(f"fields must be different names, at least one, got {check.shown(fields)}")
    for name in fields:
        check.choice("a field", name, FIELDS)
    if len({*fields}) < len(fields):
        raise ValueError(f"fields must be different names, at least one, got {check.shown(fields)}")
    parameters = Parameters(fields, Scene.of(start))
    total = sum(len(one.states) - 1 for one in several)
    disable = None if check.flag("progress", progress) else True  # None: unless on a terminal
    with tqdm(total=total, unit="step", desc="cutting", leave=False, disable=disable) as bar:
        arguments = list(several), parameters, known_noise(noise), bar
        search = _Search(*arguments)
        try:
            estimate = search.fit()
        except ValueError:  # no part agrees
            if not search.between_flights:
                raise
            return _Search(*arguments, from_start=True).fit()
        if search.between_flights and not estimate.converged:
            with suppress(ValueError):
                other = _Search(*arguments, from_start=True).fit()
                return other if other.converged else estimate
        return estimate


class _Search:
    """One fit: its windows, and the present values of the fields' numbers and of the noise."""

    def __init__(
        self, recordings: list[Recording], parameters: Parameters, known_noise: Array, progress: Any,
        from_start: bool = False,
    ) -> None:  # fmt: skip
        self._progress = progress  # a bar of tqdm
        self._recorded, self._parameters, self._known_noise = recordings, parameters, known_noise
        self._units = units(parameters.start)
        rough = rough_noise(recordings, np.append(self._units, 1.0))
        self._noise = np.where(np.isfinite(known_noise), known_noise, rough)
        self._bad_rows = [spikes_of(one, parameters.start, self._noise) for one in recordings]
        self._recordings = [one.without(rows) for one, rows in zip(recordings, self._bad_rows, strict=True)]
        from_start = from_start or "gravity" in parameters.fields  # flights need it
        self._flights = [
            None if from_start else flights_of(one, parameters.start, self._noise) for one in self._recordings
        ]
        self._observed = np.isfinite(np.concatenate([one.states for one in recordings])).mean(axis=0) > 0.5
        self._block = _BLOCK if self._observed.all() else _INCOMPLETE_BLOCK
        self._windows: list[Window] = []
        self._resting_steps = [0] * len(recordings)  # in no window because the jack rests there by the model
        self._left_out: list[Window] = []  # that the model does not explain
        self._fewest = 1  # windows that stay
        self.between_flights = False  # whether windows are cut between flights
        self._numbers = parameters.of(parameters.start)

    def fit(self) -> Fit:
        """Cut the recordings into windows, then fit all windows together."""
        guesses = self._guess()
        self.between_flights = any(guess is not None for guess in guesses)
        for number, recording in enumerate(self._recordings):
            before, guess = len(self._windows), guesses[number]
            if guess is not None:
                self._cut_between(number, guess)
            if len(self._windows) == before:
                self._left_out = [window for window in self._left_out if window.recording != number]
                if number:
                    self._cut(number, state_at(recording))
                else:
                    self._cut_first()
        self._refuse_nothing()
        self._progress.reset(total=len(_LINK_SLACKS) + 2)
        self._progress.set_description("fitting")
        self._settle(_LINK_SLACKS[0])
        self._leave_out_bad_rows()
        self._without_misfits(_LINK_SLACKS[0], len(self._windows))
        self._resume()
        self._refuse_nothing()
        for slack in _FIRST_SLACKS:
            self._settle(slack)
        self._resume()
        self._go_on()
        self._settle(_LINK_SLACKS[0])
        self._without_misfits(_LINK_SLACKS[0], len(self._windows))
        self._refuse_nothing()
        count = len(self._windows)
        self._fewest = max(1, count - max(_MAY_DROP, math.floor(_MOST_DROPPED * count)))
        for slack in (*_LINK_SLACKS, _LINK_SLACKS[-1]):
            ended = self._settle(slack)
            if self._without_misfits(slack, len(self._windows) - self._fewest):
                ended = self._settle(slack)
            shooting = Shooting(self._recordings, self._parameters, self._windows)
            chain = Chain(self._rows(shooting, slack), len(self._windows))
            self._estimate_noise(chain)
            self._progress.update()
        return self._result(chain, ended)

    def _refuse_nothing(self) -> None:
        """ValueError if there are no windows."""
        if not self._windows:
            noise = ", or the noise, which may be larger than given" * bool(np.isfinite(self._known_noise).any())
            raise ValueError(
                "no part of the recording agrees with the start scene: check its sizes, masses, gravity and drive"
                f"{noise}, or whether the jack moves"
            )

    def _settle(self, slack: float) -> bool:
        """Optimise all windows, without those that block the search; return whether it ended."""
        for _ in range(_MOST_SETTLED):
            ended, blocking = self._solve(Shooting(self._recordings, self._parameters, self._windows), slack)
            if ended or not 0 < len(blocking) <= len(self._windows) - self._fewest:
                break
            self._drop(blocking.tolist())
        return ended

    def _leave_out_bad_rows(self) -> None:
        """Leave out rows in which the jack is far off the fitted motion, if they are few."""
        for number, states in enumerate(self._motions()[0]):
            off = (self._recordings[number].states - states)[:, X_JACK:RATES]
            far = np.flatnonzero((abs(off) > _FAR * self._noise[X_JACK:RATES]).any(axis=1)).tolist()
            if len(far) + len(self._bad_rows[number]) <= _MOST_BAD * len(states):
                self._bad_rows[number].update((row, off[row]) for row in far)
                self._recordings[number] = self._recordings[number].without(far)

    def _drop(self, indices: Sequence[int]) -> None:
        """Leave windows out, for :meth:`_resume`."""
        _unlink(self._windows, indices)
        self._left_out += [self._windows[index] for index in indices]
        self._windows = [window for index, window in enumerate(self._windows) if index not in indices]

    def _resume(self) -> None:
        """Take back windows that the model explains by now: from the ends of those before them, or from flights."""
        before = {(window.recording, window.last): window for window in self._windows}
        for window in sorted(self._left_out, key=lambda one: (one.recording, one.first)):
            previous, start = before.get((window.recording, window.first)), window.start
            if previous is not None:
                recording = self._recordings[window.recording]
                window.start = end_state(recording, previous, self._parameters, self._numbers)
            explained = self._fit_alone(window)
            if not explained and previous is not None:
                window.start = start
                explained = self._fit_alone(window)
            if explained:
                self._left_out.remove(window)
                self._windows.append(window)
                before[window.recording, window.last] = window
        self._windows.sort(key=lambda one: (one.recording, one.first))
        self._link()

    def _go_on(self) -> None:
        """Follow the jack from where windows end that nothing is linked to, until it rests or the model fails."""
        for window in [one for one in self._windows if not one.linked and self._flights[one.recording] is not None]:
            recording, number = self._recordings[window.recording], window.recording
            until = min(
                (one.first for one in self._windows if one.recording == number and one.first >= window.last),
                default=len(recording.states) - 1,
            )
            chain = [window]
            while chain[-1].last < until:
                end = end_state(recording, chain[-1], self._parameters, self._numbers)
                new = next_window(recording, number, chain[-1].last, end, self._parameters, self._numbers)
                if new is None:
                    break
                chain[-1].linked, new.last = True, min(new.last, until)
                chain.append(new)
                if not self._fit_block(chain[-self._block :], free=False):
                    del chain[-1]
                    chain[-1].linked = False
                    break
            self._windows += chain[1:]
        self._windows.sort(key=lambda one: (one.recording, one.first))
        self._link()

    def _link(self) -> None:
        """Link each window to the next one if that begins where it ends."""
        for window, after in pairwise(self._windows):
            window.linked = (window.recording, window.last) == (after.recording, after.first)

    # -- solving ------------------------------------------------------------------------------------------------------

    def _scaled_slack(self, slack: float) -> float:
        noise = (self._noise[:12] / self._units)[self._observed]
        return slack * float(noise.min() if len(noise) else _NOISE_WITHOUT_STATES)

    def _rows(self, shooting: Shooting, slack: float) -> Rows:
        rows = shooting.rows(shooting.unknowns(self._numbers), self._noise, self._scaled_slack(slack))
        assert rows is not None  # the search has evaluated them here
        return rows

    def _solve(self, shooting: Shooting, slack: float, free: bool = True, most: int = 60) -> tuple[bool, Indices]:
        """Optimise the windows' starts, and the fields too if they are ``free``.

        Returns whether the search ended, and the windows that block it.
        """
        fixed = np.zeros(0) if free else self._numbers
        first, noise, scaled_slack = shooting.unknowns(self._numbers), self._noise, self._scaled_slack(slack)

        def evaluate(unknowns: Array) -> Rows | None:
            self._progress.refresh()
            rows = shooting.rows(np.concatenate([fixed, unknowns]), noise, scaled_slack)
            width = None if rows is None else rows.jacobian.shape[1] - len(fixed)
            return rows if rows is None or free else rows._replace(jacobian=rows.jacobian[:, :width])

        low, high = (bound[len(fixed) :] for bound in (self._parameters.low, self._parameters.high))
        unknowns, ended, blocking = minimise(evaluate, first[len(fixed) :], len(shooting.windows), most, low, high)
        self._numbers = shooting.set_starts(np.concatenate([fixed, unknowns]))
        return ended, blocking

    def _estimate_noise(self, chain: Chain) -> None:
        """Estimate the unknown noise from residuals, with as many degrees of freedom as the unknowns leave."""
        rows = chain.rows
        freedom, least = 1.0 - leverage(rows, chain.projections()), _NOISE_FLOOR * np.append(self._units, 1.0)
        for column in np.flatnonzero(~np.isfinite(self._known_noise)):
            of_column = rows.column == column
            count = float(freedom[of_column].sum())
            if count > 1.0:
                scale = math.sqrt(float((rows.residuals[of_column] ** 2).sum()) / count)
                self._noise[column] = max(scale * self._noise[column], least[column])

    # -- cutting recordings into windows ------------------------------------------------------------------------------

    def _guess(self) -> list[Guess | None]:
        """Set the fields' numbers to those that the impacts determine, and return guesses if these are all."""
        scene, fields, best = self._parameters.start, self._parameters.fields, dict[str, tuple[float, float]]()
        guesses = [
            None if flights is None else guess_of(recording, scene, flights, self._noise, fields)
            for recording, flights in zip(self._recordings, self._flights, strict=True)
        ]
        for guess in guesses:
            for name, value in guess.values.items() if guess else ():
                best[name] = min(best.get(name, value), value, key=lambda one: one[1])
        deviations = np.array([best.get(name, (0.0, np.inf))[1] for name in fields])
        self._first_width = 3.0 * deviations
        sure = {name: best[name][0] for name, deviation in zip(fields, deviations, strict=True) if deviation < _SURE}
        if "restitution" in sure:
            sure["restitution"] = min(sure["restitution"], 1.0)
        known = self._parameters.of(scene.changed(**sure))
        self._numbers = np.clip(known, self._parameters.low, self._parameters.high)
        return guesses if len(sure) == len(fields) else [None] * len(guesses)

    def _cut_between(self, number: int, guess: Guess) -> None:
        """Cut a recording into windows between the middles of flights, those which the model explains."""
        recording, numbers, flights = self._recordings[number], self._numbers, self._flights[number]
        assert flights is not None
        starts = starts_of(recording, self._parameters.scene(numbers), flights, guess)
        for (first, last), start in zip(flights.spans.values(), starts, strict=True):
            window = Window(number, first, last, start=start)
            (self._windows if self._fit_alone(window) else self._left_out).append(window)
        self._link()

    def _fit_alone(self, window: Window) -> bool:
        """Fit a window near its start and near the fields' present numbers; return whether it is explained."""
        recording, numbers = self._recordings[window.recording], self._numbers
        if not followed(window, motion(recording, window, self._parameters, numbers)):
            return False
        explained = self._explained([window])
        if not explained:
            mean, width = self._prior([window])
            width[: len(numbers)], width[len(numbers) :] = self._first_width, _PRIOR_FLIGHT_WIDTH
            self._solve(Shooting(self._recordings, self._parameters, [window], (mean, width)), _LINK_SLACKS[0], most=20)
            explained = self._explained([window])
        self._numbers = numbers
        return explained

    def _cut_first(self) -> None:
        """Cut the first recording from several guesses, until one gets to its end; keep the furthest."""
        furthest, best = -1, (self._numbers, self._windows, 0)
        for numbers, state in list(self._first_guesses()):
            self._numbers, self._windows, self._resting_steps[0] = numbers, [], 0
            self._progress.reset()
            complete = self._cut(0, state)
            covered = sum(window.last - window.first for window in self._windows)
            if covered > furthest:
                furthest, best = covered, (self._numbers, self._windows, self._resting_steps[0])
            if complete:
                break
        self._numbers, self._windows, self._resting_steps[0] = best

    def _first_guesses(self) -> Iterator[tuple[Array, Array]]:
        """Guesses of the fields' numbers and of the first state."""
        first, numbers, positive = state_at(self._recordings[0]), self._numbers, self._parameters.logarithmic
        for angle in (0.0,) if np.isfinite(self._recordings[0].states[0, THETA_JACK]) else _TRIAL_ANGLES:
            yield numbers, first + angle * np.eye(12)[THETA_JACK]
        for factor in (0.7, 1.4):
            scaled = np.clip(numbers * factor, 0.0, self._parameters.high)
            yield np.where(positive, numbers + math.log(factor), scaled), first

    def _cut(self, number: int, state: Array) -> bool:
        """Cut a recording into windows, each from the end of the one before it; return whether its end was reached."""
        recording = self._recordings[number]
        first, end, linked, skipped, shown = 0, state, False, 0, 0
        while first < len(recording.states) - 1:
            self._progress.update(first - shown)
            shown = first
            window = next_window(recording, number, first, end, self._parameters, self._numbers)
            if window is None:  # at rest
                pause = max(1, round(_REST_SKIPPED / recording.dt))
                window = Window(number, first, min(first + pause, len(recording.states) - 1), start=end)
                self._resting_steps[number] += window.last - first
                end, first, linked = end_state(recording, window, self._parameters, self._numbers), window.last, False
                continue
            if linked:
                self._windows[-1].linked = True
            self._windows.append(window)
            whole, explained = window.last, self._fit_last()
            for share in () if explained else _SHORTENED:
                self._windows[-1] = replace(window, last=first + max(1, round(share * (whole - first))), start=end)
                explained = self._fit_last()
                if explained:
                    break
            if not explained:
                del self._windows[-1]
                if linked:
                    self._windows[-1].linked = False
                skipped += whole - first
                if skipped > _MOST_SKIPPED * len(recording.states):
                    return False
            first, linked = self._windows[-1].last if explained else whole, explained
            last = self._windows[-1] if explained else window
            end = next_start(recording, last, self._parameters, self._numbers, explained)
        return skipped <= _FEW_SKIPPED * len(recording.states)

    def _fit_last(self) -> bool:
        """Fit the last window, with those before it; return whether it is explained.

        If the jack's angle was not observed, other angles are tried.
        """
        if self._fit_block(self._windows[-self._block :], len(self._windows) <= self._block):
            return True
        last, numbers = self._windows[-1], self._numbers
        for angle in () if self._observed[THETA_JACK] else _TRIAL_ANGLES:
            turned = replace(last, start=last.start + angle * np.eye(12)[THETA_JACK])
            if self._fit_block([turned], False):
                self._windows[-1] = turned
                if self._fit_block(self._windows[-self._block :], len(self._windows) <= self._block):
                    return True
                self._windows[-1], self._numbers = last, numbers
        return False

    def _fit_block(self, windows: list[Window], free: bool) -> bool:
        """Fit windows together, the fields too if they are ``free``; return whether the last window is explained."""
        block = Shooting(self._recordings, self._parameters, windows, self._prior(windows) if free else None)
        if block.rows(block.unknowns(self._numbers), self._noise, 1.0) is None:
            return False
        self._solve(block, _LINK_SLACKS[0], free=free, most=20)
        return self._explained(windows)

    def _explained(self, windows: list[Window]) -> bool:
        """Whether the last of these windows fits within the noise, as it is."""
        block = Shooting(self._recordings, self._parameters, windows)
        rows = block.rows(block.unknowns(self._numbers), self._noise, 1.0)
        if rows is None:
            return False
        of_last = (rows.window == len(windows) - 1) & (rows.column >= 0)
        if not of_last.any():
            return True
        return float(np.mean(rows.residuals[of_last] ** 2)) < highest_mean_square(int(of_last.sum()))

    def _prior(self, windows: list[Window]) -> tuple[Array, Array]:
        """Mean and standard deviation of the fields' numbers and of the first start, shape (F + 12,)."""
        count = len(self._numbers)
        mean = np.concatenate([self._numbers, windows[0].start / self._units])
        width = np.full(count + 12, _PRIOR_START_WIDTH)
        width[:count], width[count + THETA_JACK] = _PRIOR_WIDTH, _PRIOR_WIDTH
        return mean, width

    def _without_misfits(self, slack: float, most: int) -> bool:
        """Drop the windows that a fit does not explain, if they are ``most`` at most; return whether it did."""
        shooting = Shooting(self._recordings, self._parameters, self._windows)
        misfits = np.flatnonzero(misfitting(self._rows(shooting, slack), len(self._windows))).tolist()
        if not 0 < len(misfits) <= most:
            return False
        self._drop(misfits)
        return True

    # -- the result ---------------------------------------------------------------------------------------------------

    def _result(self, chain: Chain, ended: bool) -> Fit:
        numbers, parameters, rows = self._numbers.copy(), self._parameters, chain.rows
        (covariance, unidentified), projections = identified(chain), chain.projections()
        freedom = degrees_of_freedom(rows, projections, unidentified, ~np.isfinite(self._known_noise))
        half_widths = stats.t.ppf(0.975, np.clip(freedom, 1.0, 1e9)) * np.sqrt(np.diag(covariance))
        half_widths[(abs(unidentified) > 0.05).any(axis=0)] = np.inf
        least = np.where(parameters.logarithmic, -np.inf, 0.0)
        most = np.where(parameters.logarithmic, np.inf, parameters.high)
        ends = (parameters.values(np.clip(numbers + sign * half_widths, least, most)) for sign in (-1.0, 1.0))
        states, covered = self._motions()
        left_out = sum(len(one.states) - 1 for one in self._recordings) - covered
        residuals = self._held_out_residuals(covariance)
        unknown = [unidentified_sentence(parameters.fields, row, parameters.logarithmic) for row in unidentified]
        if not any(pushed(one, parameters.start) for one in self._recordings):
            unknown += relative_masses(parameters.fields, np.isfinite(half_widths).tolist(), parameters.start)
        return Fit(
            parameters.scene(numbers),
            {name: (float(low), float(high)) for name, low, high in zip(parameters.fields, *ends, strict=True)},
            residuals,
            tuple(unknown),
            {name: float(self._noise[k]) for k, name in enumerate((*STATE_NAMES, IMPACT)) if (rows.column == k).any()},
            states,
            left_out,
            tuple(self._problems(ended, rows, autocorrelations(rows, projections), residuals, left_out, covered)),
            tuple(self._bad_row_sentences()),
            self._not_followed()[1],
        )

    def _problems(
        self, ended: bool, rows: Rows, deviations: Array, held_out: Array, left_out: int, covered: int
    ) -> Iterator[str]:
        """Why the intervals are not to be trusted, in sentences."""
        if not ended:
            yield "the search did not end"
        shooting = Shooting(self._recordings, self._parameters, self._windows)
        present = self._rows(shooting, _LINK_SLACKS[-1])  # for the noise as it was estimated last
        gaps = jumps(present, len(self._windows), self._scaled_slack(_LINK_SLACKS[-1]), self._scaled_slack(1.0))
        if (gaps > _WIDEST_JUMP).any():
            open_links = f"{(gaps > _WIDEST_JUMP).sum()} of {sum(one.linked for one in self._windows)} links"
            yield f"{open_links} between windows are open, by up to {gaps.max():.2g} of the noise: the motion jumps"
        followed_ones = {window.recording for window in self._windows}
        for number in [one for one in range(len(self._recordings)) if one not in followed_ones]:
            yield f"no part of recording {number} agrees with the scene"
        links, (joints, skipped) = sum(one.linked for one in self._windows), self._not_followed()
        if 2 * links < joints:
            yield f"only {links} of {joints} windows go on where the one before ends: the motion was followed in pieces"
        misfits, unheard = int(misfitting(rows, len(self._windows)).sum()), int((rows.column == UNHEARD).sum())
        if misfits:
            yield f"{misfits} of {len(self._windows)} windows do not fit within the noise"
        if unheard:
            yield f"the fitted motion lacks {unheard} of the impacts that were heard"
        names = *STATE_NAMES, IMPACT, "all numbers together"
        correlated = [name for name, value in zip(names, deviations, strict=True) if value > _MOST_CORRELATED]
        if correlated:
            yield f"residuals of {', '.join(correlated)} are correlated in time: something that is not fitted is wrong"
        name, away = self._contradicted(present)
        if away > _MOST_CONTRADICTED:
            wrong = f"{name}, or something else that is not fitted, is wrong"
            yield f"{wrong}: another value would fit better by {away:.1f} standard deviations"
        for rows_of, one in zip(self._bad_rows, self._recordings, strict=True):
            if len(rows_of) > _MOST_BAD * len(one.states):
                yield f"{len(rows_of)} of {len(one.states)} rows are off the jack's path: no camera's single bad frames"
        if skipped > _MOST_SKIPPED * sum(
            self._recordings[one.recording].dt * (one.last - one.first) for one in self._windows
        ):
            yield f"the jack moves in {skipped:.2g} s that the scene does not explain"
        if len(held_out) and not np.mean(held_out**2) < highest_mean_square(len(held_out)):
            yield "windows that were held out do not fit within the noise"

    def _contradicted(self, rows: Rows) -> tuple[str, float]:
        """The field that would move furthest if it was fitted, too, and by how many standard deviations."""
        scene, names = replace(self._parameters.scene(self._numbers)), [*FIELDS]  # in which no inertia follows
        for name in self._parameters.fields:
            names.remove(name)
        parameters, slack = Parameters(names, scene), self._scaled_slack(_LINK_SLACKS[-1])
        shooting = Shooting(self._recordings, parameters, self._windows)
        shooting.units = self._units
        others = shooting.rows(shooting.unknowns(parameters.of(scene)), self._noise, slack)
        if others is None or not names:  # rounding has changed what can be followed
            return "", 0.0
        together = rows._replace(jacobian=np.column_stack([rows.jacobian, others.jacobian[:, 2 * WIDTH :]]))
        moves = abs(Chain(together, len(self._windows)).moves(rows.fields))
        furthest = int(np.argmax(moves))
        return parameters.fields[furthest], float(moves[furthest])

    def _bad_row_sentences(self) -> Iterator[str]:
        """The rows that were left out, and how far the jack is off; not rows that agree with the fitted motion."""
        for number, (rows, states) in enumerate(zip(self._bad_rows, self._motions()[0], strict=True)):
            recorded, noise = self._recorded[number].states, self._noise[X_JACK:RATES]
            recording = f" of recording {number}" * (len(self._bad_rows) > 1)
            for row, off in sorted(rows.items()):
                away = abs(recorded[row] - states[row])[X_JACK:RATES] / noise
                if np.isfinite(away).any() and not (away > _FAR).any():
                    continue
                column = X_JACK + int(np.nanargmax(abs(off) / noise))
                distance = f"{STATE_NAMES[column]} is {abs(off[column - X_JACK]):.2g} {STATE_UNITS[column]} off"
                lost = (recorded[row, [X_JACK, Y_JACK]] == 0.0).all()
                yield f"row {row}{recording}: {'x_jack and y_jack are 0, as of a lost frame' if lost else distance}"

    def _not_followed(self) -> tuple[int, float]:
        """How many windows should be linked to the next one, and the time in none though the jack moves there [s]."""
        joints, seconds = 0, 0.0
        for number, (modelled, flights) in enumerate(zip(self._motions()[0], self._flights, strict=True)):
            missing = np.isnan(modelled[1:, X_JACK])
            if flights is None:
                joints += sum(window.recording == number for window in self._windows) - 1
                steps = max(0, int(missing.sum()) - self._resting_steps[number])
            else:
                joints += sum(one[1] == other[0] for one, other in pairwise(flights.spans.values()))
                steps = sum(int(missing[first:last].sum()) for first, last in flights.spans.values())
            seconds += steps * self._recordings[number].dt
        return joints, seconds

    def _motions(self) -> tuple[tuple[Array, ...], int]:
        """The fitted motion of each recording, and the number of steps in windows."""
        states, covered = tuple(np.full(one.states.shape, np.nan) for one in self._recordings), 0
        played = motions(self._recordings, self._windows, self._parameters, self._numbers)
        assert played is not None  # the search has evaluated them here
        for window, modelled in zip(self._windows, played, strict=True):
            states[window.recording][window.first : window.last + 1] = modelled.states
            covered += window.last - window.first
        return states, covered

    def _held_out_residuals(self, covariance: Array) -> Array:
        """Studentised residuals of every fifth window, or the last of fewer, in fits without it."""
        numbers, windows = self._numbers.copy(), [replace(one, start=one.start.copy()) for one in self._windows]
        held_out = list(range(4, len(windows), 5)) or [len(windows) - 1][: len(windows) - 1]
        if not held_out:
            return np.zeros(0)
        _unlink(windows, held_out)
        rest = [window for index, window in enumerate(windows) if index not in held_out]
        self._solve(Shooting(self._recordings, self._parameters, rest), _LINK_SLACKS[-1])
        residuals = []
        for index in held_out:
            alone = Shooting(self._recordings, self._parameters, [windows[index]])
            self._solve(alone, _LINK_SLACKS[-1], free=False)
            residuals.append(studentised(self._rows(alone, _LINK_SLACKS[-1]), covariance))
        self._numbers = numbers
        return np.concatenate(residuals)


def _unlink(windows: list[Window], indices: Sequence[int]) -> None:
    """Remove the links of windows to those before and after them."""
    for index in indices:
        windows[index].linked = False
        if index:
            windows[index - 1].linked = False
