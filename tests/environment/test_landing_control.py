"""Landing control: its effect, the same in all wrappers, and its refusals."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_single
from stable_baselines3.common.env_checker import check_env

from jackbox_env import Drive, JackInBoxVectorEnv, LandingControl, LandingControlVector, Lookahead, Scene
from jackbox_env.landing import aim
from jackbox_env.planning.landing_control import Period
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.sb3_wrappers import LandingControlVecEnv
from jackbox_env.states import State
from tests.batches.several import EVERY_MODEL
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
@pytest.mark.parametrize(
    ("period", "task", "expected"),
    [
        (0.3, FALL, {(True, False), (False, True), (False, False)}),
        ("bounce", FALL, {(True, False), (False, True)}),
        ("bounce", "juggle", {(False, True), (False, False)}),
    ],
    ids=["period", "terminated", "bounce"],
)
def test_all_wrappers_do_the_same_and_end_with_the_episode(
    contact: str, period: Period, task: Any, expected: set[tuple[bool, bool]]
) -> None:
    made: dict[str, Any] = {
        "contact": contact, "task": task, "max_episode_steps": 75,
        "randomize": {"gravity": (5.0, 15.0), "box_half_width": (4.0, 8.0), "torque_limit": (1e4, 9e4)},
    }  # fmt: skip
    alone = single(period, **made)
    vector = LandingControlVector(JackInBoxVectorEnv(3, autoreset_mode="SAME_STEP", **made), period=period)
    stable = LandingControlVecEnv(make_sb3_vec_env(3, **made), period=period)
    stable.seed(4)
    np.testing.assert_array_equal(vector.reset(seed=4)[0], stable.reset())
    alone.reset(seed=4)
    rng, ends = np.random.default_rng(0), set()
    for _ in range(60):
        actions = rng.uniform(-1.3, 1.3, (3, 2)).astype(np.float32)
        seen, rewards, terminations, truncations, infos = vector.step(actions)
        seen_too, rewards_too, dones, rows = stable.step(actions)
        last, reward, terminated, truncated, info = alone.step(actions[0])
        np.testing.assert_array_equal(seen, seen_too)
        np.testing.assert_array_equal(rewards.astype(np.float32), rewards_too)
        assert (rewards[0], terminations[0], truncations[0]) == (reward, terminated, truncated)
        assert infos["duration"].tolist() == [row["duration"] for row in rows]
        assert infos["duration"][0] == info["duration"] > 0.0
        ends |= {(terminated, truncated)}
        if dones[0]:
            np.testing.assert_array_equal(rows[0]["terminal_observation"], last)
            np.testing.assert_array_equal(infos["final_obs"][0], last)
            last = alone.reset()[0]
        np.testing.assert_array_equal(seen[0], last)
    assert expected <= ends


@pytest.mark.parametrize("mode", ["NEXT_STEP", "DISABLED"])
def test_an_environment_that_restarts_makes_no_decision(mode: str) -> None:
    made: dict[str, Any] = {"contact": "exact", "task": FALL, "max_episode_steps": 60}
    alone = single("bounce", **made)
    vector = LandingControlVector(JackInBoxVectorEnv(5, autoreset_mode=mode, **made), period="bounce")
    vector.reset(seed=4)
    alone.reset(seed=4)
    rng, over, ends = np.random.default_rng(1), np.zeros(5, np.bool_), 0
    while ends < 8:
        if mode == "DISABLED" and over.any():
            vector.reset(options={"reset_mask": over})
            over = np.zeros(5, np.bool_)
        actions = rng.uniform(-1.0, 1.0, (5, 2))
        seen, rewards, terminations, truncations, infos = vector.step(actions)
        if over[0]:
            assert (rewards[0], infos["duration"][0]) == (0.0, 0.0)
            np.testing.assert_array_equal(seen[0], alone.reset()[0])
        else:
            last, reward, terminated, truncated, info = alone.step(actions[0])
            np.testing.assert_array_equal(seen[0], last)
            assert (rewards[0], terminations[0], truncations[0]) == (reward, terminated, truncated)
            assert infos["duration"][0] == info["duration"]
        over = terminations | truncations
        ends += bool(over[0])
        if mode == "DISABLED" and over[0]:
            alone.reset()


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


@pytest.mark.parametrize(("limit", "repeated"), [(60, 4), (500, 2)])
def test_a_drive_is_not_needed_after_the_last_step_of_a_decision(limit: int, repeated: int) -> None:
    made: dict[str, Any] = {"contact": "exact", "scene": Scene(drive=Drive(force_x=ends_early))}
    alone = single("bounce", max_episode_steps=limit, **made)
    inner = JackInBoxVectorEnv(3, limit, autoreset_mode="SAME_STEP", **made)
    vector = LandingControlVector(inner, period="bounce")
    vector.reset(seed=4)
    alone.reset(seed=4)
    for _ in range(repeated):
        before, times = inner.states, inner.times
        try:
            _, reward, *ends, _ = alone.step([0.1, 0.1])
        except ValueError as error:
            with pytest.raises(ValueError, match=str(error)):
                vector.step(np.full((3, 2), 0.1))
            np.testing.assert_array_equal(inner.states, before)
            np.testing.assert_array_equal(inner.times, times)
            assert limit == 500
            return
        _, rewards, *all_ends, _ = vector.step(np.full((3, 2), 0.1))
        assert (rewards[0], *(flags[0] for flags in all_ends)) == (reward, *ends)
        if any(ends):
            alone.reset()
    assert limit == 60


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
def test_it_is_an_environment_of_gymnasium_and_stable_baselines() -> None:
    env = single()
    check_env(env)
    check_single(env, skip_render_check=True)
    assert env.spec is not None
    again = gym.make(env.spec)
    np.testing.assert_array_equal(env.reset(seed=1)[0], again.reset(seed=1)[0])
    action = np.array([0.3, -0.2], dtype=np.float32)
    np.testing.assert_array_equal(env.step(action)[0], again.step(action)[0])
    assert env.get_wrapper_attr("time") == pytest.approx(0.4)


def test_unusable_actions_and_environments_are_refused() -> None:
    for refused, action in (("shape", [0.0]), ("finite", [0.0, math.nan]), ("numbers", None)):
        env = single()
        env.reset(seed=0)
        with pytest.raises((TypeError, ValueError), match=refused):
            env.step(action)
        assert env.get_wrapper_attr("time") == 0.0
    several = LandingControlVector(JackInBoxVectorEnv(4, contact="exact"))
    several.reset(seed=0)
    with pytest.raises(ValueError, match=r"actions must have shape \(4, 2\), got \(\)"):
        several.step(0.0)
    with pytest.raises(TypeError, match="period must be .*'landing'"):
        single("landing")  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="torque"):
        single(torque="chirp")
    with pytest.raises(ValueError, match="control_dt .* at least 2e-06, got 1e-19"):
        single("bounce", control_dt=1e-19)
    assert single("bounce", control_dt=2e-6).action_space.shape == (2,)
    with pytest.raises(TypeError, match="JackInBox-v0"):
        LandingControl(gym.make("CartPole-v1"))
    with pytest.raises(TypeError, match="JackInBox-v0"):
        LandingControlVector(gym.make_vec("CartPole-v1", 2))  # type: ignore[arg-type]
    with pytest.raises(ValueError, match="action wrapper"):
        LandingControl(gym.wrappers.RescaleAction(gym.make("JackInBox-v0"), np.float32(-2), np.float32(2)))
    for inside in (single(), Lookahead(gym.make("JackInBox-v0", contact="exact"), samples=8)):  # repeat actions
        with pytest.raises(ValueError, match=f"action wrapper inside, got {type(inside).__name__}"):
            LandingControl(inside)
