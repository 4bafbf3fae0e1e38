"""The same bits for one environment, in a batch, in a rollout and after it is restored, from any number of threads."""

from __future__ import annotations

import copy
import math
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode, SyncVectorEnv

from jackbox_env import Chirp, Drive, JackInBoxEnv, JackInBoxVectorEnv, Scene, Task, rollout
from jackbox_env.mechanics import energy
from tests.batches.several import EVERY_MODEL, EVERY_SIZE, SCENES, actions_at, assert_same, play, play_alone
from tests.states import inside

# -- a row of a batch -------------------------------------------------------------------------------------------------


@EVERY_MODEL
@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.SAME_STEP])
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
def test_a_batch_returns_all_that_single_environments_return(
    contact: str, mode: AutoresetMode, settings: dict[str, Any]
) -> None:
    count, arguments = 3, {"contact": contact, "max_episode_steps": 80, **settings}
    batched: Any = gym.make_vec("JackInBox-v0", num_envs=count, autoreset_mode=mode, with_infos=True, **arguments)
    single: Any = SyncVectorEnv([lambda: gym.make("JackInBox-v0", **arguments)] * count, autoreset_mode=mode)
    assert batched.observation_space == single.observation_space
    assert batched.action_space == single.action_space
    impacts = 0
    mask = np.array([True, False, True])
    for options in ({"seed": 11}, {"seed": [5, None, 7]}, {"options": {"reset_mask": mask}}):
        assert_same(*(env.reset(**copy.deepcopy(options)) for env in (batched, single)))
        for step in range(170):
            actual, expected = batched.step(actions_at(step, count)), single.step(actions_at(step, count))
            assert_same(actual, expected, f"step {step}")
            impacts += int(actual[4]["impacts"].sum())
    assert impacts > 6


@EVERY_MODEL
@pytest.mark.parametrize("count", [1, 2, 5])
def test_scenes_mixed_in_one_batch_are_each_the_single_one(contact: str, count: int) -> None:
    scenes = list(SCENES[-count:])
    batch = JackInBoxVectorEnv(count, 60, scene=scenes, contact=contact, with_infos=True)
    singles = [JackInBoxEnv(scene=scene, contact=contact) for scene in scenes]
    seen, _ = batch.reset(seed=4)
    np.testing.assert_array_equal(seen, [env.reset(seed=4 + i)[0] for i, env in enumerate(singles)])
    assert_same(play(batch, 150, 0), play_alone(singles, 150, 0, 60))
    assert batch.scenes == scenes


def test_the_number_of_threads_changes_nothing() -> None:
    scenes = [Scene(gravity=0.05 * i, jack_mass=1.0 + 0.01 * i) for i in range(300)]

    def played(threads: int | None) -> list[Any]:
        env = JackInBoxVectorEnv(300, 40, scene=scenes, contact="exact", with_infos=True, num_threads=threads)
        env.reset(seed=0)
        return play(env, 90, 1)

    singles = [JackInBoxEnv(scene=scene, contact="exact") for scene in scenes]
    for number, env in enumerate(singles):
        env.reset(seed=number)
    expected = play_alone(singles, 90, 1, 40)
    for threads in (1, 2, 3, 64, None):
        assert_same(played(threads), expected)


@pytest.mark.parametrize(
    ("frequency", "threads", "restitution"),
    [(0.5, 1, 1.0), (40.0, 2, 1.0), (-3.0, 7, 1.0), (0.5, 2, 0.6)],
    ids=["slow", "several pieces", "backwards", "with loss"],
)
def test_a_chirp_shared_by_environments_at_the_same_time_turns_each_as_alone(
    frequency: float, threads: int, restitution: float
) -> None:
    # At rest and flying, in the middle and at walls, some far off or spinning fast, at three times, in two blocks.
    count, settings = 140, {"contact": "exact", "torque": "chirp", "control_dt": 0.03}
    settings["scene"] = Scene(drive=Chirp(90000.0, frequency, 0.9), restitution=restitution)
    env = JackInBoxVectorEnv(count, 10**6, with_infos=True, num_threads=threads, **settings)  # type: ignore[arg-type]
    env.reset(seed=0)
    rng, states = np.random.default_rng(1), env.states
    states[:, 6:] += rng.normal(size=(count, 6)) * 3.0
    states[5, [0, 3]] += 3e8  # where float64 resolves little
    states[6, 11] = 300.0
    states[7, [2, 5]] += 1e7  # angles too large to be reduced together
    states[133, 2], states[139, 5] = 3e6, -1e8
    times = rng.choice([0.0, 1.7, 250.0], count)
    env.set_states(states, times)
    singles = [JackInBoxEnv(**settings) for _ in range(count)]  # type: ignore[arg-type]
    for single, state, time in zip(singles, states, times.tolist(), strict=True):
        single.set_state(state, time)
    played = play(env, 80, 0)
    assert_same(played, play_alone(singles, 80, 0))
    assert sum(infos["impacts"].sum() for *_, infos in played) > 100


# -- a row of a rollout -----------------------------------------------------------------------------------------------


def lifted(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, float]:
    return state[4] - state[1], impulse + 1e-4 * torque


@pytest.mark.parametrize("task", ["juggle", "rattle", Task(("height", "effort"), lifted)])
def test_rows_of_a_rollout_are_environments_from_any_number_of_threads(task: str | Task) -> None:
    kinds = [*SCENES, Scene(jack_arm=6.5), Scene(drive=Drive(torque=lambda t: 1e9, force_y=lambda t: 2e4 * t))]
    scenes = [scene.changed(torque_limit=90000.0) for scene in kinds for _ in range(3)]
    rng = np.random.default_rng(1)
    states = np.array([inside(scene, rng) for scene in scenes])
    states[15:18, 5] = states[15:18, 2] + math.pi / 4.0  # a long arm fits along the diagonals only
    states[15:18, 3:5] = states[15:18, :2]
    shares = rng.uniform(-1.0, 1.0, (len(scenes), 40))
    torques = shares * 90000.0
    asked: Any = {"time": 3.0, "energy": True, "impacts": True, "rewards": task, "repeat": 2}
    rollouts: Any = rollout(scenes, states, torques, 0.02, **asked)
    for number, scene in enumerate(scenes):
        env = JackInBoxEnv(contact="exact", scene=scene, task=task)
        info = env.reset(options={"state": states[number], "time": 3.0})[1]
        steps = [env.step(share) for share in np.repeat(shares[number], 2)]
        path = [info["state"], *(step[4]["state"] for step in steps)]
        energies = [energy(scene, state) for state in path]
        hits, impulses = ([step[4][name] for step in steps] for name in ("impacts", "impulse"))
        expected = path, energies, hits, impulses, [step[1] for step in steps], len(steps)
        assert_same([values[number] for values in rollouts], [np.array(values) for values in expected])
    assert rollouts.impacts.sum() > 100
    for threads in (1, 2, 3):
        assert_same(rollout(scenes, states, torques, 0.02, num_threads=threads, **asked), rollouts)


@pytest.mark.parametrize("fastest", [0.5, 20.0, 200.0])
@pytest.mark.parametrize(
    "scene",
    [
        Scene(),
        Scene(jack_arm=5.0, gravity=0.0),
        Scene(box_half_width=0.02, jack_arm=0.001, torque_limit=1.0, restitution=0.8),
    ],
    ids=["default", "long arm", "small"],
)
def test_jacks_that_a_batch_moves_together_off_the_walls_are_those_of_a_rollout(scene: Scene, fastest: float) -> None:
    count, rng = 2000, np.random.default_rng(2)
    states = np.array([inside(scene, rng, 3.0 * scene.speed_scale) for _ in range(count)])
    states[:, [8, 11]] = rng.uniform(-fastest, fastest, (count, 2))
    actions = rng.uniform(-1.0, 1.0, count)
    env = JackInBoxVectorEnv(count, contact="exact", scene=scene)
    env.reset(seed=0)
    env.set_states(states, 0.0)
    env.step(actions)
    rollouts: Any = rollout(scene, states, actions[:, None] * scene.torque_limit, 0.02, impacts=True)
    np.testing.assert_array_equal(env.states, rollouts.trajectories[:, 1])
    assert 20 < int((rollouts.impacts > 0).sum()) < count - 20  # both kinds are there


# -- restored ---------------------------------------------------------------------------------------------------------


@EVERY_SIZE
def test_copied_and_restored_batches_go_on_with_the_same_bits(contact: str, count: int) -> None:
    settings: Any = {"contact": contact, "scene": {"jack_arm": 5.0}}
    env = JackInBoxVectorEnv(count, 40, num_threads=2, **settings)
    env.reset(seed=2)
    for step in range(50):  # over a restart
        env.step(actions_at(step, count))
    copies = [pickle.loads(pickle.dumps(env)), copy.deepcopy(env)]
    states, times = env.states, env.times
    path = [env.step(actions_at(step, count))[:4] for step in range(40)]  # over another
    for twin in copies:
        assert_same([twin.step(actions_at(step, count))[:4] for step in range(40)], path)
    env.set_states(states, times)
    assert_same([env.step(actions_at(step, count))[:4] for step in range(20)], path[:20])
    single = JackInBoxEnv(**settings)
    single.set_state(states[0], times[0])
    for step in range(20):
        seen, reward, *_ = single.step(actions_at(step, count)[0])
        assert_same([seen, reward], [path[step][0][0], path[step][1][0]])


# -- negative control -------------------------------------------------------------------------------------------------


@EVERY_MODEL
def test_one_ulp_of_a_start_would_be_seen(contact: str) -> None:
    env, twin = (JackInBoxVectorEnv(5, 60, contact=contact, scene=list(SCENES), with_infos=True) for _ in range(2))
    for one in (env, twin):
        one.reset(seed=4)
    states = twin.states
    states[3, 3] = np.nextafter(states[3, 3], 9.0)
    twin.set_states(states, 0.0)
    with pytest.raises(AssertionError, match="/0/3/state"):
        assert_same(play(twin, 1, 0), play(env, 1, 0))
