"""The one-bounce policy: its bounce, its torques, its choice of a target, its files."""

from __future__ import annotations

import math

import numpy as np
import pytest

from agents.evaluation.returns import evaluate
from agents.policies.one_bounce import (
    AFTER,
    FLOOR,
    LandingPolicy,
    LandingSettings,
    bounced,
    flown,
    landing_times,
    uprighted,
)
from agents.policies.registry import find_policy
from agents.settings import EnvSettings
from jackbox_env import Scene, make_simulator
from jackbox_env.model.landing import LONGEST
from jackbox_env.model.states import Array
from jackbox_env.model.tasks import sample_start
from jackbox_env.simulators.agent_functions import observed
from tests.agents.untrained import layers_for

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


def test_the_shipped_one_juggles_better_than_ppo() -> None:
    settings = EnvSettings(contact="exact")
    distilled, ppo = (
        evaluate(name, find_policy(name, settings, 0), settings.env_settings, episodes, 3)
        for name, episodes in (("distilled", 5), ("ppo", 64))
    )
    assert distilled.mean > ppo.interval[1], (distilled, ppo.interval)


# -- the features of the landing ---------------------------------------------------------------------------------------


SCENES = [Scene(), Scene(gravity=1.62), Scene(box_half_width=3.0, jack_arm=0.5), Scene(gravity=30.0, jack_arm=2.0)]


def features(scene: Scene, state: Array) -> list[float]:
    values: list[float] = observed(scene, state[None], "landing")[0, 10:].tolist()
    return values


@pytest.mark.parametrize("scene", SCENES)
def test_the_observed_landing_is_the_flight_of_the_exact_model(scene: Scene) -> None:
    """The box moves, and turns slowly, at no torque."""
    rng, flown = np.random.default_rng(0), 0
    length, v0 = scene.box_half_width, scene.speed_scale
    for _ in range(80):
        start = sample_start(scene, rng)
        start[[2, 8]] = rng.uniform(-0.05, 0.05, 2)
        start[9:] = v0 * rng.uniform([-0.15, -0.5, -0.4], [0.15, 0.3, 0.4])
        start[[0, 1, 6, 7]] = moved = 5.0 * length * rng.uniform(-1.0, 1.0, 4)
        start[[3, 4, 9, 10]] += moved
        time, *seen = features(scene, start)
        simulator = make_simulator(scene, contact="exact")
        simulator.reset(start)
        simulator.step(2.0 * time * length / v0, 0.0)
        if simulator.impacts or time == 0.5 * LONGEST:  # a wall came first, or the flight is cut
            continue
        flown += 1
        box, jack = simulator.state[[2, 5]]
        x, y, _, vy = simulator.state[[3, 4, 9, 10]] - simulator.state[[0, 1, 6, 7]]
        assert y == pytest.approx(scene.jack_arm - length, abs=1e-4 * length)
        angles = np.array([4.0 * (jack - box), 8.0 * (jack - box), 4.0 * jack])
        np.testing.assert_allclose(seen[:6], np.stack([np.cos(angles), np.sin(angles)], axis=1).ravel(), atol=2e-3)
        turned = np.clip((jack - start[5]) / (0.5 * math.pi), -10.0, 10.0)
        np.testing.assert_allclose(seen[6:], [x / length, -vy / v0, turned, box], atol=1e-4)
    assert flown >= 20


def test_without_gravity_a_jack_lands_only_if_it_falls() -> None:
    scene, upwards = Scene(gravity=0.0), np.eye(12)[10]
    assert 2.0 * features(scene, -5.0 * upwards)[0] * 6.0 / scene.speed_scale == pytest.approx(1.0, rel=1e-5)
    for rate in (0.0, 5.0):
        assert features(scene, rate * upwards)[0] == 0.5 * LONGEST
