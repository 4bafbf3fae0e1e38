"""Objects and how the fuzz calls them."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from jackbox_env import (
    JackInBoxEnv,
    JackInBoxVectorEnv,
    Scene,
    make_simulator,
)
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.simulators import CONTACT_MODELS, Simulator
from tests.hostile import EVERYTHING, answer, arrays

# Gymnasium's own checks show these with all their digits, or fail to.
NOT_SHOWN = ("fails", "fails as float", "-10^400", "10^400", "long text", "long to show")


SHOWN_BY_GYMNASIUM = {name: value for name, value in EVERYTHING.items() if name not in NOT_SHOWN}


EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


Values = Mapping[str, Callable[[], Any]]


START = np.array([0.1, 0.2, 0.3, 0.5, -0.4, 0.2, 0.1, 0.0, 0.2, 3.0, 1.0, 2.0])


# -- with an object that goes on ---------------------------------------------------------------------------------------


@dataclass
class Subject:
    """An object, how it is put back to its start, what shows its state, and a normal step of it."""

    make: Callable[[], Any]
    start: Callable[[Any], Any]
    shown: Callable[[Any], Any]
    step: Callable[[Any], Any]


def flat(seen: Any) -> list[Any]:
    """Everything in nested results, as plain values that compare by ==."""
    if isinstance(seen, Mapping):
        return [part for key in sorted(seen) for part in [key, *flat(seen[key])]]
    if isinstance(seen, tuple | list):
        return [part for value in seen for part in flat(value)]
    return [str(seen.dtype), seen.shape, seen.tobytes()] if isinstance(seen, np.ndarray) else [repr(seen)]


def hurt(subject: Subject, call: Callable[[Any, Any], Any], values: Values) -> list[str]:
    """The values that get a wrong answer, or that change the object that refuses them."""
    found = []
    one, twin = subject.make(), subject.make()
    for name, make in values.items():
        subject.start(one)
        subject.start(twin)
        before = flat(subject.shown(one))
        try:
            refused = answer(lambda make=make: call(one, make()))  # type: ignore[misc]
        except AssertionError as error:
            found.append(f"{name}: {error}")
            continue
        if refused is not None and flat(subject.shown(one)) != before:
            found.append(f"{name}: changed by what it refused: {refused}")
        elif refused is not None and flat(subject.step(one)) != flat(subject.step(twin)):
            found.append(f"{name}: steps otherwise after {refused}")
    return found


def simulator_of(contact: str) -> Subject:
    def step(simulator: Simulator) -> Any:
        simulator.step(0.5, 1000.0)
        return simulator.state, simulator.time, simulator.torque, simulator.impacts

    return Subject(
        lambda: make_simulator(Scene(), contact=contact),
        lambda simulator: simulator.reset(START, 1.0),
        lambda simulator: (simulator.state, simulator.time, simulator.torque, simulator.impacts),
        step,
    )


def env_of(contact: str, made: bool) -> Subject:
    def start(env: Any) -> None:
        env.reset(seed=4)
        env.unwrapped.set_state(START, 1.0)

    return Subject(
        partial(gym.make, "JackInBox-v0", contact=contact) if made else partial(JackInBoxEnv, contact=contact),
        start,
        lambda env: (env.unwrapped.state, env.unwrapped.time, env.unwrapped.np_random.bit_generator.state),
        lambda env: [env.step(np.array([0.3])), env.unwrapped.time, env.reset()],
    )


def vector_of(contact: str) -> Subject:
    def start(env: Any) -> None:
        env.reset(seed=4)
        env.set_states(START, 1.0)

    return Subject(
        partial(JackInBoxVectorEnv, 3, contact=contact, with_infos=True),
        start,
        lambda env: (env.states, env.times, env.np_random_seed),
        lambda env: [env.step(np.full((3, 1), 0.3)), env.times, env.reset()],
    )


def sb3_of(contact: str) -> Subject:
    def start(env: Any) -> None:
        env.seed(4)
        env.set_options()
        env.reset()

    def step(env: Any) -> Any:
        observations, rewards, dones, _ = env.step(np.full((3, 1), 0.3))
        return observations, rewards, dones, env.vector_env.states

    return Subject(
        partial(make_sb3_vec_env, 3, contact=contact),
        start,
        lambda env: (env.vector_env.states, env.vector_env.times),
        step,
    )


MASKS = {"mask of none": lambda: np.zeros(3, dtype=bool), "mask of two": lambda: np.ones(2, dtype=bool)}


# What is called: the subject, the public method it stands for, the call, and values besides all others.
CALLS: dict[str, tuple[Callable[[str], Subject], str, Callable[[Any, Any], Any], Values]] = {
    "reset state": (simulator_of, "Simulator.reset", lambda s, x: s.reset(x), arrays(12)),
    "reset time": (simulator_of, "Simulator.reset", lambda s, x: s.reset(START, x), {}),
    "step dt": (simulator_of, "Simulator.step", lambda s, x: s.step(x, 0.0), {}),
    "step dt of the drive": (simulator_of, "Simulator.step", lambda s, x: s.step(x), {}),
    "step torque": (simulator_of, "Simulator.step", lambda s, x: s.step(0.02, x), {}),
    "env seed": (partial(env_of, made=False), "JackInBoxEnv.reset", lambda e, x: e.reset(seed=x), {}),
    "env options": (partial(env_of, made=False), "JackInBoxEnv.reset", lambda e, x: e.reset(options=x), {}),
    "env state": (
        partial(env_of, made=False), "JackInBoxEnv.reset", lambda e, x: e.reset(options={"state": x}), arrays(12),
    ),
    "env time": (partial(env_of, made=False), "JackInBoxEnv.reset", lambda e, x: e.reset(options={"time": x}), {}),
    "env step": (partial(env_of, made=False), "JackInBoxEnv.step", lambda e, x: e.step(x), arrays(1)),
    "env set_state": (partial(env_of, made=False), "JackInBoxEnv.set_state", lambda e, x: e.set_state(x), arrays(12)),
    "env set_state time": (
        partial(env_of, made=False), "JackInBoxEnv.set_state", lambda e, x: e.set_state(START, x), {},
    ),
    "made seed": (partial(env_of, made=True), "gym.make", lambda e, x: e.reset(seed=x), {}),
    "made step": (partial(env_of, made=True), "gym.make", lambda e, x: e.step(x), arrays(1)),
    "vector seed": (vector_of, "JackInBoxVectorEnv.reset", lambda e, x: e.reset(seed=x), arrays(3)),
    "vector seeds": (vector_of, "JackInBoxVectorEnv.reset", lambda e, x: e.reset(seed=[1, 2, x]), {}),
    "vector options": (vector_of, "JackInBoxVectorEnv.reset", lambda e, x: e.reset(options=x), {}),
    "vector state": (
        vector_of, "JackInBoxVectorEnv.reset", lambda e, x: e.reset(options={"state": x}),
        arrays(12) | {f"rows: {key}": value for key, value in arrays(3, 12).items()},
    ),
    "vector time": (vector_of, "JackInBoxVectorEnv.reset", lambda e, x: e.reset(options={"time": x}), arrays(3)),
    "vector mask": (
        vector_of, "JackInBoxVectorEnv.reset", lambda e, x: e.reset(options={"reset_mask": x}), arrays(3) | MASKS,
    ),
    "vector step": (
        vector_of, "JackInBoxVectorEnv.step", lambda e, x: e.step(x),
        arrays(3) | {f"rows: {key}": value for key, value in arrays(3, 1).items()},
    ),
    "vector set_states": (
        vector_of, "JackInBoxVectorEnv.set_states", lambda e, x: e.set_states(x, 0.0),
        arrays(12) | {f"rows: {key}": value for key, value in arrays(3, 12).items()},
    ),
    "vector set_states time": (
        vector_of, "JackInBoxVectorEnv.set_states", lambda e, x: e.set_states(START, x), arrays(3),
    ),
    "vector set_states chosen": (
        vector_of, "JackInBoxVectorEnv.set_states", lambda e, x: e.set_states(START, 0.0, x), arrays(3) | MASKS,
    ),
    "vector tiled": (vector_of, "JackInBoxVectorEnv.tiled", lambda e, x: e.tiled(x, (16, 16)), {}),
    "vector tiled size": (vector_of, "JackInBoxVectorEnv.tiled", lambda e, x: e.tiled(1, x), arrays(2)),
    "sb3 step": (sb3_of, "JackInBoxVecEnv.step", lambda e, x: e.step(x), arrays(3, 1)),
    "sb3 options": (
        sb3_of, "JackInBoxVecEnv.reset", lambda e, x: [e.set_options([{"state": x}, {}, {}]), e.reset()], arrays(12),
    ),
    "sb3 set_state": (
        sb3_of, "EnvView.set_state", lambda e, x: e.env_method("set_state", x, indices=[1]), arrays(12),
    ),
    "sb3 set_state time": (
        sb3_of, "EnvView.set_state", lambda e, x: e.env_method("set_state", START, x, indices=[1]), {},
    ),
}  # fmt: skip
