"""What a frame shows: the box, the jack, the background, the readings."""

from __future__ import annotations

import math

import numpy as np
import pytest
from numpy.typing import NDArray

from jackbox_env import JackInBoxEnv, Task
from jackbox_env.scene import Scene
from jackbox_env.simulators import Impact, make_simulator
from tests.rendering.pixels import ARM, Frame, L, Mask, Words, blue, draw, pixel, red, renderer_at, state


def teal(colour: NDArray[np.uint8] | tuple[int, int, int]) -> Mask:
    parts = np.asarray(colour, dtype=int)
    return (parts[..., 0] < 60) & (parts[..., 1] > 100) & (parts[..., 2] > 100) & (parts[..., 2] < 160)


# -- the array ---------------------------------------------------------------------------------------------------------


def test_each_call_returns_a_fresh_array() -> None:
    renderer = renderer_at(state())
    first, second = draw(renderer), draw(renderer)
    assert first.shape == second.shape == (512, 512, 3)
    assert first.dtype == second.dtype == np.uint8
    assert first.flags.c_contiguous
    assert first.flags.writeable
    np.testing.assert_array_equal(first, second)
    kept = second.copy()
    first[:] = 0
    np.testing.assert_array_equal(second, kept)
    np.testing.assert_array_equal(draw(renderer), kept)


# -- the box and the jack ----------------------------------------------------------------------------------------------


def test_scale_and_centre_match_the_walls_seen() -> None:
    """At angle 0 the red along a row and a column gives L and the centre in px, whatever `to_pixels` says."""
    renderer = renderer_at(state(box=(3.0, -7.0, 0.0), jack=(0.5, -4.5, 0.3)))
    frame = draw(renderer)
    x, y = renderer.to_pixels(3.0, -7.0)
    for line, place in ((frame[round(y) + 60], x), (frame[:, round(x) + 60], y)):
        places = np.nonzero(red(line))[0]
        low = places[places < place].max() + 0.5  # a pixel reaches half a pixel beyond its centre
        high = places[places > place].min() - 0.5
        assert 0.5 * (low + high) == pytest.approx(place, abs=0.6)
        assert 0.5 * (high - low) == pytest.approx(renderer.to_pixels(3.0 + L, 0.0)[0] - x, abs=0.6)
    assert renderer.to_pixels(3.0, -7.0 + L)[1] < y  # y points up


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 4, -5.5])
def test_walls_are_red_outwards_from_their_inside_faces(angle: float) -> None:
    renderer = renderer_at(state(box=(1.0, 2.0, angle), jack=(1.0, 2.0, 0.0)))
    frame = draw(renderer)
    size = renderer.to_pixels(2.0, 2.0)[0] - renderer.to_pixels(1.0, 2.0)[0]  # [px/m]
    for wall in range(4):
        normal = angle + wall * math.pi / 2.0
        for sideways in (-5.0, -1.3, 2.2, 5.9):
            for distance, is_red in ((L - 1.6 / size, False), (L + 1.6 / size, True), (L + 4.4 / size, True)):
                x = 1.0 + distance * math.cos(normal) - sideways * math.sin(normal)
                y = 2.0 + distance * math.sin(normal) + sideways * math.cos(normal)
                inwards_of_the_corner = distance < L and abs(sideways) > L - 2.0 / size
                assert red(pixel(frame, renderer.to_pixels(x, y))) == is_red or inwards_of_the_corner


def test_box_fits_beside_the_text_at_any_angle() -> None:
    """Neither the ruler nor the texts change as the box turns a full turn, and no wall touches the frame's edge."""
    reference = draw(renderer_at(state()))
    areas = [(slice(0, 512), slice(0, 54)), (slice(0, 30), slice(54, 140)), (slice(0, 30), slice(400, 512))]
    areas += [(slice(30, 42), slice(54, 150)), (slice(30, 42), slice(410, 512)), (slice(491, 512), slice(0, 512))]
    areas += [(slice(442, 491), slice(54, 120)), (slice(464, 491), slice(120, 195))]
    for angle in np.linspace(0.0, math.pi / 2.0, 19):
        frame = draw(renderer_at(state(box=(0.0, 0.0, float(angle)))))
        for area in areas:
            np.testing.assert_array_equal(frame[area], reference[area])
        rows, columns = np.nonzero(red(frame))
        assert 4 < rows.min() < rows.max() < 507
        assert 54 < columns.min() < columns.max() < 510


@pytest.mark.parametrize("angle", [0.0, 0.4, 3.0])
def test_jack_has_blue_arms_and_red_feet_but_one(angle: float) -> None:
    """The first foot is amber: a quarter turn of the cross is seen."""
    renderer = renderer_at(state(box=(0.0, 0.0, 0.1), jack=(-2.0, 1.5, angle)))
    frame = draw(renderer)
    for foot in range(4):
        direction = angle + foot * math.pi / 2.0
        for share, is_blue in ((0.0, True), (0.3, True), (0.6, True), (1.0, False)):
            place = renderer.to_pixels(
                -2.0 + share * ARM * math.cos(direction), 1.5 + share * ARM * math.sin(direction)
            )
            colour = pixel(frame, place)
            assert bool(blue(colour)) == is_blue
            assert bool(red(colour)) == (foot > 0 and share == 1.0)
            assert (colour == (255, 176, 0)) == (foot == 0 and share == 1.0)
        beyond = renderer.to_pixels(-2.0 + 1.5 * math.cos(direction), 1.5 + 1.5 * math.sin(direction))
        assert not red(pixel(frame, beyond))


# -- the background ----------------------------------------------------------------------------------------------------


def ruled_rows(frame: Frame) -> NDArray[np.float64]:
    """Places of the horizontal lines, from the darkness of the rightmost columns that no vertical line touches."""
    strip = frame[40:430, 495:511].astype(float).sum(axis=2).max(axis=1)
    dark = strip.max() - strip
    rows = []
    for row in range(len(dark)):
        if dark[row] > 0 and (row == 0 or dark[row - 1] == 0):
            run = dark[row : row + 2]
            rows.append(40 + row + float(np.average(np.arange(len(run)), weights=run)))
    return np.array(rows)


@pytest.mark.parametrize("height", [0.0, -0.31, -4.856436, 1234.5])
def test_ruled_lines_stay_in_the_world_as_the_box_sinks(height: float) -> None:
    renderer = renderer_at(state(box=(0.0, height, 0.0), jack=(0.0, height, 0.0)))
    rows = ruled_rows(draw(renderer))
    heights = 2.0 * np.arange(math.ceil(height / 2.0) - 6, math.ceil(height / 2.0) + 7)
    expected = np.array([renderer.to_pixels(0.0, float(value))[1] for value in heights])
    expected = np.sort(expected[(expected > 41) & (expected < 428)])
    assert len(expected) >= 7
    assert len(rows) >= len(expected)
    for row in expected:
        assert np.abs(rows - row).min() < 0.1


def test_height_labels_stand_at_their_heights(words: Words) -> None:
    renderer = renderer_at(state(box=(0.0, -20.3, 0.0), jack=(0.0, -20.3, 0.0)))
    draw(renderer)
    for height in (14, 16, 18, 20, 22, 24, 26):
        place = words[f"\N{MINUS SIGN}{height} m"]
        assert place[1] == pytest.approx(renderer.to_pixels(0.0, -height)[1])


@pytest.mark.parametrize(
    ("half_width", "height", "label"),
    [(1e-6, 0.0, "0.5 µm"), (1e-3, 0.0, "0.5 mm"), (1e6, 0.0, "0.5 Mm"), (6.0, 1e9, "…0002 m")],
)
def test_height_labels_of_other_sizes(half_width: float, height: float, label: str, words: Words) -> None:
    scene = Scene(box_half_width=half_width, jack_arm=0.2 * half_width)
    draw(renderer_at(state(box=(0.0, height, 0.0), jack=(0.0, height, 0.0)), scene))
    assert label in words


# -- the readings ------------------------------------------------------------------------------------------------------


def test_readings_of_a_simulation(words: Words) -> None:
    simulator = make_simulator(Scene())
    simulator.reset(state(jack=(0.5, 0.3, 0.3)))
    renderer = renderer_at(state(jack=(0.5, 0.3, 0.3)))
    draw(renderer)
    assert {"t = 0.00 s", "0.0 kN m", "0 impacts"} <= set(words)
    count, seen = 0, set()
    for _ in range(250):
        simulator.step(0.02)
        count += len(simulator.impacts)
        renderer.record(simulator.state, simulator.time, simulator.torque, simulator.impacts)
        if simulator.impacts:
            words.clear()
            draw(renderer)
            assert f"{count} impact{'' if count == 1 else 's'}" in words
            assert f"t = {simulator.time:.2f} s" in words
            assert f"{simulator.torque / 1e3:+.1f} kN m".replace("-", "\N{MINUS SIGN}") in words
            seen.add(count)
    assert 1 in seen
    assert max(seen) > 3
    renderer.record(simulator.state, simulator.time, 0.0, [Impact(simulator.time, 0, 0, 1.0)] * 3)
    draw(renderer)
    assert f"{count + 3} impacts" in words


def test_an_environments_picture_shows_its_own_return(words: Words) -> None:
    env = JackInBoxEnv(render_mode="rgb_array", task="spin")
    env.reset(seed=0, options={"state": [*state(jack=(0.0, 0.0, 0.2))[:11], 6.0]})
    total = sum(env.step(0.0)[1] for _ in range(30))
    env.render()
    assert total > 1.0
    assert {"spin", f"return {total:.1f}"} <= set(words)
    lift = Task(terms=("height", "haste", "a very long third one"), values=lambda *_: (1.0, 0.0, 0.0))
    JackInBoxEnv(render_mode="rgb_array", task=lift).render()
    assert "height, haste, a …" in words


def gauge(torque: float) -> Mask:
    renderer = renderer_at(state())
    renderer.record(state(), 0.02, torque, [])
    return teal(draw(renderer)[440:512, 54:123])


def test_gauge_turns_the_way_of_the_torque_and_grows_with_it() -> None:
    marks = {share: gauge(share * 90000.0) for share in (-1.0, -0.5, 0.0, 0.5, 1.0, 7.0)}
    assert not marks[0.0].any()
    columns = {share: np.nonzero(mark)[1] for share, mark in marks.items()}
    top = 34  # the gauge's middle column: counter-clockwise from the top is to the left
    assert columns[0.5].max() <= top <= columns[-0.5].min()
    np.testing.assert_array_equal(marks[0.5][:, : 2 * top + 1], marks[-0.5][:, 2 * top :: -1])
    assert len(columns[1.0]) > 1.4 * len(columns[0.5])
    np.testing.assert_array_equal(marks[7.0], marks[1.0])
