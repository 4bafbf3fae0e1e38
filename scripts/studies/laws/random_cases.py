"""Random cases for the laws: a scene, a start, and actions to play.

Lengths are drawn first, speeds and torques in proportion: within the steps of a case the jack crosses the box some
times and the box turns by some radians, whatever its size, so that most cases have impacts. With loss the jack lies on
the lowest wall in half of the cases at first. A quarter of the cases of ``exact`` have neighbours: scenes of other
environments in the same batch.
"""

from __future__ import annotations

import dataclasses
import math
import random
from dataclasses import dataclass
from typing import Any

from jackbox_env.scene import Chirp, Drive, Scene
from jackbox_env.tasks import TASKS

STEPS = 40  # control steps of a long case


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
    task: str
    control_dt: float  # [s]
    state: tuple[float, ...]  # (12,) the start
    time: float  # [s]
    actions: tuple[float | None, ...]  # one for each control step, in [-1, 1]; None: the scene's drive
    restored_at: int  # the step before which a new simulator takes over the state
    seed: int  # of the environments' starts
    neighbours: tuple[Scene, ...] = ()  # of environments beside the case's own in a batch with a scene each

    @property
    def settings(self) -> dict[str, Any]:
        """What an environment of the case is made with."""
        names = ("scene", "contact", "substeps", "task", "control_dt")
        return {name: getattr(self, name) for name in names}

    @property
    def torques(self) -> list[float | None]:
        """The held torque of each step [N m], or None."""
        return [None if action is None else action * self.scene.torque_limit for action in self.actions]


def _power(draw: random.Random, low: float, high: float) -> float:
    return float(10.0 ** draw.uniform(low, high))


def draw_case(draw: random.Random, contact: str, steps: int = STEPS) -> Case:
    """A case for a contact model, by a generator that a seed was given, or hypothesis."""
    dt = _power(draw, -2.5, -1.0)
    scene = draw_scene(draw, dt)
    case = Case(
        scene=scene,
        contact=contact,
        substeps=draw.randint(1, 8) if contact == "pymunk" else None,
        task=draw.choice(tuple(TASKS)),
        control_dt=dt,
        state=_start(draw, scene, dt),
        time=draw.choice((0.0, 0.0, draw.uniform(-100.0, 100.0))),
        actions=_actions(draw, steps),
        restored_at=draw.randint(0, steps - 1),
        seed=draw.randint(0, 2**31 - 1),
    )
    if not scene.elastic and draw.choice((True, False)):
        case = dataclasses.replace(case, state=_lying(draw, scene, case.state))
    if contact == "exact" and draw.choice((False, False, False, True)):
        neighbours = tuple(draw_scene(draw, dt) for _ in range(draw.randint(1, 3)))
        case = dataclasses.replace(case, neighbours=neighbours)
    return case


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


def _start(draw: random.Random, scene: Scene, dt: float) -> tuple[float, ...]:
    half, arm = scene.box_half_width, scene.jack_arm
    narrow = math.acos(half / arm) if arm > half else 0.0  # a longer arm fits no nearer than this to the axes
    relative = narrow + draw.uniform(0.0, 1.0) * (math.pi / 2.0 - 2.0 * narrow)
    room = half - arm * max(abs(math.cos(relative)), abs(math.sin(relative)))
    x, y = room * draw.uniform(-1.0, 1.0), room * draw.uniform(-1.0, 1.0)
    turn = draw.choice((0.0, draw.uniform(-10.0, 10.0)))
    place = draw.choice((0.0, draw.uniform(-100.0, 100.0)))
    cosine, sine = math.cos(turn), math.sin(turn)
    jack = place + cosine * x - sine * y, -place + sine * x + cosine * y
    speed = 0.15 * half / dt * draw.uniform(0.0, 1.0)
    spin = 0.3 / dt * draw.uniform(0.0, 1.0)
    box_rates = 0.1 * speed * draw.uniform(-1.0, 1.0), 0.1 * speed * draw.uniform(-1.0, 1.0)
    jack_rates = speed * draw.uniform(-1.0, 1.0), speed * draw.uniform(-1.0, 1.0)
    turning = 0.3 * spin * draw.uniform(-1.0, 1.0), spin * draw.uniform(-1.0, 1.0)
    angle = turn + relative + draw.randint(-4, 4) * math.pi / 2.0
    return (place, -place, turn, *jack, angle, *box_rates, turning[0], *jack_rates, turning[1])


def _lying(draw: random.Random, scene: Scene, start: tuple[float, ...]) -> tuple[float, ...]:
    """The box of a start, and in it the jack on two feet on the lowest wall, turning with it."""
    x_box, y_box, turn, *_ = start
    vx, vy, omega = start[6:9]
    tilt = math.remainder(turn, math.pi / 2.0)  # of the lowest wall
    away = scene.box_half_width - scene.jack_arm * math.sqrt(0.5)  # the most that lets the jack in
    along, cosine, sine = away * draw.uniform(-1.0, 1.0), math.cos(tilt), math.sin(tilt)
    x, y = cosine * along + sine * away, sine * along - cosine * away
    jack = x_box + x, y_box + y, tilt + math.pi / 4.0
    return (x_box, y_box, turn, *jack, vx, vy, omega, vx - omega * y, vy + omega * x, omega)


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
