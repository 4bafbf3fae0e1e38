"""Rows that are moved many at a time end as each would alone, however near to a wall they pass."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jackbox_env import Scene, rollout
from jackbox_env.model.states import Array, clearance

DT = 0.02


def near_walls(scene: Scene, rng: np.random.Generator, count: int) -> Array:
    """States in which a foot touches a wall within a step, or passes it by 1e-12 to 1 of L."""
    length, arm = scene.box_half_width, scene.jack_arm
    states = np.zeros((count, 12))
    states[:, 2], states[:, 5] = rng.uniform(-7.0, 7.0, (2, count))
    relative, angle = states[:, 5] - states[:, 2], states[:, 2]
    reach = arm * np.maximum(np.abs(np.cos(relative)), np.abs(np.sin(relative)))
    ahead = length - reach - length * 10.0 ** rng.uniform(-12.0, 0.0, count)
    aside = rng.uniform(-1.0, 1.0, count) * (length - reach)
    states[:, 3] = np.cos(angle) * ahead - np.sin(angle) * aside
    states[:, 4] = np.sin(angle) * ahead + np.cos(angle) * aside
    states[:, 6:] = rng.normal(0.0, scene.speed_scale, (count, 6)) * 10.0 ** rng.uniform(-3.0, 0.0, (count, 1))
    return states[[clearance(scene, state.tolist()) > 0.0 for state in states]]


@pytest.mark.parametrize("seed", range(8))
def test_rows_moved_together_end_as_each_does_alone(seed: int) -> None:
    rng = np.random.default_rng(seed)
    length = 10.0 ** rng.uniform(-1.0, 1.0)
    scene = Scene(
        box_half_width=length,
        jack_arm=length * rng.uniform(0.05, 0.9),
        restitution=float(rng.choice([0.7, 1.0])),
        drive=None,
    )
    states = near_walls(scene, rng, 200)
    torques = rng.uniform(-1.0, 1.0, (len(states), 1)) * scene.torque_limit
    together: Any = rollout(scene, states, torques, DT, impacts=True)
    alone: list[Any] = [
        rollout(scene, states[k : k + 1], torques[k : k + 1], DT, impacts=True) for k in range(len(states))
    ]
    assert 0.1 < np.mean(together.impacts) < 0.9 * len(states)
    np.testing.assert_array_equal(together.trajectories, np.concatenate([one.trajectories for one in alone]))
    np.testing.assert_array_equal(together.impacts, np.concatenate([one.impacts for one in alone]))
