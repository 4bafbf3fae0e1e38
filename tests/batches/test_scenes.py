"""A scene for each environment: it equals the single environment of that scene, chosen or drawn."""

from __future__ import annotations

from typing import Any

import gymnasium as gym
import numpy as np

from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Scene
from tests.states import started


def test_equal_scenes_are_one_and_a_list_goes_through_make_vec() -> None:
    batch = JackInBoxVectorEnv(3, scene=[Scene(gravity=3.0)] * 3, contact="exact")
    assert batch.scene == Scene(gravity=3.0)
    made: Any = gym.make_vec("JackInBox-v0", 2, scene=[{"gravity": 3.0}, None])
    assert made.unwrapped.scenes == [Scene(gravity=3.0), Scene()]


def test_numbers_are_drawn_before_the_start_in_the_order_of_the_fields() -> None:
    env = started(JackInBoxEnv(randomize={"restitution": (0.8, 1.0), "jack_mass": (2.0, 6.0)}), seed=3)
    rng = np.random.default_rng(3)
    assert env.scene.jack_mass == 2.0 + 4.0 * rng.random() == env.scene.jack_inertia
    assert env.scene.restitution == 0.8 + (1.0 - 0.8) * rng.random()
    assert env.scene.box_mass == Scene().box_mass
    x = rng.uniform(-1.0, 1.0, 3)
    assert (env.state[3], env.state[5]) == (x[0], 0.5 * x[2])


def test_an_inertia_that_is_fixed_or_drawn_does_not_follow_the_mass() -> None:
    batch = started(
        JackInBoxVectorEnv(2, contact="exact", randomize={"jack_inertia": (1.0, 2.0), "jack_mass": (50.0, 60.0)}),
        seed=0,
    )
    assert all(1.0 <= scene.jack_inertia <= 2.0 < 50.0 <= scene.jack_mass for scene in batch.scenes)
    fixed = started(JackInBoxEnv(scene={"jack_inertia": 3.0}, randomize={"jack_mass": (50.0, 60.0)}), seed=0)
    assert fixed.scene.jack_inertia == 3.0
