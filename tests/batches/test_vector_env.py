"""Vector environments: arguments and returned arrays."""

from __future__ import annotations

import copy
import inspect
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from jackbox_env import JackInBoxVectorEnv
from jackbox_env.env import JackInBoxEnv
from tests.batches.several import EVERY_SIZE, actions_at, assert_same


def test_the_same_arguments_mean_the_same_physics() -> None:
    single = inspect.signature(JackInBoxEnv).parameters
    batched = inspect.signature(JackInBoxVectorEnv).parameters
    for name, parameter in single.items():
        assert batched[name].default == parameter.default, name
    assert batched["max_episode_steps"].default == gym.spec("JackInBox-v0").max_episode_steps
    assert isinstance(gym.make_vec("JackInBox-v0", num_envs=2).unwrapped, JackInBoxVectorEnv)


def arrays_in(handed: Any) -> list[Any]:
    """All arrays in a returned value, those in dicts and in arrays of arrays too."""
    if isinstance(handed, np.ndarray) and handed.dtype != object:
        return [handed]
    parts = handed.values() if isinstance(handed, dict) else [] if handed is None else handed
    return [array for part in parts for array in arrays_in(part)]


@EVERY_SIZE
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
def test_returned_and_passed_arrays_belong_to_the_caller(contact: str, mode: AutoresetMode, count: int) -> None:
    settings: Any = {"contact": contact, "max_episode_steps": 4, "with_infos": True, "autoreset_mode": mode}
    scribbled, twin = (JackInBoxVectorEnv(count, **settings) for _ in range(2))
    options: Any = {"state": np.tile(np.linspace(0.0, 0.5, 12), (count, 1)), "time": np.full(count, 1.0)}
    handed_out: list[Any] = [twin.reset(seed=0, options=copy.deepcopy(options))]
    copied = copy.deepcopy(handed_out)

    def scribble(handed: Any) -> None:
        for array in arrays_in(handed):
            array[...] = 7

    scribble(scribbled.reset(seed=0, options=options))
    scribble(options)
    for step in range(14):
        actual, expected = (
            (env.step(actions_at(step, count)), env.states, env.times, env.observations) for env in (scribbled, twin)
        )
        assert_same(actual, expected)
        if step % 5 == 1:
            scribbled.set_states(actual[1], actual[2])
            twin.set_states(expected[1], expected[2])
        handed_out.append(expected)
        copied.append(copy.deepcopy(expected))
        scribble(actual)
    assert_same(scribbled.states, twin.states)
    assert_same(handed_out, copied)  # none of it was written again
