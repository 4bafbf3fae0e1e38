"""The vector environment against the single one, Gymnasium's autoreset modes in exact arrays, and refusals."""

from __future__ import annotations

import copy
import inspect
import math
import os
import pickle
import subprocess
import sys
import time
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

import jackbox_env
from jackbox_env import Drive, JackInBoxVectorEnv, Scene, planning
from jackbox_env.batches import exact
from jackbox_env.compiled.compiler import compiled_with
from jackbox_env.env import JackInBoxEnv

MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)
EVERY_MODEL = pytest.mark.parametrize("contact", ["exact", "pymunk"])
# One environment alone, of which a copy is easily none; two; more than two blocks.
SIZES = [("exact", 1), ("exact", 2), ("exact", 300), ("pymunk", 1), ("pymunk", 3)]
EVERY_SIZE = pytest.mark.parametrize(("contact", "count"), SIZES)


def actions_at(step: int, count: int) -> Any:
    return np.random.default_rng(step).uniform(-1.2, 1.2, (count, 1)).astype(np.float32)


def assert_same(found: Any, expected: Any, path: str = "") -> None:
    """Equal in kind and in every bit, dicts and arrays of arrays included."""
    if isinstance(expected, tuple):
        assert_same(dict(enumerate(found)), dict(enumerate(expected)), path)
    elif isinstance(expected, dict):
        assert set(found) == set(expected), path
        for name in expected:
            assert_same(found[name], expected[name], f"{path}/{name}")
    elif isinstance(expected, np.ndarray) and expected.dtype == object:
        for one, other in zip(found, expected, strict=True):
            assert_same(one, other, path)
    elif isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype, path
        np.testing.assert_array_equal(found, expected, err_msg=path)
    else:
        assert found == expected, path


# -- the same as single environments ----------------------------------------------------------------------------------


@EVERY_MODEL
@pytest.mark.parametrize("mode", MODES)
@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"task": "rattle", "scene": {"jack_arm": 5.0}, "control_dt": 0.05},
        {"task": "spin", "torque": "chirp"},
        {"scene": Scene(gravity=0.0, drive=Drive(force_x=lambda t: 3e4 * math.cos(3.0 * t))), "torque": "chirp"},
    ],
    ids=["default", "rattle", "spin by the chirp", "shaken"],
)
def test_all_it_says_is_what_single_environments_say(
    contact: str, mode: AutoresetMode, settings: dict[str, Any]
) -> None:
    count, given = 3, {"contact": contact, "max_episode_steps": 80, **settings}
    batched: Any = gym.make_vec("JackInBox-v0", num_envs=count, autoreset_mode=mode, with_infos=True, **given)
    single: Any = SyncVectorEnv([lambda: gym.make("JackInBox-v0", **given)] * count, autoreset_mode=mode)
    assert isinstance(batched.unwrapped, JackInBoxVectorEnv)
    assert batched.observation_space == single.observation_space
    assert batched.action_space == single.action_space
    assert_same(batched.reset(seed=11), single.reset(seed=11))
    impacts = 0
    for step in range(260):
        found, expected = batched.step(actions_at(step, count)), single.step(actions_at(step, count))
        assert_same(found, expected, f"step {step}")
        impacts += int(found[4]["impacts"].sum())
    assert impacts > 3
    assert_same(batched.reset(seed=[5, None, 7]), single.reset(seed=[5, None, 7]))
    mask = np.array([True, False, True])
    found, expected = (env.reset(options={"reset_mask": mask.copy()}) for env in (batched, single))
    assert_same(found, expected)
    for step in range(40):
        found, expected = batched.step(actions_at(step, count)), single.step(actions_at(step, count))
        assert_same(found, expected, f"after reset, step {step}")


def test_a_thousand_steps_of_64_environments_in_any_number_of_threads() -> None:
    def run(threads: int | None) -> list[Any]:
        env = JackInBoxVectorEnv(64, contact="exact", num_threads=threads, max_episode_steps=200)
        env.reset(seed=3)
        return [env.step(actions_at(step, 64))[:4] for step in range(1000)]

    one = run(1)
    for threads in (2, 3, 64, None):
        for found, expected in zip(run(threads), one, strict=True):
            for a, b in zip(found, expected, strict=True):
                np.testing.assert_array_equal(a, b)
    single = gym.make("JackInBox-v0", contact="exact", max_episode_steps=200)
    for number in (0, 17, 63):
        seen, _ = single.reset(seed=3 + number)
        over = False
        for step in range(1000):
            if over:
                seen, _ = single.reset()
                reward, over = 0.0, False
            else:
                seen, reward, _, over, _ = single.step(actions_at(step, 64)[number])  # type: ignore[assignment]
            np.testing.assert_array_equal(one[step][0][number], seen)
            assert (one[step][1][number], bool(one[step][3][number])) == (reward, over)


def test_the_same_arguments_mean_the_same_physics() -> None:
    single = inspect.signature(JackInBoxEnv).parameters
    batched = inspect.signature(JackInBoxVectorEnv).parameters
    for name, parameter in single.items():
        assert batched[name].default == parameter.default, name
    assert batched["max_episode_steps"].default == gym.spec("JackInBox-v0").max_episode_steps
    assert set(batched) - set(single) == {
        "num_envs", "max_episode_steps", "autoreset_mode", "num_threads", "with_infos"
    }  # fmt: skip


def test_make_vec_gives_it_by_default_and_takes_the_modes_by_name() -> None:
    env = gym.make_vec("JackInBox-v0", num_envs=2)
    assert isinstance(env.unwrapped, JackInBoxVectorEnv)
    assert env.metadata["autoreset_mode"] is AutoresetMode.NEXT_STEP
    named = gym.make_vec(
        "JackInBox-v0", num_envs=2, autoreset_mode="SAME_STEP", vectorization_mode="vector_entry_point"
    )
    assert named.metadata["autoreset_mode"] is AutoresetMode.SAME_STEP


@EVERY_MODEL
def test_none_lets_the_drive_act_and_actions_are_clipped(contact: str) -> None:
    driven, chirped = (JackInBoxVectorEnv(2, contact=contact, torque=torque) for torque in ("agent", "chirp"))
    for env in (driven, chirped):
        env.reset(seed=1)
    for step in range(80):
        found, expected = driven.step(None), chirped.step(actions_at(step, 2))
        np.testing.assert_array_equal(found[0], expected[0])
    np.testing.assert_array_equal(driven.states, chirped.states)
    single = gym.make("JackInBox-v0", contact=contact)
    single.reset(seed=1)
    for _ in range(80):
        _, _, _, _, info = single.step(None)
    np.testing.assert_array_equal(driven.states[0], info["state"])
    wild, tame = (JackInBoxVectorEnv(2, contact=contact) for _ in range(2))
    for env, action in ((wild, 1e30), (tame, 1.0)):
        env.reset(seed=1)
        env.step(np.full((2, 1), action))
    np.testing.assert_array_equal(wild.states, tame.states)


# -- episodes ---------------------------------------------------------------------------------------------------------


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
    with pytest.raises(RuntimeError, match="autoreset_mode DISABLED leaves it to you to reset .* over are 1 of 2"):
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


# -- what is handed out -----------------------------------------------------------------------------------------------


def arrays_in(handed: Any) -> list[Any]:
    """All arrays in what was handed out, those in dicts and in arrays of arrays as well."""
    if isinstance(handed, np.ndarray) and handed.dtype != object:
        return [handed]
    parts = handed.values() if isinstance(handed, dict) else [] if handed is None else handed
    return [array for part in parts for array in arrays_in(part)]


@EVERY_SIZE
@pytest.mark.parametrize("mode", MODES)
def test_no_buffer_handed_out_is_written_again(contact: str, mode: AutoresetMode, count: int) -> None:
    env = JackInBoxVectorEnv(count, contact=contact, max_episode_steps=5, with_infos=True, autoreset_mode=mode)
    actions = np.full((count, 1), 0.5, dtype=np.float32)
    kept: list[Any] = [env.reset(seed=0)]
    for _ in range(12):
        kept.append(env.step(actions))
        kept.append((env.states, env.times, env.observations, env._batch.held.over))
    copied = copy.deepcopy(kept)
    for _ in range(20):
        env.step(actions)
    env.reset(seed=5)
    for found, expected in zip(kept, copied, strict=True):
        assert_same(found, expected)
    assert (actions == np.float32(0.5)).all()


@EVERY_SIZE
@pytest.mark.parametrize("mode", MODES)
def test_what_is_handed_out_and_in_can_be_written_to(contact: str, mode: AutoresetMode, count: int) -> None:
    settings: Any = {"contact": contact, "max_episode_steps": 4, "with_infos": True, "autoreset_mode": mode}
    scribbled, twin = (JackInBoxVectorEnv(count, **settings) for _ in range(2))
    given: Any = {"state": np.tile(np.linspace(0.0, 0.5, 12), (count, 1)), "time": np.full(count, 1.0)}

    def scribble(handed: Any) -> None:
        for array in arrays_in(handed):
            array[...] = 7

    twin.reset(seed=0, options=copy.deepcopy(given))
    scribble(scribbled.reset(seed=0, options=given))
    scribble(given)
    for step in range(14):
        found, expected = scribbled.step(actions_at(step, count)), twin.step(actions_at(step, count))
        assert_same(found, expected)
        states, times = scribbled.states, scribbled.times
        assert_same((states, times), (twin.states, twin.times))
        scribble((found, scribbled.observations, scribbled._batch.held.over))
        if step % 5 == 1:
            scribbled.set_states(states, times)
            twin.set_states(twin.states, twin.times)
        scribble((states, times))
    assert_same((scribbled.states, scribbled.times), (twin.states, twin.times))


def test_memory_is_a_few_hundred_bytes_per_environment() -> None:
    env = JackInBoxVectorEnv(10_000, contact="exact")
    env.reset(seed=0)
    env.step(None)
    assert env._batch.nbytes / 10_000 <= 300  # type: ignore[attr-defined]
    assert env._batch.held.generators.nbytes == 32 * 10_000


@EVERY_SIZE
def test_batches_are_pickled_and_copied_whole(contact: str, count: int) -> None:
    env = JackInBoxVectorEnv(count, contact=contact, num_threads=2, max_episode_steps=12)
    env.reset(seed=0)
    for step in range(14):  # over a restart
        env.step(actions_at(step, count))
    twins = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env), env]
    for step in range(30):
        one, other, own = (twin.step(actions_at(step, count))[0] for twin in twins)
        np.testing.assert_array_equal(one, own)
        np.testing.assert_array_equal(other, own)


def test_a_fork_steps_on() -> None:
    env = JackInBoxVectorEnv(64, contact="exact", num_threads=2)
    env.reset(seed=0)
    env.step(None)
    process = os.fork()
    if process == 0:
        env.step(None)
        os._exit(0 if env.times[0] == 0.04 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0
    env.step(None)


def test_gymnasiums_vector_wrappers_work() -> None:
    env: Any = gym.make_vec("JackInBox-v0", num_envs=3, contact="exact", max_episode_steps=20)
    env = gym.wrappers.vector.NormalizeObservation(gym.wrappers.vector.RecordEpisodeStatistics(env))
    env.reset(seed=0)
    for _ in range(20):
        _, _, _, truncations, infos = env.step(env.action_space.sample())
    assert truncations.all()
    assert infos["episode"]["l"].tolist() == [20, 20, 20]


# -- pictures ---------------------------------------------------------------------------------------------------------


@EVERY_MODEL
def test_pictures_are_those_of_single_environments(contact: str) -> None:
    pytest.importorskip("pygame")
    env = JackInBoxVectorEnv(2, contact=contact, render_mode="rgb_array")
    single = gym.make("JackInBox-v0", contact=contact, render_mode="rgb_array")
    plain = JackInBoxVectorEnv(2, contact=contact)
    env.reset(seed=4)
    plain.reset(seed=4)
    single.reset(seed=5)
    for step in range(60):
        seen = env.step(actions_at(step, 2))[0]
        single.step(actions_at(step, 2)[1])
        np.testing.assert_array_equal(seen, plain.step(actions_at(step, 2))[0])
    frames = env.render()
    assert frames is not None
    assert len(frames) == 2
    np.testing.assert_array_equal(frames[1], single.render())
    env.close()


def test_no_pictures_without_a_render_mode() -> None:
    env = JackInBoxVectorEnv(2, contact="exact")
    env.reset()
    with pytest.warns(UserWarning, match="render needs a render_mode"):
        assert env.render() is None


# -- refusals ---------------------------------------------------------------------------------------------------------


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
        ({"scene": {"restitution": 0.5}}, "contact='exact' is elastic only"),
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
        ({"options": {"speed": 1}}, "options takes only 'state', 'time', 'reset_mask', got 'speed'"),
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
    states, words = env.states, env._batch.held.settled().copy()
    with pytest.raises((TypeError, ValueError), match=sentence):
        env.reset(**given)
    np.testing.assert_array_equal(env.states, states)
    np.testing.assert_array_equal(env._batch.held.settled(), words)


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
    # A child process, because the limit on its address space stands for a machine that is full.
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
