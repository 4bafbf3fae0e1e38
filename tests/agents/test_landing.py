"""The policy that chooses how the box meets the jack: its bounce, its torques, its choice, its files."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from agents.evaluation import evaluate, find_policy, shipped_names
from agents.landing import (
    AFTER,
    FLOOR,
    LandingPolicy,
    LandingSettings,
    bounced,
    flown,
    landing_times,
    read_landing,
    torques,
    upright,
    write_landing,
)
from agents.network import Layer
from agents.observing import observations
from agents.settings import EnvSettings
from agents.value import INPUTS
from jackbox_env import Scene, make_simulator
from jackbox_env.states import Array
from jackbox_env.storage import write_json
from jackbox_env.tasks import sample_start
from tests.states import inside

FREE = Scene(drive=None)
SMALL = LandingSettings(angles=(-0.3, -0.1, 0.0, 0.1, 0.3), rates=(-0.5, 0.0, 0.5))


def layers_for(width: int = 8, seed: int = 0) -> list[Layer]:
    rng = np.random.default_rng(seed)
    return [
        (rng.normal(size=(after, before)).astype(np.float32), rng.normal(size=after).astype(np.float32))
        for before, after in ((INPUTS, width), (width, 1))
    ]


def starts(count: int, scene: Scene = FREE) -> Array:
    rng = np.random.default_rng(3)
    return np.array([sample_start(scene, rng) for _ in range(count)])


@pytest.mark.parametrize("scene", [FREE, Scene(drive=None, gravity=3.0, jack_mass=40.0, restitution=0.8)])
def test_the_bounce_is_what_the_exact_model_makes_of_it(scene: Scene) -> None:
    states, rng, compared = starts(60, scene), np.random.default_rng(0), 0
    times, targets = landing_times(scene, states), rng.uniform([-0.25, -0.8], [0.25, 0.8], (60, 2))
    foreseen = bounced(scene, states, times, targets)
    for state, time, target, expected in zip(states, times, targets, foreseen, strict=True):
        before = 0.3
        start = flown(scene, state[None], np.array([time - before]))[0]
        start[2], start[8] = target[0] - before * target[1], target[1]
        simulator = make_simulator(scene, contact="exact")
        simulator.reset(start)
        simulator.step(before + AFTER, 0.0)
        if [impact.wall for impact in simulator.impacts] == [FLOOR]:
            np.testing.assert_allclose(expected, simulator.state, atol=2e-4)
            compared += 1
    assert compared > 25


@pytest.mark.parametrize("target", [(0.0, 0.0), (0.3, 0.5), (-0.2, 0.4)])
def test_the_torques_lead_to_the_target_in_time(target: tuple[float, float]) -> None:
    held, state = 0.1, np.zeros((1, 12))
    state[0, 2], state[0, 8] = 0.1, -0.2
    for left in np.arange(10, 0, -1) * held:
        (torque,) = torques(FREE, state, np.array([left]), np.array([target]), held)
        assert abs(torque) < 1.0
        growth = torque * FREE.torque_limit / FREE.box_inertia
        state[0, 2] += state[0, 8] * held + 0.5 * growth * held**2
        state[0, 8] += growth * held
    assert (state[0, 2], state[0, 8]) == pytest.approx(target, abs=0.03)


def test_a_box_turned_by_quarters_is_the_same_box() -> None:
    policy, states = LandingPolicy(SMALL, layers_for()), starts(12)
    turned = states.copy()
    turned[:, 2] += np.arange(-6, 6) * 0.5 * np.pi
    np.testing.assert_allclose(upright(turned), states, atol=1e-12)
    np.testing.assert_allclose(policy.torques(turned), policy.torques(states), atol=1e-9)


def test_the_box_is_turned_to_the_pair_that_is_worth_most() -> None:
    class Told(LandingPolicy):
        def worth(self, states: Array, times: Array) -> Array:
            return np.tile(np.arange(15) == 13, (len(states), 1)).astype(float)  # the pair (0.3, 0.0)

    states = starts(5)
    pair = np.tile([[0.3, 0.0]], (5, 1))
    expected = torques(FREE, states, landing_times(FREE, states), pair, 0.1)
    np.testing.assert_array_equal(Told(SMALL, layers_for()).torques(states), expected)


def test_a_policy_is_written_read_and_held(tmp_path: Path) -> None:
    write_landing(tmp_path, SMALL, layers_for())
    policy = read_landing(tmp_path)
    assert policy.settings == SMALL
    rng = np.random.default_rng(0)
    seen = observations(Scene(), np.array([inside(Scene(), rng) for _ in range(6)]))
    actions, state = policy.predict(seen)
    assert actions.shape == (6, 1)
    assert actions.dtype == np.float32
    np.testing.assert_array_equal(actions, LandingPolicy(SMALL, layers_for()).act(seen))
    for _ in range(4):
        held, state = policy.predict(seen[::-1], state)
        np.testing.assert_array_equal(held, actions)
    np.testing.assert_array_equal(policy.predict(seen[::-1], state)[0], policy.act(seen[::-1].copy()))
    assert isinstance(find_policy(str(tmp_path), EnvSettings(), 0).policy, LandingPolicy)


def test_what_pairs_are_worth_does_not_depend_on_the_jacks_beside() -> None:
    policy, states = LandingPolicy(SMALL, layers_for(96)), starts(9)
    times = landing_times(FREE, states)
    together = policy.worth(states, times)
    for number in range(9):
        one = slice(number, number + 1)
        np.testing.assert_array_equal(policy.worth(states[one], times[one])[0], together[number])


def test_damage_and_misfits_are_told(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match=r"a layer must take 21 numbers"):
        LandingPolicy(SMALL, layers_for()[1:])
    with pytest.raises(FileNotFoundError, match=r"holds no landing.json"):
        read_landing(tmp_path)
    write_landing(tmp_path, SMALL, layers_for())
    (tmp_path / "weights.npz").write_bytes((tmp_path / "weights.npz").read_bytes()[:-100])
    with pytest.raises(ValueError, match=r"holds no policy of landings: "):
        read_landing(tmp_path)
    (tmp_path / "weights.npz").unlink()
    with pytest.raises(FileNotFoundError, match=r"holds no weights.npz"):
        read_landing(tmp_path)
    write_landing(tmp_path, SMALL, layers_for())
    many = {"angles": [0.0] * 40, "rates": [0.0] * 40}
    damaged: list[Any] = [{"hold": 0}, {"angles": []}, many, {"angles": [3.0]}, {"rates": ["fast"]}, {"speed": 1}, []]
    for given in damaged:
        write_json(tmp_path / "landing.json", given)
        with pytest.raises(ValueError, match=r"holds no policy of landings: "):
            read_landing(tmp_path)


def test_the_shipped_one_juggles_better_than_ppo() -> None:
    assert "distilled" in shipped_names("juggle")
    settings = EnvSettings(contact="exact")
    distilled, ppo = (
        evaluate(name, find_policy(name, settings, 0).policy, settings.env_settings, episodes, 3)
        for name, episodes in (("distilled", 5), ("ppo", 64))
    )
    assert distilled.mean > ppo.interval[1], (distilled, ppo.interval)
