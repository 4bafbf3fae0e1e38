"""Many states observed at once, and their mirror images."""

from __future__ import annotations

import numpy as np
import pytest

from agents.policies.observing import mirrored, observations
from jackbox_env import Scene, rollout
from jackbox_env.observation import observe
from tests.agents.untrained import states_in


@pytest.mark.parametrize("scene", [Scene(), Scene(box_half_width=2.0, jack_arm=0.5, gravity=1.62)])
def test_observations_of_many_states_are_those_of_each_alone(scene: Scene) -> None:
    states = states_in(scene, 40)
    rows = observations(scene, states)
    assert rows.dtype == np.float32
    np.testing.assert_allclose(rows, [observe(scene, state.tolist()) for state in states], atol=1e-6)


def test_mirrored_states_go_mirrored_ways() -> None:
    states, acting = states_in(Scene(drive=None), 20), np.random.default_rng(0).uniform(-9e4, 9e4, (20, 10))
    np.testing.assert_array_equal(mirrored(mirrored(states)), states)
    one, other = (
        rollout(Scene(drive=None), start, torque, 0.02, rewards="juggle", trajectories=False)
        for start, torque in ((states, acting), (mirrored(states), -acting))
    )
    np.testing.assert_allclose(mirrored(other.trajectories[:, 1]), one.trajectories[:, 1], atol=1e-9)
    np.testing.assert_allclose(other.rewards, one.rewards, atol=1e-9)
