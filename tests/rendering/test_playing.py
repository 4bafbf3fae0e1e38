"""The window that a person plays in, on a display that nobody sees."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

from jackbox_env import playing_window
from jackbox_env.playing_window import LOADING, NO_AGENT, Game, Window
from jackbox_env.simulators import JackLostError

pygame = pytest.importorskip("pygame")
ROOT = Path(__file__).parents[2]
DT = 0.02


class Constant:
    """A policy that remembers how often it was asked."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        assert observation.shape == (10,)
        assert deterministic
        assert episode_start.tolist() == [state is None]
        return np.array([0.25], dtype=np.float32), (state or 0) + 1


def game_of(**settings: Any) -> Game:
    return Game(gym.make("JackInBox-v0", render_mode="rgb_array", **settings), seed=1)


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> Iterator[Window]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    made = Window(game_of(), Constant)
    yield made
    made.close()


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Every string written into the panel and onto the picture."""
    strings: list[str] = []
    write = Window._write

    def noting(self: Window, text: str, *rest: Any, **more: Any) -> None:
        strings.append(text)
        write(self, text, *rest, **more)

    monkeypatch.setattr(Window, "_write", noting)
    return strings


def press(window: Window, *keys: int, seconds: float = 0.0) -> None:
    """Press keys, and show a frame after so much time."""
    for key in keys:
        pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
    window.frame(seconds)


def let_go(window: Window, *keys: int) -> None:
    for key in keys:
        pygame.event.post(pygame.event.Event(pygame.KEYUP, key=key))
    window.frame(0.0)


def torque(window: Window) -> float:
    """What the next step's torque is, in units of its limit."""
    env: Any = window.game.env.unwrapped
    window.game.step()
    return float(env._simulator.torque / env.scene.torque_limit)


def picture() -> np.ndarray[Any, Any]:
    return np.transpose(pygame.surfarray.array3d(pygame.display.get_surface()), (1, 0, 2))


def test_arrows_push_as_long_as_they_are_held(window: Window) -> None:
    press(window, pygame.K_LEFT)
    assert torque(window) == 1.0
    assert window.game.acting() == "you"
    press(window, pygame.K_RIGHT)
    assert window.game.push == 0.0
    let_go(window, pygame.K_LEFT)
    assert torque(window) == -1.0
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    window.frame(0.0)
    assert window.game.acting() == "chirp"


def test_the_chirp_acts_without_a_key_until_c(window: Window) -> None:
    assert torque(window) != 0.0
    press(window, pygame.K_c)
    assert window.game.acting() == "nobody"
    assert torque(window) == 0.0
    press(window, pygame.K_c)
    assert torque(window) != 0.0


SPEEDS: list[tuple[tuple[str, ...], float]] = [
    ((), 1.0),
    (("PLUS",) * 9, 4.0),
    (("MINUS",) * 9, 0.25),
    (("EQUALS",), 2.0),
]


@pytest.mark.parametrize(("keys", "speed"), SPEEDS)
def test_time_passes_at_the_speed_that_is_chosen(window: Window, keys: tuple[str, ...], speed: float) -> None:
    press(window, *(getattr(pygame, f"K_{key}") for key in keys))
    assert window.game.speed == speed
    for _ in range(40):
        window.frame(0.02)
    assert window.game.steps == pytest.approx(40 * speed, abs=1)
    window.frame(60.0)  # somebody has slept: at most a tenth of a second is made up for
    assert window.game.steps <= 40 * speed + 0.1 * speed / DT + 1


def test_space_pauses_and_the_dot_takes_a_step(window: Window, written: list[str]) -> None:
    press(window, pygame.K_SPACE, seconds=0.1)
    assert window.game.steps == 0
    assert any(text.startswith("Paused") for text in written)
    press(window, pygame.K_PERIOD, seconds=0.1)
    press(window, pygame.K_PERIOD, seconds=0.1)
    assert window.game.steps == 2
    press(window, pygame.K_SPACE, seconds=0.1)
    assert window.game.steps == 7


def test_an_episodes_end_is_shown_and_r_starts_the_next(window: Window, written: list[str]) -> None:
    total = 0.0
    for _ in range(500):
        assert not window.game.over
        before = window.game.earned
        window.game.step()
        total += window.game.earned - before
    window.frame(0.1)
    assert {"Episode over: the best so far", f"return {total:.1f}   -   R starts the next", f"{total:.1f}"} <= set(
        written
    )
    press(window, pygame.K_PERIOD, seconds=0.1)
    assert window.game.steps == 500
    first: Any = window.game.env.unwrapped
    start = first.state
    written.clear()
    press(window, pygame.K_r, pygame.K_SPACE)
    assert (window.game.steps, window.game.earned, window.game.over) == (0, 0.0, "")
    assert (first.state != start).any()
    assert {"0.0", f"{total:.1f}", "juggle"} <= set(written)  # return, best, task


def test_only_a_better_whole_episode_is_the_best() -> None:
    game = game_of()
    game.best = 1e6
    for _ in range(500):
        game.step()
    assert (game.best, game.over) == (1e6, "Episode over")
    game.restart()
    game.step()
    game.restart()
    assert game.best == 1e6


def test_p_hands_over_to_the_trained_agent_and_back(window: Window, written: list[str]) -> None:
    press(window, pygame.K_p)
    assert LOADING in written
    assert window.note == ""
    assert window.game.acting() == "trained agent"
    assert torque(window) == 0.25
    assert torque(window) == 0.25
    assert window.game._memory == 2
    press(window, pygame.K_LEFT)
    assert torque(window) == 1.0  # whoever holds a key acts
    let_go(window, pygame.K_LEFT)
    assert torque(window) == 0.25
    assert window.game._memory == 1  # and the agent decides anew
    press(window, pygame.K_p)
    assert window.game.acting() == "chirp"


def test_p_says_what_it_needs_where_there_is_no_agent(window: Window, written: list[str]) -> None:
    def missing() -> Any:
        raise FileNotFoundError("no such folder")

    window._trained = None
    press(window, pygame.K_p)
    assert NO_AGENT in written
    window._trained = missing
    press(window, pygame.K_p)
    assert window.note == "there is no trained agent for this"
    assert window.game.agent is None


def test_a_lost_jack_ends_the_episode(window: Window, written: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def lost(action: Any) -> Any:
        raise JackLostError("the jack would leave the box")

    with monkeypatch.context() as patch:
        patch.setattr(window.game.env, "step", lost)
        window.frame(0.1)
    assert "The jack left the box" in written
    press(window, pygame.K_r, seconds=0.1)
    assert window.game.steps == 5


def test_the_picture_is_the_environments_beside_the_panel(window: Window) -> None:
    window.frame(0.0)
    np.testing.assert_array_equal(picture()[:, :512], window.game.env.render())
    assert picture().shape == (512, 512 + playing_window.PANEL, 3)


@pytest.mark.parametrize("key", ["ESCAPE", "q"])
def test_escape_closes_the_window(window: Window, key: str) -> None:
    press(window, getattr(pygame, f"K_{key}"))
    assert not window.open


@pytest.mark.parametrize(
    ("driver", "sentence"),
    [
        ("", "there is no display to play on: start this on a desktop \\("),
        ("nonsense", "there is no display to play on: SDL_VIDEODRIVER=nonsense gives none \\("),
    ],
)
def test_without_a_display_it_says_so(driver: str, sentence: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pygame.display.quit()
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    if driver:
        monkeypatch.setenv("SDL_VIDEODRIVER", driver)
    with pytest.raises(RuntimeError, match=sentence):
        Window(game_of())
    assert not pygame.display.get_init()


def test_the_command_plays_with_the_shipped_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(sys, "argv", ["play.py", "--seed", "3", "--quiet", "--task", "spin"])
    seen: list[str] = []
    frame = Window.frame

    def acted(self: Window, seconds: float) -> None:
        pressed = [pygame.K_p] if len(seen) == 1 else [pygame.K_ESCAPE] if len(seen) == 3 else []
        for key in pressed:
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=key))
        frame(self, seconds)
        seen.append(f"{self.game.task}: {self.game.acting()}")

    monkeypatch.setattr(Window, "frame", acted)
    runpy.run_path(str(ROOT / "scripts" / "play.py"), run_name="__main__")
    assert seen == ["spin: nobody", *["spin: trained agent"] * 3]
    assert not pygame.display.get_init()
