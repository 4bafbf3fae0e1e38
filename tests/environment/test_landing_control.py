"""Landing control: its effect, and the same in all wrappers."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from jackbox_env import Drive, JackInBoxVectorEnv, LandingControl, LandingControlVector, Scene
from jackbox_env.landing import aim
from jackbox_env.planning.landing_control import Period
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.sb3_wrappers import LandingControlVecEnv
from jackbox_env.states import State
from tests.batches.several import EVERY_MODEL, assert_alike, assert_same
from tests.batches.test_ends import FALL


def single(period: Period = 0.4, **made: Any) -> LandingControl:
    return LandingControl(gym.make("JackInBox-v0", **made), period=period)


@pytest.mark.parametrize("turns", [0, 3])
@pytest.mark.parametrize(("angle", "rate"), [(0.0, 0.0), (0.8, -0.4), (-0.6, 0.6)])
def test_the_box_strikes_the_falling_jack_as_the_action_sets(angle: float, rate: float, turns: int) -> None:
    env = single(0.02, contact="exact", scene={"gravity": 3.0, "torque_limit": 1e6})
    state = np.zeros(12)
    state[2], state[4] = turns * math.pi / 2.0, 2.0
    env.reset(options={"state": state})
    landing, time = math.sqrt(2.0 * 7.0 / 3.0), 0.0  # 7 m further down a foot would touch a level floor
    while landing - time > 0.03:
        _, _, _, _, info = env.step([angle, rate])
        time = info["time"]
        assert info["impacts"] == 0
    remaining, state = landing - time, info["state"]
    assert state[8] == pytest.approx(2.5 * rate, abs=0.1)
    assert state[2] + remaining * state[8] - turns * math.pi / 2.0 == pytest.approx(0.5 * angle, abs=0.01)


@EVERY_MODEL
@pytest.mark.parametrize("mode", list(AutoresetMode))
@pytest.mark.parametrize(("period", "task"), [(0.3, FALL), ("bounce", FALL), ("bounce", "juggle")])
def test_all_wrappers_do_the_same_and_end_with_the_episode(
    contact: str, mode: AutoresetMode, period: Period, task: Any
) -> None:
    made: dict[str, Any] = {
        "contact": contact, "task": task, "max_episode_steps": 75,
        "randomize": {"gravity": (5.0, 15.0), "box_half_width": (4.0, 8.0), "torque_limit": (1e4, 9e4)},
    }  # fmt: skip
    vector = LandingControlVector(JackInBoxVectorEnv(3, autoreset_mode=mode, **made), period=period)
    stable = LandingControlVecEnv(make_sb3_vec_env(3, **made), period=period) if mode.name == "SAME_STEP" else None
    actions = np.random.default_rng(0).uniform(-1.3, 1.3, (60, 3, 2)).astype(np.float32)
    ends = assert_alike(vector, [single(period, **made) for _ in range(3)], actions, stable)
    assert {(task == FALL, task != FALL), (False, True)} <= set(ends)
    assert ends[False, False] or (period, task) == ("bounce", FALL)


@pytest.mark.parametrize(
    ("action", "sentence"),
    [([0.0], r"actions must have shape \(2,\), got \(1,\)"), ([0.0, math.nan], "finite .* got nan"), (None, "numbers")],
)
def test_a_refused_action_changes_nothing(action: Any, sentence: str) -> None:
    env = single()
    env.reset(seed=0)
    with pytest.raises((TypeError, ValueError), match=sentence):
        env.step(action)
    assert env.get_wrapper_attr("time") == 0.0


@EVERY_MODEL
def test_a_decision_ends_with_the_next_impact(contact: str) -> None:
    env = single("bounce", contact=contact)
    env.reset(seed=2)
    inner: Any = env.unwrapped
    for _ in range(6):
        state, time = inner.state, inner.time
        after = env.step([0.3, -0.2])[4]
        steps = round(after["duration"] / 0.02)
        inner.set_state(state, time)
        struck = list[bool]()
        for _ in range(steps):
            share = aim(inner.scene, State(*inner.state.tolist()), 0.3 * 0.5, -0.2 * 2.5, 0.02)
            struck.append(inner.step(np.array([share]))[4]["impacts"] > 0)
        assert struck[-1] or steps == 100, struck
        assert steps > 1, struck
        assert not any(struck[1:-1]), struck  # a second foot may strike in the first step
        np.testing.assert_array_equal(inner.state, after["state"])


def test_decisions_last_while_a_foot_rests_without_impacts_and_in_long_steps() -> None:
    resting = single("bounce", contact="exact", scene={"restitution": 0.0, "torque_limit": 1e-3})
    start = np.zeros(12)
    start[4], start[5] = -5.0, 0.25 * math.pi
    resting.reset(options={"state": start})
    durations = [resting.step([0.0, 0.0])[4]["duration"] for _ in range(12)]
    assert durations[-5:] == pytest.approx([0.4] * 5), durations
    floating = single("bounce", contact="exact", scene={"gravity": 0.0})
    floating.reset(options={"state": np.zeros(12)})
    assert floating.step([1.0, 0.0])[4]["duration"] == pytest.approx(2.0)
    coarse = single("bounce", contact="exact", control_dt=2.5)
    coarse.reset(seed=0)
    assert coarse.step([0.0, 0.0])[4]["duration"] == pytest.approx(2.5)


def ends_early(time: float) -> float:
    return 1e3 * math.sqrt(1.3 - time)  # an error later


@pytest.mark.parametrize("limit", [60, 500])
def test_a_drive_is_not_needed_after_the_last_step_of_a_decision(limit: int) -> None:
    made: dict[str, Any] = {"contact": "exact", "scene": Scene(drive=Drive(force_x=ends_early))}
    inner = JackInBoxVectorEnv(3, limit, autoreset_mode="SAME_STEP", **made)
    vector, alone = LandingControlVector(inner, period="bounce"), single("bounce", max_episode_steps=limit, **made)
    assert_alike(vector, [alone], np.full((4 if limit == 60 else 1, 3, 2), 0.1))
    if limit == 500:  # the second decision needs it
        before = inner.states, inner.times
        for env, action in ((alone, [0.1, 0.1]), (vector, np.full((3, 2), 0.1))):
            with pytest.raises(ValueError, match="math domain error|expected a nonnegative input"):
                env.step(action)
        assert_same((inner.states, inner.times), before)
