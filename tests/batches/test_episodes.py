"""Vector environments: episodes, restarts, restored states."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

import jackbox_env
from jackbox_env import Drive, JackInBoxVectorEnv, Scene, Task, TaskError
from jackbox_env.env import JackInBoxEnv
from jackbox_env.exact import run as loop
from jackbox_env.planning import rollouts
from tests.batches.several import EVERY_MODEL, EVERY_SIZE, assert_same, play


@EVERY_MODEL
def test_without_autoreset_episodes_that_are_over_are_not_stepped(contact: str) -> None:
    env = JackInBoxVectorEnv(2, contact=contact, max_episode_steps=1, autoreset_mode=AutoresetMode.DISABLED)
    env.reset(seed=0)
    env.step(None)
    env.reset(options={"reset_mask": np.array([False, True])})
    with pytest.raises(RuntimeError, match="autoreset_mode DISABLED.* 1 of 2 are over"):
        env.step(None)


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


def test_long_work_that_pauses_comes_to_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    def run() -> list[Any]:
        env = JackInBoxVectorEnv(200, contact="exact", max_episode_steps=30, num_threads=1, with_infos=True)
        env.reset(seed=0)
        torques = np.random.default_rng(0).uniform(-9e4, 9e4, (3, 100))
        return [play(env, 70, 0), jackbox_env.rollout({}, np.zeros(12), torques, 0.02, energy=True)]

    straight = run()
    monkeypatch.setattr(loop, "PATIENCE", -1.0)
    monkeypatch.setattr(rollouts, "PATIENCE", 3.0)
    assert_same(run(), straight)


def test_after_a_refused_step_impacts_are_none_and_no_error() -> None:
    env = JackInBoxVectorEnv(300, contact="exact")
    env.reset(seed=0)
    env.step(np.ones(300))
    actions = np.full(300, np.nan)
    actions[:290] = 1.0
    with pytest.raises(ValueError, match="290"):
        env.step(actions)
    assert [env.impacts(number) for number in (0, 299)] == [[], []]


def test_a_rollout_without_steps_has_the_energies_of_the_first_states() -> None:
    state = np.arange(12) / 100.0
    for steps in (0, 1):
        rollouts: Any = jackbox_env.rollout({}, [state] * 3, np.zeros((3, steps)), 0.02, energy=True)
        np.testing.assert_array_equal(rollouts.energy[:, 0], [jackbox_env.mechanics.energy(Scene(), state)] * 3)


@pytest.mark.parametrize(
    ("paid", "error"),
    [
        (lambda scene, state, torque, impulse: (1.0 if state.y_jack > -0.5 else math.nan,), TaskError),
        (lambda scene, state, torque, impulse: (1.0 / max(state.y_jack + 0.5, 0.0),), ZeroDivisionError),
    ],
)
def test_a_rollout_raises_the_same_error_however_many_threads_play_it(paid: Any, error: type[Exception]) -> None:
    states, messages = np.zeros((100, 12)), set[str]()
    states[:, 10] = np.linspace(3.0, 0.0, 100)
    for num_threads in (1, 2, 3):
        with pytest.raises(error) as raised:
            jackbox_env.rollout({}, states, np.zeros(80), 0.02, rewards=Task(("paid",), paid), num_threads=num_threads)
        messages.add(str(raised.value))
    assert len(messages) == 1
