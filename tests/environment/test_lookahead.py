"""Lookahead: the appended features, the same in all wrappers, and the gain in returns."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env as check_single
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.env_checker import check_env
from stable_baselines3.common.vec_env import DummyVecEnv

from jackbox_env import JackInBoxVectorEnv, JackLostError, Lookahead, LookaheadVector, Rollout, Scene, Task, rollout
from jackbox_env.observation import observe, state_of
from jackbox_env.planning.features import Features, LookaheadOptions
from jackbox_env.planning.sb3_wrappers import LookaheadVecEnv
from jackbox_env.sb3 import make_sb3_vec_env
from tests.states import inside

SMALL: dict[str, Any] = {"samples": 8, "turns": 3, "pieces": 8, "num_threads": 1}
# Torque counts at once, so a plan is more than no torque: the box shall turn clockwise.
STEERED = Task(("steered",), lambda scene, state, torque, impulse: (-0.1 * state[8],))


def single(scene: Any = None, **settings: Any) -> Lookahead:
    return Lookahead(gym.make("JackInBox-v0", contact="exact", scene=scene), **{**SMALL, **settings})


@pytest.mark.filterwarnings("ignore:.*is different from the unwrapped version")
def test_it_is_a_gymnasium_environment_whose_spec_makes_it_again() -> None:
    env = single(follow=True, seed=3)
    check_env(env)
    check_single(env, skip_render_check=True)
    for settings, more in (({}, 2 + 3 + 4), ({"samples": 0}, 2 + 3), ({"samples": 0, "turns": 0}, 0)):
        assert single(**settings).observation_space.shape == (10 + 11 + more,)
    assert env.spec is not None
    again = gym.make(env.spec)
    np.testing.assert_array_equal(env.reset(seed=1)[0], again.reset(seed=1)[0])
    for one, two in zip(env.step(np.zeros(1)), again.step(np.zeros(1)), strict=True):
        np.testing.assert_equal(one, two)


@pytest.mark.parametrize("follow", [False, True])
def test_all_wrappers_show_and_do_the_same(follow: bool) -> None:
    # Scenes that vary: the last observation of an episode is of its scene, not of the next.
    options = {**SMALL, "follow": follow}
    made: dict[str, Any] = {"contact": "exact", "max_episode_steps": 20, "randomize": {"gravity": (1.0, 20.0)}}
    one = Lookahead(gym.make("JackInBox-v0", **made), **options)
    vector = LookaheadVector(JackInBoxVectorEnv(3, autoreset_mode="SAME_STEP", **made), **options)
    stable = LookaheadVecEnv(make_sb3_vec_env(3, **made), **options)
    stable.seed(4)
    seen, seen_too, seen_alone = vector.reset(seed=4)[0], stable.reset(), one.reset(seed=4)[0]
    rng, ends, fresh = np.random.default_rng(0), 0, Features("juggle", 0.02, LookaheadOptions(5, 3, 8, 8))
    for _ in range(10):
        np.testing.assert_array_equal(seen, seen_too)
        np.testing.assert_array_equal(seen[0], seen_alone)
        assert vector.single_observation_space.contains(seen[1])
        actions = rng.uniform(-0.3, 0.3, (3, 1)).astype(np.float32)
        seen, rewards, _, over, infos = vector.step(actions)
        seen_too, rewards_too, over_too, infos_too = stable.step(actions)
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
            seen_alone = one.reset()[0]
            appended, _ = fresh.compute([one.get_wrapper_attr("scene")], seen_alone[None, :10], fresh.begin(1))
            np.testing.assert_array_equal(seen_alone[10:], appended[0])
    assert ends == 2


def test_features_of_an_environment_depend_neither_on_others_nor_on_threads() -> None:
    scenes = [Scene(gravity=3.0), Scene(), Scene(torque_limit=2e4)]
    inner = JackInBoxVectorEnv(3, contact="exact", autoreset_mode="SAME_STEP", scene=scenes)
    env = LookaheadVector(inner, **{**SMALL, "num_threads": 2})
    seen, alone = env.reset(seed=5)[0], [single(scene=scene) for scene in scenes]
    for number in range(3):
        np.testing.assert_array_equal(alone[number].reset(seed=5 + number)[0], seen[number])
    seen = env.reset(options={"reset_mask": np.array([False, True, False])}, seed=9)[0]
    np.testing.assert_array_equal(alone[1].reset(seed=9 + 1)[0], seen[1])


@pytest.mark.parametrize("mode", [AutoresetMode.NEXT_STEP, AutoresetMode.DISABLED])
def test_a_plan_is_begun_anew_where_an_episode_starts(mode: AutoresetMode) -> None:
    inner = JackInBoxVectorEnv(2, contact="exact", task=STEERED, max_episode_steps=3, autoreset_mode=mode)
    env = LookaheadVector(inner, hold=1, **SMALL)
    env.reset(seed=1)
    for _ in range(3):
        env.step(np.zeros((2, 1)))
    if mode is AutoresetMode.NEXT_STEP:
        seen = env.step(np.zeros((2, 1)))[0]
    else:
        seen = env.reset(options={"reset_mask": np.array([True, True])})[0]
    fresh = Features(STEERED, 0.02, LookaheadOptions(1, 3, 8, 8))
    plans = fresh.begin(2)
    for _ in range(2):  # begun anew once
        appended, plans = fresh.compute([Scene()], seen[:, :10], plans)
        np.testing.assert_array_equal(seen[:, 10:], appended)
        seen = env.step(np.zeros((2, 1)))[0]


def test_the_next_impact_is_that_of_a_rollout_without_torque() -> None:
    scene, rng = Scene(drive=None), np.random.default_rng(3)
    features = Features("juggle", 0.02, LookaheadOptions(samples=0, manoeuvres=0, knots=16))
    seen = np.stack([observe(scene, inside(scene, rng).tolist()) for _ in range(20)])
    appended, _ = features.compute([scene], seen, features.begin(20))
    struck = 0
    for row, shown in zip(seen, appended, strict=True):
        played = rollout(scene, state_of(scene, row.tolist()), np.zeros(80), 0.02, impacts=True)
        assert isinstance(played, Rollout)
        assert played.impacts is not None
        hits = np.flatnonzero(played.impacts[0])
        step = hits[0] + 1 if len(hits) else 80
        assert shown[0] == np.float32(step / 80)
        np.testing.assert_array_equal(shown[1:], observe(scene, played.trajectories[0, step].tolist()))
        struck += len(hits) > 0
    assert 10 < struck <= 20


@pytest.mark.parametrize("scene", [Scene(drive=None), Scene(box_half_width=2.0, jack_arm=0.5, drive=None)])
def test_manoeuvres_stop_the_box_where_they_should(scene: Scene) -> None:
    features = Features("juggle", 0.02, LookaheadOptions(manoeuvres=5))
    state = np.array([0, 0, 0.3, 0, 0, 0, 0, 0, 0.4, 0, 0, 0.0])
    torques = features._manoeuvres([scene], state[None])[0, 1:4]  # the outermost are cut by the limit
    repeated = np.repeat(torques, 5, axis=1) * scene.torque_limit
    ends = rollout(scene.changed(gravity=0.0), state, repeated, 0.02)[:, -1]
    np.testing.assert_allclose(ends[:, 8], 0.0, atol=1e-9)
    furthest = scene.torque_limit / scene.box_inertia * 0.2**2
    np.testing.assert_allclose(ends[:, 2], 0.3 + furthest * np.array([-0.5, 0.0, 0.5]), atol=1e-9)


def test_the_plan_earns_its_predicted_return() -> None:
    env = JackInBoxVectorEnv(4, contact="exact", autoreset_mode="SAME_STEP")
    seen, _ = env.reset(seed=2)
    features = Features("juggle", 0.02, LookaheadOptions(samples=16, num_threads=1))
    appended, _ = features.compute([Scene()], seen, features.begin(4))
    scripted = features._manoeuvres([Scene()] * 4, env.states)
    decision, _ = features._search.decide(Scene(drive=None), env.states, features.begin(4), scripted)
    earned = np.zeros(4)
    for knot in range(32):
        for _ in range(5):
            earned += env.step(decision.plans[:, knot])[1]
    np.testing.assert_allclose(earned, decision.returns, atol=1e-9)
    np.testing.assert_allclose(appended[:, -4], decision.returns / 160, atol=1e-3)  # the observation is float32


def test_following_the_plan_juggles_better_than_no_torque() -> None:
    env = LookaheadVector(JackInBoxVectorEnv(8, contact="exact", autoreset_mode="SAME_STEP"), samples=16, follow=True)
    env.reset(seed=0)
    followed = np.mean([env.step(np.zeros((8, 1)))[1].mean() for _ in range(99)]) / 5.0
    plain = JackInBoxVectorEnv(8, contact="exact")
    plain.reset(seed=0)
    assert followed > np.mean([plain.step(np.zeros((8, 1)))[1].mean() for _ in range(495)]) + 0.12


def test_pymunk_and_single_environments_side_by_side_work_too() -> None:
    env = LookaheadVector(gym.make_vec("JackInBox-v0", num_envs=2, vectorization_mode="sync"), hold=1, **SMALL)
    native = LookaheadVector(JackInBoxVectorEnv(2), hold=1, **SMALL)
    np.testing.assert_array_equal(env.reset(seed=3)[0], native.reset(seed=3)[0])
    for _ in range(3):
        np.testing.assert_array_equal(env.step(np.zeros((2, 1)))[0], native.step(np.zeros((2, 1)))[0])


def test_a_reset_of_some_leaves_the_plans_of_the_others() -> None:
    made = [JackInBoxVectorEnv(2, contact="exact", task=STEERED, autoreset_mode="DISABLED") for _ in range(2)]
    pair = [LookaheadVector(env, hold=1, follow=True, **SMALL) for env in made]
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
    made = [lambda: gym.make("JackInBox-v0", contact="exact", max_episode_steps=7)] * 2
    early = LookaheadVecEnv(DummyVecEnv(made), **SMALL)
    wild: Any = single()
    wild.reset(seed=0)
    wild.unwrapped.set_state(np.where(np.arange(12) == 10, 1e30, 0.0))
    early.reset()
    early.step(np.zeros((2, 1)))
    with pytest.raises(RuntimeError, match="episodes must last a multiple of hold = 5 steps, got one that ended 2"):
        early.step(np.zeros((2, 1)))
    with pytest.raises(JackLostError):
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
    with pytest.raises(TypeError, match=r"actions must be numbers \(clipped to \[-1, 1\]\), got None"):
        env.step(None)
    seen = env.step(np.full(3, 5.0))[0]
    env.reset(seed=0)
    np.testing.assert_array_equal(env.step(np.ones((3, 1)))[0], seen)


def rescaled() -> gym.Env[Any, Any]:
    return gym.wrappers.RescaleAction(gym.make("JackInBox-v0"), np.float32(-2), np.float32(2))


def alone(env: gym.Env[Any, Any], **settings: Any) -> Any:
    return lambda: Lookahead(env, **SMALL, **settings)


def together(env: Any, hold: int = 1, **settings: Any) -> Any:
    return lambda: LookaheadVector(env, hold=hold, **SMALL, **settings)


def test_a_plan_is_not_followed_where_actions_are_no_torques() -> None:
    apart = gym.vector.AsyncVectorEnv([rescaled])
    no_torques = [
        together(gym.vector.SyncVectorEnv([rescaled]), follow=True),
        together(gym.wrappers.vector.ClipAction(JackInBoxVectorEnv(2)), follow=True),
        together(apart, follow=True),
        alone(rescaled(), follow=True),
        lambda: LookaheadVecEnv(DummyVecEnv([rescaled]), follow=True, **SMALL),
    ]
    for make in no_torques:
        with pytest.raises(ValueError, match="follow needs actions that are torques, without an action wrapper"):
            make()
    apart.close()
    alone(rescaled())()  # its agent overrides the plan
    driven = [
        alone(gym.make("JackInBox-v0", torque="chirp"), follow=True),
        together(JackInBoxVectorEnv(2, torque="chirp"), follow=True),
        lambda: LookaheadVecEnv(make_sb3_vec_env(2, torque="chirp"), follow=True, **SMALL),
    ]
    for make in driven:
        with pytest.raises(ValueError, match='follow needs an environment with torque="agent", .* got torque="chirp"'):
            make()
    with pytest.raises(ValueError, match="follow needs a plan, so samples must be at least 8, got 0"):
        single(follow=True, samples=0)


def test_other_environments_and_several_tasks_are_refused() -> None:
    tasks = [lambda task=task: gym.make("JackInBox-v0", task=task) for task in ("juggle", "spin")]
    seen = gym.wrappers.RescaleObservation(gym.make("JackInBox-v0"), np.float32(0), np.float32(1))
    refused: list[tuple[Any, type[Exception], str]] = [
        (alone(gym.make("CartPole-v1")), TypeError, "looking ahead needs JackInBox-v0, got"),
        (together(gym.make_vec("CartPole-v1", num_envs=2)), TypeError, "looking ahead needs JackInBox-v0, got"),
        (lambda: LookaheadVecEnv(DummyVecEnv([lambda: gym.make("CartPole-v1")])), TypeError, "needs JackInBox-v0, got"),
        (alone(seen), TypeError, "looking ahead needs the ten numbers of JackInBox-v0, got observations in"),
        (alone(single()), TypeError, "looking ahead needs the ten numbers"),
        (together(gym.vector.SyncVectorEnv(tasks)), ValueError, r"must have one task, got \['juggle', 'spin'\]"),
        (together(JackInBoxVectorEnv(2), hold=5), ValueError, "hold must be 1 if autoreset_mode is not SAME_STEP"),
    ]
    for make, error, sentence in refused:
        with pytest.raises(error, match=sentence):
            make()
