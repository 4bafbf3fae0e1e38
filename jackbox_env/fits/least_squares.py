"""Least squares over a chain of windows, whose Jacobian has blocks: time and memory grow with their number only.

Each row depends on the start of its window, on that of the next if it links the two, and on the fields. The starts are
eliminated by orthogonal transformations one after the other, from the last window to the first; then the fields are
solved for, and the starts follow forwards. That is a square-root information smoother (Bierman 1977, "Factorization
Methods for Discrete Sequential Estimation", chapter 10). Backwards, because a link determines the next start well.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import reduce
from itertools import pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.model.states import Array

Indices = NDArray[np.intp]

# Columns of residuals that count as no observations: a link or a prior, an impact the model lacks, a bad number.
LINK, UNHEARD, FAR = -1, -2, -3
FARTHEST = 5.0  # standard deviations of a number that is not bad; a worse one adds the logarithm of its square
WIDTH = 12  # unknowns of a window
_RANK = 1e-9  # of the largest singular value of columns of length 1; less is unidentified, and stays
_AT_ONCE = 200  # rows of a decomposition, so few that no threads are started, which costs more than they save
_TOLERANCE = 1e-10  # relative change of the sum of squares, or of the unknowns, at which a search ends
# Standard deviation of a logarithm beyond which a combination of fields is unidentifiable: what is linear at the
# estimate is not over the interval, which spans a factor of 7, and values near 0 may fit as well.
UNIDENTIFIABLE = 0.5
_NEAR_THE_END = 0.3  # standard deviations that the fields may still move where a search ends
_NEGLIGIBLE = 0.1  # decrease of a window's squares, in which its start moves by 0.3 of its standard deviation at most
_GROWTH = 8.0  # of the damping after a step that was shortened
_SHORTER = 0.25  # of a step that fails
_BLOCKED = 0.01  # share of a step, below which a window that prevents a decrease blocks the search
_FIRST_DAMPING, _LEAST_DAMPING = 1e-6, 1e-14  # of the squared lengths of the observations' columns


class Rows(NamedTuple):
    """Residuals in the order of their windows, their Jacobian, and what each residual belongs to."""

    residuals: Array  # (modelled - observed) / noise
    jacobian: Array  # by the window's start, the next window's, and the fields: (rows, 24 + F)
    column: Indices  # index into the state, 12: an impact's time; LINK, UNHEARD or FAR
    window: Indices  # index of the window

    @property
    def fields(self) -> int:
        """F."""
        return int(self.jacobian.shape[1]) - 2 * WIDTH


class Chain:
    """The rows of each window, compressed to triangles."""

    def __init__(self, rows: Rows, windows: int) -> None:
        self.rows, self.windows = rows, windows
        ends = np.searchsorted(rows.window, np.arange(windows + 1))
        with_residuals = np.column_stack(
            [
                rows.jacobian[:, WIDTH : 2 * WIDTH],
                rows.jacobian[:, :WIDTH],
                rows.jacobian[:, 2 * WIDTH :],
                rows.residuals,
            ]
        )
        self._blocks = [  # by the next start, the start, the fields, and residuals
            reduce(_joined, np.split(with_residuals[first:last], range(0, last - first, _AT_ONCE)))
            for first, last in pairwise(ends)
        ]
        seen = rows.column >= 0
        squares = np.zeros((windows, WIDTH))
        np.add.at(squares, rows.window[seen], rows.jacobian[seen, :WIDTH] ** 2)
        self._starts_lengths = squares + 1e-4 * squares.mean()
        lengths = (rows.jacobian[seen, 2 * WIDTH :] ** 2).sum(axis=0)
        self._fields_lengths = lengths + 1e-4 * lengths.mean() if len(lengths) else lengths

    def step(self, damping: float) -> tuple[Array, float]:
        """Minimise the squares of residuals and Jacobian times step, and ``damping`` times that of the scaled step.

        The step of all unknowns, fields first, shape (F + 12 windows,), and the decrease of the squares by it.
        """
        by_fields, starts, left = self._eliminate(damping)
        fields, every = by_fields[:, 0], [np.zeros(WIDTH)]
        for by in starts:
            every.append(by @ np.concatenate([every[-1], fields, [1.0]]))
        decrease = float((self.rows.residuals**2).sum() - (left[:, -1] ** 2).sum())
        return np.concatenate([fields, *every[1:]]), decrease

    def information(self) -> Array:
        """Triangle R of the fields' inverse covariance R^T R, which the starts are free for, (k, F)."""
        return self._eliminate(0.0, 0)[2][:, : self.rows.fields]

    def moves(self, fitted: int) -> Array:
        """The standard deviations by which each field after the first would move if it was fitted too, (k,).

        0 for a field whose standard deviation would be above :data:`UNIDENTIFIABLE`.
        """
        rest, others = self._eliminate(0.0, 0)[2], self._eliminate(0.0, fitted)[2]
        columns, lengths = others[:, :-1], np.linalg.norm(others[:, :-1], axis=0)
        least = np.maximum(1.0 / UNIDENTIFIABLE, 1e-6 * np.linalg.norm(rest[:, fitted:-1], axis=0))
        return np.asarray(-(columns.T @ others[:, -1]) / np.maximum(lengths, least) * (lengths > least))

    def _eliminate(self, damping: float, fitted: int | None = None) -> tuple[Array, list[Array], Array]:
        """The first fields by the others; each start by the start before it and the fields; the rows that are left.

        Functions of (others, 1). ``fitted``: how many fields are first; None: all.
        """
        count = self.rows.fields
        carry, starts = np.zeros((0, WIDTH + count + 1)), list[Array]()
        for index in reversed(range(self.windows)):
            before = self._blocks[index - 1] if index else np.zeros((0, 2 * WIDTH + count + 1))
            if index == self.windows - 1:
                carry = self._blocks[index][:, WIDTH:]
            stack = np.zeros((len(before) + len(carry) + WIDTH, 2 * WIDTH + count + 1))
            stack[: len(before)] = before
            stack[len(before) : -WIDTH, :WIDTH] = carry[:, :WIDTH]
            stack[len(before) : -WIDTH, 2 * WIDTH :] = carry[:, WIDTH:]
            stack[-WIDTH:, :WIDTH] = np.diag(np.sqrt(damping * self._starts_lengths[index]))
            by, carry = _solve(stack, WIDTH)
            starts.append(by)
        damped = np.column_stack([np.diag(np.sqrt(damping * self._fields_lengths)), np.zeros(count)])
        by, left = _solve(np.concatenate([carry[:, WIDTH:], damped]), count if fitted is None else fitted)
        return by, starts[::-1], left


def _solve(stack: Array, width: int) -> tuple[Array, Array]:
    """The first unknowns as functions of (the others, 1), and the rows that are left for the others."""
    lengths = np.linalg.norm(stack[:, :width], axis=0)
    lengths[lengths == 0.0] = 1.0
    left, values, right = np.linalg.svd(stack[:, :width] / lengths)
    rank = int((values > _RANK * values.max(initial=0.0)).sum())
    rotated = left.T @ stack[:, width:]
    by: Array = -((right[:rank].T / values[:rank]) / lengths[:, None]) @ rotated[:rank]
    return by, _joined(rotated[:0], rotated[rank:])


def _joined(triangle: Array, rows: Array) -> Array:
    """A matrix of at most as many rows as columns, with the same products of columns as both together."""
    return np.asarray(np.linalg.qr(np.concatenate([triangle, rows]), mode="r"))


def minimise(
    evaluate: Callable[[Array], Rows | None], unknowns: Array, windows: int, most: int, low: Array, high: Array
) -> tuple[Array, bool, Indices]:
    """Least squares by Levenberg and Marquardt: the unknowns, fields first, whether the search ended, what blocked it.

    A step that fails is shortened: damping alone would first have to reach the squared lengths of the columns. A search
    that stalls has not ended: the linear model still predicts a decrease, which no step brings. It stalls where a
    window's motion jumps or has a kink, because two impacts change their order there, or because one leaves the window.
    However short a step is, the window's squares grow then. The one whose squares grew most in the last step
    that failed is returned as blocking.

    Tight links are narrow, curved valleys: a step along them leaves them by its square, over the slack (Maratos 1978).
    A full step that fails is therefore followed by a second one, from where it ends, before it is shortened.

    Args:
        evaluate: the rows of unknowns; None if there are none, so that a shorter step is tried. Not None at the first.
        unknowns: fields, then starts.
        windows: how many there are.
        most: evaluations.
        low, high: the fields' bounds, shape (F,), within which they are at the first.
    """
    rows = evaluate(unknowns)
    assert rows is not None
    damping, count = _FIRST_DAMPING, len(low)

    def moved_by(unknowns: Array, move: Array) -> tuple[Array, Rows | None, float]:
        tried = unknowns + move
        tried[:count] = np.clip(tried[:count], low, high)  # against rounding
        trial = evaluate(tried)
        return tried, trial, np.inf if trial is None else float((trial.residuals**2).sum())

    move, promised, share = _step_within(rows, windows, damping, unknowns[:count], low, high)
    longest, blocking = share, np.zeros(0, np.intp)
    for _ in range(most):
        square = float((rows.residuals**2).sum())
        tried, trial, after = moved_by(unknowns, share * move)
        expected = share * (2.0 - share) * promised
        if trial is not None and share == longest and not square - after > 1e-4 * expected:
            again, _, further = _step_within(trial, windows, _LEAST_DAMPING, tried[:count], low, high)
            second = moved_by(tried, further * again)
            if second[2] < after:
                tried, trial, after = second
        decrease = square - after
        last = _small(share * move, unknowns) or max(abs(decrease), abs(expected)) <= _TOLERANCE * square
        if trial is not None and decrease > 1e-4 * expected:
            unknowns, rows = tried, trial
            damping = max(0.1 * damping, _LEAST_DAMPING) if share == longest else max(_GROWTH * damping, _FIRST_DAMPING)
            move, promised, share = _step_within(rows, windows, damping, unknowns[:count], low, high)
            longest = share
        else:
            share *= _SHORTER
            last |= share < _BLOCKED
            if trial is not None:
                excess = np.bincount(rows.window, trial.residuals**2 - rows.residuals**2, windows)
                blocking = np.array([excess.argmax()])
        if last:  # the end, unless the step was small because it was shortened or damped, or blocked
            move, promised, _ = _step_within(rows, windows, _FIRST_DAMPING, unknowns[:count], low, high)
            away = float(np.linalg.norm(Chain(rows, windows).information() @ move[:count]))
            ended = (away < _NEAR_THE_END and promised < _NEGLIGIBLE * windows) or _small(move, unknowns)
            return unknowns, ended, blocking
    return unknowns, False, blocking


def _step_within(
    rows: Rows, windows: int, damping: float, fields: Array, low: Array, high: Array
) -> tuple[Array, float, float]:
    """A step from the fields, the decrease of the squares by it, and the share of it that stays within bounds.

    Fields at a bound that it would cross are held.
    """
    held = np.zeros(len(fields), dtype=bool)
    while True:
        step, decrease = Chain(rows, windows).step(damping)
        moves = step[: len(fields)]
        moves[held] = 0.0
        moving = moves != 0.0
        room = (np.where(moves > 0.0, high, low) - fields)[moving] / moves[moving]
        if not (room <= _TOLERANCE).any():
            return step, decrease, float(room.min(initial=1.0))
        held[np.flatnonzero(moving)[room <= _TOLERANCE]] = True
        jacobian = rows.jacobian.copy()
        jacobian[:, 2 * WIDTH :][:, held] = 0.0
        rows = rows._replace(jacobian=jacobian)


def _small(step: Array, unknowns: Array) -> bool:
    """Whether a step is too small to matter."""
    return float(np.linalg.norm(step)) <= _TOLERANCE * float(np.linalg.norm(unknowns))
