"""Steps and comparisons that the tests of vector environments share."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from jackbox_env import Chirp, Drive, JackInBoxEnv, JackInBoxVectorEnv, Scene

EVERY_MODEL = pytest.mark.parametrize("contact", ["exact", "pymunk"])
# 1: NumPy easily makes a view where a copy is meant. 300: more than two blocks.
EVERY_SIZE = pytest.mark.parametrize(("contact", "count"), [("exact", 1), ("exact", 300), ("pymunk", 1), ("pymunk", 3)])
SHAKEN = Drive(force_x=lambda time: 2e4 * math.cos(5.0 * time))
TURNED = Drive(torque=lambda time: 6e4 * math.sin(3.0 * time))
SCENES = (
    Scene(),
    Scene(gravity=1.62, restitution=0.6, drive=None),
    Scene(box_half_width=3.0, jack_mass=9.0, torque_limit=2e4, drive=Chirp(2e4, 1.0, 0.0)),
    Scene(jack_arm=4.0, drive=SHAKEN),
    Scene(gravity=0.0, box_mass=50.0, torque_limit=5000.0, drive=TURNED),
)
RANGES = {"jack_mass": (2.0, 6.0), "restitution": (0.5, 1.0), "box_half_width": (4.0, 8.0), "gravity": (0.0, 20.0)}


def choosy(rng: np.random.Generator) -> dict[str, Any]:
    """Fields that depend on draws of 32 bits, of which numpy keeps a half for the next one."""
    arm = float(rng.choice([0.5, 1.0, 1.5]))
    chirp = Chirp(1e4 * int(rng.integers(1, 9, dtype=np.int32)), 0.5, 0.0)
    return {"jack_arm": arm, "drive": chirp if rng.random() < 0.5 else None}


def actions_at(step: int, count: int) -> Any:
    return np.random.default_rng(step).uniform(-1.2, 1.2, (count, 1)).astype(np.float32)


def play(env: JackInBoxVectorEnv, steps: int, seed: int) -> list[Any]:
    """Results of a batch: every seventh step under the drive, the others under random actions."""
    rng, played = np.random.default_rng(seed), []
    for step in range(steps):
        actions = rng.uniform(-1.0, 1.0, env.num_envs)
        seen, rewards, _, ends, infos = env.step(None if step % 7 == 0 else actions)
        played.append((seen, rewards, ends, unmarked(infos)))
    return played


def unmarked(infos: dict[str, Any]) -> dict[str, Any]:
    """Infos without the masks that mark their environments."""
    return {
        name: unmarked(values) if isinstance(values, dict) else values
        for name, values in infos.items()
        if name[0] != "_"
    }


def play_alone(envs: Sequence[JackInBoxEnv], steps: int, seed: int, limit: int = 10**9) -> list[Any]:
    """The same by single environments."""
    rng, played = np.random.default_rng(seed), []
    for step in range(steps):
        actions = rng.uniform(-1.0, 1.0, len(envs))
        played.append(step_alone(envs, [None] * len(envs) if step % 7 == 0 else actions, step, limit))
    return played


def step_alone(envs: Sequence[JackInBoxEnv], actions: Sequence[Any] | Any, step: int, limit: int) -> tuple[Any, ...]:
    """A step of single environments, which restart in the step after their last."""
    if step % (limit + 1) == limit:
        rows = [(seen, 0.0, info) for seen, info in (env.reset() for env in envs)]
    else:
        steps = [env.step(action) for env, action in zip(envs, actions, strict=True)]
        rows = [(seen, reward, info) for seen, reward, _, _, info in steps]
    observations, rewards, infos = zip(*rows, strict=True)
    ends = np.full(len(envs), step % (limit + 1) == limit - 1)
    return np.array(observations), np.array(rewards), ends, columns(infos)


def columns(infos: Sequence[dict[str, Any]]) -> dict[str, Any]:
    """Infos of single environments as a batch has them."""
    values = {name: [info[name] for info in infos] for name in infos[0]}
    return {name: columns(one) if isinstance(one[0], dict) else np.array(one) for name, one in values.items()}


def assert_alike(
    vector: Any, alone: Sequence[Any], actions: Iterable[Any], stable: Any = None, seed: int = 4
) -> Counter[tuple[bool, bool]]:
    """Step a vector environment, single ones that equal its first ones, and environments of Stable-Baselines3.

    All outputs are compared, in any autoreset mode; those of Stable-Baselines3 restart in the same step. Returns how
    often steps of the single environments were (terminated, truncated).
    """
    mode, ends, waits = vector.metadata["autoreset_mode"], Counter[tuple[bool, bool]](), [False] * len(alone)
    made = [0] * len(alone)  # decisions in the episodes
    seen = vector.reset(seed=seed)[0]
    assert_same(list(seen[: len(alone)]), [env.reset(seed=seed + i)[0] for i, env in enumerate(alone)])
    if stable is not None:
        stable.seed(seed)
        assert_same(stable.reset(), seen)
    for action in actions:
        seen, rewards, terminations, truncations, infos = vector.step(action)
        if stable is not None:
            *others, rows = stable.step(action)
            assert_same(others, [seen, rewards.astype(np.float32), terminations | truncations])
        for i, env in enumerate(alone):
            outcome = rewards[i], terminations[i], truncations[i]
            if waits[i]:
                waits[i] = False
                assert_same(seen[i], env.reset()[0])
                assert (outcome, infos["duration"][i]) == ((0.0, False, False), 0.0)
                continue
            last, *expected, info = env.step(action[i])
            assert outcome == tuple(expected)
            ended = expected[1] or expected[2]
            final = infos.get("final_info", infos) if ended else infos
            assert_same({name: final[name][i] for name in final if name in info and name != "scene"}, {
                name: np.asarray(info[name]) if name == "state" else info[name]
                for name in info if name in final and name != "scene"
            })  # fmt: skip
            ends[expected[1], expected[2]] += 1
            made[i] += 1
            if stable is not None:
                assert rows[i]["duration"] == info["duration"]
            if ended and stable is not None:
                assert_same(rows[i]["terminal_observation"], last)
                assert rows[i]["TimeLimit.truncated"] == (expected[1:] == [False, True])
                assert rows[i]["episode"]["l"] == made[i]
            made[i] = 0 if ended else made[i]
            if ended and mode is AutoresetMode.SAME_STEP:
                assert_same(infos["final_obs"][i], last)
                last = env.reset()[0]
            assert_same(seen[i], last)
            waits[i] = ended and mode is AutoresetMode.NEXT_STEP
            if ended and mode is AutoresetMode.DISABLED:
                seen = vector.reset(options={"reset_mask": np.arange(vector.num_envs) == i})[0]
                assert_same(seen[i], env.reset()[0])
    return ends


def assert_same(actual: Any, expected: Any, path: str = "") -> None:
    """Equal in kind and in every bit, dicts and arrays of arrays included."""
    if isinstance(expected, tuple | list) or (isinstance(expected, np.ndarray) and expected.dtype == object):
        assert len(actual) == len(expected), path
        for index, (one, other) in enumerate(zip(actual, expected, strict=True)):
            assert_same(one, other, f"{path}/{index}")
    elif isinstance(expected, dict):
        assert set(actual) == set(expected), path
        for name in expected:
            assert_same(actual[name], expected[name], f"{path}/{name}")
    elif isinstance(expected, np.ndarray):
        assert actual.dtype == expected.dtype, path
        np.testing.assert_array_equal(actual, expected, err_msg=path)
    else:
        assert actual == expected, path
