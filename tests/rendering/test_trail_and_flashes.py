"""Trail of the jack and flashes of impacts in a frame."""

from __future__ import annotations

import cmath
import math
import pickle

import numpy as np
import pytest
from numpy.typing import NDArray

from jackbox_env.render.renderer import Renderer
from jackbox_env.simulators import Impact
from tests.rendering.pixels import ARM, Frame, L, draw, pixel, renderer_at, state

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
        colour = pixel(frame, renderer.to_pixels(-4.0 + 0.17 * step, 2.5 - 0.03 * step))
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


def test_memory_is_bounded_and_holds_copies() -> None:
    passed = np.array(state(jack=(1.0, 1.0, 0.2)))
    renderer = renderer_at(state())
    sizes = []
    for step in range(2000):
        renderer.record(passed, 0.02 * step, 0.0, [Impact(0.02 * step, 0, 0, 1.0)] * 3)
        if step in (500, 1999):
            sizes.append(len(pickle.dumps(renderer)))
    assert sizes[1] <= sizes[0] + 10  # the count itself
    before = draw(renderer)
    passed[:] = 3.0
    np.testing.assert_array_equal(draw(renderer), before)


# -- the flashes -------------------------------------------------------------------------------------------------------


def with_and_without(after: list[float], *impacts: Impact) -> tuple[Renderer, Renderer]:
    """Two renderers after a step of 0.02 s, one of them with impacts."""
    flashed, plain = renderer_at(after), renderer_at(after)
    flashed.record(after, 0.02, 0.0, impacts)
    plain.record(after, 0.02, 0.0, [])
    return flashed, plain


def glow(pair: tuple[Renderer, Renderer]) -> NDArray[np.int_]:
    return changed(draw(pair[0]), draw(pair[1]))


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
    pair = with_and_without(after, Impact(0.01, wall, foot, 50.0))
    glowing = np.argwhere(glow(pair))[:, ::-1]  # column and row
    low, high = glowing.min(axis=0), glowing.max(axis=0)
    assert 0.5 * (low + high) == pytest.approx(pair[0].to_pixels(point.real, point.imag), abs=1.5)
    assert high - low == pytest.approx(24.5, abs=1.5)


def test_flash_fades_within_a_quarter_of_a_second() -> None:
    pair = with_and_without(TOUCHING, Impact(0.02, 3, 3, 50.0))
    strengths = [int(glow(pair).sum())]
    for step in range(2, 16):
        for renderer in pair:
            renderer.record(TOUCHING, 0.02 * step, 0.0, [])
        strengths.append(int(glow(pair).sum()))
    assert max(np.diff(strengths)) <= 0
    assert strengths[0] > max(5_000, strengths[9] / 0.6)
    assert strengths[11] > strengths[14] == 0  # 0.22 s and 0.28 s after the impact


def test_harder_impacts_flash_larger() -> None:
    weak, usual, hard = (
        np.count_nonzero(glow(with_and_without(TOUCHING, Impact(0.02, 3, 3, impulse))))
        for impulse in (0.1, 20.0, 1e300)
    )
    assert weak < usual < hard < 2500
