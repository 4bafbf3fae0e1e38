"""Custom tasks that end episodes and draw starts: the same alone, in batches, under action repeat and in rollouts."""

from __future__ import annotations

from collections.abc import Sequence
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


TASK = Task(("part",), dividing, high)


@EVERY_MODEL
@pytest.mark.parametrize("masses", [(4.0,) * 3, (4.0, 5.0, 6.0)])
def test_the_reward_of_an_episode_that_waits_is_not_evaluated(masses: Sequence[float], contact: str) -> None:
    made: dict[str, Any] = {"scene": [Scene(jack_mass=mass) for mass in masses], "contact": contact, "with_infos": True}
    ending, pay = np.zeros((3, 12)), 1e-4 / 9e4
    ending[:, 4] = 1.0, -1.0, 1.5  # the first and the last episode end at once
    for repeat in (1, 2):
        batch = JackInBoxVectorEnv(3, task=TASK, action_repeat=repeat, **made)
        batch.reset(options={"state": ending})
        _, rewards, terminations, _, infos = batch.step(np.zeros(3))
        assert terminations.tolist() == [True, False, True]
        assert rewards.tolist() == infos["reward_part"].tolist() == [pay, repeat * pay, pay]
        assert infos["duration"].tolist() == [0.02, repeat * 0.02, 0.02]
        _, rewards, terminations, _, infos = batch.step(np.array([-1.0, 0.0, -1.0]))
        assert rewards.tolist() == infos["reward_part"].tolist() == [0.0, repeat * pay, 0.0]
        assert not terminations.any()
