"""The scene that a recording was made in: fields of a scene fitted to what was seen and heard, with intervals."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from jackbox_env import checks as check
from jackbox_env.exact.tangents import FIELDS
from jackbox_env.measure.recordings import Recording
from jackbox_env.measure.shooting import UNHEARD, Parameters, Rows, Shooting, Window, motion, next_window, units
from jackbox_env.scene import Scene
from jackbox_env.states import RATES, STATE_NAMES, THETA_JACK, Array

try:
    from scipy import optimize, stats
except ImportError as error:
    raise ImportError(check.extra_needed("jackbox_env.fit", "scipy", "train")) from error

IMPACT = "impacts"  # the name of the noise of impacts' times
_BLOCKS = 4, 12  # windows that are fitted together while a recording is taken in: all was seen, or not all
_SLACKS = (1.0, 0.3, 0.1, 0.03, 0.01, 1e-3, 1e-5)  # of links, over the smallest noise
_LAGS = 4  # rows: residuals further apart are not compared
_CORRELATED = 4.5  # standard deviations of white noise's autocorrelation beyond which residuals are not white
_LOST_SHARE = 0.2  # of the steps in windows, which the search may lose
_SHORTER = 0.5, 0.25  # of a window that is not explained
_UNSEEN = 1e-4  # slack of links at first, in units of the state, where impacts are all there is
_MANY = 20  # third differences that tell the noise
_ROUGH = 1e-2  # noise at first, in units of the state; of impacts' times [s]
_SMALLEST = 1e-12  # noise that can be given, in SI units
_LEAST = 1e-9  # noise that is estimated, at least, in the same units: rounding grows to about this within a window
_UNTOLD = 5.0  # standard deviation of a logarithm beyond which a combination is not told
_LOST = 1e6  # residual of a motion that cannot be followed, in units of the noise
_PAUSE = 0.2  # [s] after which rest is looked at again
_VAGUE = 0.5  # standard deviation of what is not known yet: logarithms of fields, the jack's angle [rad]
_GUESSED = 0.02  # the same of a recording's other first numbers, in units of the state
# [rad] to try where the jack's angle was not seen; it looks the same after a quarter turn.
_ANGLES = (-0.6, -0.4, -0.2, 0.0, 0.2, 0.4, 0.6, 0.8)


@dataclass(frozen=True)
class Fit:
    """A scene fitted to recordings.

    Attributes:
        scene: the scene.
        intervals: of each field, the 95 % interval; (0, inf), of restitution (0, 1), where the recordings do not
            tell it.
        residuals: of the windows that were held out, (observed - fitted) over the standard deviation that is expected
            there, shape (n,): about normal, where the model is right. A held-out window's start is its own.
        unidentified: the combinations of fields that the recordings do not tell, each in a sentence.
        noise: standard deviation of each number that was observed, by its name, and of "impacts" [s].
        motions: the fitted motion of each recording, shape (H + 1, 12), NaN where it was left out.
        left_out: steps that were left out because the jack is at rest there, or cannot be followed.
        problems: why the intervals are not to be trusted, each in a sentence without a full stop; empty if the search
            ended, every window fits within the noise, and the residuals are white.
    """

    scene: Scene
    intervals: dict[str, tuple[float, float]]
    residuals: Array
    unidentified: tuple[str, ...]
    noise: dict[str, float] = field(default_factory=dict)
    motions: tuple[Array, ...] = ()
    left_out: int = 0
    problems: tuple[str, ...] = ()

    @property
    def converged(self) -> bool:
        """Whether there are no problems."""
        return not self.problems


def fit(
    recordings: Recording | Sequence[Recording], fields: Sequence[str], start: Scene | Mapping[str, Any] | None = None,
    *, noise: float | ArrayLike | Mapping[str, float] | None = None,
) -> Fit:  # fmt: skip
    """Fit fields of a scene to recordings, by multiple shooting with exact derivatives (``measure/shooting.py``).

    Least squares by SciPy. The intervals are those of the linearised problem, in logarithms of masses, lengths and
    inertias.

    Args:
        recordings: one or several, of the same scene.
        fields: which of the scene's numbers to fit: any of gravity, box_mass, box_inertia, jack_mass, jack_inertia,
            jack_arm, box_half_width, restitution. An inertia that the scene derives follows its mass and length.
        start: where the search begins; its other fields and its drive are taken as they are.
        noise: standard deviations of what was observed: one number, 12 in the order of a state, or by name ("x_jack",
            "impacts" [s]); None, and what is not named: estimated from the residuals. That takes some dozens of
            observations of a kind: tell the noise of a handful of impacts' times.

    Raises:
        TypeError, ValueError: unusable values; recordings that no motion of the scene at the start can follow.
    """
    given = [recordings] if isinstance(recordings, Recording) else recordings
    if not isinstance(given, Sequence) or not given or not all(isinstance(one, Recording) for one in given):
        raise TypeError(f"recordings must be a Recording or several, got {check.shown(recordings)}")
    if isinstance(fields, str) or not isinstance(fields, Sequence) or not len(fields):
        raise ValueError(f"fields must be different names, at least one, got {check.shown(fields)}")
    for name in fields:
        check.choice("a field", name, FIELDS)
    if len({*fields}) < len(fields):
        raise ValueError(f"fields must be different names, at least one, got {check.shown(fields)}")
    parameters = Parameters(fields, Scene.of(start))
    return _Search(list(given), parameters, _known_noise(noise)).fit()


def _known_noise(noise: Any) -> Array:
    """Standard deviations of the 12 numbers of a state and of impacts' times, shape (13,); NaN where not known."""
    names, known = (*STATE_NAMES, IMPACT), np.full(13, np.nan)
    if isinstance(noise, Mapping):
        check.known_keys("noise", noise, names)
        for name, value in noise.items():
            known[names.index(name)] = check.real(f"noise[{name!r}]", value, at_least=_SMALLEST)
    elif noise is not None:
        given = np.array(check.array("noise", noise, "hold numbers"), dtype=np.float64)
        if given.shape not in ((), (12,)) or not (np.isfinite(given).all() and (given >= _SMALLEST).all()):
            wanted = f"noise must be finite and at least {_SMALLEST:g}, one number or 12 or by name"
            raise ValueError(f"{wanted}, got {check.shown(noise)}")
        known[: 13 if given.ndim == 0 else 12] = given
    return known


class _Search:
    """One fit."""

    def __init__(self, recordings: list[Recording], parameters: Parameters, known: Array) -> None:
        self._recordings, self._parameters, self._known = recordings, parameters, known
        self._units = units(parameters.start)
        self._noise = np.where(np.isfinite(known), known, rough_noise(recordings, np.append(self._units, 1.0)))
        self._seen = np.isfinite(np.concatenate([one.states for one in recordings])).mean(axis=0) > 0.5
        self._block = _BLOCKS[0] if self._seen.all() else _BLOCKS[1]
        self._windows: list[Window] = []
        self._rested = 0  # steps that no window has because the jack is at rest there
        self._numbers = parameters.of(parameters.start)

    def fit(self) -> Fit:
        """Take in the recordings, then fit all windows together."""
        self._begin()
        for number, recording in enumerate(self._recordings[1:], start=1):
            self._grow(number, first_state(recording))
        if not self._windows:
            reasons = "the scene at the start leads elsewhere, or they are at rest"
            if np.isfinite(self._known).any():
                reasons += ", or the noise is larger than given"
            raise ValueError(f"recordings must be followed for a while: {reasons}")
        whole = Shooting(self._recordings, self._parameters, self._windows)
        whole = self._without_misfits(whole)
        for level in (*range(len(_SLACKS)), -1):
            solved = self._solve(whole, _SLACKS[level])
            rows = self._rows(whole, _SLACKS[level])
            self._estimate(rows)
        return self._result(whole, rows, solved)

    # -- the search ---------------------------------------------------------------------------------------------------

    def _slack(self, level: float) -> float:
        seen = (self._noise[:12] / self._units)[self._seen]
        return level * float(seen.min() if len(seen) else _UNSEEN)

    def _rows(self, shooting: Shooting, level: float) -> Rows:
        rows = shooting.rows(shooting.unknowns(self._numbers), self._noise, self._slack(level))
        assert rows is not None  # it is where the search has been
        return rows

    def _solve(self, shooting: Shooting, level: float, free: bool = True, most: int = 60) -> Any:
        """Move starts, and the fields where they are ``free``; SciPy's result."""
        held = np.zeros(0) if free else self._numbers
        first, noise, slack = shooting.unknowns(self._numbers), self._noise, self._slack(level)
        kept: dict[bytes, tuple[Array, Array]] = {}

        def rows(unknowns: Array) -> tuple[Array, Array]:
            key = unknowns.tobytes()
            if key not in kept:
                found = shooting.rows(np.concatenate([held, unknowns]), noise, slack)
                shape = next(iter(kept.values()))[1].shape if kept else (0, 0)
                kept.clear() if found is not None else None
                nothing = np.full(shape[0], _LOST), np.zeros(shape)
                kept[key] = nothing if found is None else (found.residuals, found.by[:, len(held) :])
            return kept[key]

        inside = first[len(held) :]
        residuals, by = rows(inside)
        method: Any = "lm" if len(residuals) >= by.shape[1] else "trf"
        solved = optimize.least_squares(
            lambda u: rows(u)[0], inside, lambda u: rows(u)[1], method=method, x_scale="jac", max_nfev=most, xtol=1e-10,
            ftol=1e-10,
        )  # fmt: skip
        numbers = np.clip(shooting.put(np.concatenate([held, solved.x])), self._parameters.low, self._parameters.high)
        if shooting.rows(shooting.unknowns(numbers), noise, slack) is None:  # the range of a field has cut it off
            numbers = shooting.put(first)
        self._numbers = numbers
        return solved

    def _begin(self) -> None:
        """Take in the first recording from several starts, until one follows it to its end; keep the furthest."""
        furthest, found = -1, (self._numbers, self._windows, 0)
        for numbers, state in list(self._guesses()):
            self._numbers, self._windows, self._rested = numbers, [], 0
            ended = self._grow(0, state)
            reached = sum(window.last - window.first for window in self._windows)
            if reached > furthest:
                furthest, found = reached, (self._numbers, self._windows, self._rested)
            if ended:
                break
        self._numbers, self._windows, self._rested = found

    def _guesses(self) -> Iterator[tuple[Array, Array]]:
        """Fields' numbers and first states to begin with."""
        first, numbers, positive = first_state(self._recordings[0]), self._numbers, self._parameters.logarithmic
        for angle in (0.0,) if np.isfinite(self._recordings[0].states[0, THETA_JACK]) else _ANGLES:
            yield numbers, first + angle * np.eye(12)[THETA_JACK]
        for factor in (0.7, 1.4):
            scaled = np.clip(numbers * factor, 0.0, self._parameters.high)
            yield np.where(positive, numbers + math.log(factor), scaled), first

    def _grow(self, number: int, state: Array) -> bool:
        """Cut a recording into windows, each from the end of the one before it; whether its end was reached."""
        recording = self._recordings[number]
        first, end, linked = 0, state, False
        while first < len(recording.states) - 1:
            window = next_window(recording, number, first, end, self._parameters, self._numbers)
            if window is None:  # at rest
                pause = max(1, round(_PAUSE / recording.dt))
                window = Window(number, first, min(first + pause, len(recording.states) - 1), start=end)
                self._rested += window.last - first
                end, first, linked = self._end(window), window.last, False
                continue
            if linked:
                self._windows[-1].linked = True
            self._windows.append(window)
            whole, followed = window.last, self._lock()
            for share in () if followed else _SHORTER:  # a step that is too wide
                self._windows[-1] = replace(window, last=first + max(1, round(share * (whole - first))), start=end)
                followed = self._lock()
                if followed:
                    break
            if not followed:
                del self._windows[-1]
                if linked:
                    self._windows[-1].linked = False
                if not np.isfinite(recording.states[whole]).all():
                    return False
            first, linked = self._windows[-1].last if followed else whole, followed
            seen = recording.states[first]
            end = seen if np.isfinite(seen).all() else self._end(self._windows[-1])
        return True

    def _lock(self) -> bool:
        """Fit the last window, with those before it; whether it is explained.

        Where the jack's angle was not seen, others are tried.
        """
        if self._joined(self._windows[-self._block :], len(self._windows) <= self._block):
            return True
        last, numbers = self._windows[-1], self._numbers
        for angle in () if self._seen[THETA_JACK] else _ANGLES:
            turned = replace(last, start=last.start + angle * np.eye(12)[THETA_JACK])
            if self._joined([turned], False):
                self._windows[-1] = turned
                if self._joined(self._windows[-self._block :], len(self._windows) <= self._block):
                    return True
                self._windows[-1], self._numbers = last, numbers
        return False

    def _joined(self, windows: list[Window], free: bool) -> bool:
        """Fit windows together, with the fields near where they are or not at all; whether the last is explained."""
        block = Shooting(self._recordings, self._parameters, windows, self._anchor(windows) if free else None)
        if block.rows(block.unknowns(self._numbers), self._noise, 1.0) is None:
            return False
        self._solve(block, _SLACKS[0], free=free, most=20)
        return self._explained(block)

    def _anchor(self, windows: list[Window]) -> tuple[Array, Array]:
        """Fields within half of what they are, and a first start near what was guessed where it was not seen."""
        count, units = len(self._numbers), self._units
        place, width = np.concatenate([self._numbers, windows[0].start / units]), np.full(count + 12, _GUESSED)
        width[:count], width[count + THETA_JACK] = _VAGUE, _VAGUE
        return place, width

    def _explained(self, block: Shooting) -> bool:
        """Whether the last window's residuals are within the noise."""
        rows = self._rows(block, _SLACKS[0])
        own = (rows.window == len(block.windows) - 1) & (rows.column >= 0)
        return not own.any() or float(np.mean(rows.residuals[own] ** 2)) < highest(int(own.sum()))

    def _end(self, window: Window) -> Array:
        """Where a window leads to; what was observed there, where the model cannot tell."""
        recording = self._recordings[window.recording]
        found = motion(recording, window, self._parameters, self._numbers)
        if found is not None:
            end: Array = found.states[-1]
            return end
        seen = recording.states[window.last]
        return np.where(np.isfinite(seen), seen, window.start)

    def _estimate(self, rows: Rows) -> None:
        """Estimate the noise that is not known from residuals, less what the unknowns have taken."""
        taken, least = leverage(rows), _LEAST * np.append(self._units, 1.0)
        for column in np.flatnonzero(~np.isfinite(self._known)):
            own = rows.column == column
            left = float((1.0 - taken[own]).sum())
            if left > 1.0:
                scale = math.sqrt(float((rows.residuals[own] ** 2).sum()) / left)
                self._noise[column] = max(scale * self._noise[column], least[column])

    def _misfits(self, rows: Rows) -> NDArray[np.bool_]:
        """Which windows do not fit: their mean square residual is far above that of most."""
        square, most = np.zeros(len(self._windows)), np.full(len(self._windows), np.inf)
        for place in range(len(square)):
            own = (rows.window == place) & (rows.column >= 0)
            if own.any():
                square[place], most[place] = np.mean(rows.residuals[own] ** 2), highest(int(own.sum()))
        usual = max(1.0, float(np.median(square[square > 0.0]))) if (square > 0.0).any() else 1.0
        wrong: NDArray[np.bool_] = square > most * usual
        return wrong

    def _without_misfits(self, whole: Shooting) -> Shooting:
        """The windows that a first fit with loose links explains."""
        self._solve(whole, _SLACKS[0])
        wrong = self._misfits(self._rows(whole, _SLACKS[0]))
        for place in np.flatnonzero(wrong):
            self._windows[place].linked = False
            if place:
                self._windows[place - 1].linked = False
        self._windows = [window for window, out in zip(self._windows, wrong, strict=True) if not out]
        return Shooting(self._recordings, self._parameters, self._windows)

    # -- what is known then -------------------------------------------------------------------------------------------

    def _result(self, whole: Shooting, rows: Rows, solved: Any) -> Fit:
        numbers, names = self._numbers.copy(), self._parameters.fields
        covariance, untold = told(rows, len(names))
        wide = self._quantiles(rows, covariance) * np.sqrt(np.diag(covariance))
        wide[(abs(untold) > 0.05).any(axis=0)] = np.inf
        low, high = (self._parameters.values(np.clip(numbers + sign * wide, *self._reach())) for sign in (-1.0, 1.0))
        motions, covered = self._motions()
        left_out = sum(len(one.states) - 1 for one in self._recordings) - covered
        residuals = self._held_out(covariance)
        return Fit(
            self._parameters.scene(numbers),
            {name: (float(a), float(b)) for name, a, b in zip(names, low, high, strict=True)}, residuals,
            tuple(sentence(names, row, self._parameters.logarithmic) for row in untold),
            {name: float(self._noise[k]) for k, name in enumerate((*STATE_NAMES, IMPACT)) if (rows.column == k).any()},
            motions, left_out, tuple(self._problems(rows, solved, residuals, left_out, covered)),
        )  # fmt: skip

    def _problems(self, rows: Rows, solved: Any, held_out: Array, left_out: int, covered: int) -> Iterator[str]:
        """Why the intervals are not to be trusted, in sentences."""
        if solved.status <= 0:
            yield "the search did not end"
        wrong, unheard = int(self._misfits(rows).sum()), int((rows.column == UNHEARD).sum())
        if wrong:
            yield f"{wrong} of {len(self._windows)} windows do not fit within the noise"
        if unheard:
            yield f"the fitted motion lacks {unheard} of the impacts that were heard"
        names, deviations = (*STATE_NAMES, IMPACT, "all numbers together"), autocorrelations(rows)
        correlated = [name for name, value in zip(names, deviations, strict=True) if value > _CORRELATED]
        if correlated:
            yield f"residuals of {', '.join(correlated)} are correlated in time: something that is not fitted is wrong"
        if left_out - self._rested > _LOST_SHARE * covered:
            yield f"{left_out - self._rested} steps could not be followed"
        elif left_out > covered:
            yield f"the motion was followed for {covered} steps only, and taken for rest in {left_out}"
        if len(held_out) and not np.mean(held_out**2) < highest(len(held_out)):
            yield "windows that were held out do not fit within the noise"

    def _quantiles(self, rows: Rows, covariance: Array) -> Array:
        """Half widths of the fields' intervals over their standard deviations, (F,).

        Student's, with the degrees of freedom that Welch (1947) and Satterthwaite (1946) give a sum of variances of
        which each, that of one kind of observation, was estimated by itself.
        """
        own, left = beside(rows, len(covariance)), 1.0 - leverage(rows)
        shares, spread = np.zeros(len(covariance)), np.zeros(len(covariance))
        for column in np.unique(rows.column[rows.column >= 0]):
            part = rows.column == column
            variance = ((own[part] @ covariance) ** 2).sum(axis=0)
            shares += variance
            if not np.isfinite(self._known[column]):
                spread += variance**2 / max(float(left[part].sum()), 1e-3)
        freedom = shares**2 / np.maximum(spread, 1e-300)
        found: Array = stats.t.ppf(0.975, np.clip(freedom, 1.0, 1e9))
        return found

    def _reach(self) -> tuple[Array, Array]:
        """Between which numbers an interval lies."""
        positive = self._parameters.logarithmic
        return np.where(positive, -np.inf, 0.0), np.where(positive, np.inf, self._parameters.high)

    def _motions(self) -> tuple[tuple[Array, ...], int]:
        """The fitted motion of each recording, and how many steps the windows have."""
        motions, covered = tuple(np.full(one.states.shape, np.nan) for one in self._recordings), 0
        for window in self._windows:
            found = motion(self._recordings[window.recording], window, self._parameters, self._numbers)
            if found is not None:
                motions[window.recording][window.first : window.last + 1] = found.states
            covered += window.last - window.first
        return motions, covered

    def _held_out(self, covariance: Array) -> Array:
        """Residuals of every fifth window, or the last of fewer, of fits without it, over what is expected of them."""
        numbers, windows = self._numbers.copy(), self._windows
        out = [place for place in range(len(windows)) if place % 5 == 4] or [len(windows) - 1][: len(windows) - 1]
        if not out:
            return np.zeros(0)
        copies = [replace(window, start=window.start.copy()) for window in windows]
        for place in out:
            copies[place].linked = False
            if place:
                copies[place - 1].linked = False
        self._solve(
            Shooting(self._recordings, self._parameters, [w for p, w in enumerate(copies) if p not in out]), _SLACKS[-1]
        )
        residuals = []
        for place in out:
            alone = Shooting(self._recordings, self._parameters, [copies[place]])
            self._solve(alone, _SLACKS[-1], free=False)
            residuals.append(studentised(self._rows(alone, _SLACKS[-1]), covariance))
        self._numbers = numbers
        return np.concatenate(residuals)


def highest(count: int) -> float:
    """Mean square of so many residuals, in units of their noise, above which they are no noise."""
    return 1.5 + 9.0 / math.sqrt(count)


def rough_noise(recordings: Sequence[Recording], units: Array) -> Array:
    """Noise of the state's numbers and of impacts' times, shape (13,), by third differences, nearly 0 in free flight.

    They are divided differences of the rows that were observed, over the standard deviation at unit noise.
    """
    noise = _ROUGH * units
    for column in range(12):
        parts = [_third_differences(one.states[:, column]) for one in recordings]
        sizes = abs(np.concatenate(parts))
        if len(sizes) > _MANY:
            noise[column] = max(float(np.median(sizes)) / 0.6745, 1e-6 * units[column])
    return noise


def _third_differences(values: Array) -> Array:
    """Third divided differences of the values that are not NaN, of variance 1 if the values have; at most (n - 3,)."""
    rows = np.flatnonzero(np.isfinite(values))
    if len(rows) < 4:
        return np.zeros(0)
    four = np.lib.stride_tricks.sliding_window_view(rows, 4).astype(np.float64)
    weights = 1.0 / np.prod(four[:, :, None] - four[:, None, :] + np.eye(4), axis=2)
    weights /= np.linalg.norm(weights, axis=1, keepdims=True)
    found: Array = (weights * np.lib.stride_tricks.sliding_window_view(values[rows], 4)).sum(axis=1)
    return found


def first_state(recording: Recording) -> Array:
    """A guess of a recording's first state: what was observed, rates from the first places, else 0."""
    seen, state = recording.states, np.zeros(12)
    for column in range(RATES):
        rows = np.flatnonzero(np.isfinite(seen[:, column]))[:5]
        rates = np.isfinite(seen[:1, column + RATES])
        if len(rows):
            times, places = rows * recording.dt, seen[rows, column]
            slope = np.polyfit(times, places, 1)[0] if len(rows) > 1 and rows[-1] < 10 else 0.0
            state[column] = places[0] - slope * times[0]
            state[column + RATES] = slope
        if rates.all():
            state[column + RATES] = seen[0, column + RATES]
    return state


def scaled(by: Array) -> tuple[Array, Array]:
    """Derivatives with columns of length 1 (0 where there are none), and their lengths."""
    lengths = np.linalg.norm(by, axis=0)
    lengths[lengths == 0.0] = 1.0
    return by / lengths, lengths


def _fitted_space(rows: Rows) -> Array:
    """An orthonormal basis of what the unknowns can change of the residuals, shape (rows, rank)."""
    left, values, _ = np.linalg.svd(scaled(rows.by)[0], full_matrices=False)
    basis: Array = left[:, values > 1e-9 * values.max(initial=0.0)]
    return basis


def leverage(rows: Rows) -> Array:
    """The share of each residual that the unknowns take, shape (rows,): the diagonal of H = J (J^T J)^+ J^T."""
    share: Array = (_fitted_space(rows) ** 2).sum(axis=1)
    return share


def autocorrelations(rows: Rows) -> Array:
    """Autocorrelation of the residuals of each column and of all, lags 1 to 4 together, shape (14,).

    In units of its standard deviation for white noise: products r_i r_j have the mean -H_ij in a right model (Durbin
    and Watson 1950), H as in :func:`leverage`, and a variance of about 1. 0 for columns of fewer than 12 residuals.
    """
    basis, sums, counts = _fitted_space(rows), np.zeros(14), np.zeros(14)
    for column in range(13):
        own = rows.column == column
        off, base = rows.residuals[own], basis[own]
        for lag in range(1, _LAGS + 1) if len(off) >= 12 else ():
            sums[column] += (off[lag:] * off[:-lag]).sum() + (base[lag:] * base[:-lag]).sum()
            counts[column] += len(off) - lag
    sums[13], counts[13] = sums.sum(), counts.sum()
    found: Array = sums / np.sqrt(np.maximum(counts, 1.0))
    return found


def beside(rows: Rows, fields: int) -> Array:
    """Derivatives by the fields, (rows, F), less what the starts can take of them."""
    starts, own = scaled(rows.by[:, fields:])[0], rows.by[:, :fields]
    rest: Array = own - starts @ np.linalg.lstsq(starts, own, rcond=1e-10)[0]
    return rest


def told(rows: Rows, fields: int) -> tuple[Array, Array]:
    """Covariance of the fields' numbers, (F, F), and the combinations of length 1 that are not told, (k, F)."""
    _, values, ways = np.linalg.svd(np.linalg.qr(beside(rows, fields), mode="r"), full_matrices=True)
    deviations = np.full(fields, np.inf)
    deviations[: len(values)] = 1.0 / np.maximum(values, 1e-300)
    lost = (deviations > _UNTOLD) | (deviations > 1e8 * deviations.min())
    kept = ways[~lost]
    return kept.T @ (deviations[~lost, None] ** 2 * kept), ways[lost]


def studentised(rows: Rows, covariance: Array) -> Array:
    """(observed - fitted) over its standard deviation, of a window to which its start was fitted, the fields not."""
    fields = len(covariance)
    starts = scaled(rows.by[:, fields:])[0]
    left, values, _ = np.linalg.svd(starts, full_matrices=False)
    base = left[:, values > 1e-9 * values.max(initial=0.0)]
    own = rows.by[:, :fields] - base @ (base.T @ rows.by[:, :fields])
    variance = 1.0 - (base**2).sum(axis=1) + np.einsum("if,fg,ig->i", own, covariance, own)
    kept = (rows.column >= 0) & (variance > 1e-6)
    found: Array = -rows.residuals[kept] / np.sqrt(variance[kept])
    return found


def sentence(names: Sequence[str], way: Array, logarithmic: NDArray[np.bool_]) -> str:
    """A combination of fields that recordings do not tell, in words."""
    way = way / way[np.argmax(abs(way))]
    parts = [place for place in range(len(way)) if abs(way[place]) > 0.05]
    listed = [names[place] for place in parts]
    if len(parts) == 1:
        return f"the recordings do not tell {listed[0]}"
    if logarithmic[parts].all() and (abs(way[parts] - 1.0) < 0.05).all():
        return f"the recordings tell {' and '.join(listed)} only up to one common factor"
    moves = [f"{name} by {way[place]:+.2g} %" for name, place in zip(listed, parts, strict=True)]
    return f"moving {' and '.join(moves)} changes nothing that was observed"
