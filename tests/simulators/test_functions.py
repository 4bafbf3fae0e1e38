"""A drive's functions in the exact contact model: the pieces it cuts them into, and their accuracy."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from jackbox_env import Drive
from jackbox_env.exact.flight import DEGREE
from jackbox_env.simulators import drives
from jackbox_env.simulators.drives import function_pieces

Array = NDArray[np.float64]
Function = Callable[[float], float]

DT = 0.02


class Counted:
    """A function that counts its calls."""

    def __init__(self, function: Function) -> None:
        self.function, self.calls = function, 0

    def __call__(self, time: float) -> float:
        self.calls += 1
        return self.function(time)


def pieces(function: Function, time: float = 0.0, dt: float = DT) -> Array:
    return function_pieces(Drive(torque=function), time, dt)


def ends(table: Array) -> Array:
    """Where pieces begin and end [s] since the step's start."""
    return np.append(table[:, 0], table[-1, 0] + table[-1, 1])


def integrals(table: Array) -> tuple[float, float]:
    """The first and second integral of the pieces over the step."""
    first: list[float] = []
    second: list[float] = []
    for row in table.tolist():
        half, powers = 0.5 * row[1], row[2 : 3 + DEGREE]
        whole = half * math.fsum(2.0 * power / (k + 1.0) for k, power in enumerate(powers) if k % 2 == 0)
        moment = half * math.fsum(2.0 * power / (k + 2.0) for k, power in enumerate(powers) if k % 2 == 1)
        second += [row[1] * math.fsum(first), half * (whole - moment)]
        first.append(whole)
    return math.fsum(first), math.fsum(second)


# -- interpolation ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("function", "dt", "most"),
    [
        (lambda t: 5.0, 0.02, 1),
        (lambda t: 3e4 * math.cos(9.0 * t), 0.02, 1),
        (lambda t: 1.0 + t * (2.0 - t * (3.0 - t)), 10.0, 1),
        (lambda t: math.sin(100.0 * t), 0.02, 4),
        (lambda t: math.sin(1000.0 * t), 0.02, 32),
        (lambda t: 1.0 / (1.0 + (300.0 * (t - 0.0123)) ** 2), 0.02, 23),
        (lambda t: math.exp(-((200.0 * (t - 0.007)) ** 2)), 0.02, 16),
        (lambda t: math.tanh(50.0 * (t - 0.3)), 0.7, 39),
        (lambda t: 3.0 + math.cos(500.0 * t), 0.1, 64),
    ],
)  # fmt: skip
def test_smooth_functions_take_few_pieces_and_are_right_to_rounding(function: Function, dt: float, most: int) -> None:
    table = pieces(function, 0.0, dt)
    assert len(table) <= most
    worst = largest = 0.0
    for row in table:
        for u in np.linspace(-1.0, 1.0, 41).tolist():
            value = function(row[0] + 0.5 * row[1] * (1.0 + u))
            interpolated = float(np.polynomial.polynomial.polyval(u, row[2 : 3 + DEGREE]))
            worst, largest = max(worst, abs(interpolated - value)), max(largest, abs(value))
    assert worst <= 1e-12 * largest


# -- jumps ------------------------------------------------------------------------------------------------------------


def cubic(rng: np.random.Generator, time: float) -> tuple[Function, float, float]:
    """A smooth function of order one over the step after ``time``, and its integrals from the time 0."""
    a, b, c, d = rng.uniform(-1.0, 1.0, 4).tolist()

    def smooth(t: float) -> float:
        s = (t - time) / DT
        return float(a + s * (b + s * (c + s * d)))

    once = DT * (a + b / 2.0 + c / 3.0 + d / 4.0)
    return smooth, once, DT * DT * (a / 2.0 + b / 6.0 + c / 12.0 + d / 20.0)


def share_of_step(rng: np.random.Generator, kind: str) -> float:
    """The time of a jump as a share of the step."""
    if kind == "near an end":
        away = 10.0 ** rng.uniform(-12.0, -2.4)
        return float(rng.choice([away, 1.0 - away]))
    return float(rng.integers(1, 64) / 64.0) if kind == "dyadic" else rng.uniform()


@pytest.mark.parametrize("kind", ["anywhere", "near an end", "dyadic", "several", "left-continuous", "later"])
@pytest.mark.parametrize("order", [0, 1], ids=["jumps", "kinks"])
def test_jumps_are_located_to_1e_12_of_the_step_and_kinks_are_followed_to_rounding(kind: str, order: int) -> None:
    rng = np.random.default_rng(0)
    for _ in range(60 if order else 600):
        time = rng.uniform(0.0, 30.0) if kind == "later" else 0.0
        smooth, once, twice = cubic(rng, time)
        count = int(rng.integers(2, 6)) if kind == "several" else 1
        heights = 10.0 ** rng.uniform(-3.0, 6.0) * rng.uniform(0.2, 1.0, count) * rng.choice([-1.0, 1.0], count)
        breaks = [(time + DT * share_of_step(rng, kind), float(height)) for height in heights / DT**order]

        def function(t: float, smooth: Function = smooth, breaks: Any = breaks) -> float:
            closed = kind == "left-continuous"
            passed = ((t - at, height) for at, height in breaks if (t > at if closed else t >= at))
            return smooth(t) + math.fsum(height * since**order for since, height in passed)

        counted = Counted(function)
        table = pieces(counted, time)
        spacing = 2.0 * math.ulp(time + DT) if time else 0.0
        for at, _ in breaks if order == 0 else ():
            assert np.abs(ends(table) - (at - time)).min() <= 1e-12 * DT + spacing
        assert counted.calls < 250 * count + 100 or order == 1
        if time == 0.0:
            computed, allowed = integrals(table), 1e-12 * DT * min(abs(heights))
            once += math.fsum(height * (DT - at) ** (1 + order) / (1 + order) for at, height in breaks)
            twice += math.fsum(height * (DT - at) ** (2 + order) / (2 + 4 * order) for at, height in breaks)
            assert abs(computed[0] - once) <= allowed
            assert abs(computed[1] - twice) <= allowed * DT


def test_without_points_at_the_ends_jumps_hide_there(monkeypatch: pytest.MonkeyPatch) -> None:
    # The control: these are the shares of Chebyshev points of the first kind.
    def late(t: float) -> float:
        return float(t >= 0.998 * DT)

    assert integrals(pieces(late))[0] == pytest.approx(0.002 * DT, rel=1e-9)
    inner = [0.5 - 0.5 * math.cos((k + 0.5) * math.pi / 13.0) for k in range(13)]
    monkeypatch.setattr(drives, "_SHARES", inner)
    assert integrals(pieces(late))[0] == 0.0


# -- rounding that is not shape ---------------------------------------------------------------------------------------


def scattered(time: float) -> float:
    """Noise in [-1, 1] that is a function of the time."""
    word = int(np.float64(time).view(np.uint64)) * 6364136223846793005 + 1442695040888963407 & (1 << 64) - 1
    word = (word ^ word >> 29) * 0xBF58476D1CE4E5B9 & (1 << 64) - 1
    return (word ^ word >> 32) / 2.0**63 - 1.0


@pytest.mark.parametrize(
    "function",
    [
        *(lambda t, size=size: math.sin(9.0 * t) + size * scattered(t) for size in (1e-5, 1e-6, 1e-7, 1e-9, 1e-12)),
        lambda t: np.float32(9e4 * math.sin(t)),
        lambda t: np.float32(9e4 * math.sin(300.0 * t)),
        lambda t: float(np.float32(9e4 * (1.0 + 1e-3 * t))),
        lambda t: float(math.floor(1e5 * t)),
    ],
)
def test_rounding_is_not_followed(function: Function) -> None:
    for time in (1.0, 1.5, 33.3):
        counted = Counted(function)
        table = function_pieces(Drive(torque=counted), time, DT)
        assert counted.calls < 1500
        for row in table:
            value = float(function(time + row[0] + 0.5 * row[1]))
            assert abs(row[2] - value) <= 1e-4 * max(1.0, abs(value))


# -- the largest and the smallest --------------------------------------------------------------------------------------


@pytest.mark.parametrize("dt", [5e-324, 1e-310, 1e-300, 1e-200])
def test_the_shortest_steps(dt: float) -> None:
    table = pieces(lambda t: 1.0 + t, 0.0, dt)
    assert table[:, :2].tolist() == [[0.0, dt]]
    assert table[0, 2:].tolist() == [1.0] + [0.0] * 38
