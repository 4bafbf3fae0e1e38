"""Frames of other sizes, without the overlay, and of several environments."""

from __future__ import annotations

import math
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Scene
from jackbox_env.canvas import TRACK
from jackbox_env.rendering import Renderer
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.simulators import Impact
from jackbox_env.tiles import GAP
from tests.rendering.pixels import Words, blue, draw, red, state


def bare(size: tuple[int, int] = (84, 84), scene: Scene | None = None) -> Renderer:
    return Renderer(scene or Scene(), "rgb_array", 50, size=size, overlay=False)


# -- size --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("overlay", [True, False])
@pytest.mark.parametrize("size", [(84, 84), (301, 97), (1024, 768), (16, 16)])
def test_the_box_fits_into_a_frame_of_any_size(size: tuple[int, int], overlay: bool) -> None:
    renderer = Renderer(Scene(), "rgb_array", 50, size=size, overlay=overlay)
    for angle in np.linspace(0.0, math.pi / 2.0, 7):
        renderer.reset(state(box=(5.0, -3.0, float(angle)), jack=(5.0, -3.0, 0.4)), 0.0)
        frame = draw(renderer)
        assert frame.shape == (size[1], size[0], 3)
        if min(size) > 80:
            rows, columns = np.nonzero(red(frame))
            assert rows.min() > 0
            assert rows.max() < size[1] - 1
            assert columns.min() > 0
            assert columns.max() < size[0] - 1
            assert np.ptp(rows) > 0.55 * min(size)
            assert blue(frame).any()


@pytest.mark.parametrize("size", [(84,), (84, 15), (4097, 84), (84.0, 84), (True, 84), 84])
def test_other_sizes_are_refused(size: Any) -> None:
    with pytest.raises((TypeError, ValueError)) as refused:
        JackInBoxEnv(render_size=size)
    assert "render_size" in str(refused.value)
    assert "from 16 to 4096" in str(refused.value)
    assert str(size) in str(refused.value)


def test_a_size_may_come_from_json() -> None:
    env: Any = gym.make("JackInBox-v0", render_mode="rgb_array", render_size=[96, 64], render_overlay=False)
    env.reset(seed=0)
    assert env.render().shape == (64, 96, 3)
    assert gym.make(gym.envs.registration.EnvSpec.from_json(env.spec.to_json())).metadata["render_size"] == (96, 64)


def test_the_window_has_the_size(monkeypatch: pytest.MonkeyPatch) -> None:
    pygame = pytest.importorskip("pygame")
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    env = JackInBoxEnv(render_mode="human", render_size=(320, 240))
    env.reset(seed=0)
    assert pygame.display.get_surface().get_size() == (320, 240)
    env.close()
    assert not pygame.display.get_init()


# -- without the overlay -----------------------------------------------------------------------------------------------


def test_without_the_overlay_a_frame_is_a_function_of_the_state(words: Words) -> None:
    """Neither text, nor the past, nor what acts: box, jack and background."""
    at = state(box=(0.3, -2.0, 0.4), jack=(1.0, -3.0, 0.2))
    renderer, moved = bare(), bare()
    renderer.reset(at, 0.0)
    for step in range(10):
        moved.record(state(jack=(0.3 * step, 1.0, 0.1)), 0.02 * step, 5e4, [Impact(0.02 * step, 1, 2, 90.0)], 0.7)
    moved.record(at, 3.7, 5e4, [Impact(3.7, 0, 1, 90.0)], 0.7)
    np.testing.assert_array_equal(draw(renderer), draw(moved))
    assert words == {}
    shown = Renderer(Scene(), "rgb_array", 50, size=(84, 84))
    shown.reset(at, 0.0)
    assert not np.array_equal(draw(shown), draw(renderer))


# -- several environments ----------------------------------------------------------------------------------------------


def test_each_environment_of_a_vector_has_a_frame_of_the_size() -> None:
    given: dict[str, Any] = {"render_mode": "rgb_array", "render_size": (80, 60), "render_overlay": False}
    env = gym.make_vec("JackInBox-v0", num_envs=3, **given)
    env.reset(seed=4)
    frames: Any = env.render()
    assert isinstance(frames, tuple)
    single = gym.make("JackInBox-v0", **given)
    for number, frame in enumerate(frames):
        single.reset(seed=4 + number)
        np.testing.assert_array_equal(frame, single.render())
    several = make_sb3_vec_env(3, **given)
    several.seed(4)
    several.reset()
    for frame, image in zip(frames, several.get_images(), strict=True):
        np.testing.assert_array_equal(frame, image)
    assert several.render().shape == (2 * 60, 2 * 80, 3)  # type: ignore[union-attr]


@pytest.mark.parametrize("contact", ["pymunk", "exact"])
def test_tiles_are_the_environments_as_they_are(contact: str) -> None:
    env = JackInBoxVectorEnv(7, contact=contact, scene=[{"jack_arm": 1.0 + 0.2 * number} for number in range(7)])
    env.reset(seed=0)
    for _ in range(30):
        env.step(np.full(7, 0.7))
    picture = env.tiled(5, size=(60, 40))
    assert picture.dtype == np.uint8
    assert picture.shape == (2 * 40 + GAP, 3 * 60 + 2 * GAP, 3)
    for number in range(5):
        single = JackInBoxEnv(
            scene=env.scenes[number], render_mode="rgb_array", render_size=(60, 40), render_overlay=False
        )
        single.set_state(env.states[number])
        row, column = divmod(number, 3)
        top, left = row * (40 + GAP), column * (60 + GAP)
        np.testing.assert_array_equal(picture[top : top + 40, left : left + 60], single.render())
    assert (picture[40 + GAP :, 2 * (60 + GAP) :] == TRACK).all()
    assert env.tiled().shape == (3 * 128 + 2 * GAP, 3 * 128 + 2 * GAP, 3)  # all there are


def test_tiles_are_refused_in_one_sentence() -> None:
    env = JackInBoxVectorEnv(2)
    with pytest.raises(ValueError, match="first must be a whole number from 1 to 1024, got 0"):
        env.tiled(0)
    with pytest.raises(ValueError, match="size must be .width, height., two whole numbers from 16 to 1024, got .8, 8."):
        env.tiled(size=(8, 8))
