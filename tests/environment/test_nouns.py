"""Observations, actions and how long they last: what they do, the same in every kind of environment."""

from __future__ import annotations

import math
import random
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from jackbox_env import Drive, JackInBoxEnv, Scene, State
from jackbox_env.model.action import Repeats
from jackbox_env.model.observation import observation_of, observe
from jackbox_env.simulators.agent_functions import observed
from tests.batches.alike import Alike
from tests.batches.drawn import SEEN
from tests.batches.several import EVERY_MODEL, SHAKEN, TURNED, assert_same
from tests.states import at, inside, started

LANDINGS: dict[str, Any] = {"action": "landing", "action_repeat": "bounce"}


def made(**settings: Any) -> gym.Env[Any, Any]:
    return gym.make("JackInBox-v0", **settings)


@EVERY_MODEL
@pytest.mark.parametrize("repeat", [4, "bounce"])
def test_a_decision_adds_up_its_control_steps(contact: str, repeat: Repeats) -> None:
    settings: dict[str, Any] = {"contact": contact, "task": "rattle", "scene": {"gravity": 30.0}}
    env: Any = started(JackInBoxEnv(action_repeat=repeat, **settings), seed=2)
    single: Any = started(JackInBoxEnv(**settings), seed=2)
    for share in (0.3, None, -0.8, None, 0.1, 0.9):
        last, reward, _, _, info = env.step(share)
        steps = round(info["duration"] / 0.02)
        parts = [(*single.step(share), single.impacts) for _ in range(steps)]
        struck = [bool(part[5]) for part in parts]
        assert steps == repeat or repeat == "bounce"
        assert repeat == 4 or any(struck[1:]) == struck[-1], struck  # a second foot may strike in the first step
        assert_same((last, info["state"], info["time"]), (parts[-1][0], parts[-1][4]["state"], parts[-1][4]["time"]))
        assert_same(env.impacts, [impact for part in parts for impact in part[5]])
        assert info["impacts"] == len(env.impacts)
        sums = {name: sum(part[4][name] for part in parts) for name in ("impulse", "reward_knock", "reward_effort")}
        assert {name: info[name] for name in sums} == pytest.approx(sums)
        assert info["torque"] == pytest.approx(sum(part[4]["torque"] for part in parts) / steps)
        assert reward == pytest.approx(sum(part[1] for part in parts))


# -- landings ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("turns", [0, 3])
@pytest.mark.parametrize(("angle", "rate"), [(0.0, 0.0), (0.8, -0.4), (-0.6, 0.6)])
def test_the_box_strikes_the_falling_jack_as_the_action_sets(angle: float, rate: float, turns: int) -> None:
    env = started(
        made(contact="exact", action="landing", scene={"gravity": 3.0, "torque_limit": 1e6}),
        options={"state": at(theta_box=turns * math.pi / 2.0, y_jack=2.0)},
    )
    landing, time = math.sqrt(2.0 * 7.0 / 3.0), 0.0  # 7 m further down a foot would touch a level floor
    while landing - time > 0.03:
        _, _, _, _, info = env.step([angle, rate])
        time = info["time"]
        assert info["impacts"] == 0
    remaining, state = landing - time, info["state"]
    assert state[8] == pytest.approx(2.5 * rate, abs=0.1)
    assert state[2] + remaining * state[8] - turns * math.pi / 2.0 == pytest.approx(0.5 * angle, abs=0.01)


def test_decisions_last_while_a_foot_rests_without_impacts_and_in_long_steps() -> None:
    resting: Any = started(
        JackInBoxEnv(contact="exact", scene={"restitution": 0.0, "torque_limit": 1e-3}, **LANDINGS),
        options={"state": at(y_jack=-5.0, theta_jack=0.25 * math.pi)},
    )
    durations = [resting.step([0.0, 0.0])[4]["duration"] for _ in range(12)]
    assert durations[-5:] == pytest.approx([0.4] * 5), durations
    floating: Any = started(
        JackInBoxEnv(contact="exact", scene={"gravity": 0.0}, **LANDINGS), options={"state": np.zeros(12)}
    )
    assert floating.step([1.0, 0.0])[4]["duration"] == pytest.approx(2.0)
    coarse: Any = started(JackInBoxEnv(contact="exact", control_dt=2.5, **LANDINGS), seed=0)
    assert coarse.step([0.0, 0.0])[4]["duration"] == pytest.approx(2.5)


def ends_early(time: float) -> float:
    return 1e3 * math.sqrt(1.3 - time)  # an error later


def test_a_drive_is_not_needed_after_the_last_step_of_a_decision() -> None:
    settings: dict[str, Any] = {"contact": "exact", "episode_steps": 500, **LANDINGS}
    alike = Alike(settings, [Scene(drive=Drive(force_x=ends_early))], 3, [0])
    alike.reset_some(np.ones(3, dtype=np.bool_), 4)
    alike.step(random.Random(0))
    with pytest.raises(ValueError, match="math domain error|expected a nonnegative input"):  # the second needs it
        alike.step(random.Random(0))


def test_observations_of_many_states_are_those_of_each_up_to_rounding() -> None:
    rng, scene = np.random.default_rng(1), Scene(box_half_width=3.0, gravity=3.7)
    states = np.array([inside(scene, rng) for _ in range(200)])
    states[100:, [2, 5]] *= 1e4
    for name in ("state", "landing", SEEN):
        one = np.array([observe(scene.numbers, State(*state), 0.5, observation_of(name)) for state in states])
        many = observed(scene, states, name, 0.5)
        np.testing.assert_allclose(many, one, atol=3e-7 if name != "landing" else 2e-6)
        low, high = observation_of(name).bounds
        assert ((many >= low) & (many <= high)).all()


def test_decisions_that_last_longer_than_drives_are_read_ahead_are_those_of_single_environments() -> None:
    drives = SHAKEN, Drive(force_y=lambda time: 3e4 * math.sin(4.0 * time)), TURNED
    settings: dict[str, Any] = {"contact": "exact", "action_repeat": 220}
    alike = Alike(settings, [Scene(drive=drive) for drive in drives], 3, range(3))
    alike.reset_some(np.ones(3, dtype=np.bool_), 4)
    for number in range(5):
        alike.step(random.Random(number))


# -- films ------------------------------------------------------------------------------------------------------------


def test_a_list_of_frames_has_all_control_steps_since_the_last_one() -> None:
    env = started(made(render_mode="rgb_array_list", action_repeat=5, render_size=(32, 32)), seed=0)
    assert env.metadata["render_fps"] == 50
    env.step(None)
    env.step(None)
    frames: Any = env.render()
    assert len(frames) == 11
    assert not np.array_equal(frames[0], frames[-1])
    assert env.render() == []
    assert made(render_mode="rgb_array", action_repeat=5).metadata["render_fps"] == 10
