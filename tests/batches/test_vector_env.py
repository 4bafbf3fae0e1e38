"""Vector environments: arguments, returned arrays, episodes, restarts, restored states."""

from __future__ import annotations

import inspect
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import jackbox_env
from jackbox_env import JackInBoxVectorEnv
from jackbox_env.envs.single import JackInBoxEnv
from jackbox_env.exact import run as loop
from jackbox_env.planning import rollouts
from tests.batches.several import assert_same, play
from tests.states import lying, started


def test_the_same_arguments_mean_the_same_physics() -> None:
    single = inspect.signature(JackInBoxEnv).parameters
    batched = inspect.signature(JackInBoxVectorEnv).parameters
    for name, parameter in single.items():
        assert batched[name].default == parameter.default, name
    assert isinstance(gym.make_vec("JackInBox-v0", num_envs=2).unwrapped, JackInBoxVectorEnv)


@pytest.mark.parametrize("patience", [3.0, 30.0])
def test_long_work_that_pauses_comes_to_the_same(patience: float, monkeypatch: pytest.MonkeyPatch) -> None:
    strikes = np.tile([0.0, 0, 0, 0, -4.9, 0, 0, 0, 0, 0, -10, 0], (32, 1))
    strikes[0] = lying()  # work after which the call pauses; then the log is full of strikes

    def run() -> list[Any]:
        env = started(
            JackInBoxVectorEnv(200, contact="exact", max_episode_steps=30, num_threads=1, with_infos=True), seed=0
        )
        torques = np.random.default_rng(0).uniform(-9e4, 9e4, (3, 100))
        lin = jackbox_env.linearize({"restitution": 0.5}, strikes, np.zeros((32, 50)), 0.02)
        return [
            play(env, 70, 0), jackbox_env.rollout({}, np.zeros(12), torques, 0.02, energy=True), lin.A, lin.trajectories
        ]  # fmt: skip

    straight = run()
    monkeypatch.setattr(loop, "PATIENCE", -1.0)  # after each row
    monkeypatch.setattr(rollouts, "PATIENCE", patience)
    monkeypatch.setattr(rollouts, "_ROOM", 1)
    assert_same(run(), straight)
