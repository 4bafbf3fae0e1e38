"""Vector environments: the same as single ones, what they hand out, pictures."""

from __future__ import annotations

import copy
import inspect
import math
import os
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from jackbox_env import Drive, JackInBoxVectorEnv, Scene
from jackbox_env.env import JackInBoxEnv
from tests.batches.several import EVERY_MODEL, EVERY_SIZE, actions_at, assert_same

MODES = (AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP)


# -- the same as single environments -----------------------------------------------------------------------------------


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


# -- what is handed out ------------------------------------------------------------------------------------------------


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


# -- pictures ----------------------------------------------------------------------------------------------------------


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
