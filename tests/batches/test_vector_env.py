"""Vector environments: arguments, returned arrays, episodes, restarts, restored states."""

from __future__ import annotations

import copy
import inspect
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import jackbox_env
from jackbox_env import Drive, JackInBoxVectorEnv, Scene
from jackbox_env.envs.single import JackInBoxEnv
from jackbox_env.exact import run as loop
from jackbox_env.planning import rollouts
from tests.batches.several import EVERY_MODEL, EVERY_SIZE, actions_at, assert_same, play
from tests.states import lying


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


# -- episodes, restarts, restored states -------------------------------------------------------------------------------


@EVERY_MODEL
def test_reset_accepts_states_and_times(contact: str) -> None:
    env, drawn = JackInBoxVectorEnv(3, contact=contact, with_infos=True), JackInBoxVectorEnv(3, contact=contact)
    starts = np.zeros((3, 12))
    starts[:, 3], starts[:, 11] = [0.1, 0.2, 0.3], 2.0
    _, infos = env.reset(seed=0, options={"state": starts, "time": [1.0, 2.0, 3.0]})
    np.testing.assert_array_equal(env.states, starts)
    np.testing.assert_array_equal(infos["state"], starts)
    assert infos["time"].tolist() == env.times.tolist() == [1.0, 2.0, 3.0]
    env.step(None)
    env.reset(options={"state": starts[1], "time": 0.5, "reset_mask": np.array([True, False, False])})
    np.testing.assert_array_equal(env.states[0], starts[1])
    assert env.times.tolist() == [0.5, 2.02, 3.02]
    # A start from the options draws nothing: the next drawn one is the first of the seed.
    drawn.reset(seed=0)
    env.reset()
    np.testing.assert_array_equal(env.states, drawn.states)


@EVERY_SIZE
def test_a_state_put_back_after_the_end_starts_an_episode_there(contact: str, count: int) -> None:
    env = JackInBoxVectorEnv(count, contact=contact, max_episode_steps=3)
    env.reset(seed=0)
    states, times = env.states, env.times
    path = [env.step(None) for _ in range(3)]
    env.set_states(states, times)
    assert_same([env.step(None) for _ in range(3)], path)
    assert (path[0][1] > 0.0).all()
    assert path[2][3].all()


def test_an_episode_that_waits_does_not_evaluate_its_drive() -> None:
    def recorded(time: float) -> float:
        if time > 0.1 + 1e-9:
            raise ValueError("beyond the data")
        return 1e4

    env = JackInBoxVectorEnv(2, contact="exact", scene=Scene(drive=Drive(torque=recorded)), max_episode_steps=5)
    env.reset(seed=0)
    for _ in range(13):
        env.step(None)
    single = JackInBoxEnv(contact="exact", scene=env.scene, control_dt=0.2)
    single.reset(seed=0)
    with pytest.raises(ValueError, match="beyond the data"):
        single.step(None)


@pytest.mark.parametrize("patience", [3.0, 30.0])
def test_long_work_that_pauses_comes_to_the_same(patience: float, monkeypatch: pytest.MonkeyPatch) -> None:
    strikes = np.tile([0.0, 0, 0, 0, -4.9, 0, 0, 0, 0, 0, -10, 0], (32, 1))
    strikes[0] = lying()  # work after which the call pauses; then the log is full of strikes

    def run() -> list[Any]:
        env = JackInBoxVectorEnv(200, contact="exact", max_episode_steps=30, num_threads=1, with_infos=True)
        env.reset(seed=0)
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
