"""The renderer in its process: copies, sizes, other users of pygame, the window."""

from __future__ import annotations

import copy
import math
import os
import pickle
import subprocess
import sys
from collections.abc import Callable, Iterator

import gymnasium as gym
import numpy as np
import pytest

from jackbox_env.rendering import Renderer
from jackbox_env.scene import Scene
from jackbox_env.simulators import Impact, make_simulator
from tests.rendering.pixels import Frame, Words, blue, draw, pixel, red, renderer_at, state

pygame = pytest.importorskip("pygame")


# -- copies, sizes, and others in the same process ---------------------------------------------------------------------


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


@pytest.mark.parametrize("half_width", [1e-25, 1.0, 1e25])
@pytest.mark.parametrize("arm", [1e-3, 0.2, 1.41])
@pytest.mark.parametrize("distance", [0.0, 1e300])
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


@pytest.mark.parametrize("away", [20.0, 1e9, -1.7e308])
def test_a_jack_far_outside_is_left_out(away: float) -> None:
    renderer = renderer_at(state(jack=(away, 0.0, 0.5)))
    renderer.record(state(box=(-away, 0.0, 0.0), jack=(away, away, 0.5)), 0.02, 0.0, [Impact(0.02, 0, 0, 1.0)])
    frame = draw(renderer)
    assert np.count_nonzero(red(frame)) > 4 * 290 * 4
    assert not blue(frame).any()


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


def test_a_picture_shows_the_scene_that_holds() -> None:
    env = gym.make("JackInBox-v0", render_mode="rgb_array")
    start = np.zeros(12)
    start[5] = math.pi / 4.0
    env.reset(options={"state": start})
    default = env.render()
    env.reset(options={"state": start, "scene": {"jack_arm": 3.0}})
    other = env.render()
    alone = gym.make("JackInBox-v0", render_mode="rgb_array", scene={"jack_arm": 3.0})
    alone.reset(options={"state": start})
    np.testing.assert_array_equal(other, alone.render())
    assert not np.array_equal(other, default)  # type: ignore[arg-type]


def test_arrays_need_no_display() -> None:
    code = (
        "from jackbox_env.rendering import Renderer; from jackbox_env.scene import Scene; import pygame\n"
        "renderer = Renderer(Scene(), 'rgb_array', 50); renderer.reset([0.0] * 12, 0.0)\n"
        "print(renderer.render().shape, pygame.display.get_init()); renderer.close()"
    )
    assert python(code, SDL_VIDEODRIVER="no such driver") == "(512, 512, 3) False"


def test_missing_pygame_is_named_in_a_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(gym.error.DependencyNotInstalled, match=r'in a checkout .*pip install -e "\.\[render\]"'):
        Renderer(Scene(), "rgb_array", 50)


# -- the window --------------------------------------------------------------------------------------------------------


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
