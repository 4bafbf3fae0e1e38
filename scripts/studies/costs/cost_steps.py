"""What ``costs.py`` times: the same control steps with a thing and without it.

The cost of a thing must not be mixed up with its effect on the motion: without gravity the jack hardly meets a wall. So
all variants step the same states, taken from episodes of the default scene and restored before each step. What cannot
be switched off is replaced by a stand-in that does as little as possible. One thread does everything. Its own clock is
read, which stops while other processes use the core.
"""

from __future__ import annotations

import itertools
import math
import time
from contextlib import nullcontext
from typing import Any, NamedTuple
from unittest.mock import patch

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from jackbox_env import Drive, Scene, _validation
from jackbox_env.env import JackInBoxEnv
from jackbox_env.planning import rollout
from jackbox_env.tasks import sample_start
from scripts.studies.timing import Timed, repeat

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
TAKEN_OUT = ("contact", "_score", "_info", "checks", "bare")  # of one environment


class Moments(NamedTuple):
    """States of episodes, and the action that follows each."""

    states: Array  # (episodes, moments, 12)
    times: list[float]  # [s], of each moment
    actions: NDArray[np.float32]  # (episodes, moments, 1)
    hits: NDArray[np.int64]  # (episodes, moments), impacts in the step from there


def moments(episodes: int, every: int, scene: Scene | None = None) -> Moments:
    """Every ``every`` steps a moment of episodes under random actions, played by the exact model."""
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


def stepped(contact: str, given: Moments, seconds: float, kind: str) -> Timed:
    """Steps per second of an environment of one of ``KINDS``, or of a plain one with something ``TAKEN_OUT``."""
    settings = KINDS.get(kind, {})
    env: Any = gym.make("JackInBox-v0", contact=contact, max_episode_steps=_NEVER, **settings)
    core: JackInBoxEnv = env.unwrapped
    simulator: Any = core._simulator
    env.reset(seed=0)
    for _ in range(2):
        env.step(given.actions[0, 0])  # Gymnasium's checker examines only the first steps
    games: list[list[tuple[Any, Any]]] = []
    for states, actions in zip(given.states, given.actions, strict=True):
        games.append([])
        for state, moment, action in zip(states, given.times, actions, strict=True):
            simulator.reset(state, moment)
            games[-1].append((simulator._present, action))
    if kind == "drawn":
        games = [games[0][:_DRAWN]]
    step, unchecked = _without(env, kind), kind in ("contact", "checks")

    def block() -> int:
        with patch.object(_validation, "real", lambda _, value, **__: value) if unchecked else nullcontext():
            for game in games:
                simulator._present = game[0][0]
                core._start_picture()
                for simulator._present, action in game:
                    step(action)
        return sum(map(len, games))

    return repeat(block, seconds, clock=time.thread_time)


def _without(env: Any, kind: str) -> Any:
    """What is called with each action."""
    core = env.unwrapped
    observation, terms = core._score(core.state, 0.0, 0.0)

    def drawn(action: Any) -> None:
        env.step(action)
        env.render()

    def contact(action: Any) -> None:
        core._simulator.step(DT, 90000.0 * float(action[0]))

    if kind == "_info":
        core._info = lambda *_: {}
    elif kind == "_score":
        core._score = lambda *_: (observation, terms)
    elif kind == "checks":
        core._torque_of = lambda action: max(-1.0, min(1.0, float(action[0]))) * 90000.0
    return {"bare": core.step, "drawn": drawn, "contact": contact}.get(kind, env.step)


def asked(contact: str, steps: int = 120) -> float:
    """How often a drive's function is asked per control step."""
    calls = itertools.count()
    scene = Scene(drive=Drive(torque=lambda time: _chirped(time) + 0.0 * next(calls)))
    env = JackInBoxEnv(contact=contact, scene=scene, torque="chirp")
    env.reset(seed=0)
    before = next(calls)
    for _ in range(steps):
        env.step(None)
    return (next(calls) - before - 1) / steps


def batched(contact: str, given: Moments, seconds: float, **settings: Any) -> Timed:
    """Environment steps per second of a batch that is put back to its moments before each step."""
    count = FEW if contact == "pymunk" or "render_mode" in settings else TOGETHER
    env: Any = gym.make_vec(
        "JackInBox-v0", count, vectorization_mode="vector_entry_point", contact=contact, num_threads=1,
        max_episode_steps=_NEVER, **settings,
    )  # fmt: skip
    env.reset(seed=0)
    everyone, place = np.ones(count, dtype=np.bool_), env.unwrapped._place
    lap = [
        (given.states[:count, k].copy(), np.full(count, moment), given.actions[:count, k].copy())
        for k, moment in enumerate(given.times)
    ]

    def run() -> float:
        passed, steps = 0.0, 0
        while passed <= seconds:
            for states, times, actions in lap:
                place(everyone, states, times, anew=True)
                began = time.thread_time()
                env.step(actions)
                passed += time.thread_time() - began
            steps += count * len(lap)
        return steps / passed

    return run
