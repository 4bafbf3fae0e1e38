"""Observations that are pictures: what they show, of which moments, and that nobody else's array changes them."""

from __future__ import annotations

import math
from itertools import product
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray
from stable_baselines3 import PPO
from stable_baselines3.common.env_checker import check_env

from jackbox_env import JackInBoxEnv, Pixels, Scene
from jackbox_env.exact.threads import Threads
from jackbox_env.render import raster
from jackbox_env.render.raster import Past
from jackbox_env.sb3 import make_sb3_vec_env
from tests.batches.several import EVERY_MODEL

Picture = NDArray[Any]

FINER = 6  # points of a pixel along each side, of a picture by sampling
# Angle of the box; the jack's centre on its axes [m] and its angle relative to it.
POSES = [(0.0, 0.0, 0.0, 0.3), (0.4, 2.0, -1.0, 2.5), (-2.9, -3.5, 3.0, -1.2), (1.3, 0.5, 4.4, 4.0)]


def state_of(pose: tuple[float, ...], centre: complex = 3.0 - 700.0j) -> list[float]:
    """A state at rest with this pose, the box's centre somewhere."""
    angle, x, y, relative = pose
    jack = centre + complex(x, y) * complex(math.cos(angle), math.sin(angle))
    return [centre.real, centre.imag, angle, jack.real, jack.imag, angle + relative, *[0.0] * 6]


def sampled(pose: tuple[float, ...], size: tuple[int, int], scene: Scene) -> Picture:
    """A picture by the class's description, from whether points are within a mark, not from distances to an edge."""
    angle, x, y, relative = pose
    _, _, half, wall, greatest = raster.view_of(size, 0j).tolist()
    columns, rows = (np.arange(side * FINER) / FINER + 0.5 / FINER - 0.5 * side for side in size)
    points = (columns[None] - 1j * rows[:, None]) * complex(math.cos(angle), -math.sin(angle))  # on the box's axes
    picture = np.zeros(points.shape)
    outer = np.maximum(abs(points.real), abs(points.imag))
    picture[(outer > half) & (outer < half + wall)] = 120.0
    picture[(points.real > half) & (outer < half + wall)] = 200.0
    scale = half / scene.box_half_width
    arm, jack = scale * scene.jack_arm, scale * complex(x, y)
    radius = min(max(0.25 * arm, 1.0), greatest)
    on_jack = (points - jack) * complex(math.cos(relative), -math.sin(relative))
    for along, across in ((on_jack.real, on_jack.imag), (on_jack.imag, on_jack.real)):
        picture[(abs(along) < arm) & (abs(across) < 0.5 * radius)] = 90.0
    for foot, shade in ((3, 160.0), (2, 160.0), (1, 160.0), (0, 255.0)):
        picture[abs(on_jack - arm * 1j**foot) < radius] = shade
    whole: Picture = picture.reshape(size[1], FINER, size[0], FINER).mean(axis=(1, 3))
    return whole


@pytest.mark.parametrize(("size", "half_width"), [((84, 84), 6.0), ((60, 90), 0.6), ((200, 128), 6.0)])
@pytest.mark.parametrize("pose", POSES)
def test_a_picture_shows_box_and_jack_where_they_are(
    pose: tuple[float, ...], size: tuple[int, int], half_width: float
) -> None:
    pose = (pose[0], pose[1] / 6.0 * half_width, pose[2] / 6.0 * half_width, pose[3])
    env = JackInBoxEnv(observation=Pixels(size), scene={"box_half_width": half_width, "jack_arm": half_width / 6.0})
    env.set_state(state_of(pose))
    assert env.observation.shape == (size[1], size[0], 1)
    difference = env.observation[..., 0] - sampled(pose, size, env.scene)
    assert abs(difference).mean() < 0.7
    assert abs(difference).max() < 75.0  # at corners and ends, which are round
    turned = sampled((pose[0] + math.pi / 2.0, *pose[1:]), size, env.scene)
    assert abs(env.observation[..., 0] - turned).mean() > 1.4 * abs(difference).mean() + 0.4


CHANGES = [*(0.01, 0.05, 0.05, 0.1) * np.eye(4), *0.5 * math.pi * np.array(list(product(range(4), [0], [0], range(4))))]


@pytest.mark.parametrize("pose", POSES)
def test_a_picture_determines_the_jacks_pose_and_the_boxs_angle(pose: tuple[float, ...]) -> None:
    """It changes with each of them, and with every quarter turn of box and jack."""
    pictures = drawn(Scene(), [state_of(tuple(pose + change)) for change in CHANGES], (84, 84)).astype(float)
    unlike = np.abs(pictures[..., None] - pictures[..., None, :]).mean(axis=(0, 1))
    assert (unlike + np.eye(len(CHANGES)) > 0.05).all()


# -- the moments -------------------------------------------------------------------------------------------------------


def drawn(scene: Scene, states: list[Any], size: tuple[int, int]) -> Picture:
    """Pictures of states one by one, side by side in channels."""
    frames = np.empty((len(states), size[1], size[0], 1), np.uint8)
    past = Past(Pixels(size), np.array(states)[:, None, :6])
    past.draw(np.array([scene.numbers]), np.arange(len(states)), frames, Threads(1))
    return np.moveaxis(frames[..., 0], 0, -1)


@EVERY_MODEL
@pytest.mark.parametrize(("repeat", "stack"), [(1, 4), (3, 2), (2, 5), ("bounce", 3)])
def test_pictures_are_of_the_last_control_steps(contact: str, repeat: Any, stack: int) -> None:
    env = JackInBoxEnv(contact=contact, observation=Pixels((30, 24), stack), action_repeat=repeat)
    env.stored_steps = None
    seen, info = env.reset(seed=1)
    states, struck = [info["state"]] * stack, 0
    np.testing.assert_array_equal(seen, drawn(env.scene, states[-stack:], (30, 24)))
    for number in range(12 if repeat == "bounce" else 90 // repeat):
        seen, _, _, _, info = env.step(0.2 * (-1) ** number)
        struck += info["impacts"]
        states += [step.state for step in env.control_steps]
        np.testing.assert_array_equal(seen, drawn(env.scene, states[-stack:], (30, 24)))
        np.testing.assert_array_equal(env.observation, seen)
    assert struck
    assert (seen[..., 0] != seen[..., -1]).any()
    env.set_state(states[0])
    np.testing.assert_array_equal(env.observation, drawn(env.scene, states[:stack], (30, 24)))


# -- anything that may come --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("size", [(16, 16), (16, 400), (301, 17)])
@pytest.mark.parametrize(("half_width", "arm"), [(1e-25, 0.2), (6.0, 1.41), (1e25, 1e-9)])
@pytest.mark.parametrize("away", [0.0, 30.0, 1e300])
def test_any_size_anywhere_is_drawn(size: tuple[int, int], half_width: float, arm: float, away: float) -> None:
    scene = Scene(box_half_width=half_width, jack_arm=arm * half_width)
    states = [[*[away] * 2, 1e18, *[-away] * 2, 3e9, *[0.0] * 6], [*[away] * 2, 0.7, *[away] * 2, 0.1, *[0.0] * 6]]
    lost, near = np.moveaxis(drawn(scene, states, size), -1, 0)
    assert (lost.max() > 210) == (away < half_width)  # else its jack is out of the picture
    assert near.max() > 210
    assert np.count_nonzero(near) < 0.75 * near.size


def test_names_stand_for_sizes() -> None:
    assert JackInBoxEnv(observation="pixels-40x36x3").observation_space == gym.spaces.Box(0, 255, (36, 40, 3), np.uint8)
    assert JackInBoxEnv(observation="pixels").observation_space.shape == (84, 84, 1)
    assert [Pixels().name, Pixels((40, 36), 3).name] == ["pixels", "pixels-40x36x3"]


@pytest.mark.filterwarnings("error:.*image")
def test_stable_baselines3_takes_them_for_pictures() -> None:
    pixels = Pixels((36, 40), 4)
    check_env(JackInBoxEnv(fidelity="exact", observation=pixels))
    envs = make_sb3_vec_env(4, fidelity="exact", observation=pixels)
    model = PPO("CnnPolicy", envs, n_steps=8, batch_size=16, n_epochs=1, device="cpu")
    model.learn(32)
    assert model.policy.observation_space.shape == (4, 40, 36)
