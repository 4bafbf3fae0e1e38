"""The contents of a frame: box, jack, background, readings."""

from __future__ import annotations

import cmath
import math
import pickle

import numpy as np
import pytest
from numpy.typing import NDArray

from jackbox_env import JackInBoxEnv, Task
from jackbox_env.simulators import Impact
from tests.rendering.pixels import ARM, Frame, L, Mask, Words, blue, draw, pixel, place, red, renderer_at, state

# -- the box and the jack ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("angle", [0.0, 0.3, -5.5])
def test_walls_are_red_outwards_from_their_inside_faces(angle: float) -> None:
    """Seen 6 m, here 152.4 px, around the middle; y points up."""
    renderer = renderer_at(state(box=(3.0, -7.0, angle), jack=(3.0, -7.0, 0.0)))
    frame, middle, half = draw(renderer), 256.0 + 256.0j, 224.0 / math.sqrt(2.0) - 6.0
    for normal in np.exp(-1j * (angle + 0.5 * np.pi * np.arange(4))):
        for sideways in (-130.0, 60.0, 146.0):
            for beyond in (-1.6, 1.6, 4.4):
                point = middle + normal * (half + beyond - 1j * sideways)
                assert red(pixel(frame, (point.real, point.imag))) == (beyond > 0.0)


@pytest.mark.parametrize("angle", [0.0, 0.4, 3.0])
def test_jack_has_blue_arms_and_red_feet_but_one(angle: float) -> None:
    """The first foot is amber: a quarter turn of the cross is seen."""
    renderer = renderer_at(state(box=(0.0, 0.0, 0.1), jack=(-2.0, 1.5, angle)))
    frame = draw(renderer)
    for foot in range(4):
        points = -2.0 + 1.5j + cmath.rect(ARM, angle + 0.5 * foot * math.pi) * np.array([0.0, 0.3, 0.6, 1.0, 1.5])
        along = [pixel(frame, place(point.real, point.imag)) for point in points]
        assert [bool(blue(colour)) for colour in along] == [True, True, True, False, False]
        assert [bool(red(colour)) for colour in along] == [False, False, False, foot > 0, False]
        assert (along[3] == (255, 176, 0)) == (foot == 0)


# -- the background ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("height", [0.0, -0.31, 1234.5])
def test_ruled_lines_stay_in_the_world_as_the_box_sinks(height: float) -> None:
    renderer = renderer_at(state(box=(7000.3, height, 0.0), jack=(7000.3, height, 0.0)))
    strip = draw(renderer)[40:430, 503].astype(int).sum(axis=1)  # no vertical line is here
    dark = strip < strip.max() - 9
    lines = [
        y
        for metre in range(-10, 11, 2)
        if 60.0 < (y := place(0.0, 2 * (height // 2) + metre, (0.0, height))[1]) < 410.0
    ]
    assert len(lines) >= 6
    for y in lines:
        assert dark[round(y) - 41 : round(y) - 38].any()
    assert np.count_nonzero(dark) <= 2 * (len(lines) + 3)


# -- the readings ------------------------------------------------------------------------------------------------------


def test_a_picture_shows_time_torque_and_impacts(words: Words) -> None:
    renderer = renderer_at(state())
    draw(renderer)
    assert {"t = 0.00 s", "0.0 kN m", "0 impacts"} <= set(words)
    renderer.record(state(), 1.24, -44960.0, [Impact(1.23, 0, 0, 1.0)])
    draw(renderer)
    assert {"t = 1.24 s", "-45.0 kN m", "1 impact"} <= set(words)
    renderer.record(state(), 1.26, 500.0, [Impact(1.25, 0, 0, 1.0)] * 3)
    draw(renderer)
    assert {"t = 1.26 s", "0.5 kN m", "4 impacts"} <= set(words)


def test_the_picture_of_an_environment_shows_its_return(words: Words) -> None:
    env = JackInBoxEnv(render_mode="rgb_array", task="spin")
    env.reset(seed=0, options={"state": [*state(jack=(0.0, 0.0, 0.2))[:11], 6.0]})
    total = sum(env.step(0.0)[1] for _ in range(30))
    env.render()
    assert total > 1.0
    assert {"spin", f"return {total:.1f}"} <= set(words)
    lift = Task(terms=("height", "haste", "a very long third one"), values=lambda *_: (1.0, 0.0, 0.0))
    JackInBoxEnv(render_mode="rgb_array", task=lift).render()
    assert "height, haste, a …" in words


@pytest.mark.parametrize("away", [20.0, -1e9, 1e300])
def test_a_jack_far_outside_is_not_drawn(away: float) -> None:
    renderer = renderer_at(state(jack=(away, 0.0, 0.5)))
    renderer.record(state(box=(-away, 0.0, 0.0), jack=(away, away, 0.5)), 0.02, 0.0, [Impact(0.02, 0, 0, 1.0)])
    frame = draw(renderer)
    assert np.count_nonzero(red(frame)) > 4 * 290 * 4
    assert not blue(frame).any()


def gauge(torque: float) -> Mask:
    """Where the gauge is teal: columns from 34 px left of its middle to 34 px right."""
    renderer = renderer_at(state())
    renderer.record(state(), 0.02, torque, [])
    colours = draw(renderer)[460:512, 0:69].astype(int)
    return (colours[..., 0] < 60) & (colours[..., 1] > 100) & (abs(colours[..., 2] - 130) < 30)


def test_gauge_turns_the_way_of_the_torque_and_grows_with_it() -> None:
    none, left, right, full, more = map(gauge, (0.0, 45000.0, -45000.0, 90000.0, 7 * 90000.0))
    assert not none.any()
    assert not left[:, 37:].any()  # counter-clockwise from the top, with a round end there, is to the left
    assert np.count_nonzero(right[:, ::-1] != left) < 0.05 * left.sum()
    assert full.sum() > 1.4 * left.sum() > 0.0
    np.testing.assert_array_equal(more, full)


# -- the trail and the flashes -----------------------------------------------------------------------------------------


TOUCHING = state(jack=(0.0, ARM - L, 0.0))  # wall 3 with foot 3


def changed(frame: Frame, other: Frame) -> NDArray[np.int_]:
    """How much each pixel differs, without the rows of text at the top and the gauge's corner."""
    difference: NDArray[np.int_] = np.abs(frame.astype(int) - other.astype(int)).sum(axis=2)
    difference[:44] = 0
    difference[430:, :220] = 0
    return difference


# -- the trail ---------------------------------------------------------------------------------------------------------


def test_trail_follows_the_jack_through_the_world_fades_and_ends() -> None:
    """The jack moves along a slope, the box sinks: the trail stays where the jack was."""
    renderer = renderer_at(state(jack=(-4.0, 2.5, 0.0)))
    for step in range(41):
        now = state(box=(0.0, -0.01 * step, 0.0), jack=(-4.0 + 0.17 * step, 2.5 - 0.03 * step, 0.0))
        renderer.record(now, 0.02 * step, 0.0, [])
    frame, shades = draw(renderer), []
    for step in (5, 10, 15, 20, 25):
        colour = pixel(frame, place(-4.0 + 0.17 * step, 2.5 - 0.03 * step, (0.0, -0.4)))
        shades.append(colour[2] - colour[0])  # blue less red is 0 on white
    assert min(np.diff([5, *shades])) > 0
    for step in range(41, 91):  # a second later nothing of it is left
        renderer.record(now, 0.02 * step, 0.0, [])
    assert not changed(draw(renderer), draw(renderer_at(now))).any()


def test_reset_forgets_everything() -> None:
    renderer = renderer_at(state(jack=(-4.0, 0.0, 0.0)))
    renderer.record(TOUCHING, 0.02, 5e4, [Impact(0.02, 3, 3, 9.0)], 1.0)
    renderer.reset(state(), 0.6)
    np.testing.assert_array_equal(draw(renderer), draw(renderer_at(state(), time=0.6)))


def test_memory_is_bounded_and_a_frame_belongs_to_the_caller() -> None:
    passed = np.array(state(jack=(1.0, 1.0, 0.2)))
    renderer = renderer_at(state())
    sizes = []
    for step in range(2000):
        renderer.record(passed, 0.02 * step, 0.0, [Impact(0.02 * step, 0, 0, 1.0)] * 3)
        if step in (500, 1999):
            sizes.append(len(pickle.dumps(renderer)))
    assert sizes[1] <= sizes[0] + 10  # the count itself
    frame = draw(renderer)
    before = frame.copy()
    frame[:], passed[:] = 0, 3.0
    np.testing.assert_array_equal(draw(renderer), before)


# -- the flashes -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("wall", "foot", "sideways"), [(0, 0, 1.0), (1, 3, -2.0), (2, 1, 4.0), (3, 2, -2.5)])
def test_flash_shows_where_the_foot_hit_at_the_time_of_the_impact(wall: int, foot: int, sideways: float) -> None:
    """Its centre and size are those of what an impact changes in the frame.

    The arm stands 0.4 rad from the wall's normal, and the foot has slid 0.3 m until the end of the step.
    """
    angle = 0.25 + wall * math.pi / 2.0
    point = 2.0 - 3.0j + cmath.rect(1.0, angle) * complex(L, sideways)
    jack = point + 0.3j * cmath.rect(1.0, angle) - cmath.rect(ARM, angle + 0.4)
    after = state(box=(2.0, -3.0, 0.25), jack=(jack.real, jack.imag, angle + 0.4 - foot * math.pi / 2.0))
    rate = 30.0j * cmath.rect(1.0, angle)  # [m/s] for 0.01 s
    after[9:11] = rate.real, rate.imag
    flashed, plain = renderer_at(after), renderer_at(after)
    flashed.record(after, 0.02, 0.0, [Impact(0.01, wall, foot, 50.0)])
    plain.record(after, 0.02, 0.0, [])
    glowing = np.argwhere(changed(draw(flashed), draw(plain)))[:, ::-1]  # column and row
    low, high = glowing.min(axis=0), glowing.max(axis=0)
    assert 0.5 * (low + high) == pytest.approx(place(point.real, point.imag, (2.0, -3.0)), abs=1.5)
    assert high - low == pytest.approx(24.5, abs=1.5)
