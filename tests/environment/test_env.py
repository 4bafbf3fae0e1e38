"""The environment: spaces, checkers, stepping."""

from __future__ import annotations

import functools
import math
import os
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

from jackbox_env import Chirp, JackInBoxEnv, Scene, State, make_simulator
from jackbox_env.model.observation import BOUNDS, STATE, observe
from tests.states import started

make: Any = functools.partial(gym.make, "JackInBox-v0")


@pytest.mark.skipif("EXPECTED_GYMNASIUM" not in os.environ, reason="only where make test says which one")
def test_this_run_is_under_the_gymnasium_it_claims() -> None:
    assert gym.__version__ == os.environ["EXPECTED_GYMNASIUM"]


# -- spaces and checkers -----------------------------------------------------------------------------------------------


AIMED: dict[str, Any] = {"observation": "landing", "action": "landing", "action_repeat": "bounce", "contact": "exact"}


@pytest.mark.parametrize(
    "settings", [{}, {"task": "rattle", "torque": "chirp"}, AIMED, {"action": "discrete"}], ids=str
)
def test_the_checkers_of_gymnasium_and_stable_baselines3_pass_with_warnings_as_errors(settings: dict[str, Any]) -> None:
    stable = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make(**settings).unwrapped)
        stable.check_env(make(**settings), warn=True)


def test_the_spaces_are_the_documented_ones() -> None:
    env = make()
    assert env.observation_space == gym.spaces.Box(
        np.array([-1, -1, -10, -10, -1, -1, -10, -1, -1, -10], np.float32),
        np.array([1, 1, 10, 10, 1, 1, 10, 1, 1, 10], np.float32),
        dtype=np.float32,
    )
    assert env.action_space == gym.spaces.Box(-1.0, 1.0, (1,), np.float32)
    assert env.spec.max_episode_steps == 500
    assert env.spec.reward_threshold == 300.0
    assert make(control_dt=0.1).metadata["render_fps"] == 10
    assert make(control_dt=5.0).metadata["render_fps"] == 1
    assert make(render_size=[96, 64]).metadata["render_size"] == (96, 64)
    assert env.metadata["render_fps"] == 50


def test_an_observation_equals_the_documented_table() -> None:
    # Box at (1, 2) turned by 90 degrees, moving with (0.5, 0); jack 3 m above it, turned by 30 degrees further.
    state = [1.0, 2.0, math.pi / 2, 1.0, 5.0, math.pi / 2 + math.pi / 6, 0.5, 0.0, 1.5, 0.5, -2.0, -7.0]
    v0 = math.sqrt(2.0 * 9.81 * 6.0)
    expected = [3.0 / 6, 0, -2.0 / v0, 0, 0, 1, 1.5 * 6 / v0, math.cos(2 * math.pi / 3), math.sin(2 * math.pi / 3)]
    observation = observe(Scene().numbers, State(*state), 0.0, STATE)
    np.testing.assert_allclose(observation, [*expected, -7.0 / v0], atol=1e-6)
    assert observation.dtype == np.float32
    quarter_turn = [*state[:5], state[5] + math.pi / 2, *state[6:]]
    np.testing.assert_allclose(observe(Scene().numbers, State(*quarter_turn), 0.0, STATE), observation, atol=1e-6)


def test_observations_are_clipped_and_info_is_raw() -> None:
    env, state = make(), np.array([0.0] * 8 + [-400.0, 500.0, -500.0, 9000.0])
    observation, info = env.reset(options={"state": state})
    np.testing.assert_array_equal(observation[[2, 3, 6, 9]], [10.0, -10.0, -10.0, 10.0])
    assert observation in env.observation_space
    np.testing.assert_array_equal(info["state"], state)
    for row in 1e3 * np.random.default_rng(0).standard_normal((200, 12)):
        assert np.all(np.abs(observe(Scene().numbers, State(*row.tolist()), 0.0, STATE)) <= BOUNDS)


# -- stepping ----------------------------------------------------------------------------------------------------------


def test_none_is_the_chirp_and_an_action_is_the_agents_torque_instead() -> None:
    env = started(make(), options={"state": np.zeros(12), "time": 3.0})
    *_, info = env.step(np.array([0.25], dtype=np.float32))
    assert (info["torque"], info["time"]) == (22500.0, 3.02)
    assert info["state"][8] == pytest.approx(22500.0 / 14400.0 * 0.02)
    assert env.step(None)[4]["torque"] == pytest.approx(Chirp().torque(3.03), rel=1e-2)


@pytest.mark.parametrize(
    ("action", "torque"), [(0.5, 4.0), ((0.5,), 4.0), (np.array(0.5), 4.0), (2.0, 8.0), ([-1e30], -8.0), (1, 8.0)]
)
def test_an_action_is_a_share_of_the_torque_limit_and_is_clipped(action: Any, torque: float) -> None:
    env = JackInBoxEnv(scene={"torque_limit": 8.0})
    env.set_state(env.state)  # in place of a reset
    assert env.step(action)[4]["torque"] == torque


def test_the_environment_steps_what_the_simulator_steps() -> None:
    scene = Scene(box_half_width=3.0, jack_arm=0.5)
    env = make(scene=scene, control_dt=0.05, substeps=7)
    simulator = started(make_simulator(scene, substeps=7), env.reset(seed=1)[1]["state"])
    for action in np.random.default_rng(0).uniform(-1, 1, 100).astype(np.float32):
        info = env.step(np.array([action]))[4]
        expected = simulator.step(0.05, float(action) * 90000.0)
        assert (env.unwrapped.impacts, info["impacts"]) == (simulator.impacts, len(simulator.impacts))
        assert info["impulse"] == pytest.approx(sum(hit.impulse for hit in simulator.impacts))
    np.testing.assert_array_equal(info["state"], expected.state)


@pytest.mark.parametrize(
    ("task", "terms"), [("juggle", ["centre"]), ("spin", ["spin"]), ("rattle", ["knock", "effort"])]
)
def test_an_episode_of_500_steps_earns_the_sum_of_its_terms_and_has_the_same_info_keys_from_reset_on(
    task: str, terms: list[str]
) -> None:
    env, names = make(task=task), {f"reward_{name}" for name in terms}
    _, info = env.reset(seed=3)
    assert set(info) == {"state", "time", "torque", "impacts", "impulse", "duration"} | names
    assert (info["torque"], info["impacts"], info["impulse"], info["time"], info["duration"]) == (0.0, 0, 0.0, 0.0, 0.0)
    ends = []
    for _ in range(500):
        _, reward, terminated, truncated, later = env.step(None)
        ends.append((terminated, truncated))
        assert reward == pytest.approx(sum(later[name] for name in names))
    assert ends == [(False, False)] * 499 + [(False, True)]
    assert set(later) == set(info)
    assert not np.shares_memory(info["state"], later["state"])
