"""The native Stable-Baselines3 VecEnv against DummyVecEnv over Monitor over the single environment."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

from gymnasium.wrappers import RecordEpisodeStatistics, TimeLimit
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import DummyVecEnv

from jackbox_env.sb3 import EnvView, make_sb3_vec_env
from tests.batches.several import EVERY_MODEL, actions_at, assert_same


def dummy(num_envs: int, **settings: Any) -> DummyVecEnv:
    return DummyVecEnv([lambda: Monitor(gym.make("JackInBox-v0", **settings))] * num_envs)


def assert_same_infos(actual: list[dict[str, Any]], expected: list[dict[str, Any]]) -> None:
    for one, other in zip(actual, expected, strict=True):
        assert [(name, type(value)) for name, value in one.items()] == [(n, type(value)) for n, value in other.items()]
        assert "state" not in one or one["state"].base is None  # keeps no other environment's state alive
        assert one.get("episode", {"t": 0.0})["t"] >= 0.0
        untimed = [{**info, "episode": {**info.get("episode", {}), "t": 0.0}} for info in (one, other)]
        assert_same(untimed[0], untimed[1])


@EVERY_MODEL
def test_each_step_is_that_of_dummy_vec_env(contact: str) -> None:
    arguments: dict[str, Any] = {
        "contact": contact, "max_episode_steps": 35, "task": "rattle", "control_dt": 0.05, "scene": {"jack_arm": 5.0},
        "randomize": {"gravity": (5.0, 15.0)},
    }  # fmt: skip
    native, plain = make_sb3_vec_env(3, with_infos=True, **arguments), dummy(3, **arguments)
    assert native.observation_space == plain.observation_space
    assert native.action_space == plain.action_space
    assert native.seed(9) == plain.seed(9) == [9, 10, 11]
    assert_same(native.reset(), plain.reset())
    assert_same_infos(native.reset_infos, plain.reset_infos)
    impacts = 0
    for step in range(110):
        actual, expected = native.step(actions_at(step, 3)), plain.step(actions_at(step, 3))
        assert_same(actual[:3], expected[:3])
        assert_same_infos(actual[3], expected[3])
        assert_same_infos(native.reset_infos, plain.reset_infos)
        impacts += sum(info["impacts"] for info in actual[3])
    assert impacts > 3
    for env in (native, plain):
        env.set_options([{}, {"state": 0.7 * np.eye(12)[3]}, {"time": 2.0}])
    for times in ([0.0, 0.0, 2.0], [0.0] * 3):  # options are used once
        assert_same(native.reset(), plain.reset())  # unseeded: the generators went the same way
        assert native.get_attr("time") == times


def test_single_environments_can_be_read_and_set() -> None:
    env = make_sb3_vec_env(3, contact="exact")
    env.seed(0)
    env.reset()
    assert env.get_attr("np_random_seed") == [0, 1, 2]
    assert_same(env.get_attr("observation"), list(env.vector_env.observations))
    env.set_attr("label", "mine", indices=[0])
    assert [hasattr(view, "label") for view in env.get_attr("unwrapped")] == [True, False, False]
    assert all(isinstance(view, EnvView) for view in env.get_attr("unwrapped"))
    assert env.env_is_wrapped(Monitor, indices=[0]) == env.env_is_wrapped(TimeLimit, indices=1) == [True]
    assert env.env_is_wrapped(RecordEpisodeStatistics) == [False] * 3
