"""Custom tasks that end episodes and draw starts: the same alone, in batches, under action repeat and in rollouts."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jackbox_env import (
    JackInBoxVectorEnv,
    Scene,
    Task,
)
from tests.batches.several import EVERY_MODEL


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
