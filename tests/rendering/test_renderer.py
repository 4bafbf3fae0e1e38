"""The renderer in its process: copies, sizes, other users of pygame, the window."""

from __future__ import annotations

import copy
import math
import os
import pickle
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from types import SimpleNamespace
from typing import Any

import numpy as np
import pygame
import pytest

from jackbox_env import JackInBoxEnv
from jackbox_env.model.scene import Scene
from jackbox_env.render.renderer import Renderer
from jackbox_env.simulators import Impact
from tests.rendering.pixels import Frame, Words, blue, draw, pixel, red, renderer_at, state

# -- copies, sizes, and others in the same process ---------------------------------------------------------------------


@pytest.mark.parametrize("duplicate", [lambda one: pickle.loads(pickle.dumps(one)), copy.deepcopy])
def test_copies_draw_the_same_and_go_on_alike(duplicate: Callable[[Renderer], Renderer]) -> None:
    renderer = renderer_at(state())
    renderer.record(state(jack=(0.3, 0.1, 0.3)), 0.02, 4e4, [Impact(0.02, 0, 0, 9.0)], 0.5)
    before = draw(renderer)
    twin, later = duplicate(renderer), duplicate(renderer)
    for one in (renderer, later):
        one.record(state(jack=(0.9, 0.1, 0.3)), 0.04, 4e4, [Impact(0.04, 0, 1, 9.0)], 0.5)
    np.testing.assert_array_equal(draw(twin), before)  # nothing is shared
    np.testing.assert_array_equal(draw(later), draw(renderer))


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
    hub = pixel(frame, (256, 256))  # in the middle of the box; the feet of a very small jack cover it
    assert blue(hub) or (arm < 0.01 and red(hub))
    assert len(words) < 24
    assert max(map(len, words)) < 24


def test_others_may_close_theirs_and_quit_pygame(words: Words) -> None:
    renderer, other, fresh = (renderer_at(state()) for _ in range(3))
    draw(renderer)
    other.close()
    pygame.quit()
    renderer.record(state(), 12.34, 0.0, [])  # a text never written before needs the font itself
    frame = draw(renderer)
    assert "t = 12.34 s" in words
    fresh.record(state(), 12.34, 0.0, [])
    np.testing.assert_array_equal(frame, draw(fresh))


def test_a_picture_shows_the_scene_that_holds() -> None:
    start = np.eye(12)[5] * math.pi / 4.0
    env, alone = (JackInBoxEnv(render_mode="rgb_array", scene={"jack_arm": arm}) for arm in (1.0, 3.0))
    alone.reset(options={"state": start})
    env.reset(options={"state": start, "scene": {"jack_arm": 3.0}})
    np.testing.assert_array_equal(env.render(), alone.render())
    env.reset(options={"state": start, "scene": {}})
    assert not np.array_equal(env.render(), alone.render())


def test_arrays_need_no_display() -> None:
    code = (
        "from jackbox_env.render.renderer import Renderer; from jackbox_env.model.scene import Scene; import pygame\n"
        "renderer = Renderer(Scene(), 'rgb_array', 50); renderer.reset([0.0] * 12, 0.0)\n"
        "assert renderer.render().shape == (512, 512, 3); assert not pygame.display.get_init(); renderer.close()"
    )
    subprocess.run([sys.executable, "-c", code], env={**os.environ, "SDL_VIDEODRIVER": "no such driver"}, check=True)


# -- the window --------------------------------------------------------------------------------------------------------


@pytest.fixture
def windows(monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[Renderer, Renderer]]:
    """Two renderers of the human mode, of 320 x 240, on a virtual display."""
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    one, other = (Renderer(Scene(), "human", 1000, size=(320, 240)) for _ in range(2))
    yield one, other
    one.close()
    other.close()
    pygame.display.quit()


def shown_by(renderer: Any) -> Frame:
    shown: Frame = np.transpose(pygame.surfarray.array3d(renderer._window.get_surface()), (1, 0, 2))
    return shown


def test_window_shows_the_frame_and_is_paced(
    windows: tuple[Renderer, Renderer], monkeypatch: pytest.MonkeyPatch
) -> None:
    done: list[object] = []
    pump = pygame.event.pump
    monkeypatch.setattr(pygame.time, "Clock", lambda: SimpleNamespace(tick=done.append))
    monkeypatch.setattr(pygame.event, "pump", lambda: done.append(("pumped", pump())))
    for _ in range(2):
        assert windows[0].render() is None
    np.testing.assert_array_equal(shown_by(windows[0]), draw(Renderer(Scene(), "rgb_array", 1000, size=(320, 240))))
    assert done == [("pumped", None), 1000] * 2


def test_closing_one_window_leaves_the_other(windows: tuple[Renderer, Renderer]) -> None:
    one, other = windows
    one.render()
    other.render()
    assert copy.deepcopy(one).render() is None
    one.close()
    one.close()
    assert one._window is None
    other.record(state(jack=(2.0, 1.0, 0.5)), 0.02, 0.0, [])
    other.render()
    assert blue(shown_by(other)).any()


@pytest.mark.parametrize("disturb", [lambda: pygame.quit(), lambda: pygame.display.set_mode((600, 400))])
def test_window_survives_others_and_leaves_theirs(
    windows: tuple[Renderer, Renderer], disturb: Callable[[], object]
) -> None:
    windows[0].render()
    expected = shown_by(windows[0])
    disturb()
    windows[0].render()
    np.testing.assert_array_equal(shown_by(windows[0]), expected)
    theirs = pygame.display.set_mode((600, 400))
    windows[0].close()
    assert pygame.display.get_surface() is theirs


@pytest.mark.parametrize(
    ("number", "close", "setting"),
    [
        (signal.SIGINT, False, {}),
        (signal.SIGTERM, True, {"SDL_NO_SIGNAL_HANDLERS": "0"}),  # the user wants SDL's own
    ],
)
def test_signals_end_a_process_with_a_window_unless_the_user_leaves_them_to_sdl(
    number: int, close: bool, setting: dict[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    code = (
        "import os, signal; from jackbox_env import Scene; from jackbox_env.render.renderer import Renderer\n"
        "signal.signal(signal.SIGINT, signal.SIG_DFL); renderer = Renderer(Scene(), 'human', 50); renderer.render()\n"
        f"renderer.close() if {close} else None; os.kill(os.getpid(), {int(number)})"
    )
    monkeypatch.delenv("SDL_NO_SIGNAL_HANDLERS", raising=False)  # of other windows
    child = subprocess.run([sys.executable, "-c", code], env={**os.environ, "SDL_VIDEODRIVER": "dummy", **setting})
    assert child.returncode == (0 if setting else -number)
