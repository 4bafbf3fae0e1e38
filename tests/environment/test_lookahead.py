"""Looking ahead: what is appended, the same in all wrappers, and that it helps."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_single
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv

from jackbox_env import JackInBoxVectorEnv, Lookahead, LookaheadVector, Rollout, Scene, Task, rollout
from jackbox_env.futures import Futures
from jackbox_env.observation import observe, state_of
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.sb3_wrappers import LookaheadVecEnv
from tests.states import inside

SMALL: dict[str, Any] = {"samples": 8, "turns": 3, "pieces": 8, "num_threads": 1}
PLANNED = slice(-4, None)  # what the plan brings, and its next torques


# Torque counts at once, so a plan is more than no torque: the box shall turn clockwise.
STEERED = Task(("steered",), lambda scene, state, torque, impulse: (-0.1 * state[8],))


def single(max_episode_steps: int = 500, **settings: Any) -> Lookahead:
    env = gym.make("JackInBox-v0", contact="exact", max_episode_steps=max_episode_steps)
    return Lookahead(env, **{**SMALL, **settings})


def test_it_is_a_gymnasium_environment() -> None:
    env = single()
    check_env(env)
    assert env.observation_space.shape == (10 + 11 + 2 + 3 + 4,)
    assert single(samples=0).observation_space.shape == (10 + 11 + 2 + 3,)
    assert single(samples=0, turns=0).observation_space.shape == (10 + 11,)


@pytest.mark.parametrize("follow", [False, True])
def test_all_wrappers_show_and_do_the_same(follow: bool) -> None:
    given = {**SMALL, "follow": follow}
    made: dict[str, Any] = {"contact": "exact", "max_episode_steps": 20}
    one = single(20, follow=follow)
    vector = LookaheadVector(JackInBoxVectorEnv(3, autoreset_mode="SAME_STEP", **made), **given)
    several = LookaheadVecEnv(make_sb3_vec_env(3, **made), **given)
    several.seed(4)
    seen, seen_too, seen_alone = vector.reset(seed=4)[0], several.reset(), one.reset(seed=4)[0]
    rng, ends = np.random.default_rng(0), 0
    for _ in range(10):
        np.testing.assert_array_equal(seen, seen_too)
        np.testing.assert_array_equal(seen[0], seen_alone)
        assert vector.single_observation_space.contains(seen[1])
        actions = rng.uniform(-0.3, 0.3, (3, 1)).astype(np.float32)
        seen, rewards, _, over, infos = vector.step(actions)
        seen_too, rewards_too, over_too, infos_too = several.step(actions)
        seen_alone, reward, _, ended, _ = one.step(actions[0])
        np.testing.assert_allclose(rewards, rewards_too, rtol=1e-6)
        assert rewards[0] == pytest.approx(reward, abs=1e-12)
        np.testing.assert_array_equal(over, over_too)
        assert over[0] == ended
        if ended:
            ends += 1
            np.testing.assert_array_equal(infos["final_obs"][0], seen_alone)
            for number in range(3):
                np.testing.assert_array_equal(infos["final_obs"][number], infos_too[number]["terminal_observation"])
            seen, seen_too, seen_alone = vector.reset(seed=4)[0], several_again(several), one.reset(seed=4)[0]
    assert ends == 2


def several_again(environments: LookaheadVecEnv) -> Any:
    environments.seed(4)
    return environments.reset()


def test_an_environment_sees_the_same_beside_others_and_with_threads() -> None:
    env = LookaheadVector(
        JackInBoxVectorEnv(4, contact="exact", autoreset_mode="SAME_STEP"), **{**SMALL, "num_threads": 2}
    )
    seen, alone = env.reset(seed=0)[0], single()
    np.testing.assert_array_equal(alone.reset(seed=2)[0], seen[2])
    seen = env.reset(options={"reset_mask": np.array([False, True, False, False])}, seed=9)[0]
    np.testing.assert_array_equal(alone.reset(seed=9 + 1)[0], seen[1])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_a_plan_is_begun_anew_where_an_episode_starts(mode: AutoresetMode) -> None:
    env = LookaheadVector(
        JackInBoxVectorEnv(2, contact="exact", max_episode_steps=3, autoreset_mode=mode), hold=1, **SMALL
    )
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.zeros((2, 1)))
    if mode is AutoresetMode.NEXT_STEP:
        seen = env.step(np.zeros((2, 1)))[0]
    else:
        seen = env.reset(options={"reset_mask": np.array([True, True])})[0]
    fresh = Futures("juggle", 0.02, hold=1, **SMALL)
    appended, _ = fresh.look([Scene()], seen[:, :10], fresh.begin(2))
    np.testing.assert_array_equal(seen[:, 10:], appended)


def test_the_next_impact_is_that_of_a_rollout_without_torque() -> None:
    scene, rng = Scene(drive=None), np.random.default_rng(3)
    futures = Futures("juggle", 0.02, samples=0, turns=0, pieces=16)
    seen = np.stack([observe(scene, inside(scene, rng).tolist()) for _ in range(20)])
    appended, _ = futures.look([scene], seen, futures.begin(20))
    struck = 0
    for row, found in zip(seen, appended, strict=True):
        played = rollout(scene, state_of(scene, row.tolist()), np.zeros(80), 0.02, impacts=True)
        assert isinstance(played, Rollout)
        assert played.impacts is not None
        hits = np.flatnonzero(played.impacts[0])
        step = hits[0] + 1 if len(hits) else 80
        assert found[0] == np.float32(step / 80)
        np.testing.assert_array_equal(found[1:], observe(scene, played.trajectories[0, step].tolist()))
        struck += len(hits) > 0
    assert 10 < struck <= 20


@pytest.mark.parametrize("scene", [Scene(drive=None), Scene(box_half_width=2.0, jack_arm=0.5, drive=None)])
def test_turns_stop_the_box_where_they_should(scene: Scene) -> None:
    futures = Futures("juggle", 0.02, turns=5)
    state = np.array([0, 0, 0.3, 0, 0, 0, 0, 0, 0.4, 0, 0, 0.0])
    torques = futures._turns([scene], state[None])[0, 1:4]  # the outermost are cut by the limit
    repeated = np.repeat(torques, 5, axis=1) * scene.torque_limit
    ends = rollout(Scene.of({**_fields(scene), "gravity": 0.0}), state, repeated, 0.02)[:, -1]
    np.testing.assert_allclose(ends[:, 8], 0.0, atol=1e-9)
    furthest = scene.torque_limit / scene.box_inertia * 0.2**2
    np.testing.assert_allclose(ends[:, 2], 0.3 + furthest * np.array([-0.5, 0.0, 0.5]), atol=1e-9)


def _fields(scene: Scene) -> dict[str, Any]:
    return {"box_half_width": scene.box_half_width, "jack_arm": scene.jack_arm, "drive": None}


def test_the_plan_earns_what_it_says() -> None:
    env = JackInBoxVectorEnv(4, contact="exact", autoreset_mode="SAME_STEP")
    seen, _ = env.reset(seed=2)
    futures = Futures("juggle", 0.02, samples=16, num_threads=1)
    appended, _ = futures.look([Scene()], seen, futures.begin(4))
    turns = futures._turns([Scene()] * 4, env.states)
    found, _ = futures._search.decide(Scene(drive=None), env.states, futures.begin(4), turns)
    earned = np.zeros(4)
    for piece in range(32):
        for _ in range(5):
            earned += env.step(found.plans[:, piece])[1]
    np.testing.assert_allclose(earned, found.returns, atol=1e-9)
    np.testing.assert_allclose(appended[:, -4], found.returns / 160, atol=1e-3)  # the observation is float32


def test_following_the_plan_juggles_better_than_no_torque() -> None:
    env = LookaheadVector(JackInBoxVectorEnv(8, contact="exact", autoreset_mode="SAME_STEP"), samples=16, follow=True)
    env.reset(seed=0)
    followed = np.mean([env.step(np.zeros((8, 1)))[1].mean() for _ in range(99)]) / 5.0
    plain = JackInBoxVectorEnv(8, contact="exact")
    plain.reset(seed=0)
    assert followed > np.mean([plain.step(np.zeros((8, 1)))[1].mean() for _ in range(495)]) + 0.12


def test_scenes_of_their_own_are_foreseen() -> None:
    scenes = [Scene(gravity=3.0), Scene(), Scene(torque_limit=2e4)]
    env = LookaheadVector(JackInBoxVectorEnv(3, contact="exact", autoreset_mode="SAME_STEP", scene=scenes), **SMALL)
    seen, _ = env.reset(seed=5)
    for number, scene in enumerate(scenes):
        one = Lookahead(gym.make("JackInBox-v0", contact="exact", scene=scene), **SMALL)
        np.testing.assert_array_equal(one.reset(seed=5 + number)[0], seen[number])


def test_pymunk_and_single_environments_side_by_side_work_too() -> None:
    env = LookaheadVector(gym.make_vec("JackInBox-v0", num_envs=2, vectorization_mode="sync"), hold=1, **SMALL)
    native = LookaheadVector(JackInBoxVectorEnv(2), hold=1, **SMALL)
    np.testing.assert_array_equal(env.reset(seed=3)[0], native.reset(seed=3)[0])
    for _ in range(3):
        np.testing.assert_array_equal(env.step(np.zeros((2, 1)))[0], native.step(np.zeros((2, 1)))[0])


def test_the_end_of_an_episode_is_seen_in_its_own_scene() -> None:
    settings: dict[str, Any] = {"contact": "exact", "randomize": {"gravity": (1.0, 20.0), "box_half_width": (3.0, 9.0)}}
    one = Lookahead(gym.make("JackInBox-v0", max_episode_steps=10, **settings), **SMALL)
    made = {"max_episode_steps": 10, **settings}
    vector = LookaheadVector(JackInBoxVectorEnv(1, autoreset_mode="SAME_STEP", **made), **SMALL)
    several = LookaheadVecEnv(make_sb3_vec_env(1, **made), **SMALL)
    one.reset(seed=3)
    vector.reset(seed=3)
    several.seed(3)
    several.reset()
    for _ in range(2):
        seen = one.step(np.zeros(1))[0]
        infos, infos_too = vector.step(np.zeros((1, 1)))[4], several.step(np.zeros((1, 1)))[3]
    np.testing.assert_array_equal(infos["final_obs"][0], seen)
    np.testing.assert_array_equal(infos_too[0]["terminal_observation"], seen)


def test_a_reset_of_some_leaves_the_plans_of_the_others() -> None:
    pair = [
        LookaheadVector(
            JackInBoxVectorEnv(2, contact="exact", task=STEERED, autoreset_mode="DISABLED"),
            hold=1,
            follow=True,
            **SMALL,
        )
        for _ in range(2)
    ]
    for env in pair:
        env.reset(seed=[1, 2])
        for _ in range(5):
            last = env.step(np.zeros((2, 1)))[0]
    shown = pair[0].reset(options={"reset_mask": np.array([True, False])})[0]
    np.testing.assert_array_equal(shown[1], last[1])
    assert not np.array_equal(shown[0], last[0])
    for _ in range(3):
        seen, plain = (env.step(np.zeros((2, 1)))[0] for env in pair)
        np.testing.assert_array_equal(seen[1], plain[1])


def test_after_a_step_that_failed_only_a_reset_leads_on() -> None:
    early = LookaheadVecEnv(make_sb3_vec_env(2, contact="exact", max_episode_steps=7), **SMALL)
    wild = single()
    wild.reset(seed=0)
    wild.env.unwrapped.set_state(np.array([0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 1e30, 0]))  # type: ignore[attr-defined]
    early.reset()
    early.step(np.zeros((2, 1)))
    with pytest.raises(RuntimeError, match="episodes must last a multiple"):
        early.step(np.zeros((2, 1)))
    with pytest.raises(RuntimeError):
        wild.step(np.zeros(1))
    for env, action in ((early, np.zeros((2, 1))), (wild, np.zeros(1)), (single(), np.zeros(1))):
        with pytest.raises(RuntimeError, match="step must come after a reset, got none yet or none"):
            env.step(action)
        env.reset()
        env.step(action)


def test_actions_that_correct_a_plan_are_checked_and_clipped() -> None:
    plain = JackInBoxVectorEnv(3, contact="exact", task=STEERED, autoreset_mode="SAME_STEP")
    env = LookaheadVector(plain, follow=True, **SMALL)
    assert (env.reset(seed=0)[0][:, -3] < -0.1).all()
    with pytest.raises(ValueError, match=r"actions must have shape \(3, 1\) or \(3,\), got \(1, 3\)"):
        env.step(np.zeros((1, 3)))
    with pytest.raises(TypeError, match=r"actions must hold numbers \(clipped to \[-1, 1\]\), got None"):
        env.step(None)
    seen = env.step(np.full(3, 5.0))[0]
    env.reset(seed=0)
    np.testing.assert_array_equal(env.step(np.ones((3, 1)))[0], seen)


def test_a_plan_is_not_followed_where_actions_are_no_torques() -> None:
    halved = gym.wrappers.RescaleAction(gym.make("JackInBox-v0"), np.float32(-2), np.float32(2))
    made: list[Callable[[], gym.Env[Any, Any]]] = [
        lambda: gym.wrappers.RescaleAction(gym.make("JackInBox-v0"), np.float32(-2), np.float32(2))
    ]
    sentence = "follow needs actions that are torques, without an action wrapper inside, got"
    sync = gym.vector.SyncVectorEnv(made)
    outside = gym.wrappers.vector.ClipAction(JackInBoxVectorEnv(2))
    apart = gym.vector.AsyncVectorEnv(made)
    for env in (sync, outside, apart):
        with pytest.raises(ValueError, match=sentence):
            LookaheadVector(env, hold=1, follow=True, **SMALL)
    apart.close()
    with pytest.raises(ValueError, match=f"{sentence} RescaleAction"):
        Lookahead(halved, follow=True, **SMALL)
    Lookahead(halved, **SMALL)  # its agent says what it wants
    with pytest.raises(ValueError, match=f"{sentence} an action wrapper"):
        LookaheadVecEnv(DummyVecEnv(made), follow=True, **SMALL)


def test_a_plan_is_not_followed_where_the_chirp_acts() -> None:
    sentence = 'follow needs an environment with torque="agent", for it steers, got torque="chirp"'
    with pytest.raises(ValueError, match=sentence):
        Lookahead(gym.make("JackInBox-v0", torque="chirp"), follow=True, **SMALL)
    with pytest.raises(ValueError, match=sentence):
        LookaheadVector(JackInBoxVectorEnv(2, torque="chirp"), hold=1, follow=True, **SMALL)
    with pytest.raises(ValueError, match=sentence):
        LookaheadVecEnv(make_sb3_vec_env(2, torque="chirp"), follow=True, **SMALL)


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
def test_its_spec_makes_it_again() -> None:
    env = single(follow=True, seed=3)
    check_single(env, skip_render_check=True)
    assert env.spec is not None
    again = gym.make(env.spec)
    assert isinstance(again, Lookahead)
    first, second = env.reset(seed=1)[0], again.reset(seed=1)[0]
    np.testing.assert_array_equal(first, second)
    for one, two in zip(env.step(np.zeros(1)), again.step(np.zeros(1)), strict=True):
        np.testing.assert_equal(one, two)


def test_environments_of_several_tasks_are_refused() -> None:
    made = [lambda task=task: gym.make("JackInBox-v0", task=task) for task in ("juggle", "spin")]
    with pytest.raises(ValueError, match=r"all environments must have one task, got \['juggle', 'spin'\]"):
        LookaheadVector(gym.vector.SyncVectorEnv(made), hold=1)
    rescaled = gym.wrappers.RescaleObservation(gym.make("JackInBox-v0"), np.float32(0), np.float32(1))
    with pytest.raises(TypeError, match="looking ahead needs the ten numbers of JackInBox-v0, got observations in"):
        Lookahead(rescaled)


@pytest.mark.parametrize(
    ("given", "sentence"),
    [
        ({"hold": 0}, "hold must be a whole number from 1 to 1000, got 0"),
        ({"turns": 4}, "turns must be odd, for the middle one is no turn, or 0, got 4"),
        ({"turns": -1}, "turns must be a whole number from 0 to 999, got -1"),
        ({"samples": 3}, "samples must be at least 8, or 0 for no plan, got 3"),
        ({"pieces": 7}, "pieces must be a whole number from 8 to 10000, got 7"),
        ({"num_threads": 0}, "num_threads must be a whole number >= 1, got 0"),
        ({"follow": True, "samples": 0}, "follow needs a plan to follow, got samples = 0"),
    ],
)
def test_unusable_settings_are_refused(given: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ValueError, match=sentence):
        Lookahead(gym.make("JackInBox-v0"), **given)


def test_other_environments_and_early_ends_are_refused() -> None:
    with pytest.raises(TypeError, match="looking ahead needs JackInBox-v0, got"):
        Lookahead(gym.make("CartPole-v1"))
    with pytest.raises(TypeError, match="looking ahead needs JackInBox-v0, got"):
        LookaheadVector(gym.make_vec("CartPole-v1", num_envs=2), hold=1)
    with pytest.raises(TypeError, match="looking ahead needs the ten numbers of JackInBox-v0, got observations in"):
        Lookahead(single())
    with pytest.raises(ValueError, match="hold must be 1 where autoreset_mode is not SAME_STEP, got 5"):
        LookaheadVector(JackInBoxVectorEnv(2))
    env = LookaheadVecEnv(make_sb3_vec_env(2, contact="exact", max_episode_steps=7), **SMALL)
    env.reset()
    env.step(np.zeros((2, 1)))
    with pytest.raises(RuntimeError, match="episodes must last a multiple of hold = 5 steps, got one that ended 2"):
        env.step(np.zeros((2, 1)))
