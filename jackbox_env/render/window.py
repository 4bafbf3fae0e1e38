"""A window in which a person plays JackInBox-v0 with the keyboard."""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, Protocol

import gymnasium as gym
import numpy as np

from jackbox_env.colours import JACK, Colour
from jackbox_env.render.canvas import INK, PALE_INK, SIZE, TRACK, import_pygame, write
from jackbox_env.simulators import JackLostError

if TYPE_CHECKING:
    import pygame

SLOWEST, FASTEST = 0.25, 4.0  # simulated seconds in a second
FRAMES = 50  # in a second
_LONGEST = 0.1  # [s] of the clock that one frame advances by at most: a slow machine plays slower
PANEL = 248  # [px] width beside the picture
_EDGE = 20  # [px] of the panel
_PAPER: Colour = (250, 251, 253)
_RED: Colour = (190, 30, 36)
_DRIVERS = ("SDL_VIDEODRIVER", "SDL_VIDEO_DRIVER")  # variables that name SDL's driver
_INVISIBLE = ("offscreen", "dummy", "evdev")  # drivers without visible windows
NO_AGENT = "P needs a checkout of the project"
LOADING = "loading the trained agent ..."


class Predicts(Protocol):
    """A policy as those of Stable-Baselines3."""

    def predict(
        self, observation: Any, state: Any = None, episode_start: Any = None, deterministic: bool = False
    ) -> tuple[Any, Any]:
        """Return an action, and the state for the next call."""


class Game:
    """One environment, its episodes, and who acts in it, without windows and keys.

    Args:
        env: ``JackInBox-v0`` made with ``render_mode="rgb_array"``.
        seed: of the first start; None: drawn.
        chirp: whether the scene's drive acts if nobody else does.
    """

    def __init__(self, env: gym.Env[Any, Any], seed: int | None = None, chirp: bool = True) -> None:
        self.env, self.chirp = env, chirp
        self.control_dt: float = env.unwrapped.control_dt  # type: ignore[attr-defined]
        self.best: float | None = None  # return of a whole episode that the player acted in
        self.paused = False
        self.push = 0.0  # of the player, from -1 to 1
        self.agent: Predicts | None = None
        self.speed = 1.0  # simulated seconds in a second
        self.restart(seed)

    def faster(self, by: float) -> None:
        """Multiply the speed, within its limits."""
        self.speed = min(max(by * self.speed, SLOWEST), FASTEST)

    def restart(self, seed: int | None = None) -> None:
        """Start the next episode."""
        self._observation, _ = self.env.reset(seed=seed)
        self.earned, self.steps, self.over, self._owed, self._played = 0.0, 0, "", 0.0, False
        self._memory: Any = None  # the agent's state between predictions

    def acting(self) -> str:
        """Who acts now."""
        if self.push:
            return "you"
        if self.agent is not None:
            return "trained agent"
        return "chirp" if self.chirp else "nobody"

    def advance(self, seconds: float) -> None:
        """Advance by so much time of the clock."""
        if self.paused or self.over:
            return
        self._owed += min(seconds, _LONGEST) * self.speed / self.control_dt
        while self._owed >= 1.0 and not self.over:
            self._owed -= 1.0
            self.step()

    def step(self) -> None:
        """Take one control step, unless the episode is over."""
        if self.over:
            return
        try:
            self._observation, reward, terminated, truncated, _ = self.env.step(self._action())
        except JackLostError:
            self.over = "The jack left the box"
            return
        self.earned += float(reward)
        self.steps += 1
        if terminated or truncated:
            self.over = "Episode over"
            if self._played and (self.best is None or self.earned > self.best):
                self.best, self.over = self.earned, "Episode over: your best so far"

    def _action(self) -> Any:
        if self.push:
            self._played = True
            self._memory = None  # the agent starts afresh when it acts again
            return np.array([self.push], dtype=np.float32)
        if self.agent is not None:
            begins = np.array([self._memory is None])
            action, self._memory = self.agent.predict(self._observation, self._memory, begins, deterministic=True)
            return action
        return None if self.chirp else np.zeros(1, dtype=np.float32)


def open_display(pygame: Any) -> None:
    """Open pygame's display.

    Raises:
        RuntimeError: there is none. SDL then uses an invisible driver; one that is set by its variable is accepted.
    """
    try:
        pygame.display.init()
        invisible = pygame.display.get_driver() in _INVISIBLE and not any(map(os.environ.get, _DRIVERS))
    except pygame.error as error:
        raise RuntimeError(f"there is no display to play on: {error}") from error
    if invisible:
        pygame.display.quit()
        raise RuntimeError("there is no display to play on: start this on a desktop")


class GameWindow:
    """Shows a game and handles the keys.

    Args:
        game: the game.
        trained: loads the trained agent; None: there is none.

    Raises:
        gymnasium.error.DependencyNotInstalled: pygame is missing.
        RuntimeError: there is no display.
    """

    def __init__(self, game: Game, trained: Callable[[], Predicts] | None = None) -> None:
        self.pygame = import_pygame()
        self.game, self.open, self.note = game, True, ""
        self._trained, self._pressed = trained, set[int]()
        open_display(self.pygame)
        self._screen = self.pygame.display.set_mode((SIZE + PANEL, SIZE))
        self.pygame.display.set_caption("Jack in a box")

    def frame(self, seconds: float) -> None:
        """Handle the keys, advance by so much time of the clock, and show the game."""
        for event in self.pygame.event.get():
            self._handle(event)
        self.game.advance(seconds)
        self._draw()

    def close(self) -> None:
        """Close the window and the environment."""
        self.open = False
        self.game.env.close()
        self.pygame.display.quit()

    # -- keys ---------------------------------------------------------------------------------------------------------

    def _handle(self, event: pygame.event.Event) -> None:
        pygame = self.pygame
        if event.type == pygame.QUIT:
            self.open = False
        elif event.type == pygame.KEYDOWN:
            self._pressed.add(event.key)
            self._press(event.key, getattr(event, "unicode", ""))
        elif event.type == pygame.KEYUP:
            self._pressed.discard(event.key)
        elif event.type == pygame.WINDOWFOCUSLOST:
            self._pressed.clear()  # their releases go elsewhere
        self.game.push = float(pygame.K_LEFT in self._pressed) - float(pygame.K_RIGHT in self._pressed)

    def _press(self, key: int, letter: str) -> None:
        """Do the action of a key; + and - and the dot are read as letters, whatever the keyboard's layout."""
        game, name = self.game, letter if letter in ("+", "-", ".") else self.pygame.key.name(key)
        if name in ("escape", "q"):
            self.open = False
        elif name == "r":
            game.restart()
        elif name == "space":
            game.paused = not game.paused
        elif name == ".":
            game.paused = True
            game.step()
        elif name in ("+", "=", "[+]"):
            game.faster(2.0)
        elif name in ("-", "[-]"):
            game.faster(0.5)
        elif name == "c":
            game.chirp = not game.chirp
        elif name == "p":
            self._hand_over()

    def _hand_over(self) -> None:
        """Switch the trained agent on or off."""
        if self.game.agent is not None:
            self.game.agent = None
        elif self._trained is None:
            self.note = NO_AGENT
        else:
            self.note = LOADING
            self._draw()
            try:
                self.game.agent, self.note = self._trained(), ""
            except (OSError, ValueError, ImportError):
                self.note = "there is no trained agent for this"

    # -- the picture --------------------------------------------------------------------------------------------------

    def _draw(self) -> None:
        frame: Any = self.game.env.render()
        self._screen.fill(_PAPER)
        height, width = frame.shape[:2]
        self._screen.blit(self.pygame.image.frombuffer(frame.tobytes(), (width, height), "RGB"), (0, 0))
        self._screen.fill(TRACK, (SIZE, 0, 1, SIZE))
        self._draw_numbers()
        self._draw_keys()
        if self.game.over:
            self._banner(self.game.over, "R starts the next")
        elif self.game.paused:
            self._banner("Paused", "the dot takes one step")
        self.pygame.display.flip()

    def _write(self, text: str, x: float, y: float, size: int, colour: Colour = INK, align: float = 0.0) -> None:
        """Write with the left end (align 0), the middle (0.5) or the right end (1) at (x, y), half way down."""
        write(self._screen, text, complex(x, y), size, colour, align)

    def _draw_numbers(self) -> None:
        game, left, right = self.game, SIZE + _EDGE, SIZE + PANEL - _EDGE
        rows = (
            ("your best", "-" if game.best is None else f"{game.best:.1f}", INK),
            ("acting", game.acting(), JACK),
            ("speed", f"{game.speed:g} \N{MULTIPLICATION SIGN}", INK),
        )
        for number, (name, value, colour) in enumerate(rows):
            self._write(name, left, 30 + 32 * number, 20, PALE_INK)
            self._write(value, right, 30 + 32 * number, 24, colour, align=1.0)
        self._screen.fill(TRACK, (left, 122, PANEL - 2 * _EDGE, 1))

    def _draw_keys(self) -> None:
        game = self.game
        rows = (
            ("left", "turn left", self.game.push > 0.0),
            ("right", "turn right", self.game.push < 0.0),
            ("R", "next episode", False),
            ("space", "pause", game.paused),
            (".", "one step", False),
            ("+  -", "speed", False),
            ("P", "trained agent", game.agent is not None),
            ("C", "chirp without a key", game.chirp),
            ("Esc", "quit", False),
        )
        for number, (key, meaning, is_on) in enumerate(rows):
            y, colour = 152 + 34 * number, JACK if is_on else INK
            self._write(key, SIZE + _EDGE, y, 20, colour)
            self._write(meaning, SIZE + _EDGE + 66, y, 20, colour)
        self._write(self.note, SIZE + 0.5 * PANEL, 484, 18, _RED, align=0.5)

    def _banner(self, title: str, below: str) -> None:
        """Write at the top of the picture, where it hides nothing of the box."""
        self._screen.fill(_PAPER, (140, 0, 270, 40))
        self._write(title, 275, 12, 24, JACK, align=0.5)
        self._write(below, 275, 31, 18, PALE_INK, align=0.5)


def play(
    env: gym.Env[Any, Any], seed: int | None = None, chirp: bool = True, trained: Callable[[], Predicts] | None = None
) -> None:
    """Play until the window is closed.

    Args:
        env: ``JackInBox-v0`` made with ``render_mode="rgb_array"``.
        seed: of the first start; None: drawn.
        chirp: whether the scene's drive acts while no key is pressed.
        trained: loads the agent that P switches on; None: there is none, and P shows a note.

    Raises:
        gymnasium.error.DependencyNotInstalled: pygame is missing.
        RuntimeError: there is no display.
    """
    window = GameWindow(Game(env, seed, chirp), trained)
    clock = window.pygame.time.Clock()
    try:
        while window.open:
            window.frame(clock.tick(FRAMES) / 1000.0)
    finally:
        window.close()
