"""The window of `jackbox play`, on a virtual display."""

from __future__ import annotations

import runpy
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import gymnasium as gym
import numpy as np
import pygame
import pytest

from jackbox_env.render.window import LOADING, NO_AGENT, PANEL, Game, GameWindow
from jackbox_env.simulators import JackLostError

ROOT = Path(__file__).parents[2]


class Constant:
    """A policy that counts its predictions."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        assert (observation.shape, deterministic, episode_start.tolist()) == ((10,), True, [state is None])
        return np.array([0.25], dtype=np.float32), (state or 0) + 1


def a_game() -> Game:
    return Game(gym.make("JackInBox-v0", render_mode="rgb_array"), seed=1)


@pytest.fixture
def window(monkeypatch: pytest.MonkeyPatch) -> Iterator[GameWindow]:
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    pygame.display.quit()
    made = GameWindow(a_game(), Constant)
    yield made
    made.close()


@pytest.fixture
def written(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Every string written into the panel and onto the picture."""
    strings: list[str] = []
    monkeypatch.setattr(GameWindow, "_write", lambda self, text, *rest, **more: strings.append(text))
    return strings


def press(window: GameWindow, *keys: int, seconds: float = 0.0, kind: int = pygame.KEYDOWN) -> None:
    """Press keys, and show a frame after so much time."""
    for key in keys:
        pygame.event.post(pygame.event.Event(kind, key=key))
    window.frame(seconds)


def torque(window: GameWindow) -> float:
    """The torque of the next step, in units of its limit."""
    env: Any = window.game.env.unwrapped
    window.game.step()
    return float(env._simulator.torque / env.scene.torque_limit)


def test_arrows_push_as_long_as_they_are_held(window: GameWindow) -> None:
    press(window, pygame.K_LEFT)
    assert (torque(window), window.game.acting()) == (1.0, "you")
    press(window, pygame.K_RIGHT)
    assert window.game.push == 0.0
    press(window, pygame.K_LEFT, kind=pygame.KEYUP)
    assert torque(window) == -1.0
    pygame.event.post(pygame.event.Event(pygame.WINDOWFOCUSLOST))
    window.frame(0.0)
    assert window.game.acting() == "chirp"


def test_the_chirp_acts_without_a_key_until_c(window: GameWindow) -> None:
    assert torque(window) != 0.0
    press(window, pygame.K_c)
    assert (torque(window), window.game.acting()) == (0.0, "nobody")
    press(window, pygame.K_c)
    assert torque(window) != 0.0


@pytest.mark.parametrize(("key", "presses", "speed"), [("EQUALS", 1, 2.0), ("PLUS", 9, 4.0), ("MINUS", 9, 0.25)])
def test_time_passes_at_the_speed_that_is_chosen(window: GameWindow, key: str, presses: int, speed: float) -> None:
    press(window, *[getattr(pygame, f"K_{key}")] * presses)
    assert window.game.speed == speed
    for _ in range(40):
        window.frame(0.02)
    assert window.game.steps == pytest.approx(40 * speed, abs=1)
    window.frame(60.0)  # somebody has slept: at most a tenth of a second is made up for
    assert window.game.steps <= 40 * speed + 0.1 * speed / 0.02 + 1


def test_space_pauses_and_the_dot_takes_a_step(window: GameWindow, written: list[str]) -> None:
    press(window, pygame.K_SPACE, seconds=0.1)
    assert window.game.steps == 0
    assert any(text.startswith("Paused") for text in written)
    for _ in range(2):
        press(window, pygame.K_PERIOD, seconds=0.1)
    assert window.game.steps == 2
    press(window, pygame.K_SPACE, seconds=0.1)
    assert window.game.steps == 7


def test_an_episodes_end_is_shown_and_r_starts_the_next(window: GameWindow, written: list[str]) -> None:
    game, alike = window.game, gym.make("JackInBox-v0")
    env: Any = game.env.unwrapped
    alike.reset(seed=1)
    total = sum(float(alike.step(None)[1]) for _ in range(500))
    for _ in range(500):
        assert not game.over
        game.step()
    start = env.state
    press(window, pygame.K_PERIOD, seconds=0.1)
    assert game.steps == 500
    assert game.earned == pytest.approx(total)
    assert {"Episode over", "R starts the next"} <= set(written)
    assert game.best is None  # nobody played
    written.clear()
    press(window, pygame.K_r, pygame.K_SPACE)
    assert (game.steps, game.earned, game.over) == (0, 0.0, "")
    assert (env.state != start).any()


def test_the_best_is_of_episodes_that_the_player_acted_in(window: GameWindow, written: list[str]) -> None:
    game = window.game
    press(window, pygame.K_LEFT, seconds=0.1)
    press(window, pygame.K_LEFT, kind=pygame.KEYUP)
    while not game.over:
        game.step()
    window.frame(0.0)
    assert {"Episode over: your best so far", f"{game.earned:.1f}"} <= set(written)
    for best, played, over in ((-1.0, False, "Episode over"), (1e6, True, "Episode over")):
        game.restart()
        game.best, game.push = best, float(played)
        while not game.over:
            game.step()
        assert (game.best, game.over) == (best, over)


def test_the_panel_does_not_repeat_the_picture(window: GameWindow, written: list[str]) -> None:
    window.frame(0.1)
    assert window.game.earned > 0.0
    assert {"juggle", f"{window.game.earned:.1f}"}.isdisjoint(written)


def test_p_hands_over_to_the_trained_agent_and_back(window: GameWindow, written: list[str]) -> None:
    press(window, pygame.K_p)
    assert LOADING in written
    assert (window.note, window.game.acting()) == ("", "trained agent")
    assert (torque(window), torque(window), window.game._memory) == (0.25, 0.25, 2)
    press(window, pygame.K_LEFT)
    assert torque(window) == 1.0  # a held key overrides
    press(window, pygame.K_LEFT, kind=pygame.KEYUP)
    assert (torque(window), window.game._memory) == (0.25, 1)  # and the agent decides anew
    press(window, pygame.K_p)
    assert window.game.acting() == "chirp"


def test_p_shows_a_message_if_there_is_no_agent(window: GameWindow, written: list[str]) -> None:
    def missing() -> Any:
        raise FileNotFoundError("no such folder")

    window._trained = None
    press(window, pygame.K_p)
    assert NO_AGENT in written
    window._trained = missing
    press(window, pygame.K_p)
    assert "no trained agent" in window.note
    assert window.game.agent is None


def test_a_lost_jack_ends_the_episode(window: GameWindow, written: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    def escape(action: Any) -> Any:
        raise JackLostError("the jack would leave the box")

    with monkeypatch.context() as patch:
        patch.setattr(window.game.env, "step", escape)
        window.frame(0.1)
    assert "The jack left the box" in written
    press(window, pygame.K_r, seconds=0.1)
    assert window.game.steps == 5


def test_the_picture_is_the_environments_beside_the_panel_until_escape(window: GameWindow) -> None:
    window.frame(0.0)
    shown = np.transpose(pygame.surfarray.array3d(pygame.display.get_surface()), (1, 0, 2))  # type: ignore[arg-type]
    assert shown.shape == (512, 512 + PANEL, 3)
    np.testing.assert_array_equal(shown[:, :512], window.game.env.render())
    press(window, pygame.K_ESCAPE)
    assert not window.open


@pytest.mark.parametrize(("driver", "named"), [("", "desktop"), ("nonsense", "nonsense")])
def test_without_a_display_the_window_raises_an_error(driver: str, named: str, monkeypatch: pytest.MonkeyPatch) -> None:
    pygame.display.quit()
    for name in ("DISPLAY", "WAYLAND_DISPLAY", "SDL_VIDEODRIVER"):
        monkeypatch.delenv(name, raising=False)
    if driver:
        monkeypatch.setenv("SDL_VIDEODRIVER", driver)
    with pytest.raises(RuntimeError, match=f"no display .*{named}"):
        GameWindow(a_game())
    assert not pygame.display.get_init()


def test_the_command_plays_with_the_shipped_agent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "argv", ["play.py", "--seed", "3", "--quiet", "--task", "spin", "--dt", "0.04"])
    seen: list[str] = []
    frame, pressed = GameWindow.frame, {1: pygame.K_p, 3: pygame.K_ESCAPE}

    def acted(self: GameWindow, seconds: float) -> None:
        if len(seen) in pressed:
            pygame.event.post(pygame.event.Event(pygame.KEYDOWN, key=pressed[len(seen)]))
        frame(self, seconds)
        env: Any = self.game.env.unwrapped
        seen.append(f"{env.task} by {env.control_dt} s: {self.game.acting()}")

    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    monkeypatch.setattr(GameWindow, "frame", acted)
    runpy.run_path(str(ROOT / "scripts" / "play.py"), run_name="__main__")
    assert seen == ["spin by 0.04 s: nobody", *["spin by 0.04 s: trained agent"] * 3]
    assert not pygame.display.get_init()
