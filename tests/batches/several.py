"""Steps and comparisons that the tests of vector environments share."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import Chirp, Drive, JackInBoxVectorEnv, Scene

EVERY_MODEL = pytest.mark.parametrize("contact", ["exact", "pymunk"])
SHAKEN = Drive(force_x=lambda time: 2e4 * math.cos(5.0 * time))
TURNED = Drive(torque=lambda time: 6e4 * math.sin(3.0 * time))
SCENES = (
    Scene(),
    Scene(gravity=1.62, restitution=0.6, drive=None),
    Scene(box_half_width=3.0, jack_mass=9.0, torque_limit=2e4, drive=Chirp(2e4, 1.0, 0.0)),
    Scene(jack_arm=4.0, drive=SHAKEN),
    Scene(gravity=0.0, box_mass=50.0, torque_limit=5000.0, drive=TURNED),
)


def actions_at(step: int, count: int) -> Any:
    return np.random.default_rng(step).uniform(-1.2, 1.2, (count, 1)).astype(np.float32)


def play(env: JackInBoxVectorEnv, steps: int, seed: int) -> list[Any]:
    """Results of a batch: every seventh step under the drive, the others under random actions."""
    rng, played = np.random.default_rng(seed), []
    for step in range(steps):
        actions = rng.uniform(-1.0, 1.0, env.num_envs)
        played.append(env.step(None if step % 7 == 0 else actions))
    return played


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
