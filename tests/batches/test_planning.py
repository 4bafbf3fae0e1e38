"""Rollouts: arguments, errors and optional results. Their bits are in tests/guarantees/test_bits.py."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import Rollout, Scene, Task, rollout
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


OUTSIDE = [[0.0] * 12, [0.0, 0.0, 0.0, 7.5, *[0.0] * 8]]  # of the default box, by 2.5 m


@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"states": np.zeros((2, 11))}, r"states .*\(N, 12\) or \(12,\), got \(2, 11\)"),
        ({"states": np.full((2, 12), math.nan)}, r"states\[0\].* x_box = nan"),
        ({"states": np.full((2, 12), 1e200)}, r"states\[0\]"),
        ({"states": OUTSIDE}, r"states\[1\].* at most 1 m outside, got 2.5 m"),
        ({"states": OUTSIDE, "scene": [{"box_half_width": 9.0}, None]}, r"states\[1\]"),
        ({"states": [[1.0], [2.0, 3.0]]}, "states must be numbers"),
        ({"torques": np.zeros((3, 5))}, "states must have as many rows as torques, got 2 and 3"),
        ({"torques": np.zeros((2, 5, 1))}, r"torques .*\(N, H\) or \(H,\), got \(2, 5, 1\)"),
        ({"torques": [[0.0, math.inf]] * 2}, "torques .* got inf"),
        ({"dt": 0.0}, "dt .* above 0, got 0.0"),
        ({"time": math.inf}, "time must be a finite number"),
        ({"time": 1e9}, "dt .* end by 1e[+]09 s"),
        ({"scene": [None] * 3}, "scene .* list of 2.* got 3"),
        ({"rewards": "climb"}, "rewards .* 'juggle', 'spin', 'rattle'.*, got 'climb'"),
        ({"repeat": 0}, "repeat .* from 1 to 1000000, got 0"),
        ({"trajectories": 1.5}, "trajectories .* got 1.5"),
    ],
)
def test_unusable_values_are_refused(changes: dict[str, Any], named: str) -> None:
    usual = {"scene": Scene(), "states": np.zeros((2, 12)), "torques": np.zeros((2, 5)), "dt": 0.02}
    with pytest.raises((TypeError, ValueError), match=named):
        rollout(**{**usual, **changes})


def test_a_jack_too_fast_is_named() -> None:
    states = np.zeros((3, 12))
    states[2, 9] = 1e90
    with pytest.raises(RuntimeError, match=r"states\[2\]"):
        rollout(Scene(), states, np.zeros((3, 5)), 0.02)


def low(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
    if state[4] < -0.5:
        raise ValueError("the jack is too low")
    return (1.0,)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_in_a_custom_task_is_raised(threads: int) -> None:
    states, torques = inputs(300, 60)
    with pytest.raises(ValueError, match="the jack is too low"):
        rollout(Scene(), states, torques, 0.02, rewards=Task(("one",), low), num_threads=threads)


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
