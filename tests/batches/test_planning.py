"""Rollouts: arguments, errors and optional results. Their bits are in tests/guarantees/test_bits.py."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jackbox_env import Rollout, Scene, rollout
from tests.batches.several import SCENES, assert_same
from tests.states import inside


def inputs(count: int, steps: int) -> tuple[Any, Any]:
    rng = np.random.default_rng(1)
    return np.array([inside(Scene(), rng) for _ in range(count)]), rng.uniform(-9e4, 9e4, (count, steps))


def test_one_state_one_sequence_or_one_scene_serves_all() -> None:
    states, torques = inputs(5, 10)
    whole = rollout(None, states, torques, 0.02)
    assert_same(rollout({}, states[2], torques, 0.02)[2], whole[2])
    assert_same(rollout(None, states, torques[3], 0.02)[3], whole[3])
    mixed = rollout(SCENES[:2], states[0], torques[0], 0.02)
    assert_same(mixed[1], rollout(SCENES[1], states[0], torques[0], 0.02)[0])
    assert rollout(None, states, np.zeros((5, 0)), 0.02).shape == (5, 1, 12)
    assert rollout(None, np.zeros((0, 12)), np.zeros((0, 7)), 0.02).shape == (0, 8, 12)


@pytest.mark.parametrize("steps", [0, 1, 2, 7])
def test_first_and_last_states_are_those_of_the_trajectories(steps: int) -> None:
    states, torques = inputs(5, steps)
    asked: Any = {"rewards": "juggle", "impacts": True}
    whole = rollout(Scene(), states, np.repeat(torques, 3, axis=1), 0.02, **asked)
    ends = rollout(Scene(), states, torques, 0.02, repeat=3, trajectories=False, **asked)
    expected = whole._replace(trajectories=whole.trajectories[:, [0, -1]])
    assert_same(ends, expected)
    only = rollout(Scene(), states, torques, 0.02, repeat=3, trajectories=False)
    assert_same(only, Rollout(expected.trajectories, None, None, None, None, None))
