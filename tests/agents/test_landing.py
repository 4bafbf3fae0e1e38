"""The one-bounce policy: its bounce, its torques, its choice of a target, its files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from agents.evaluation.returns import evaluate
from agents.policies.network import write_with_layers
from agents.policies.observing import observations
from agents.policies.one_bounce import (
    AFTER,
    FLOOR,
    LandingPolicy,
    LandingSettings,
    bounced,
    flown,
    uprighted,
)
from agents.policies.registry import find_policy
from agents.settings import EnvSettings
from jackbox_env import Scene, make_simulator
from jackbox_env.landing import landing_times
from jackbox_env.states import Array
from jackbox_env.tasks import sample_start
from tests.agents.untrained import layers_for, states_in

FREE = Scene(drive=None)
SMALL = LandingSettings(angles=(-0.3, -0.1, 0.0, 0.1, 0.3), rates=(-0.5, 0.0, 0.5))


def starts(count: int, scene: Scene = FREE) -> Array:
    rng = np.random.default_rng(3)
    return np.array([sample_start(scene, rng) for _ in range(count)])


@pytest.mark.parametrize("scene", [FREE, Scene(drive=None, gravity=3.0, jack_mass=40.0, restitution=0.8)])
def test_the_bounce_is_that_of_the_exact_model(scene: Scene) -> None:
    states, compared = starts(60, scene), 0
    times, targets = landing_times(scene, states), np.random.default_rng(0).uniform([-0.25, -0.8], [0.25, 0.8], (60, 2))
    before = flown(scene, states, times - 0.3)
    before[:, 2], before[:, 8] = targets[:, 0] - 0.3 * targets[:, 1], targets[:, 1]
    for start, expected in zip(before, bounced(scene, states, times, targets), strict=True):
        simulator = make_simulator(scene, contact="exact")
        simulator.reset(start)
        simulator.step(0.3 + AFTER, 0.0)
        if [impact.wall for impact in simulator.impacts] == [FLOOR]:
            np.testing.assert_allclose(expected, simulator.state, atol=2e-4)
            compared += 1
    assert compared > 25


def test_a_box_turned_by_quarters_is_the_same_box() -> None:
    policy, states = LandingPolicy(SMALL, layers_for()), starts(12)
    turned = states.copy()
    turned[:, 2] += np.arange(-6, 6) * 0.5 * np.pi
    np.testing.assert_allclose(uprighted(turned), states, atol=1e-12)
    np.testing.assert_allclose(policy.towards_best(turned), policy.towards_best(states), atol=1e-9)


def test_a_policy_is_written_read_and_held(tmp_path: Path) -> None:
    write_with_layers(tmp_path, "landing.json", SMALL, layers_for())
    policy = find_policy(str(tmp_path), EnvSettings(), 0).policy
    assert isinstance(policy, LandingPolicy)
    seen = observations(Scene(), states_in(Scene(), 6))
    actions, state = policy.predict(seen)
    np.testing.assert_array_equal(actions, LandingPolicy(SMALL, layers_for()).predict(seen)[0])
    others = np.roll(seen, 1, axis=0)
    for _ in range(4):
        held, state = policy.predict(others, state)
        np.testing.assert_array_equal(held, actions)
    anew = policy.predict(others, state)[0]
    np.testing.assert_array_equal(anew, policy.predict(others)[0])
    assert not np.array_equal(anew, actions)


def test_the_shipped_one_juggles_better_than_ppo() -> None:
    settings = EnvSettings(contact="exact")
    distilled, ppo = (
        evaluate(name, find_policy(name, settings, 0).policy, settings.env_settings, episodes, 3)
        for name, episodes in (("distilled", 5), ("ppo", 64))
    )
    assert distilled.mean > ppo.interval[1], (distilled, ppo.interval)
