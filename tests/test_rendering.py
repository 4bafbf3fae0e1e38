"""What a frame shows, where it shows it, and what the renderer leaves alone."""

from __future__ import annotations

import copy
import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator
from itertools import pairwise
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from numpy.typing import NDArray

from jackbox_env.scene import Scene
from jackbox_env.simulators import Impact, make_simulator

pygame = pytest.importorskip("pygame")

from jackbox_env.canvas import Canvas  # noqa: E402
from jackbox_env.rendering import Renderer  # noqa: E402

Frame = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Words = dict[str, tuple[float, float]]

L, ARM = 6.0, 1.0  # [m] the default scene's half width and jack arm
AT_REST = (0.0,) * 6


def state(box: tuple[float, ...] = (0.0, 0.0, 0.0), jack: tuple[float, ...] = (0.0, 0.0, 0.0)) -> list[float]:
    return [*box, *jack, *AT_REST]


def renderer_at(start: list[float], scene: Scene | None = None, time: float = 0.0) -> Renderer:
    renderer = Renderer(scene or Scene(), "rgb_array", 50)
    renderer.reset(start, time)
    return renderer


def draw(renderer: Renderer) -> Frame:
    frame = renderer.render()
    assert frame is not None
    return frame


def pixel(frame: Frame, point: tuple[float, float]) -> tuple[int, int, int]:
    red, green, blue = frame[round(point[1]), round(point[0])].tolist()
    return red, green, blue


def red(colour: NDArray[np.uint8] | tuple[int, int, int]) -> Mask:
    parts = np.asarray(colour, dtype=int)
    return (parts[..., 0] > 180) & (parts[..., 1] < 110) & (parts[..., 2] < 110)


def blue(colour: NDArray[np.uint8] | tuple[int, int, int]) -> Mask:
    parts = np.asarray(colour, dtype=int)
    return (parts[..., 0] < 80) & (parts[..., 1] < 130) & (parts[..., 2] > 150)


def teal(colour: NDArray[np.uint8] | tuple[int, int, int]) -> Mask:
    parts = np.asarray(colour, dtype=int)
    return (parts[..., 0] < 60) & (parts[..., 1] > 100) & (parts[..., 2] > 100) & (parts[..., 2] < 160)


def changed(frame: Frame, other: Frame) -> NDArray[np.int_]:
    """How much each pixel differs, without the rows of text at the top and the gauge's corner."""
    difference: NDArray[np.int_] = np.abs(frame.astype(int) - other.astype(int)).sum(axis=2)
    difference[:40] = 0
    difference[430:, :220] = 0
    return difference


def middle(weights: NDArray[np.int_]) -> tuple[float, float]:
    rows, columns = np.nonzero(weights)
    values = weights[rows, columns]
    return float(np.average(columns, weights=values)), float(np.average(rows, weights=values))


@pytest.fixture
def words(monkeypatch: pytest.MonkeyPatch) -> Words:
    """Every string written, and the last place where."""
    written: Words = {}
    write = Canvas.text

    def noting(self: Canvas, text: str, place: tuple[float, float], *rest: Any, **more: Any) -> None:
        written[text] = place
        write(self, text, place, *rest, **more)

    monkeypatch.setattr(Canvas, "text", noting)
    return written


# -- the array -------------------------------------------------------------------------------------------------------


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


# -- the box and the jack --------------------------------------------------------------------------------------------


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


@pytest.mark.parametrize("angle", [0.0, 0.3, math.pi / 4, 1.2, 2.0, -5.5, 1e6])
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


def test_inside_face_is_exact_to_a_fraction_of_a_pixel() -> None:
    """The share of red in the edge's pixels, summed along a normal, places the face."""
    renderer = renderer_at(state(jack=(0.0, 3.0, 0.0)))
    frame = draw(renderer).astype(float)
    face = renderer.to_pixels(L, 0.0)[0]
    row = frame[300, 300:, 1]  # green: 255 inside, 36 in the wall
    inside = np.clip((row - 36.0) / (255.0 - 36.0), 0.0, 1.0)
    until = int(np.argmin(inside))
    rules = int(np.sum(inside[: until - 2] < 0.99))  # at most one ruled line darkens the way there a little
    assert rules < 12
    edge = 300 - 0.5 + (until - 2) + inside[until - 2 : until + 1].sum()
    assert edge == pytest.approx(face, abs=0.15)


def test_box_fits_beside_the_text_at_any_angle() -> None:
    """Neither the ruler nor the texts change as the box turns a full turn, and no wall touches the frame's edge."""
    reference = draw(renderer_at(state()))
    areas = [(slice(0, 512), slice(0, 54)), (slice(0, 30), slice(54, 140)), (slice(0, 30), slice(420, 512))]
    areas += [(slice(455, 512), slice(54, 120)), (slice(466, 512), slice(120, 195))]
    for angle in np.linspace(0.0, math.pi / 2.0, 19):
        frame = draw(renderer_at(state(box=(0.0, 0.0, float(angle)))))
        for area in areas:
            np.testing.assert_array_equal(frame[area], reference[area])
        rows, columns = np.nonzero(red(frame))
        assert 4 < rows.min() < rows.max() < 507
        assert 54 < columns.min() < columns.max() < 510


@pytest.mark.parametrize("angle", [0.0, 0.4, math.pi / 4, 3.0, -1e5])
def test_jack_has_blue_arms_and_red_feet(angle: float) -> None:
    renderer = renderer_at(state(box=(0.0, 0.0, 0.1), jack=(-2.0, 1.5, angle)))
    frame = draw(renderer)
    for foot in range(4):
        direction = angle + foot * math.pi / 2.0
        for share, is_blue, is_red in ((0.0, True, False), (0.3, True, False), (0.6, True, False), (1.0, False, True)):
            place = renderer.to_pixels(
                -2.0 + share * ARM * math.cos(direction), 1.5 + share * ARM * math.sin(direction)
            )
            colour = pixel(frame, place)
            assert bool(blue(colour)) == is_blue
            assert bool(red(colour)) == is_red
        beyond = renderer.to_pixels(-2.0 + 1.5 * math.cos(direction), 1.5 + 1.5 * math.sin(direction))
        assert not red(pixel(frame, beyond))


def test_edges_are_smooth() -> None:
    """A turned wall shows shades between red and white, and a tenth of a degree moves them."""
    frame = draw(renderer_at(state(box=(0.0, 0.0, 0.1))))
    shades = np.unique(frame[200:300, 400:480, 1])
    assert len(shades) > 20
    assert (frame != draw(renderer_at(state(box=(0.0, 0.0, 0.1 + math.radians(0.1)))))).any()


# -- the background --------------------------------------------------------------------------------------------------


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


def test_background_moves_and_the_box_does_not() -> None:
    high = draw(renderer_at(state()))
    low = draw(renderer_at(state(box=(0.0, -1.0, 0.0), jack=(0.0, -1.0, 0.0))))
    np.testing.assert_array_equal(red(high), red(low))
    assert (high[40:430, :54] != low[40:430, :54]).any()
    assert (high[40:430, 495:] != low[40:430, 495:]).any()


def test_height_labels_stand_at_their_heights(words: Words) -> None:
    renderer = renderer_at(state(box=(0.0, -20.3, 0.0), jack=(0.0, -20.3, 0.0)))
    draw(renderer)
    for height in (14, 16, 18, 20, 22, 24, 26):
        place = words[f"\N{MINUS SIGN}{height} m"]
        assert place[1] == pytest.approx(renderer.to_pixels(0.0, -height)[1])


@pytest.mark.parametrize(
    ("half_width", "height", "label"), [(1e-3, 0.0, "0.5 mm"), (1e6, 0.0, "0.5 Mm"), (6.0, 1e9, "…0002 m")]
)
def test_height_labels_of_other_sizes(half_width: float, height: float, label: str, words: Words) -> None:
    scene = Scene(box_half_width=half_width, jack_arm=0.2 * half_width)
    draw(renderer_at(state(box=(0.0, height, 0.0), jack=(0.0, height, 0.0)), scene))
    assert label in words


# -- the trail -------------------------------------------------------------------------------------------------------


def paleness(frame: Frame, point: tuple[float, float]) -> int:
    """How blue the trail is at a point: blue less red, 0 on white."""
    colour = pixel(frame, point)
    return colour[2] - colour[0]


def test_trail_follows_the_jack_through_the_world_fades_and_ends() -> None:
    """The jack moves along a slope, the box sinks: the trail stays where the jack was."""
    renderer = renderer_at(state(jack=(-4.0, 2.5, 0.0)))
    for step in range(1, 41):
        now = state(box=(0.0, -0.01 * step, 0.0), jack=(-4.0 + 0.17 * step, 2.5 - 0.03 * step, 0.0))
        renderer.record(now, 0.02 * step, 0.0, [])
    frame = draw(renderer)
    ages = [5 * count for count in range(3, 8)]  # steps ago
    shades = []
    for age in ages:
        step = 40 - age
        shades.append(paleness(frame, renderer.to_pixels(-4.0 + 0.17 * step, 2.5 - 0.03 * step)))
    assert all(new > old > 5 for new, old in pairwise(shades))
    # a second later nothing of it is left
    for step in range(41, 91):
        renderer.record(now, 0.02 * step, 0.0, [])
    clean = renderer_at(now)
    assert not changed(draw(renderer), draw(clean)).any()


def test_reset_forgets_everything() -> None:
    renderer = renderer_at(state(jack=(-4.0, 0.0, 0.0)))
    for step in range(30):
        renderer.record(state(jack=(-4.0 + 0.2 * step, 0.0, 0.0)), 0.02 * step, 5e4, [Impact(0.02 * step, 0, 0, 9.0)])
    still = state(jack=(1.0, 0.0, 0.0))
    fresh = draw(renderer_at(still, time=0.6))
    assert changed(draw(renderer), fresh).any()
    renderer.reset(still, 0.6)
    np.testing.assert_array_equal(draw(renderer), fresh)


def test_beads_lie_on_the_trail_to_a_fraction_of_a_pixel() -> None:
    """The darkness of a lone bead has its centre where the jack's was."""
    for x, y in ((2.513, 0.97), (2.52, 0.96), (2.53, 0.95), (2.54, 0.94)):  # [m] between the ruled lines
        renderer = renderer_at(state(jack=(x, y, 0.0)))
        renderer.record(state(jack=(-4.0, -4.0, 0.0)), 0.02, 0.0, [])
        place = renderer.to_pixels(x, y)
        column, row = round(place[0]), round(place[1])
        darkness = 255 - draw(renderer)[row - 6 : row + 7, column - 6 : column + 7, 0].astype(int)
        bead = middle(darkness)
        assert column - 6 + bead[0] == pytest.approx(place[0], abs=0.2)
        assert row - 6 + bead[1] == pytest.approx(place[1], abs=0.2)


def test_time_may_go_back() -> None:
    renderer = renderer_at(state(), time=50.0)
    renderer.record(state(), -50.0, 0.0, [Impact(-10.0, 0, 0, 1.0)])
    draw(renderer)


def test_memory_is_bounded() -> None:
    renderer = renderer_at(state())
    sizes = []
    for step in range(1, 3001):
        renderer.record(state(), 0.02 * step, 0.0, [Impact(0.02 * step, 0, 0, 1.0)] * 3)
        if step in (500, 3000):
            sizes.append(len(pickle.dumps(renderer)))
    assert sizes[1] <= sizes[0] + 10  # the count itself


def test_record_keeps_a_copy_of_the_state() -> None:
    given = np.array(state(jack=(1.0, 1.0, 0.2)))
    renderer = renderer_at(state())
    renderer.record(given, 0.02, 0.0, [])
    before = draw(renderer)
    given[:] = 3.0
    np.testing.assert_array_equal(draw(renderer), before)


# -- the flashes -----------------------------------------------------------------------------------------------------


def on_wall(wall: int, foot: int, box_angle: float, sideways: float) -> tuple[list[float], tuple[float, float]]:
    """A state whose foot touches a wall, its arm 0.4 rad from the normal, and the place of that foot."""
    normal = box_angle + wall * math.pi / 2.0
    cosine, sine = math.cos(normal), math.sin(normal)
    place = (2.0 + L * cosine - sideways * sine, -3.0 + L * sine + sideways * cosine)
    arm = normal + 0.4
    jack = (place[0] - ARM * math.cos(arm), place[1] - ARM * math.sin(arm), arm - foot * math.pi / 2.0)
    return state(box=(2.0, -3.0, box_angle), jack=jack), place


@pytest.mark.parametrize(("wall", "foot", "sideways"), [(0, 0, 1.0), (1, 3, -2.0), (2, 1, 4.0), (3, 2, -4.5)])
def test_flash_shows_where_the_foot_hit(wall: int, foot: int, sideways: float) -> None:
    """Its centre and size are those of what an impact changes in the frame."""
    touching, place = on_wall(wall, foot, 0.25, sideways)
    away = [*touching[:3], 2.0, -3.0, *touching[5:]]  # the jack has gone on, the flash stays
    flashed, plain = renderer_at(touching), renderer_at(touching)
    flashed.record(touching, 0.02, 0.0, [Impact(0.02, wall, foot, 50.0)])
    plain.record(touching, 0.02, 0.0, [])
    for renderer in (flashed, plain):
        renderer.record(away, 0.04, 0.0, [])
    glow = changed(draw(flashed), draw(plain))
    expected = flashed.to_pixels(*place)
    rows, columns = np.nonzero(glow)
    assert 0.5 * (columns.min() + columns.max()) == pytest.approx(expected[0], abs=1.5)
    assert 0.5 * (rows.min() + rows.max()) == pytest.approx(expected[1], abs=1.5)
    assert 20 <= np.ptp(columns) <= 50
    assert np.ptp(rows) == pytest.approx(np.ptp(columns), abs=4)


def test_flash_is_placed_at_the_time_of_the_impact() -> None:
    """The foot has slid 0.3 m along the wall between the impact and the end of the step."""
    touching, place = on_wall(0, 0, 0.0, 1.0)
    later = touching.copy()
    later[4] += 0.3
    later[10] = 30.0  # [m/s] for 0.01 s
    flashed, plain = renderer_at(touching), renderer_at(touching)
    flashed.record(later, 0.02, 0.0, [Impact(0.01, 0, 0, 50.0)])
    plain.record(later, 0.02, 0.0, [])
    rows = np.nonzero(changed(draw(flashed), draw(plain)))[0]
    assert 0.5 * (rows.min() + rows.max()) == pytest.approx(flashed.to_pixels(*place)[1], abs=2.0)


def test_flash_fades_within_a_quarter_of_a_second() -> None:
    touching, _ = on_wall(3, 0, 0.1, 0.0)
    flashed, plain = renderer_at(touching), renderer_at(touching)
    strengths = []
    for step in range(1, 16):
        flashed.record(touching, 0.02 * step, 0.0, [Impact(0.02, 3, 0, 50.0)] if step == 1 else [])
        plain.record(touching, 0.02 * step, 0.0, [])
        strengths.append(int(changed(draw(flashed), draw(plain)).sum()))
    assert strengths[0] > 10_000
    assert strengths[9] < 0.6 * strengths[0]
    assert all(new >= old for new, old in pairwise(strengths))
    assert strengths[11] > 0  # 0.22 s after the impact
    assert strengths[14] == 0  # 0.28 s


def test_harder_impacts_flash_larger() -> None:
    touching, _ = on_wall(3, 0, 0.1, 0.0)
    plain = renderer_at(touching)
    plain.record(touching, 0.02, 0.0, [])
    areas = []
    for impulse in (0.1, 20.0, 1e300):
        flashed = renderer_at(touching)
        flashed.record(touching, 0.02, 0.0, [Impact(0.02, 3, 0, impulse)])
        areas.append(np.count_nonzero(changed(draw(flashed), draw(plain))))
    assert areas[0] < areas[1] < areas[2] < 2500


# -- the readings ----------------------------------------------------------------------------------------------------


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


# -- copies, sizes, and others in the same process -------------------------------------------------------------------


@pytest.mark.parametrize("duplicate", [lambda one: pickle.loads(pickle.dumps(one)), copy.deepcopy])
@pytest.mark.parametrize("drawn_before", [False, True])
def test_copies_draw_the_same_and_go_on_alike(duplicate: Callable[[Renderer], Renderer], drawn_before: bool) -> None:
    simulator = make_simulator(Scene())
    simulator.reset(state(jack=(0.5, 0.3, 0.3)))
    renderer = renderer_at(simulator.state.tolist())

    def go_on(*renderers: Renderer) -> None:
        for _ in range(58):
            simulator.step(0.02)
            for one in renderers:
                one.record(simulator.state, simulator.time, simulator.torque, simulator.impacts)

    go_on(renderer)
    if drawn_before:
        draw(renderer)
    twin = duplicate(renderer)
    np.testing.assert_array_equal(draw(twin), draw(renderer))
    alone = draw(twin)
    go_on(renderer)
    np.testing.assert_array_equal(draw(twin), alone)  # nothing is shared
    twin = duplicate(renderer)
    go_on(renderer, twin)
    np.testing.assert_array_equal(draw(twin), draw(renderer))


@pytest.mark.parametrize("half_width", [1e-25, 1e-3, 1.0, 1e6, 1e25])
@pytest.mark.parametrize("arm", [1e-3, 0.2, 0.99, 1.41])
@pytest.mark.parametrize("distance", [0.0, 1e9, 1e300])
def test_any_size_anywhere_is_drawn(half_width: float, arm: float, distance: float, words: Words) -> None:
    scene = Scene(box_half_width=half_width, jack_arm=arm * half_width)
    start = state(box=(distance, -distance, 1e9), jack=(distance, -distance, 1e12))
    renderer = renderer_at(start, scene)
    start[6:] = [1e8 * distance] * 6
    renderer.record(start, 1e9, 1e60, [Impact(1e9 - 10.0, 2, 3, 1e60)])
    frame = draw(renderer)
    assert np.count_nonzero(red(frame)) > 4 * 290 * 4
    hub = pixel(frame, (283, 256))  # in the middle of the box; the feet of a very small jack cover it
    assert blue(hub) or (arm < 0.01 and red(hub))
    assert len(words) < 20
    assert max(map(len, words)) < 24


@pytest.mark.parametrize("away", [20.0, -1e3, 1e9, 1e300, -1.7e308])
def test_a_jack_far_outside_is_left_out(away: float) -> None:
    renderer = renderer_at(state(jack=(away, 0.0, 0.5)))
    renderer.record(state(box=(-away, 0.0, 0.0), jack=(away, away, 0.5)), 0.02, 0.0, [Impact(0.02, 0, 0, 1.0)])
    frame = draw(renderer)
    assert np.count_nonzero(red(frame)) > 4 * 290 * 4
    assert not blue(frame).any()


def test_a_jack_across_the_edge_of_the_frame_is_cut() -> None:
    """Every place along the four edges, some arms inside and some outside."""
    seen = 0
    for angle in np.linspace(0.0, 2.0 * math.pi, 41):
        renderer = renderer_at(state(jack=(10.0 * math.cos(angle), 10.0 * math.sin(angle), 3.0 * float(angle))))
        frame = draw(renderer)
        rows, columns = np.nonzero(blue(frame))
        x, y = renderer.to_pixels(10.0 * math.cos(angle), 10.0 * math.sin(angle))
        assert (np.hypot(columns - x, rows - y) < 30.0).all()
        seen += len(rows) > 0
    assert seen > 20


def test_closing_one_leaves_the_others_alive() -> None:
    one, other = renderer_at(state()), renderer_at(state())
    expected = draw(other)
    draw(one)
    one.close()
    one.close()
    np.testing.assert_array_equal(draw(other), expected)


def test_another_environment_may_quit_pygame(words: Words) -> None:
    renderer = renderer_at(state())
    draw(renderer)
    pygame.quit()
    renderer.record(state(), 12.34, 0.0, [])  # a text never written before needs the font itself
    frame = draw(renderer)
    assert "t = 12.34 s" in words
    fresh = renderer_at(state())
    fresh.record(state(), 12.34, 0.0, [])
    np.testing.assert_array_equal(frame, draw(fresh))


def python(code: str, **environment: str) -> str:
    """Run code in an interpreter of its own and return what it prints."""
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        env={**os.environ, "PYGAME_HIDE_SUPPORT_PROMPT": "1", **environment},
        timeout=120,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


def test_importing_does_not_import_pygame() -> None:
    assert python("import sys, jackbox_env.rendering; print('pygame' in sys.modules)") == "False"


def test_arrays_need_no_display() -> None:
    code = (
        "from jackbox_env.rendering import Renderer; from jackbox_env.scene import Scene; import pygame\n"
        "renderer = Renderer(Scene(), 'rgb_array', 50); renderer.reset([0.0] * 12, 0.0)\n"
        "print(renderer.render().shape, pygame.display.get_init()); renderer.close()"
    )
    assert python(code, SDL_VIDEODRIVER="no such driver") == "(512, 512, 3) False"


def test_missing_pygame_is_named_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(gym.error.DependencyNotInstalled, match=r'pip install "jackbox\[render\]"'):
        Renderer(Scene(), "rgb_array", 50)


# -- the window ------------------------------------------------------------------------------------------------------


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> Iterator[Callable[[], Renderer]]:
    """Makes renderers of the human mode on a display that nobody sees."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    made: list[Renderer] = []

    def make() -> Renderer:
        renderer = Renderer(Scene(), "human", 1000)
        renderer.reset(state(jack=(0.0, 1.0, 0.5)), 0.0)
        made.append(renderer)
        return renderer

    yield make
    for renderer in made:
        renderer.close()
    pygame.display.quit()


def window() -> Frame:
    shown: Frame = np.transpose(pygame.surfarray.array3d(pygame.display.get_surface()), (1, 0, 2))
    return shown


def test_window_shows_the_same_frame(windows: Callable[[], Renderer]) -> None:
    renderer = windows()
    assert renderer.render() is None
    np.testing.assert_array_equal(window(), draw(renderer_at(state(jack=(0.0, 1.0, 0.5)))))
    renderer.record(state(jack=(0.0, -1.0, 0.5)), 0.02, 0.0, [])
    assert renderer.render() is None
    assert pygame.display.get_surface().get_size() == (512, 512)
    renderer.close()
    renderer.close()
    assert not pygame.display.get_init()


def test_window_is_paced_and_its_events_are_pumped(
    windows: Callable[[], Renderer], monkeypatch: pytest.MonkeyPatch
) -> None:
    paces, pumps, flips = [], [], []

    class Clock:
        def tick(self, pace: float) -> None:
            paces.append(pace)

    pump, flip = pygame.event.pump, pygame.display.flip
    monkeypatch.setattr(pygame.time, "Clock", Clock)
    monkeypatch.setattr(pygame.event, "pump", lambda: pumps.append(pump()))
    monkeypatch.setattr(pygame.display, "flip", lambda: flips.append(flip()))
    renderer = windows()
    for _ in range(3):
        renderer.render()
    assert paces == [1000] * 3
    assert len(pumps) == len(flips) == 3


def test_closing_one_window_leaves_the_other(windows: Callable[[], Renderer]) -> None:
    one, other = windows(), windows()
    one.render()
    other.render()
    one.close()
    assert pygame.display.get_init()
    other.record(state(jack=(2.0, 1.0, 0.5)), 0.02, 0.0, [])
    other.render()
    assert blue(window()).any()
    other.close()
    assert not pygame.display.get_init()


@pytest.mark.parametrize("disturb", [lambda: pygame.quit(), lambda: pygame.display.set_mode((600, 400))])
def test_window_survives_others(windows: Callable[[], Renderer], disturb: Callable[[], object]) -> None:
    renderer = windows()
    renderer.render()
    expected = window()
    disturb()
    renderer.render()
    np.testing.assert_array_equal(window(), expected)


def test_closing_leaves_a_window_that_somebody_else_has_taken(windows: Callable[[], Renderer]) -> None:
    renderer = windows()
    renderer.render()
    theirs = pygame.display.set_mode((600, 400))
    renderer.close()
    assert pygame.display.get_init()
    theirs.fill((1, 2, 3))


def test_copies_of_a_window_can_be_drawn(windows: Callable[[], Renderer]) -> None:
    renderer = windows()
    renderer.render()
    expected = window()
    twin = pickle.loads(pickle.dumps(renderer))
    renderer.close()
    assert twin.render() is None
    np.testing.assert_array_equal(window(), expected)
    twin.close()
    assert not pygame.display.get_init()
