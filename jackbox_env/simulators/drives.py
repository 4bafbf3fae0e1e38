"""Drives of functions for the exact contact model: a polynomial on each piece of a step, cut at every jump.

Method: interpolation in the 13 Chebyshev points of the second kind (Trefethen 2013, "Approximation Theory and
    Approximation Practice", ch. 3 and 4). Both ends of a piece are among them, so a jump at an end is seen as well. A
    piece is accepted when its last three Chebyshev coefficients are rounding. Otherwise it is cut: at a jump if
    bisection locates one, else in the middle.
Exactness: rounding, of the function's largest value in the step. A jump is located within 2^-44 of the step, or within
    the spacing of float64 times if that is wider.
Cost: 13 calls of a function for a smooth step, about 80 more for each jump, about 1,000 more for each kink.
Fails: a pulse between two of the 13 points is missed; the widest gap is 0.13 of a piece. A residual below 1e-5 of the
    largest value counts as the function's rounding if four cuts in a row do not reduce it. In the rest of the step up
    to four times that residual then counts as rounding too. More than 4,096 pieces in a step raise ValueError.
Bits: the points are literals, and compiled code takes the sums in the order written. So the pieces are the same on
    every machine on which the functions return the same. ``math.sin`` does not: its last place is the C library's.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from jackbox_env.exact.flight import DEGREE, POINTS, TABLE_WIDTH, interpolate
from jackbox_env.jit.compiler import compiled
from jackbox_env.model.scene import Drive
from jackbox_env.model.states import Array
from jackbox_env.tools import checks as check

Sampled = Callable[[float], float]  # a function's value at a number of ticks since the step's start

_TICKS = 1 << 44  # in a step; all cuts are at whole ticks
_TICK = 2.0**-44
_MOST_PIECES = 4096  # of a step
_RESIDUAL = 1e-13  # of a function's interpolation, over the function's largest value in the step
_NOISE = 1e-5  # the same if cuts do not reduce it: then it is the function's rounding, not its shape
_VAIN = 4  # cuts in a row that do not reduce it
_HELPED = 0.25  # of a residual: a cut helped if one part has no more than this
_MARGIN = 4.0  # times that residual counts as rounding elsewhere in the step
_SHORTEST = 2.0**-1000  # [s] instead of 0 in a division; times that differ are further apart
_STEEP = 0.3  # of the change over a gap: a jump has at least this share, however small the gap becomes
_LOWEST = 1e-8  # of a jump, over the function's largest value in the step

_SHARES: list[float] = [0.5 * (1.0 + point) for point in POINTS.tolist()]  # of a piece's length


@dataclass(slots=True)
class _Unresolved:
    """A function that its interpolant does not resolve on a piece."""

    axis: int
    values: list[float]  # at the piece's 13 points
    residual: float  # over the function's largest value
    vain: int = 0  # cuts in a row that did not reduce the residual


class _Piece(NamedTuple):
    """A stretch of a step, interpolated."""

    first: int  # tick it starts at
    last: int  # tick it ends at
    row: Array  # of the table
    unresolved: list[_Unresolved]  # empty if all functions are resolved


class _Functions:
    """A drive's functions over one step."""

    def __init__(self, drive: Drive, time: float, dt: float) -> None:
        names = [(axis, name) for axis, name in enumerate(("torque", "force_x", "force_y")) if getattr(drive, name)]
        self._functions = {axis: _sampled(name, getattr(drive, name), time, dt) for axis, name in names}
        self._dt, self._rounding = dt, math.ulp(abs(time) + dt)  # [s]
        self._largest = [1e-300] * 3
        self._noise = [0.0] * 3  # residual that cuts do not reduce, over the largest value
        self._interpolate = compiled(interpolate)

    def interpolated(self, first: int, last: int) -> _Piece:
        """Interpolate the functions between two ticks."""
        row, unresolved = np.zeros(TABLE_WIDTH), []
        row[0], row[1] = first * _TICK * self._dt, (last - first) * _TICK * self._dt
        for axis, function in self._functions.items():
            column = 2 + axis * (DEGREE + 1)
            if last - first == 1:  # the resolution of a jump
                row[column] = 0.5 * function(first) + 0.5 * function(last)
                continue
            values = [function(first + (last - first) * share) for share in _SHARES]
            peak, tail, slope = self._interpolate(np.array(values), row, column)
            largest = self._largest[axis] = max(self._largest[axis], peak)
            # A time that is rounded moves the value along the slope.
            if tail > _RESIDUAL * largest + 4.0 * slope / max(0.5 * row[1], _SHORTEST) * self._rounding:
                unresolved.append(_Unresolved(axis, values, tail / largest))
        return _Piece(first, last, row, unresolved)

    def cut(self, piece: _Piece) -> list[_Piece]:
        """The parts of a piece that is not resolved, in time order; none where it stays whole."""
        for one in piece.unresolved:
            if one.vain == _VAIN:
                self._noise[one.axis] = max(self._noise[one.axis], _MARGIN * one.residual)
        unresolved = [one for one in piece.unresolved if one.residual > self._noise[one.axis]]
        if not unresolved:
            return []
        first, last = piece.first, piece.last
        ends = {first, (first + last) // 2, last}
        for one in unresolved:
            lowest = _LOWEST * self._largest[one.axis]
            jump = _jump(self._functions[one.axis], first, last, one.values, lowest)
            if jump is not None:
                ends = {first, jump, jump + 1, last}
                break
        parts = [self.interpolated(start, end) for start, end in itertools.pairwise(sorted(ends))]
        for one in unresolved:
            self._count_in_vain(one, [part for part in parts if part.last - part.first > 1])
        return parts

    def _count_in_vain(self, before: _Unresolved, parts: list[_Piece]) -> None:
        """Count in the remaining residuals of a cut function whether the cut was in vain."""
        remaining = [one for part in parts for one in part.unresolved if one.axis == before.axis]
        helped = len(remaining) < len(parts) or any(one.residual <= _HELPED * before.residual for one in remaining)
        if before.residual <= _NOISE and not helped:
            for one in remaining:
                one.vain = before.vain + 1


def function_pieces(drive: Drive, time: float, dt: float) -> Array:
    """Interpolate a drive's functions over a step of ``dt`` [s] after ``time`` [s], each piece to rounding.

    Returns:
        Pieces in time order, shape (pieces, ``TABLE_WIDTH``).

    Raises:
        TypeError, ValueError: a function returns no finite number, or has more jumps or kinks than can be resolved.
    """
    functions = _Functions(drive, time, dt)
    rows: list[Array] = []
    waiting = [functions.interpolated(0, _TICKS)]
    while waiting:
        piece = waiting.pop()
        parts = functions.cut(piece)
        if parts:
            waiting += reversed(parts)
        else:
            rows.append(piece.row)
        if len(rows) + len(waiting) > _MOST_PIECES:
            raise ValueError(
                f"drive must be smooth but for some jumps: over the {dt:g} s after t = {time:g} s it wants more than "
                f"{_MOST_PIECES} pieces"
            )
    return np.array(rows)


def _sampled(name: str, function: Callable[[float], float], time: float, dt: float) -> Sampled:
    """The function by ticks since the step's start, each value checked."""

    def sampled(ticks: float) -> float:
        moment = time + ticks * _TICK * dt
        value = function(moment)
        if type(value) is float and -math.inf < value < math.inf:  # this is fast
            return value
        return check.real(f"{name}({moment:g} s)", value)

    return sampled


def _odd_gap(values: list[float]) -> tuple[int, float]:
    """The gap between two points whose slope differs most from its neighbours', and their slope, per piece."""
    widths = [end - start for start, end in itertools.pairwise(_SHARES)]
    slopes = [(b - a) / width for (a, b), width in zip(itertools.pairwise(values), widths, strict=True)]
    most, odd, beside = -1.0, 0, 0.0
    for gap, slope in enumerate(slopes):
        before, after = slopes[gap - 1 if gap else 1], slopes[gap + 1 if gap < DEGREE - 1 else gap - 1]
        nearest = max(min(slope, max(before, after)), min(before, after))
        change = abs(slope - nearest) * widths[gap]
        if change > most:
            most, odd, beside = change, gap, nearest
    return odd, beside


def _jump(function: Sampled, first: int, last: int, values: list[float], lowest: float) -> int | None:
    """The tick after which the function jumps, or None if no jump stands out in the piece.

    Bisection of one gap between two points, less the slope of its neighbours. Where the function is smooth, or bends,
    its change shrinks with the gap; at a jump it stays.
    """
    gap, slope = _odd_gap(values)
    trend = slope / (last - first)  # per tick
    low = first + math.floor((last - first) * _SHARES[gap])
    high = first + math.ceil((last - first) * _SHARES[gap + 1])
    at_low, at_high = function(low), function(high)
    change = abs(at_high - at_low - trend * (high - low))
    least = max(lowest, _STEEP * change)
    while high - low > 1:
        middle = (low + high) // 2
        value = function(middle)
        below, above = abs(value - at_low - trend * (middle - low)), abs(at_high - value - trend * (high - middle))
        if below >= above:
            high, at_high, change = middle, value, below
        else:
            low, at_low, change = middle, value, above
        if not change >= least:
            return None
    return low
