"""Custom tasks that end episodes and draw starts: the same alone, in batches, under action repeat and in rollouts."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.vector import AutoresetMode

from jackbox_env import (
    JackInBoxVectorEnv,
    Scene,
    Task,
    rollout,
)
from jackbox_env.sb3 import make_sb3_vec_env
from tests.batches.several import EVERY_MODEL, RANGES, assert_alike, assert_same


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


def actions(steps: int, count: int = 3) -> Any:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (steps, count, 1)).astype(np.float32)


@EVERY_MODEL
@pytest.mark.parametrize("randomize", [None, RANGES], ids=["one scene", "drawn scenes"])
@pytest.mark.parametrize("mode", list(AutoresetMode))
def test_a_batch_ends_and_starts_as_single_environments_do(mode: AutoresetMode, randomize: Any, contact: str) -> None:
    made: dict[str, Any] = {"contact": contact, "task": FALL, "randomize": randomize, "max_episode_steps": LIMIT}
    alone = [gym.make("JackInBox-v0", **made) for _ in range(3)]
    ends = assert_alike(JackInBoxVectorEnv(3, autoreset_mode=mode, **made), alone, actions(300), seed=5)
    assert ends[True, False] >= 2
    assert ends[False, True] >= 2


@EVERY_MODEL
def test_an_end_in_the_last_step_is_no_truncation_to_stable_baselines(contact: str) -> None:
    task = Task(("height", "effort"), terms, lambda scene, state, torque, impulse: True)
    made: dict[str, Any] = {"contact": contact, "task": task, "max_episode_steps": 1}
    batch, alone = JackInBoxVectorEnv(2, autoreset_mode="SAME_STEP", **made), gym.make("JackInBox-v0", **made)
    assert assert_alike(batch, [alone], actions(3, 2), make_sb3_vec_env(2, **made)) == {(True, True): 3}


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
    batch = JackInBoxVectorEnv(3, scene=scenes, action_repeat=2, **made)
    batch.reset(options={"state": ENDING})
    _, rewards, terminations, _, infos = batch.step(np.zeros(3))
    assert rewards.tolist() == infos["reward_part"].tolist() == [pay, 2.0 * pay, pay]
    assert infos["duration"].tolist() == [0.02, 0.04, 0.02]
    assert terminations.tolist() == [True, False, True]


# -- actions that are repeated ----------------------------------------------------------------------------------------


# -- rollouts ---------------------------------------------------------------------------------------------------------


def test_rollouts_earn_nothing_after_the_end() -> None:
    rng = np.random.default_rng(1)
    starts = np.array([above(Scene(), rng) for _ in range(6)])
    torques = rng.uniform(-9e4, 9e4, (6, 62))
    rollouts: Any = rollout(None, starts, torques, 0.02, rewards=FALL, impacts=True)
    endless = rollout(None, starts, torques, 0.02, rewards=Task(FALL.terms, FALL.values))
    assert_same(rollouts.trajectories, endless.trajectories)
    hit = rollouts.impacts > 0
    np.testing.assert_array_equal(rollouts.lengths, np.where(hit.any(axis=1), hit.argmax(axis=1) + 1, 62))
    assert set(endless.lengths.tolist()) == {62}
    assert rollouts.lengths.min() < 62
    assert rollouts.lengths.max() == 62
    going = np.arange(62) < rollouts.lengths[:, None]
    np.testing.assert_array_equal(rollouts.rewards, np.where(going, endless.rewards, 0.0))


# -- what is refused --------------------------------------------------------------------------------------------------
