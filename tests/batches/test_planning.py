"""Rollouts: the same bits as stepping, from any number of threads, and refusals."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import Chirp, Drive, JackInBoxEnv, Rollout, Scene, Task, make_simulator, rollout
from jackbox_env.mechanics import energy
from tests.states import inside

SCENES = [
    Scene(),
    Scene(gravity=0.0, jack_arm=5.0, drive=None),
    Scene(jack_arm=6.5, drive=Chirp(rate=0.0)),
    Scene(drive=Drive(torque=lambda t: 1e9, force_x=lambda t: 2e4 * math.sin(5.0 * t))),
]


def cases(scene: Scene, count: int, steps: int) -> tuple[Any, Any]:
    rng = np.random.default_rng(1)
    states = []
    for _ in range(count):
        state = inside(scene, rng)
        if scene.jack_arm > 6.0:
            state[3:6] = [*state[0:2], state[2] + math.pi / 4.0]
        states.append(state)
    return np.array(states), rng.uniform(-9e4, 9e4, (count, steps))


@pytest.mark.parametrize("scene", SCENES, ids=["default", "weightless", "long arm", "side force"])
def test_a_rollout_is_stepping_bit_for_bit(scene: Scene) -> None:
    states, torques = cases(scene, 5, 60)
    found = rollout(scene, states, torques, 0.02, time=3.0, energy=True, impacts=True)
    assert isinstance(found, Rollout)
    assert found.impacts is not None
    assert found.impulse is not None
    assert found.energy is not None
    assert found.trajectories.shape == (5, 61, 12)
    simulator = make_simulator(scene, contact="exact")
    for number in range(5):
        simulator.reset(states[number], time=3.0)
        np.testing.assert_array_equal(found.trajectories[number, 0], states[number])
        for step in range(60):
            simulator.step(0.02, torques[number, step])
            np.testing.assert_array_equal(found.trajectories[number, step + 1], simulator.state)
            assert found.impacts[number, step] == len(simulator.impacts)
            assert found.impulse[number, step] == sum(hit.impulse for hit in simulator.impacts)
            assert found.energy[number, step + 1] == energy(scene, simulator.state)
    assert found.impacts.sum() > 10


def test_threads_change_nothing() -> None:
    states, torques = cases(Scene(), 101, 100)
    one = rollout(Scene(), states, torques, 0.02, num_threads=1)
    for threads in (2, 3, None):
        np.testing.assert_array_equal(rollout(Scene(), states, torques, 0.02, num_threads=threads), one)


def test_one_state_or_one_sequence_serves_all() -> None:
    states, torques = cases(Scene(), 4, 10)
    fan = rollout(None, states[0], torques, 0.02)
    assert fan.shape == (4, 11, 12)
    np.testing.assert_array_equal(fan[2], rollout({}, states[:1], torques[2:3], 0.02)[0])
    np.testing.assert_array_equal(
        rollout(None, states, torques[0], 0.02)[3, 5], rollout(None, states[3], torques[0], 0.02)[0, 5]
    )
    assert rollout(None, states, np.zeros((4, 0)), 0.02).shape == (4, 1, 12)
    assert rollout(None, np.zeros((0, 12)), np.zeros((0, 7)), 0.02).shape == (0, 8, 12)


def test_the_inputs_are_left_alone() -> None:
    states, torques = cases(Scene(), 4, 10)
    kept = states.copy(), torques.copy()
    rollout(Scene(), states, torques, 0.02)[:] = 0.0
    np.testing.assert_array_equal(states, kept[0])
    np.testing.assert_array_equal(torques, kept[1])


BAD = np.zeros((2, 12))
BAD[1, 3] = 7.5


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"states": np.zeros((2, 11))}, r"states must have shape \(N, 12\) or \(12,\), got \(2, 11\)"),
        ({"states": np.full((2, 12), math.nan)}, r"states\[0\]: state must be finite, got x_box = nan"),
        ({"states": np.full((2, 12), 1e200)}, r"states\[0\]: state must be within"),
        ({"states": BAD}, r"states\[1\]: state must have every foot at most 1 m outside, got 2.5 m"),
        ({"states": "here"}, "states must hold numbers, got 'here'"),
        ({"states": [[1.0], [2.0, 3.0]]}, "states must hold numbers"),
        ({"torques": np.zeros((3, 5))}, "states and torques must be as many, got 2 and 3"),
        ({"torques": np.zeros((2, 5, 1))}, r"torques must have shape \(N, H\) or \(H,\), got \(2, 5, 1\)"),
        ({"torques": [[0.0, math.inf]] * 2}, "torques must be finite, got inf"),
        ({"torques": [[None]] * 2}, "torques must hold numbers"),
        ({"dt": 0.0}, "dt must be a finite number above 0, got 0.0"),
        ({"dt": math.nan}, "dt must be a finite number above 0, got nan"),
        ({"time": math.inf}, "time must be a finite number at least"),
        ({"time": 1e9}, "dt must move the time and end by 1e[+]09 s"),
        ({"num_threads": 0}, "num_threads must be a whole number >= 1, got 0"),
        ({"scene": "box"}, "scene must be a Scene"),
        ({"rewards": "climb"}, "rewards must be one of 'juggle', 'spin', 'rattle', got 'climb'"),
        ({"repeat": 0}, "repeat must be a whole number from 1 to 1000000, got 0"),
        ({"trajectories": 1.5}, "trajectories must be True or False, got 1.5"),
    ],
)
def test_unusable_values_are_refused_in_one_sentence(given: dict[str, Any], sentence: str) -> None:
    usual = {"scene": Scene(), "states": np.zeros((2, 12)), "torques": np.zeros((2, 5)), "dt": 0.02}
    with pytest.raises((TypeError, ValueError), match=sentence):
        rollout(**{**usual, **given})


def test_a_jack_too_fast_is_named() -> None:
    states = np.zeros((3, 12))
    states[2, 9] = 1e90
    with pytest.raises(
        RuntimeError,
        match=r"the jack of states\[2\] (moves too fast|needs more than 1,000,000 gap)",
    ):
        rollout(Scene(), states, np.zeros((3, 5)), 0.02)


def lifted(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, float]:
    return state[4] - state[1], impulse + 1e-4 * torque


@pytest.mark.parametrize("task", ["juggle", "rattle", Task(("height", "effort"), lifted)])
def test_rewards_are_those_of_the_environment(task: str | Task) -> None:
    scenes = [Scene(jack_mass=2.0 + number, gravity=5.0) for number in range(4)]
    states, _ = cases(scenes[0], 4, 30)
    shares = np.random.default_rng(2).integers(-64, 65, (4, 30)) / 64.0
    torques = shares * scenes[0].torque_limit
    found = rollout(scenes, states, torques, 0.02, rewards=task, repeat=2)
    assert found.rewards is not None
    assert found.rewards.shape == (4, 60)
    for number, scene in enumerate(scenes):
        env = JackInBoxEnv(contact="exact", scene=scene, task=task)
        env.reset(options={"state": states[number]})
        for step in range(60):
            _, reward, _, _, info = env.step(shares[number, step // 2])
            assert found.rewards[number, step] == reward
            np.testing.assert_array_equal(found.trajectories[number, step + 1], info["state"])
    assert np.ptp(found.rewards) > 0.05


def low(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
    if state[4] < -0.5:
        raise ValueError("the jack is too low")
    return (1.0,)


@pytest.mark.parametrize("threads", [1, 2])
def test_an_error_in_a_task_of_ones_own_comes_back(threads: int) -> None:
    states, torques = cases(Scene(), 300, 60)
    with pytest.raises(ValueError, match="the jack is too low"):
        rollout(Scene(), states, torques, 0.02, rewards=Task(("one",), low), num_threads=threads)


@pytest.mark.parametrize("steps", [0, 1, 2, 7])
def test_first_and_last_states_are_those_of_the_trajectories(steps: int) -> None:
    states, torques = cases(Scene(), 5, steps)
    whole = rollout(Scene(), states, np.repeat(torques, 3, axis=1), 0.02, rewards="juggle", impacts=True)
    ends = rollout(Scene(), states, torques, 0.02, repeat=3, rewards="juggle", impacts=True, trajectories=False)
    assert ends.trajectories.shape == (5, 2, 12)
    np.testing.assert_array_equal(ends.trajectories, whole.trajectories[:, [0, -1]])
    assert ends.rewards is not None
    np.testing.assert_array_equal(ends.rewards, whole.rewards)
    np.testing.assert_array_equal(ends.impulse, whole.impulse)
    only = rollout(Scene(), states, torques, 0.02, repeat=3, trajectories=False)
    assert isinstance(only, Rollout)
    assert only.rewards is None
    assert only.impacts is None
    np.testing.assert_array_equal(only.trajectories, ends.trajectories)
