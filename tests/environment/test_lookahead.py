"""Lookahead: the appended features, the same in all wrappers, and the gain in returns."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode
from stable_baselines3.common.vec_env import DummyVecEnv

from jackbox_env import JackInBoxVectorEnv, JackLostError, Lookahead, LookaheadVector, Scene, Task, rollout
from jackbox_env.observation import observe, state_of
from jackbox_env.planning.features import Features, LookaheadOptions
from jackbox_env.planning.sb3_wrappers import LookaheadVecEnv
from jackbox_env.sb3 import make_sb3_vec_env
from tests.batches.several import assert_alike
from tests.batches.test_ends import FALL
from tests.states import inside

SMALL: dict[str, Any] = {"samples": 8, "turns": 3, "pieces": 8, "num_threads": 1}
# Torque counts at once, so a plan is more than no torque: the box shall turn clockwise.
STEERED = Task(("steered",), lambda scene, state, torque, impulse: (-0.1 * state[8],))


def single(scene: Any = None, **settings: Any) -> Lookahead:
    return Lookahead(gym.make("JackInBox-v0", contact="exact", scene=scene), **{**SMALL, **settings})


@pytest.mark.parametrize("follow", [False, True])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_all_wrappers_show_and_do_the_same_and_end_with_the_episode(mode: AutoresetMode, follow: bool) -> None:
    """Scenes vary: the last observation of an episode is of its scene, not of the next."""
    options = {**SMALL, "follow": follow, "hold": 5 if mode is AutoresetMode.SAME_STEP else 1}
    ranges = {"gravity": (1.0, 20.0), "torque_limit": (2e4, 9e4)}
    made: dict[str, Any] = {"contact": "exact", "task": FALL, "max_episode_steps": 55, "randomize": ranges}
    inner = JackInBoxVectorEnv(3, autoreset_mode=mode, **made)
    vector = LookaheadVector(inner, **{**options, "num_threads": 2})
    stable = LookaheadVecEnv(make_sb3_vec_env(3, **made), **options) if options["hold"] == 5 else None
    actions = np.random.default_rng(0).uniform(-0.3, 0.3, (200 // options["hold"], 3, 1)).astype(np.float32)
    alone = [Lookahead(gym.make("JackInBox-v0", **made), **options) for _ in range(3)]
    ends = assert_alike(vector, alone, actions, stable)
    assert {(True, False), (False, True)} <= set(ends)


def test_a_plan_is_begun_anew_at_a_reset() -> None:
    made = [gym.make("JackInBox-v0", contact="exact", task=STEERED) for _ in range(2)]
    played, fresh = (Lookahead(env, hold=1, follow=True, **SMALL) for env in made)
    played.reset(seed=1)
    for _ in range(3):
        played.step(np.zeros(1))
    np.testing.assert_array_equal(played.reset(seed=2)[0], fresh.reset(seed=2)[0])
    np.testing.assert_array_equal(played.step(np.zeros(1))[0], fresh.step(np.zeros(1))[0])


def test_the_features_asked_for_are_appended() -> None:
    for settings, more in (({}, 2 + 3 + 4), ({"samples": 0}, 2 + 3), ({"samples": 0, "turns": 0}, 0)):
        assert single(**settings).observation_space.shape == (10 + 11 + more,)


def test_the_next_impact_is_that_of_a_rollout_without_torque() -> None:
    scene, rng = Scene(drive=None), np.random.default_rng(3)
    features = Features("juggle", 0.02, LookaheadOptions(samples=0, manoeuvres=0, knots=16))
    seen = np.stack([observe(scene, inside(scene, rng).tolist()) for _ in range(20)])
    appended, _ = features.compute([scene], seen, features.begin(20))
    struck = 0
    for row, shown in zip(seen, appended, strict=True):
        played: Any = rollout(scene, state_of(scene, row.tolist()), np.zeros(80), 0.02, impacts=True)
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


def test_the_best_plans_predicted_return_is_appended() -> None:
    env = JackInBoxVectorEnv(4, contact="exact")
    seen, _ = env.reset(seed=2)
    features = Features("juggle", 0.02, LookaheadOptions(samples=16, num_threads=1))
    appended, _ = features.compute([Scene()], seen, features.begin(4))
    scripted = features._manoeuvres([Scene()] * 4, env.states)
    decision, _ = features._search.decide(Scene(drive=None), env.states, features.begin(4), scripted)
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
