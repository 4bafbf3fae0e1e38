"""Random cases: a scene, a start, and actions to play, drawn by a generator or by hypothesis.

Lengths are drawn first, speeds and torques in proportion: within the steps of a case the jack crosses the box some
times and the box turns by some radians, whatever its size, so that most cases have impacts. With loss the jack lies on
the lowest wall in half of the cases at first.

Hypothesis draws the same cases each time. ``HYPOTHESIS_PROFILE=hours``, which is ``make soak``, draws many more,
others each time.
"""

from __future__ import annotations

import dataclasses
import math
import os
import random
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeVar

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from jackbox_env.model.scene import Chirp, Drive, Scene
from tests.states import lying

T = TypeVar("T")
STEPS = 24  # control steps of a case
_COMMON: Any = {
    "print_blob": True,
    "deadline": None,
    "suppress_health_check": [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example],
}
settings.register_profile("quick", max_examples=120, derandomize=True, **_COMMON)
settings.register_profile("hours", max_examples=10_000, **_COMMON)  # hypothesis keeps 80 kB of each
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


class HypothesisDraw(random.Random):
    """A generator whose choices are hypothesis's, which it shrinks."""

    def __init__(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        super().__init__()
        self._draw = draw

    def uniform(self, low: float, high: float) -> float:
        # Any float but the tiny: products of those with lengths and times would leave the range of scenes.
        number: float = self._draw(st.floats(low, high).filter(lambda x: x == 0.0 or abs(x) > 1e-12))
        return number

    def randint(self, low: int, high: int) -> int:
        number: int = self._draw(st.integers(low, high))
        return number

    def choice(self, options: Sequence[T]) -> T:  # type: ignore[override]
        option: T = self._draw(st.sampled_from(options))
        return option


@dataclass(frozen=True)
class Wave:
    """The function mean + amplitude sin(rate t + phase) of the time, with its integrals in closed form."""

    mean: float
    amplitude: float
    rate: float  # [rad/s], not 0
    phase: float

    def __call__(self, time: float) -> float:
        """The value at ``time`` [s]."""
        return self.mean + self.amplitude * math.sin(self.rate * time + self.phase)

    def integrals(self, start: float, since: float) -> tuple[float, float]:
        """Integrated once and twice from ``start`` [s] over ``since`` [s], both 0 at first."""
        first, half = self.rate * start + self.phase, 0.5 * self.rate * since
        # int sin = 2 sin(phase + half) sin(half) / rate; and again: (rate T cos(first) - [sin]) / rate^2
        once = 2.0 * math.sin(first + half) * math.sin(half) / self.rate
        change = 2.0 * math.cos(first + half) * math.sin(half)
        twice = (math.cos(first) * since - change / self.rate) / self.rate
        return self.mean * since + self.amplitude * once, 0.5 * self.mean * since**2 + self.amplitude * twice


@dataclass(frozen=True)
class Case:
    """What is simulated: everything that a replay needs."""

    scene: Scene
    contact: str
    substeps: int | None
    control_dt: float  # [s]
    state: tuple[float, ...]  # (12,) the start
    time: float  # [s]
    actions: tuple[float | None, ...]  # one for each control step, in [-1, 1]; None: the scene's drive


def _power(draw: random.Random, low: float, high: float) -> float:
    return float(10.0 ** draw.uniform(low, high))


def draw_case(draw: random.Random, contact: str, steps: int = STEPS) -> Case:
    """A case for a contact model, drawn by a seeded generator or by hypothesis."""
    dt = _power(draw, -2.5, -1.0)
    scene = draw_scene(draw, dt)
    substeps = draw.randint(1, 8) if contact == "pymunk" else None
    time = draw.choice((0.0, 0.0, draw.uniform(-100.0, 100.0)))
    return Case(scene, contact, substeps, dt, draw_start(draw, scene, dt), time, _actions(draw, steps))


def draw_scene(draw: random.Random, dt: float) -> Scene:
    """A scene whose jack crosses the box some times within the steps of a case."""
    half, box_mass = _power(draw, -0.5, 1.5), _power(draw, 0.0, 3.0)
    # From nearly a point, by arms that turn freely, to those that fit near 45 degrees only.
    arm = half * draw.choice((draw.uniform(0.02, 0.4), draw.uniform(0.4, 0.99), draw.uniform(1.0, 1.4)))
    jack_mass = box_mass * _power(draw, -3.0, 0.5)
    box_inertia = draw.choice((None, box_mass * half**2 * _power(draw, -0.5, 0.5)))
    jack_inertia = draw.choice((None, jack_mass * arm**2 * _power(draw, -1.0, 0.3)))
    scene = Scene(
        box_half_width=half,
        box_mass=box_mass,
        box_inertia=box_inertia,  # type: ignore[arg-type]  # None: derived
        jack_arm=arm,
        jack_mass=jack_mass,
        jack_inertia=jack_inertia,  # type: ignore[arg-type]
        gravity=draw.choice((0.0, 9.81, draw.uniform(0.0, 0.02) * half / dt**2)),  # the last falls 16 L in a case
        restitution=draw.choice((1.0, 1.0, 0.0, draw.uniform(0.0, 1.0))),
    )
    limit = scene.box_inertia * draw.uniform(1e-4, 0.01) / dt**2  # at most 8 rad in a case
    return dataclasses.replace(scene, torque_limit=limit, drive=_drive(draw, scene, limit, dt))


def _drive(draw: random.Random, scene: Scene, limit: float, dt: float) -> Chirp | Drive | None:
    kind = draw.choice(("none", "chirp", "chirp", "functions"))
    if kind == "none":
        return None
    if kind == "chirp":
        frequency, growth = draw.uniform(-0.1, 0.1) / dt, draw.uniform(-0.2, 0.2) / (STEPS * dt**2)
        return Chirp(limit * draw.uniform(-1.0, 1.0), frequency, draw.choice((0.0, growth, growth)))
    push = scene.box_mass * 0.01 * scene.box_half_width / dt**2  # at most 8 L in a case
    return Drive(
        torque=draw.choice((None, _wave(draw, limit, dt))),
        force_x=draw.choice((None, _wave(draw, push, dt))),
        force_y=draw.choice((None, _wave(draw, push, dt))),
    )


def _wave(draw: random.Random, largest: float, dt: float) -> Wave:
    # At most a twentieth of a turn per step: one panel of quadrature follows it to rounding.
    rate = 2.0 * math.pi * draw.uniform(0.001, 0.05) / dt
    return Wave(draw.uniform(-0.5, 0.5) * largest, draw.uniform(0.0, 0.5) * largest, rate, draw.uniform(-3.0, 3.0))


def draw_start(draw: random.Random, scene: Scene, dt: float) -> tuple[float, ...]:
    """A state in a scene; with loss the jack may lie on the lowest wall."""
    start = _flying(draw, scene, dt)
    return start if scene.elastic or draw.choice((True, False)) else _lying(draw, scene, start)


def _flying(draw: random.Random, scene: Scene, dt: float) -> tuple[float, ...]:
    half, arm = scene.box_half_width, scene.jack_arm
    narrow = math.acos(half / arm) if arm > half else 0.0  # a longer arm fits no nearer than this to the axes
    relative = narrow + draw.uniform(0.0, 1.0) * (math.pi / 2.0 - 2.0 * narrow)
    room = half - arm * max(abs(math.cos(relative)), abs(math.sin(relative)))
    x, y = room * draw.uniform(-1.0, 1.0), room * draw.uniform(-1.0, 1.0)
    turn = draw.choice((0.0, draw.uniform(-10.0, 10.0)))
    offset = draw.choice((0.0, draw.uniform(-100.0, 100.0)))
    cosine, sine = math.cos(turn), math.sin(turn)
    jack = offset + cosine * x - sine * y, -offset + sine * x + cosine * y
    speed = 0.15 * half / dt * draw.uniform(0.0, 1.0)
    spin = 0.3 / dt * draw.uniform(0.0, 1.0)
    box_rates = 0.1 * speed * draw.uniform(-1.0, 1.0), 0.1 * speed * draw.uniform(-1.0, 1.0)
    jack_rates = speed * draw.uniform(-1.0, 1.0), speed * draw.uniform(-1.0, 1.0)
    turning = 0.3 * spin * draw.uniform(-1.0, 1.0), spin * draw.uniform(-1.0, 1.0)
    angle = turn + relative + draw.randint(-4, 4) * math.pi / 2.0
    return (offset, -offset, turn, *jack, angle, *box_rates, turning[0], *jack_rates, turning[1])


def _lying(draw: random.Random, scene: Scene, start: tuple[float, ...]) -> tuple[float, ...]:
    """The box of a start, and in it the jack on two feet on the lowest wall, turning with it."""
    away = scene.box_half_width - scene.jack_arm * math.sqrt(0.5)  # the most that lets the jack in
    tilt = math.remainder(start[2], math.pi / 2.0)  # of the lowest wall
    state = lying(away * draw.uniform(-1.0, 1.0), start[8], tilt, depth=away)
    state[3:5] += start[:2]
    state[9:11] += start[6:8]
    return (*start[:3], *state[3:6].tolist(), *start[6:9], *state[9:12].tolist())


def _actions(draw: random.Random, steps: int) -> tuple[float | None, ...]:
    """Blocks of equal or of different actions, held ones and the drive's."""
    actions: list[float | None] = []
    while len(actions) < steps:
        length, kind = draw.randint(1, 12), draw.choice(("drive", "still", "limit", "held", "random"))
        if kind == "random":
            actions += [draw.uniform(-1.0, 1.0) for _ in range(length)]
            continue
        value = {"drive": None, "still": 0.0, "limit": draw.choice((-1.0, 1.0)), "held": draw.uniform(-1.0, 1.0)}[kind]
        actions += [value] * length
    return tuple(actions[:steps])
