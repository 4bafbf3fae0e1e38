"""Frames of other sizes, without the overlay, and of several environments."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import JackInBoxVectorEnv, Scene
from jackbox_env.render.canvas import TRACK
from jackbox_env.render.renderer import GAP, Renderer
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.simulators import Impact
from tests.rendering.pixels import Words, blue, draw, red, state

BARE: dict[str, Any] = {"render_mode": "rgb_array", "render_overlay": False}


@pytest.mark.parametrize("overlay", [True, False])
@pytest.mark.parametrize("size", [(84, 84), (301, 97), (1024, 768), (16, 16)])
def test_the_box_fits_into_a_frame_of_any_size(size: tuple[int, int], overlay: bool) -> None:
    renderer = Renderer(Scene(), "rgb_array", 50, size=size, overlay=overlay)
    for angle in np.linspace(0.0, math.pi / 2.0, 7):
        renderer.reset(state(box=(5.0, -3.0, float(angle)), jack=(5.0, -3.0, 0.4)), 0.0)
        frame = draw(renderer)
        assert (frame.shape, frame.dtype.name) == ((size[1], size[0], 3), "uint8")
        if min(size) > 80:
            red_pixels = np.argwhere(red(frame))[:, ::-1]  # column and row
            low, high = red_pixels.min(axis=0), red_pixels.max(axis=0)
            assert (low > 0).all()
            assert (high + 1 < size).all()
            assert np.ptp(high - low) <= 2 < 0.55 * min(size) < min(high - low)
            assert blue(frame).any()


def test_without_the_overlay_a_frame_is_a_function_of_the_state(words: Words) -> None:
    """Neither text, nor the past, nor what acts: box, jack and background."""
    at = state(box=(0.3, -2.0, 0.4), jack=(1.0, -3.0, 0.2))
    still, moved, shown = (Renderer(Scene(), "rgb_array", 50, size=(84, 84), overlay=on) for on in (False, False, True))
    still.reset(at, 0.0)
    moved.record(state(jack=(0.3, 1.0, 0.1)), 0.02, 5e4, [Impact(0.02, 1, 2, 90.0)], 0.7)
    moved.record(at, 0.04, 5e4, [Impact(0.04, 0, 1, 90.0)], 0.7)
    np.testing.assert_array_equal(draw(still), draw(moved))
    assert words == {}
    shown.reset(at, 0.0)
    assert not np.array_equal(draw(shown), draw(still))


@pytest.mark.parametrize(("width", "lettered"), [(399, False), (400, True)])
def test_a_small_frame_has_no_letters_to_squint_at(width: int, lettered: bool, words: Words) -> None:
    renderer = Renderer(Scene(), "rgb_array", 50, size=(width, width), task="juggle")
    renderer.record(state(jack=(0.5, 0.0, 0.0)), 0.02, 5e4, [Impact(0.02, 0, 0, 90.0)])
    draw(renderer)
    assert ("juggle" in words) == lettered


# -- several environments ----------------------------------------------------------------------------------------------


def test_several_environments_without_a_render_mode_have_no_pictures() -> None:
    with pytest.warns(UserWarning, match="render_mode"):
        assert JackInBoxVectorEnv(2).render() is None
    with pytest.warns(UserWarning, match="render_mode"):
        assert make_sb3_vec_env(2).get_images() == [None, None]


@pytest.mark.parametrize("contact", ["pymunk", "exact"])
def test_tiles_are_the_environments_as_they_are(contact: str) -> None:
    scenes = [{"jack_arm": 1.0 + 0.2 * number} for number in range(7)]
    env = JackInBoxVectorEnv(7, contact=contact, scene=scenes, render_size=(60, 40), **BARE)
    env.reset(seed=0)
    for _ in range(30):
        env.step(np.full(7, 0.7))
    picture = env.tiled(5, size=(60, 40))
    assert picture.shape == (2 * 40 + GAP, 3 * 60 + 2 * GAP, 3)
    frames: Any = env.render()
    for number in range(5):
        top, left = number // 3 * (40 + GAP), number % 3 * (60 + GAP)
        np.testing.assert_array_equal(picture[top : top + 40, left : left + 60], frames[number])
    assert (picture[40 + GAP :, 2 * (60 + GAP) :] == TRACK).all()
    assert env.tiled().shape == (3 * 128 + 2 * GAP, 3 * 128 + 2 * GAP, 3)  # all there are
