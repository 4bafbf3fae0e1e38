"""The cost of each modelled thing on top of a plain control step: the part ``costs`` of docs/speed.md.

The cost of a thing must not be mixed up with its effect on the motion: without gravity the jack hardly strikes a wall.
So all variants step the same states, from episodes of the default scene, which are set before each step. The clock is
that of one thread, and stops while other processes use the core.
"""

from __future__ import annotations

import itertools
import math
import statistics
import time
from collections.abc import Mapping, Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from jackbox_env import Drive, Scene, Task
from jackbox_env.model.tasks import TASKS, juggle
from scripts.studies.pages import figure, table
from scripts.studies.speed.measured import DT, EPISODE, TOGETHER, play, vector_env
from scripts.studies.timing import Rates, Timed, repeat

MODELS = PYMUNK, EXACT, BATCH = "pymunk", "exact", "exact, batch"
FEW, DRAWN = 16, 50  # environments in a batch of single ones, or episodes; moments at which frames are drawn


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
_RESTARTING: dict[str, Any] = {"episode_steps": 1, "autoreset_mode": "SAME_STEP"}
# These scenes differ by so little that the motion is that of the default scene.
_SCENES = [Scene(gravity=9.81 + 1e-9 * number) for number in range(TOGETHER)]
_RANGES = {"jack_mass": (4.0, 4.0 + 1e-6), "gravity": (9.81, 9.81 + 1e-6)}
KINDS: dict[str, dict[str, Any]] = {
    "plain": {},
    "weightless": {"scene": Scene(gravity=0.0)},
    "chirp": {"torque": "chirp"},
    "function": {"torque": "chirp", "scene": Scene(drive=Drive(torque=_chirped))},
    "pushed": {"scene": Scene(drive=Drive(force_x=_shaken, force_y=_shaken))},
    "long arm": {"scene": LONG},
    "rattle": {"task": "rattle"},
    "picture": {"render_mode": "rgb_array"},
}
IN_BATCHES: dict[str, dict[str, Any]] = {  # kinds of steps that only batches are timed with
    "infos": {"with_infos": True},
    "own scenes": {"scene": _SCENES},
    "restarted": {**_RESTARTING, "scene": _SCENES},
    "redrawn": {**_RESTARTING, "randomize": _RANGES},
    "own task": {"task": Task(TASKS["juggle"].terms, _juggled)},
}
ARM = "more impacts: an arm of 8 m"
THINGS = {  # the kinds of steps with them and without
    "gravity": ("plain", "weightless"),
    "task rattle, in place of juggle": ("rattle", "plain"),
    "the chirp, in place of a held torque": ("chirp", "plain"),
    "a torque that is a Python function, in place of the chirp": ("function", "chirp"),
    "side forces that are Python functions": ("pushed", "plain"),
    ARM: ("long arm", "plain"),
    "a `render_mode`, nothing drawn": ("picture", "plain"),
    "a frame drawn in each step": ("drawn", "picture"),
    "stepped in a batch of 16": ("together", "plain"),
    "`with_infos` of a batch": ("infos", "plain"),
    "a scene for each environment": ("own scenes", "plain"),
    "scenes drawn at each reset, two fields each: only in a step that resets": ("redrawn", "restarted"),
    "a task of one's own, in place of a built-in one that does the same": ("own task", "plain"),
}


def stepped(contact: str, count: int, seconds: float, frames: bool = False, **settings: Any) -> Timed:
    """Environment steps per second of one environment, or of a batch of ``count``, from moments of episodes.

    With ``frames`` one is drawn after each step.
    """
    keywords = {"contact": contact, "episode_steps": None, **settings}
    scene, every = LONG if settings.get("scene") is LONG else Scene(), 4 if count <= FEW else 40
    trajectories, _, torques = play(max(count, FEW), scene)
    states, actions = trajectories[:, :-1:every], (torques[:, ::every, None] / scene.torque_limit).astype(np.float32)
    times = [DT * k for k in range(0, EPISODE, every)]
    env: Any = vector_env("JackInBox-v0", count, num_threads=1, **keywords) if count > 1 else None
    if env is None:
        env = gym.make("JackInBox-v0", **keywords)
        env.reset(seed=0)
        moments = zip(states.reshape(-1, 12), times * FEW, actions.reshape(-1, 1), strict=True)
    else:
        moments = zip(states.swapaxes(0, 1), times, actions.swapaxes(0, 1), strict=True)
    put = env.unwrapped.set_state if count == 1 else env.unwrapped.set_states
    lap, action = itertools.cycle(list(moments)[: DRAWN if frames else None]), actions[0, 0]

    def prepare() -> None:
        nonlocal action
        state, moment, action = next(lap)
        put(state, moment)

    def block() -> int:
        env.step(action)
        if frames:
            env.render()
        return count

    return repeat(block, seconds, prepare, time.thread_time)


def costs(seconds: float) -> dict[str, Timed]:
    """All kinds of steps, each with the models that have it."""
    timed = {f"{PYMUNK}: together": stepped(PYMUNK, FEW, seconds)}
    for contact in (PYMUNK, EXACT):
        timed[f"{contact}: drawn"] = stepped(contact, 1, seconds, True, **KINDS["picture"])
        timed |= {f"{contact}: {kind}": stepped(contact, 1, seconds, **of) for kind, of in KINDS.items()}
    for kind, of in (KINDS | IN_BATCHES).items():
        timed[f"{BATCH}: {kind}"] = stepped(EXACT, FEW if kind == "picture" else TOGETHER, seconds, **of)
    return timed


def figures(rates: Rates) -> dict[str, Any]:
    """The times [ns] of a plain step and of each thing on top of it, by model, in each round; impacts in a step."""

    def ns(model: str, kind: str) -> list[float]:
        return [1e9 / rate for rate in rates[f"{model}: {kind}"]]

    on_top = {
        what: {
            model: [more - less for more, less in zip(ns(model, having), ns(model, without), strict=True)]
            for model in MODELS
            if {f"{model}: {having}", f"{model}: {without}"} <= set(rates)
        }
        for what, (having, without) in THINGS.items()
    }
    impacts = {name: float(play(FEW, scene)[1].mean()) for name, scene in (("usual", Scene()), ("long arm", LONG))}
    return {"plain": {"a plain step": {model: ns(model, "plain") for model in MODELS}}, "on_top": on_top,
            "impacts": impacts}  # fmt: skip


# -- the page ----------------------------------------------------------------------------------------------------------


def cell(values: Sequence[float] | None) -> str:
    """Nanoseconds on top of a plain step."""
    if values is None:
        return ""
    if min(values) <= 0.0 <= max(values):  # not of one sign in all rounds
        return "below noise"
    middle = statistics.median(values)
    return f"{'+' if middle > 0.0 else ''}{figure(middle)}"


def filled(results: Mapping[str, Any]) -> dict[str, Any]:
    """The numbers of the part."""
    on_top, impacts = results["on_top"], results["impacts"]
    plain = {model: statistics.median(values) for model, values in results["plain"]["a plain step"].items()}
    more = impacts["long arm"] - impacts["usual"]
    little = [
        what
        for what, costs in on_top.items()
        if all(abs(statistics.median(values)) < 0.1 * plain[model] for model, values in costs.items())
    ]
    rows = [[what, *(cell(costs.get(model)) for model in MODELS)] for what, costs in on_top.items()]
    return {
        "table": table(
            ("on top of a plain step [ns]", *MODELS),
            [
                ["**a plain step**", *(f"**{figure(plain[model])}**" for model in MODELS)],
                *(row for row in rows if row[0] not in little),
            ],
        ),
        "little": "; ".join(little),
        "each": ", ".join(f"{figure(statistics.median(on_top[ARM][m]) / more)} ns ({m})" for m in on_top[ARM]),
    }
