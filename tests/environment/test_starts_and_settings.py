"""The environment: starts, restored states, settings."""

from __future__ import annotations

import functools
import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.envs.registration import EnvSpec
from gymnasium.vector import AutoresetMode

from jackbox_env import Pixels, Scene
from jackbox_env.mechanics import gaps

make: Any = functools.partial(gym.make, "JackInBox-v0")

# -- starts ------------------------------------------------------------------------------------------------------------


def test_starts_are_drawn_as_documented_and_from_the_seed() -> None:
    env = make()
    starts = np.array([env.reset(seed=seed)[1]["state"] for seed in range(400)])
    np.testing.assert_array_equal(starts[:, [0, 1, 2, *range(6, 12)]], 0.0)
    for column, bound in ((3, 1.0), (4, 1.0), (5, 0.5)):
        assert 0.97 * bound < np.abs(starts[:, column]).max() <= bound
        assert abs(starts[:, column].mean()) < 0.1 * bound
    again = np.array([env.reset(seed=seed)[1]["state"] for seed in range(3)])
    np.testing.assert_array_equal(again, starts[:3])
    assert not np.array_equal(env.reset()[1]["state"], env.reset()[1]["state"])


@pytest.mark.parametrize(("arm", "spread"), [(5.0, 0.2), (5.999999, 2e-7), (6.0, 0.0), (7.0, 0.0), (8.48, 0.0)])
def test_long_arms_start_where_they_fit(arm: float, spread: float) -> None:
    scene = Scene(jack_arm=arm)
    env = make(scene=scene)
    for seed in range(50):
        state = env.reset(seed=seed)[1]["state"]
        assert np.abs(state[3:5]).max() <= spread * (1 + 1e-9)
        assert gaps(scene, state).min() >= -1e-9
        if arm >= 6.0:
            assert state[5] == math.pi / 4
        env.step(None)


# -- construction ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "settings",
    [
        {"scene": Scene(gravity=1.62, jack_arm=2.0), "torque": "chirp", "control_dt": 0.01},
        {"scene": {"gravity": 1.62, "drive": {"rate": 0.1}}, "task": "spin", "substeps": 8},
        {"scene": {}, "observation": Pixels((32, 24), 2)},
    ],
    ids=str,
)
def test_specs_round_trip_through_json(settings: dict[str, Any]) -> None:
    env: Any = make(**settings)
    assert env.unwrapped.scene == Scene.of(settings["scene"])
    again: Any = gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json()))
    assert again.unwrapped.scene == env.unwrapped.scene
    np.testing.assert_array_equal(env.reset(seed=1)[0], again.reset(seed=1)[0])
    for action in np.random.default_rng(0).uniform(-1, 1, (60, 1)).astype(np.float32):
        (one, reward, *_), (other, other_reward, *_) = env.step(action), again.step(action)
        np.testing.assert_array_equal(one, other)
        assert reward == other_reward


# -- Gymnasium's words ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("mode", [*AutoresetMode, *(mode.value for mode in AutoresetMode)])
def test_gymnasiums_words_for_autoreset_are_accepted_and_a_spec_has_json(mode: AutoresetMode | str) -> None:
    envs: Any = gym.make_vec("JackInBox-v0", num_envs=2, autoreset_mode=mode, max_episode_steps=None)
    again: Any = gym.make_vec(EnvSpec.from_json(envs.spec.to_json()), num_envs=2)
    for one in (envs, again):  # Gymnasium reads the metadata, TorchRL's wrapper the attribute
        assert one.metadata["autoreset_mode"] is one.autoreset_mode is AutoresetMode(mode)
        assert one.max_episode_steps == 500
