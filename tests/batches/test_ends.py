"""Custom tasks that end episodes and draw starts: the same alone, in batches, under action repeat and in rollouts."""

from __future__ import annotations

import math
import re
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from jackbox_env import (
    JackInBoxEnv,
    JackInBoxVectorEnv,
    LandingControlVector,
    Lookahead,
    LookaheadVector,
    Scene,
    Task,
    TaskError,
    rollout,
)
from jackbox_env.landing import torques
from jackbox_env.planning.landing_control import Aiming
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.sb3_wrappers import HoldingVecEnv, LookaheadVecEnv
from tests.batches.several import EVERY_MODEL, RANGES, assert_same


def terms(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, float]:
    return state[4] - state[1], -abs(torque) / scene.torque_limit


def struck(scene: Any, state: Any, torque: float, impulse: float) -> bool:
    return bool(impulse > 0.0)


def above(scene: Scene, rng: np.random.Generator) -> Any:
    """Starts that need a draw of 32 bits, of which numpy keeps a half for the next one."""
    state = np.zeros(12)
    state[3], state[4] = rng.uniform(-1.0, 1.0), rng.uniform(0.3, 0.5) * (scene.box_half_width - 1.0)
    state[10] = float(rng.integers(-2, 1, dtype=np.int32))
    return state


FALL = Task(("height", "effort"), terms, struck, above)
LIMIT = 55  # falls end before and after it


@EVERY_MODEL
@pytest.mark.parametrize("randomize", [None, RANGES], ids=["one scene", "drawn scenes"])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_batch_ends_and_starts_as_single_environments_do(mode: AutoresetMode, randomize: Any, contact: str) -> None:
    made: dict[str, Any] = {"contact": contact, "task": FALL, "randomize": randomize, "max_episode_steps": LIMIT}
    batch = JackInBoxVectorEnv(3, autoreset_mode=mode, **made)
    alone = [gym.make("JackInBox-v0", **made) for _ in range(3)]
    seen, _ = batch.reset(seed=5)
    np.testing.assert_array_equal(seen, [env.reset(seed=5 + number)[0] for number, env in enumerate(alone)])
    rng, waiting, ends = np.random.default_rng(0), [False] * 3, [0, 0]
    for _ in range(300):
        actions = rng.uniform(-1.0, 1.0, 3)
        seen, rewards, terminations, truncations, infos = batch.step(actions)
        for number, env in enumerate(alone):
            outcome = rewards[number], terminations[number], truncations[number]
            if waiting[number]:
                waiting[number] = False
                np.testing.assert_array_equal(seen[number], env.reset()[0])
                assert outcome == (0.0, False, False)
                continue
            last, *expected, _ = env.step(actions[number : number + 1])
            assert outcome == tuple(expected)
            ends[0] += bool(outcome[1])
            ends[1] += bool(outcome[2])
            if not any(expected[1:]):
                np.testing.assert_array_equal(seen[number], last)
            elif mode is AutoresetMode.SAME_STEP:
                np.testing.assert_array_equal(infos["final_obs"][number], last)
                np.testing.assert_array_equal(seen[number], env.reset()[0])
            elif mode is AutoresetMode.NEXT_STEP:
                np.testing.assert_array_equal(seen[number], last)
                waiting[number] = True
            else:
                fresh, _ = batch.reset(options={"reset_mask": np.arange(3) == number})
                np.testing.assert_array_equal(fresh[number], env.reset()[0])
    assert min(ends) >= 2


@EVERY_MODEL
def test_an_end_in_the_last_step_is_no_truncation_to_stable_baselines(contact: str) -> None:
    task = Task(("height", "effort"), terms, lambda scene, state, torque, impulse: True)
    made: dict[str, Any] = {"contact": contact, "task": task, "max_episode_steps": 1}
    batch, alone = JackInBoxVectorEnv(2, **made), gym.make("JackInBox-v0", **made)
    batch.reset(seed=0)
    alone.reset(seed=0)
    assert alone.step(np.zeros(1))[2:4] == (True, True)
    assert [column.tolist() for column in batch.step(np.zeros(2))[2:4]] == [[True, True]] * 2
    stable = make_sb3_vec_env(1, **made)
    stable.reset()
    assert stable.step(np.zeros((1, 1)))[3][0]["TimeLimit.truncated"] is False


def dividing(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
    """A reward that is a division by zero at full torque clockwise."""
    return (1e-4 / (torque + 9e4),)


def high(scene: Any, state: Any, torque: float, impulse: float) -> bool:
    return bool(state[4] > 0.0)


ENDING = np.zeros((3, 12))
ENDING[:, 4] = 1.0, -1.0, 1.5  # the first and the last episode end at once


@EVERY_MODEL
@pytest.mark.parametrize("several", [False, True])
def test_the_reward_of_an_episode_that_waits_is_not_evaluated(several: bool, contact: str) -> None:
    task, pay = Task(("part",), dividing, high), 1e-4 / 9e4
    made: dict[str, Any] = {"contact": contact, "task": task, "with_infos": True}
    scenes = [Scene(jack_mass=mass) for mass in (4.0, 5.0, 6.0)] if several else None
    batch = JackInBoxVectorEnv(3, scene=scenes, **made)
    batch.reset(options={"state": ENDING})
    assert batch.step(np.zeros(3))[2].tolist() == [True, False, True]
    _, rewards, terminations, _, infos = batch.step(np.array([-1.0, 0.0, -1.0]))
    assert rewards.tolist() == infos["reward_part"].tolist() == [0.0, pay, 0.0]
    assert not terminations.any()
    actions = iter(([0.0, 0.0, 0.0], [-1.0, 0.0, -1.0]))
    batch.reset(options={"state": ENDING})
    _, rewards, terminations, _, infos = batch.step(lambda states: next(actions), repeat=2)
    assert rewards.tolist() == [pay, 2.0 * pay, pay]
    assert infos["reward_part"].tolist() == [pay, pay, pay]
    assert terminations.tolist() == [True, False, True]


@EVERY_MODEL
def test_landing_control_does_not_evaluate_the_reward_of_an_episode_that_waits(contact: str) -> None:
    batch, aims = JackInBoxVectorEnv(3, contact=contact), np.full((3, 2), 0.5)
    batch.reset(options={"state": ENDING})
    targets = Aiming(batch, 0.04).act(aims).targets
    batch.step(torques(batch.scene, batch.states, targets, 0.02))
    ignored = torques(batch.scene, batch.states, targets, 0.02)[0] * 9e4
    task = Task(("part",), lambda scene, state, torque, impulse: (1.0 / (torque - ignored),), high)
    wrapped = LandingControlVector(JackInBoxVectorEnv(3, contact=contact, task=task), period=0.04)
    wrapped.reset(options={"state": ENDING})
    assert wrapped.step(aims)[2].tolist() == [True, False, True]


# -- actions that are held --------------------------------------------------------------------------------------------


@EVERY_MODEL
def test_held_actions_end_with_the_episode(contact: str) -> None:
    made: dict[str, Any] = {"contact": contact, "task": FALL, "max_episode_steps": LIMIT}
    batch = JackInBoxVectorEnv(3, autoreset_mode="SAME_STEP", with_infos=True, **made)
    stable = HoldingVecEnv(make_sb3_vec_env(3, with_infos=True, **made), 4)
    stable.seed(5)
    alone = [gym.make("JackInBox-v0", **made) for _ in range(3)]
    np.testing.assert_array_equal(batch.reset(seed=5)[0], stable.reset())
    for number, env in enumerate(alone):
        env.reset(seed=5 + number)
    rng, early, kinds, lengths = np.random.default_rng(0), 0, set(), [0] * 3
    for _ in range(60):
        actions = rng.uniform(-1.0, 1.0, (3, 1)).astype(np.float32)
        seen, rewards, terminations, truncations, infos = batch.step(actions, repeat=4)
        seen_too, rewards_too, dones, rows = stable.step(actions)
        np.testing.assert_array_equal(seen, seen_too)
        np.testing.assert_array_equal(rewards.astype(np.float32), rewards_too)
        np.testing.assert_array_equal(terminations | truncations, dones)
        for number, env in enumerate(alone):
            total, steps = 0.0, 0
            while steps < 4:
                last, reward, terminated, truncated, info = env.step(actions[number])
                total, steps = total + float(reward), steps + 1
                if terminated or truncated:
                    break
            assert (total, terminated, truncated) == (rewards[number], terminations[number], truncations[number])
            assert infos["steps"][number] == steps
            lengths[number] += steps
            kinds |= {(terminated, truncated)}
            if terminated or truncated:
                early += steps < 4
                np.testing.assert_array_equal(infos["final_obs"][number], last)
                np.testing.assert_array_equal(rows[number]["terminal_observation"], last)
                assert rows[number]["TimeLimit.truncated"] == (truncated and not terminated)
                assert rows[number]["episode"]["l"] == lengths[number]
                assert_same(infos["final_info"]["state"][number], info["state"])
                last, lengths[number] = env.reset()[0], 0
            else:
                assert infos["impacts"][number] == info["impacts"] == rows[number]["impacts"]
            np.testing.assert_array_equal(seen[number], last)
    assert early >= 5
    assert {(True, False), (False, True), (False, False)} <= kinds


@EVERY_MODEL
def test_an_episode_that_ends_in_a_held_step_stays_where_it_ended(contact: str) -> None:
    made: dict[str, Any] = {"contact": contact, "task": FALL}
    batch, alone = JackInBoxVectorEnv(3, autoreset_mode="DISABLED", **made), [JackInBoxEnv(**made) for _ in range(3)]
    batch.reset(seed=5)
    batch.step(np.full(3, 0.2), repeat=70)
    for number, env in enumerate(alone):
        env.reset(seed=5 + number)
        while not env.step(0.2)[2]:
            pass
        assert_same((batch.states[number], batch.times[number]), (env.state, np.float64(env.time)))


@EVERY_MODEL
def test_a_held_step_that_fails_has_not_happened(contact: str) -> None:
    def root(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
        return (math.nan if state[10] < -5.0 and state[3] > 0.0 else 1.0,)

    def fast(scene: Any, state: Any, torque: float, impulse: float) -> bool:
        return bool(state[10] < -4.9)

    task = Task(("root",), root, fast)
    batch = JackInBoxVectorEnv(2, contact=contact, task=task, autoreset_mode="SAME_STEP")
    starts = np.zeros((2, 12))
    starts[:, 3] = 0.5, -0.5
    starts[0, 10] = 0.1
    batch.reset(options={"state": starts})
    for _ in range(3):
        batch.step(None, repeat=8)
    before, times = batch.states, batch.times
    for _ in range(2):
        with pytest.raises(TaskError, match="'root' is nan, in environment 0"):
            batch.step(None, repeat=8)  # 1 ends in the first of these steps
        assert_same((batch.states, batch.times), (before, times))
    assert batch.step(None)[2].tolist() == [False, True]


def test_lookahead_ends_with_the_episode_in_all_wrappers() -> None:
    small: dict[str, Any] = {"samples": 8, "turns": 3, "pieces": 8, "num_threads": 1}
    made: dict[str, Any] = {"contact": "exact", "task": FALL, "max_episode_steps": LIMIT}
    one = Lookahead(gym.make("JackInBox-v0", **made), **small)
    vector = LookaheadVector(JackInBoxVectorEnv(2, autoreset_mode="SAME_STEP", **made), **small)
    stable = LookaheadVecEnv(make_sb3_vec_env(2, **made), **small)
    stable.seed(5)
    seen = one.reset(seed=5)[0]
    np.testing.assert_array_equal(vector.reset(seed=5)[0], stable.reset())
    ends = 0
    for _ in range(40):
        action = np.full((2, 1), 0.3, dtype=np.float32)
        all_seen, rewards, terminations, truncations, infos = vector.step(action)
        seen_too, _, dones, rows = stable.step(action)
        seen, reward, terminated, truncated, _ = one.step(action[0])
        assert (rewards[0], terminations[0], truncations[0]) == (reward, terminated, truncated)
        np.testing.assert_array_equal(all_seen, seen_too)
        if dones[0]:
            ends += 1
            np.testing.assert_array_equal(infos["final_obs"][0], seen)
            np.testing.assert_array_equal(rows[0]["terminal_observation"], seen)
            seen = one.reset()[0]
        np.testing.assert_array_equal(all_seen[0], seen)
    assert ends >= 2


# -- rollouts ---------------------------------------------------------------------------------------------------------


def test_rollouts_earn_nothing_after_the_end() -> None:
    rng = np.random.default_rng(1)
    starts = np.array([above(Scene(), rng) for _ in range(6)])
    torques = rng.uniform(-9e4, 9e4, (6, 62))
    rollouts = rollout(None, starts, torques, 0.02, rewards=FALL, impacts=True)
    endless = rollout(None, starts, torques, 0.02, rewards=Task(FALL.terms, FALL.values))
    assert_same(rollouts.trajectories, endless.trajectories)
    assert rollouts.impacts is not None
    hit = rollouts.impacts > 0
    np.testing.assert_array_equal(rollouts.lengths, np.where(hit.any(axis=1), hit.argmax(axis=1) + 1, 62))
    assert set(endless.lengths.tolist()) == {62}
    assert rollouts.lengths.min() < 62
    assert rollouts.lengths.max() == 62
    going = np.arange(62) < rollouts.lengths[:, None]
    np.testing.assert_array_equal(rollouts.rewards, np.where(going, endless.rewards, 0.0))


# -- what is refused --------------------------------------------------------------------------------------------------


@EVERY_MODEL
@pytest.mark.parametrize("terms", [(math.nan, 1.0), (1.0, math.inf), (1e308, 1e308)])
def test_a_reward_that_is_no_number_names_its_term(terms: tuple[float, float], contact: str) -> None:
    one, two = terms

    def values(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, float]:
        return (one, two) if impulse > 0.0 else (0.0, 0.0)

    task = Task(("one", "two"), values)
    guilty = [f"'{name}' is {value}" for name, value in zip(task.terms, terms, strict=True)]
    said = ", ".join([text for text, value in zip(guilty, terms, strict=True) if not math.isfinite(value)] or guilty)
    env, batch = JackInBoxEnv(contact=contact, task=task), JackInBoxVectorEnv(1, contact=contact, task=task)
    env.reset(seed=0)
    batch.reset(seed=0)
    refused: TaskError | None = None
    while refused is None:
        before = env.state
        assert_same(batch.states, before[None])
        try:
            env.step(0.0)
            batch.step(np.zeros(1))
        except TaskError as error:
            refused = error
    assert str(refused).endswith(said)
    with pytest.raises(TaskError, match=re.escape(said) + ", in environment 0"):
        batch.step(np.zeros(1))
    assert_same((env.state, batch.states), (before, before[None]))
    if contact == "exact":
        with pytest.raises(TaskError, match=re.escape(said) + r", in step \d+ of states\[1\]"):
            rollout({"gravity": 0.0}, [np.zeros(12), 9.0 * (np.arange(12) == 10)], np.zeros(99), 0.02, rewards=task)


@EVERY_MODEL
def test_starts_and_ends_that_are_none_are_refused(contact: str) -> None:
    def nothing(scene: Any, state: Any, torque: float, impulse: float) -> Any:
        return 1.0

    with pytest.raises(TypeError, match="True or False"):
        JackInBoxEnv(contact=contact, task=Task(("height", "effort"), terms, nothing))
    outside = np.zeros(12)
    outside[3] = 9.0
    for state, said in ((outside, "foot"), ([1.0], "12"), ("here", "numbers")):
        task = Task(("height", "effort"), terms, None, lambda scene, rng, state=state: state)
        env: Any
        for env in (JackInBoxEnv(contact=contact, task=task), JackInBoxVectorEnv(2, contact=contact, task=task)):
            inside = above(Scene(), np.random.default_rng(0))
            env.reset(seed=3, options={"state": inside})
            with pytest.raises((TypeError, ValueError), match=f"the task's start has drawn what is none: .*{said}"):
                env.reset(seed=4)
            assert_same(env.states[0] if hasattr(env, "states") else env.state, inside)
