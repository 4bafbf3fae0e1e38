"""Vector environments: episodes, restarts, restored states."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import jackbox_env
from jackbox_env import Drive, JackInBoxVectorEnv, Scene, planning
from jackbox_env.batches import exact
from jackbox_env.compiled.compiler import compiled_with
from jackbox_env.env import JackInBoxEnv
from tests.batches.several import EVERY_MODEL, EVERY_SIZE, actions_at, assert_same


@EVERY_SIZE
def test_next_step_autoreset_in_exact_arrays(contact: str, count: int) -> None:
    env = JackInBoxVectorEnv(count, contact=contact, max_episode_steps=3)
    first, _ = env.reset(seed=0)
    env.reset(options={"reset_mask": np.arange(count) == count - 1})  # a second draw for the last environment
    zeros = np.zeros((count, 1))
    for _ in range(2):
        _, _, _, truncations, _ = env.step(zeros)
        assert not truncations.any()
    last, rewards, terminations, truncations, infos = env.step(zeros)
    assert truncations.all()
    assert not terminations.any()
    assert (rewards > 0.0).all()
    assert infos == {}
    np.testing.assert_array_equal(last, env.observations)
    started, rewards, _, truncations, _ = env.step(np.ones((count, 1)))  # the action is ignored
    assert not truncations.any()
    assert not rewards.any()
    assert not env.times.any()
    assert not np.array_equal(started, first)
    assert env.states[:, [0, 1, 2, *range(6, 12)]].any() == np.False_
    _, rewards, _, _, _ = env.step(zeros)
    assert (rewards > 0.0).all()


@EVERY_SIZE
def test_same_step_autoreset_in_exact_arrays(contact: str, count: int) -> None:
    env = JackInBoxVectorEnv(count, contact=contact, max_episode_steps=2, autoreset_mode="SAME_STEP", with_infos=True)
    twin = JackInBoxVectorEnv(count, contact=contact, max_episode_steps=100)
    env.reset(seed=0)
    twin.reset(seed=0)
    zeros = np.zeros((count, 1))
    env.step(zeros)
    twin.step(zeros)
    started, rewards, _, truncations, infos = env.step(zeros)
    last, expected, _, _, _ = twin.step(zeros)
    assert truncations.all()
    np.testing.assert_array_equal(rewards, expected)
    np.testing.assert_array_equal(np.stack(infos["final_obs"]), last)
    assert infos["_final_obs"].all()
    np.testing.assert_array_equal(infos["final_info"]["state"], twin.states)
    assert not env.times.any()
    np.testing.assert_array_equal(started, env.observations)
    np.testing.assert_array_equal(infos["state"], env.states)
    assert not np.array_equal(started, last)


@EVERY_MODEL
def test_without_autoreset_the_caller_restarts(contact: str) -> None:
    env = JackInBoxVectorEnv(2, contact=contact, max_episode_steps=2, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    env.step(None)
    env.reset(options={"reset_mask": np.array([False, True])})
    _, _, _, truncations, _ = env.step(None)
    assert truncations.tolist() == [True, False]
    with pytest.raises(RuntimeError, match="with autoreset_mode DISABLED, reset the episodes .* 1 of 2 are over"):
        env.step(None)
    env.reset(options={"reset_mask": truncations})
    env.step(None)
    assert env.times.tolist() == [0.02, 0.04]


@EVERY_MODEL
def test_starts_can_be_given(contact: str) -> None:
    env = JackInBoxVectorEnv(3, contact=contact, with_infos=True)
    given = np.zeros((3, 12))
    given[:, 3], given[:, 11] = [0.1, 0.2, 0.3], 2.0
    _, infos = env.reset(seed=0, options={"state": given, "time": [1.0, 2.0, 3.0]})
    np.testing.assert_array_equal(env.states, given)
    np.testing.assert_array_equal(infos["state"], given)
    assert infos["time"].tolist() == env.times.tolist() == [1.0, 2.0, 3.0]
    env.step(None)
    env.reset(options={"state": given[1], "time": 0.5, "reset_mask": np.array([True, False, False])})
    np.testing.assert_array_equal(env.states[0], given[1])
    assert env.times.tolist() == [0.5, 2.02, 3.02]
    # A given start draws nothing: the next drawn one is the first of the seed.
    drawn = JackInBoxVectorEnv(3, contact=contact)
    drawn.reset(seed=0)
    env.reset()
    np.testing.assert_array_equal(env.states, drawn.states)


@EVERY_SIZE
def test_set_states_goes_on_bit_for_bit(contact: str, count: int) -> None:
    env = JackInBoxVectorEnv(count, contact=contact, scene={"jack_arm": 5.0})
    env.reset(seed=2)
    for step in range(50):
        env.step(actions_at(step, count))
    states, times = env.states, env.times
    path = [env.step(actions_at(step, count))[0] for step in range(50, 70)]
    env.set_states(states, times)
    np.testing.assert_array_equal([env.step(actions_at(step, count))[0] for step in range(50, 70)], path)
    only = np.arange(count) == count // 2
    kept = env.states
    env.set_states(states, times, only)
    np.testing.assert_array_equal(env.states[only], states[only])
    np.testing.assert_array_equal(env.states[~only], kept[~only])


def test_angles_too_large_to_be_reduced_together_are_seen_alike() -> None:
    env = JackInBoxVectorEnv(70, contact="exact")  # more than a block of them
    env.reset(seed=0)
    states = env.states
    states[3, 2], states[68, 5] = 3e6, -1e8
    env.set_states(states, 0.0)
    seen = env.step(None)[0]
    single = gym.make("JackInBox-v0", contact="exact")
    single.reset()
    for number in (0, 3, 4, 67, 68, 69):
        single.unwrapped.set_state(states[number])  # type: ignore[attr-defined]
        np.testing.assert_array_equal(seen[number], single.step(None)[0])
        cosine, sine = seen[number][4:6].astype(float)
        assert cosine**2 + sine**2 == pytest.approx(1.0, abs=1e-6)


def test_an_episode_that_waits_does_not_ask_its_drive() -> None:
    def recorded(time: float) -> float:
        if time > 0.1 + 1e-9:
            raise ValueError("beyond the data")
        return 1e4

    env = JackInBoxVectorEnv(2, contact="exact", scene=Scene(drive=Drive(torque=recorded)), max_episode_steps=5)
    env.reset(seed=0)
    for _ in range(13):
        env.step(None)
    single = JackInBoxEnv(contact="exact", scene=env.scene, control_dt=0.2)
    with pytest.raises(ValueError, match="beyond the data"):
        single.step(None)


@pytest.mark.slow
def test_long_work_that_pauses_comes_to_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> list[Any]:
        env = JackInBoxVectorEnv(200, contact="exact", max_episode_steps=30, num_threads=1, with_infos=True)
        env.reset(seed=0)
        return [env.step(actions_at(step, 200)) for step in range(70)]

    straight = run()
    monkeypatch.setattr(exact, "compiled", lambda function: compiled_with(function, PATIENCE=-1))
    for found, expected in zip(run(), straight, strict=True):
        assert_same(found, expected)
    monkeypatch.setattr(planning, "compiled", lambda function: compiled_with(function, PATIENCE=3))
    torques = np.random.default_rng(0).uniform(-9e4, 9e4, (3, 100))
    paused = jackbox_env.rollout({}, np.zeros(12), torques, 0.02, energy=True)
    monkeypatch.undo()
    assert_same(paused, jackbox_env.rollout({}, np.zeros(12), torques, 0.02, energy=True))


@EVERY_SIZE
def test_a_state_put_back_after_the_end_starts_an_episode_there(contact: str, count: int) -> None:
    env = JackInBoxVectorEnv(count, contact=contact, max_episode_steps=3)
    env.reset(seed=0)
    states, times = env.states, env.times
    path = [env.step(None)[0] for _ in range(3)]
    env.set_states(states, times)
    for step in range(3):
        seen, rewards, _, truncations, _ = env.step(None)
        np.testing.assert_array_equal(seen, path[step])
        assert (rewards > 0.0).all()
        assert truncations.all() == (step == 2)
