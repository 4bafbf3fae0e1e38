"""Vector environments: what they refuse. A refused call changes nothing."""

from __future__ import annotations

import math
import subprocess
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import jackbox_env
from jackbox_env import JackInBoxVectorEnv
from tests.batches.several import EVERY_MODEL


def generators_of(env: JackInBoxVectorEnv) -> Any:
    env._batch.held.settle()
    return env._batch.held.generators.copy()


@pytest.mark.parametrize(
    ("settings", "sentence"),
    [
        ({"num_envs": 0}, "num_envs must be a whole number from 1 to 1000000000, got 0"),
        ({"num_envs": 10**30}, "num_envs must be a whole number from 1 to 1000000000, got 1000"),
        (
            {"max_episode_steps": 10**400},
            "max_episode_steps must be a whole number from 1 to 1000000000000000, got 1000",
        ),
        ({"num_envs": 2.0}, "num_envs must be a whole number from 1 to 1000000000, got 2.0"),
        ({"max_episode_steps": 0}, "max_episode_steps must be a whole number from 1 to .*, got 0"),
        ({"num_threads": 0}, "num_threads must be a whole number >= 1, got 0"),
        (
            {"autoreset_mode": "LATER"},
            "autoreset_mode must be one of 'NEXT_STEP', 'SAME_STEP', 'DISABLED', got 'LATER'",
        ),
        ({"autoreset_mode": None}, "autoreset_mode must be one of .* got None"),
        ({"render_mode": "human"}, "render_mode must be None or \"rgb_array\" for several environments, got 'human'"),
        ({"render_mode": "ansi"}, "render_mode must be one of 'human', 'rgb_array', got 'ansi'"),
        ({"with_infos": "yes"}, "with_infos must be True or False, got 'yes'"),
        ({"substeps": 4}, "contact='exact' has no substeps or iterations, got substeps=4"),
        ({"task": "fly"}, "task must be one of"),
        ({"control_dt": 0.0}, "control_dt must be a finite number above 0"),
        ({"contact": "box2d"}, "contact must be one of 'pymunk', 'exact', got 'box2d'"),
    ],
)
def test_unusable_arguments_are_refused_in_one_sentence(settings: dict[str, Any], sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        JackInBoxVectorEnv(**{"num_envs": 2, "contact": "exact", **settings})


NAN_AT_ONE = np.array([[0.0], [math.nan]])


@EVERY_MODEL
@pytest.mark.parametrize(
    ("actions", "sentence"),
    [
        (NAN_AT_ONE, "action must be a finite number .* got nan for environment 1"),
        (np.array([[math.inf], [0.0]]), "action must be a finite number .* got inf for environment 0"),
        (np.zeros((3, 1)), r"actions must have shape \(2, 1\) or \(2,\), got shape \(3, 1\)"),
        (np.zeros((2, 2)), r"actions must have shape \(2, 1\) or \(2,\), got shape \(2, 2\)"),
        (0.5, r"actions must have shape \(2, 1\) or \(2,\), got shape \(\)"),
        ("left", "actions must hold numbers"),
        ([[0.0], [0.0, 1.0]], "actions must hold numbers"),
        ([[None], [0.0]], "actions must hold numbers"),
    ],
)
def test_unusable_actions_leave_all_environments_as_they_were(contact: str, actions: Any, sentence: str) -> None:
    env = JackInBoxVectorEnv(2, contact=contact)
    env.reset(seed=0)
    env.step(None)
    states, times = env.states, env.times
    with pytest.raises((TypeError, ValueError), match=sentence):
        env.step(actions)
    np.testing.assert_array_equal(env.states, states)
    np.testing.assert_array_equal(env.times, times)
    env.step([[1], [-1]])


@EVERY_MODEL
def test_an_unusable_action_is_ignored_only_where_an_episode_waits(contact: str) -> None:
    env = JackInBoxVectorEnv(2, contact=contact, max_episode_steps=2)
    env.reset(seed=0)
    env.step(None)
    env.reset(options={"reset_mask": np.array([False, True])})
    _, _, _, truncations, _ = env.step(None)
    assert truncations.tolist() == [True, False]  # environment 0 waits
    states = env.states
    with pytest.raises(ValueError, match="action must be a finite number .* got nan for environment 1"):
        env.step(np.full((2, 1), math.nan))
    np.testing.assert_array_equal(env.states, states)
    env.step(np.array([[math.nan], [0.5]]))
    assert env.times.tolist() == [0.0, 0.04]


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"seed": -1}, "seed must be a whole number >= 0, got -1"),
        ({"seed": 1.5}, "seed must be a whole number >= 0, got 1.5"),
        ({"seed": b"ab"}, "seed must be a whole number >= 0, got b'ab'"),
        ({"seed": "ab"}, "seed must be a whole number >= 0, got 'ab'"),
        ({"seed": [1]}, "seed must be a whole number or a list of 2, got 1 of them"),
        ({"seed": [1, "2"]}, "seed must be a whole number >= 0, got '2'"),
        ({"options": {"speed": 1}}, "options takes only 'state', 'time', 'scene', 'reset_mask', got 'speed'"),
        ({"options": [1]}, "options must be a dict"),
        (
            {"options": {"state": np.zeros(11)}},
            r"options\['state'\] must have shape \(12,\) or \(2, 12\), got shape \(11,\)",
        ),
        (
            {"options": {"state": [[0.0] * 12, [0.0, 0.0, 0.0, 9.0, *[0.0] * 8]]}},
            r"options\['state'\]\[1\]: a start must have every foot inside",
        ),
        ({"options": {"time": math.nan}}, r"options\['time'\] must be a finite number"),
        ({"options": {"time": [[1.0], [1.0, 2.0]]}}, r"options\['time'\] must hold numbers, got"),
        ({"options": {"reset_mask": [[True], []]}}, r"options\['reset_mask'\] must be an array of bool, got"),
        ({"options": {"time": [1.0]}}, r"options\['time'\] must be a number or have shape \(2,\)"),
        ({"options": {"reset_mask": [1, 0]}}, r"options\['reset_mask'\] must be an array of bool"),
        ({"options": {"reset_mask": np.zeros(2, bool)}}, r"options\['reset_mask'\] must choose at least one"),
        ({"options": {"reset_mask": np.ones(3, bool)}}, r"options\['reset_mask'\] must have shape \(2,\), got \(3,\)"),
    ],
)
def test_unusable_resets_leave_all_environments_as_they_were(given: dict[str, Any], sentence: str) -> None:
    env = JackInBoxVectorEnv(2, contact="exact")
    env.reset(seed=0)
    env.step(None)
    states, words = env.states, generators_of(env)
    with pytest.raises((TypeError, ValueError), match=sentence):
        env.reset(**given)
    np.testing.assert_array_equal(env.states, states)
    np.testing.assert_array_equal(generators_of(env), words)


@EVERY_MODEL
def test_episodes_without_a_limit(contact: str) -> None:
    env = gym.make_vec("JackInBox-v0", num_envs=2, contact=contact, max_episode_steps=-1)
    env.reset(seed=np.array(5))  # type: ignore[arg-type]
    for _ in range(520):
        truncations = env.step(None)[3]
        assert not truncations.any()


def test_a_step_needs_a_reset() -> None:
    env = JackInBoxVectorEnv(2, contact="exact")
    with pytest.raises(RuntimeError, match="step must come after a reset of all environments, got none yet"):
        env.step(None)
    env.reset(options={"reset_mask": np.array([True, False])})
    with pytest.raises(RuntimeError, match="step must come after a reset of all environments"):
        env.step(None)


@EVERY_MODEL
def test_a_jack_that_can_not_be_followed_leaves_all_environments_as_they_were(contact: str) -> None:
    env = JackInBoxVectorEnv(3, contact=contact)
    env.reset(seed=0)
    env.step(None)
    states, times = env.states, env.times
    states[2, 9] = 1e90
    env.set_states(states, times)
    with pytest.raises(RuntimeError, match="moves too fast|more than 1,000,000 gap|would leave the box"):
        env.step(None)
    np.testing.assert_array_equal(env.states, states)
    np.testing.assert_array_equal(env.times, times)
    states[2, 9] = 0.0
    env.set_states(states, times)
    env.step(None)


def test_torque_that_would_overflow_is_refused_for_many_in_mid_air() -> None:
    env = JackInBoxVectorEnv(3, contact="exact", scene={"torque_limit": 1e60, "box_inertia": 1e-60, "drive": None})
    env.reset(seed=0)
    states = env.states
    with pytest.raises(RuntimeError, match="the jack of environment 1 moves too fast to be followed"):
        env.step([0.0, 1.0, 0.0])
    np.testing.assert_array_equal(env.states, states)
    env.step([0.0, 0.0, 0.0])


def test_times_run_out_for_each_environment() -> None:
    env = JackInBoxVectorEnv(2, contact="exact", scene={"drive": None})
    env.reset(options={"time": [0.0, 1e9]})
    with pytest.raises(ValueError, match="dt must move the time and end by 1e[+]09 s, got 0.02 at t = 1e[+]09 s"):
        env.step(None)


def test_nothing_is_left_out_of_the_public_names() -> None:
    assert jackbox_env.JackInBoxVectorEnv is JackInBoxVectorEnv


@EVERY_MODEL
def test_more_environments_than_there_is_room_for_are_refused_at_once(contact: str) -> None:
    # A child process with little address space stands for a machine without free memory.
    code = (
        "import resource, jackbox_env, gymnasium\n"
        "resource.setrlimit(resource.RLIMIT_AS, (6 * 2**30, 6 * 2**30))\n"
        f"settings = {{'num_envs': 50_000_000, 'contact': {contact!r}}}\n"
        "try:\n    gymnasium.make_vec('JackInBox-v0', **settings)\n"
        "except MemoryError as error:\n    print(error)"
    )
    began = time.monotonic()
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=60)
    assert ran.stdout.startswith("Unable to allocate")
    assert time.monotonic() - began < 30.0


def test_options_of_one_time_none_and_scenes_without_names() -> None:
    envs = JackInBoxVectorEnv(2)
    plain, _ = envs.reset(seed=3)
    np.testing.assert_array_equal(envs.reset(seed=3, options={"time": None})[0], plain)
    for scene in ({1: 2}, [None, {1: 2}]):
        with pytest.raises(TypeError, match=r"options\['scene'\] must have names of fields as its keys, got 1"):
            envs.reset(options={"scene": scene})
    with pytest.raises(TypeError, match="randomize must have names of fields as its keys, got 1"):
        JackInBoxVectorEnv(2, randomize=lambda rng: {1: 2.0}).reset()  # type: ignore[dict-item]
