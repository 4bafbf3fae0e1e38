"""The steps that ``costs.py`` times: the same control steps with a thing and without it.

The cost of a thing must not be mixed up with its effect on the motion: without gravity the jack hardly strikes a wall.
So all variants step the same states, from episodes of the default scene, which are set before each step. One thread
does everything. Its clock is read around each step; it stops while other processes use the core.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any, NamedTuple

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from jackbox_env import Drive, Scene, Task, linearize, make_simulator
from jackbox_env.model.tasks import TASKS, juggle, sample_start
from jackbox_env.planning.rollouts import rollout
from scripts.studies.timing import Timed

Array = NDArray[np.float64]

DT = 0.02  # [s]
EPISODE = 500  # steps
TOGETHER, FEW = 1024, 16  # environments in a batch of the exact model, and of single environments; or episodes
_DRAWN = 50  # moments at which frames are drawn
_NEVER = 10**9  # steps to truncation


def _chirped(time: float) -> float:
    """The default chirp written as a Python function [N m]."""
    return 90000.0 * math.sin(2.0 * math.pi * (0.5 + 0.45 * time) * time)


def _shaken(time: float) -> float:
    """A side force [N]."""
    return 4000.0 * math.sin(3.0 * time)


def _juggled(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
    """The built-in task's reward by a function of one's own."""
    return juggle(scene, state, torque, impulse)


LONG = Scene(jack_arm=8.0)
PLAIN = "plain"
KINDS: dict[str, dict[str, Any]] = {
    PLAIN: {},
    "weightless": {"scene": Scene(gravity=0.0)},
    "chirp": {"torque": "chirp"},
    "function": {"torque": "chirp", "scene": Scene(drive=Drive(torque=_chirped))},
    "pushed": {"scene": Scene(drive=Drive(force_x=_shaken, force_y=_shaken))},
    "long arm": {"scene": LONG},
    "rattle": {"task": "rattle"},
    "picture": {"render_mode": "rgb_array"},
    "drawn": {"render_mode": "rgb_array"},
}
# These scenes differ by so little that the motion is that of the default scene.
SCENES = [Scene(gravity=9.81 + 1e-9 * number) for number in range(TOGETHER)]
_RANGES = {"jack_mass": (4.0, 4.0 + 1e-6), "gravity": (9.81, 9.81 + 1e-6)}
_RESTARTING: dict[str, Any] = {"max_episode_steps": 1, "autoreset_mode": "SAME_STEP"}
IN_BATCHES: dict[str, dict[str, Any]] = {  # kinds of steps that only batches are timed with
    "infos": {"with_infos": True},
    "own scenes": {"scene": SCENES},
    "restarted": {**_RESTARTING, "scene": SCENES},
    "redrawn": {**_RESTARTING, "randomize": _RANGES},
    "own task": {"task": Task(TASKS["juggle"].terms, _juggled)},
}
FLIGHT, BOUNCE, PILE = "free flight", "a bounce, e = 0.8", "bounces pile up before rest, e = 0.8"
LEVEL, TURNING = "rest on a level floor, e = 0.5", "rest on a floor that turns by 0.2 rad/s, e = 0.5"
CORNER = "locked in a corner of a box that turns by 3 rad/s, e = 0.5"
RESTING = (LEVEL, TURNING, CORNER)
_LOSSY = {kind: Scene(restitution=0.8 if "0.8" in kind else 0.5, drive=None) for kind in (BOUNCE, PILE, *RESTING)}
LOSS = {FLIGHT: _LOSSY[BOUNCE]} | _LOSSY  # kinds of steps with loss, and their scenes
_PILED = 10, 20  # impacts in a step where bounces pile up


class Moments(NamedTuple):
    """States of episodes, and the action that follows each."""

    states: Array  # (episodes, moments, 12)
    times: list[float]  # [s], of each moment
    actions: NDArray[np.float32]  # (episodes, moments, 1)
    hits: NDArray[np.int64]  # (episodes, moments), impacts in the step from there


def moments(episodes: int, every: int, scene: Scene | None = None) -> Moments:
    """Every ``every``-th step of episodes under random actions, played by the exact model."""
    scene, rng = scene or Scene(), np.random.default_rng(0)
    starts = np.array([sample_start(scene, rng) for _ in range(episodes)])
    actions = rng.uniform(-1.0, 1.0, (episodes, EPISODE, 1)).astype(np.float32)
    torques = scene.torque_limit * actions[:, :, 0].astype(np.float64)
    played: Any = rollout(scene, starts, torques, DT, impacts=True, num_threads=1)
    chosen = slice(0, EPISODE, every)
    return Moments(
        played.trajectories[:, :-1][:, chosen].copy(), [DT * k for k in range(EPISODE)[chosen]],
        actions[:, chosen].copy(), played.impacts[:, chosen],
    )  # fmt: skip


def with_loss(kind: str, courses: int = 256) -> Moments:
    """Moments of one kind of ``LOSS`` under no torque, two for each environment of a batch, from courses of 14 s.

    The box is level and at rest at first, except for the kinds that turn. A resting jack lies on two feet, in a corner
    on three.
    """
    scene, rng = LOSS[kind], np.random.default_rng(0)
    lies, omega = kind in RESTING, {TURNING: 0.2, CORNER: 3.0}.get(kind, 0.0)
    positions = np.full(courses, math.sqrt(0.5) - 6.0) if kind == CORNER else rng.uniform(-4.0, 4.0, courses)
    starts = np.array([_lying(x, omega) if lies else sample_start(scene, rng) for x in positions.tolist()])
    steps = 50 if lies else 700
    played: Any = rollout(scene, starts, np.zeros((courses, steps)), DT, impacts=True, num_threads=1)
    hits: NDArray[np.int64] = played.impacts
    early = np.arange(steps) < 300  # nothing rests yet
    piled = (hits >= _PILED[0]) & (hits <= _PILED[1])
    matching = {FLIGHT: (hits == 0) & early, BOUNCE: (hits == 1) & early, PILE: piled}.get(kind, hits > 0)
    some = rng.choice(np.flatnonzero(matching), (TOGETHER, 2))
    states = played.trajectories[:, :-1].reshape(-1, 12)[some]
    return Moments(states, [0.0, 0.0], np.zeros((TOGETHER, 2, 1), dtype=np.float32), hits.ravel()[some])


def _lying(x: float, omega: float) -> Array:
    """A jack at ``x`` [m] on two feet on the floor of the default box, both turning by ``omega`` [rad/s] as one."""
    y = math.sqrt(0.5) - 6.0
    return np.array([0.0, 0.0, 0.0, x, y, math.pi / 4.0, 0.0, 0.0, omega, -omega * y, omega * x, omega])


def timed(lap: Sequence[tuple[Callable[[], Any], Callable[[], Any]]], steps: int, seconds: float) -> Timed:
    """Steps per second of the second call of each pair; the first is not timed. A second call makes ``steps`` steps."""
    clock = time.thread_time
    reading = min(-clock() + clock() for _ in range(1000))  # [s] that a reading itself needs

    def run() -> float:
        passed, pairs = 0.0, 0
        while passed <= seconds:
            for prepare, step in lap:
                prepare()
                began = clock()
                step()
                passed += clock() - began - reading
            pairs += len(lap)
        return steps * pairs / passed

    return run


def alone(scene: Scene, sample: Moments, seconds: float) -> Timed:
    """Steps per second of the exact contact model, without an environment, under no torque."""
    simulator = make_simulator(scene, "exact")
    step = partial(simulator.step, DT, 0.0)
    return timed([(partial(simulator.reset, state), step) for state in sample.states[:64].reshape(-1, 12)], 1, seconds)


def derived(scene: Scene, sample: Moments, seconds: float) -> Timed:
    """Steps per second of rollouts of one step, their derivatives by state and torque included, under no torque."""
    torques = np.zeros((TOGETHER, 1))

    def step(states: Array) -> None:
        linearize(scene, states, torques, DT, num_threads=1).A  # noqa: B018

    return timed([(int, partial(step, sample.states[:, k])) for k in range(sample.states.shape[1])], TOGETHER, seconds)


def stepped(contact: str, sample: Moments, seconds: float, kind: str) -> Timed:
    """Steps per second of an environment of one of ``KINDS``."""
    env: Any = gym.make("JackInBox-v0", contact=contact, max_episode_steps=_NEVER, **KINDS[kind])
    env.reset(seed=0)
    for _ in range(2):
        env.step(sample.actions[0, 0])  # Gymnasium's checker examines only the first steps

    def drawn(action: Any) -> None:
        env.step(action)
        env.render()

    step = drawn if kind == "drawn" else env.step
    lap = [
        (partial(env.unwrapped.set_state, state, moment), partial(step, action))
        for states, actions in zip(sample.states, sample.actions, strict=True)
        for state, moment, action in zip(states, sample.times, actions, strict=True)
    ]
    return timed(lap[:_DRAWN] if kind == "drawn" else lap, 1, seconds)


def batched(contact: str, sample: Moments, seconds: float, **settings: Any) -> Timed:
    """Environment steps per second of a batch."""
    count = FEW if contact == "pymunk" or "render_mode" in settings else TOGETHER
    keywords = {"contact": contact, "num_threads": 1, "max_episode_steps": _NEVER, **settings}
    env: Any = gym.make_vec("JackInBox-v0", count, vectorization_mode="vector_entry_point", **keywords)
    env.reset(seed=0)
    lap = [
        (
            partial(env.unwrapped.set_states, sample.states[:count, k], moment),
            partial(env.step, sample.actions[:count, k]),
        )
        for k, moment in enumerate(sample.times)
    ]
    return timed(lap, count, seconds)
