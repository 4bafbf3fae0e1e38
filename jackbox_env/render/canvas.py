"""A frame's surface and the marks on it, for the renderer.

Marks are drawn on a surface several times as large, which :meth:`Canvas.smooth` scales down; text is written on the
frame itself. Points are complex numbers in pixels of the frame: x to the right, y (imaginary) down from the top left,
where pixel (i, j) has its centre at i + j * 1j.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from jackbox_env.tools.colours import Colour

if TYPE_CHECKING:
    import pygame

SIZE = 512  # [px] width and height of a frame by default

INK: Colour = (38, 46, 60)
PALE_INK: Colour = (112, 122, 138)
TRACK: Colour = (205, 212, 222)

_FINER = 4  # letters are drawn so many times as large: at their own size whole pixels leave uneven gaps
_SMALL = 160  # [px] a frame less wide or high is drawn at four times its size: its walls are 1.5 px thick


def import_pygame() -> ModuleType:
    """Return pygame.

    Raises:
        gymnasium.error.DependencyNotInstalled: pygame is missing; the message names what to install.
    """
    try:
        import pygame
        import pygame.font
    except ImportError as error:
        raise DependencyNotInstalled("drawing needs pygame: pip install pygame-ce") from error
    return pygame


@lru_cache
def _font(size: int) -> pygame.font.Font:
    fonts = import_pygame().font
    fonts.init()
    font: pygame.font.Font = fonts.Font(None, size)  # the one that comes with pygame
    return font


@lru_cache(maxsize=256)
def _written(text: str, size: int, colour: Colour) -> pygame.Surface:
    pygame = import_pygame()
    try:
        large = _font(_FINER * size).render(text, True, colour)
    except pygame.error:  # somebody else in this process has called pygame.quit()
        _font.cache_clear()
        large = _font(_FINER * size).render(text, True, colour)
    width, height = large.get_size()
    return pygame.transform.smoothscale(large, (width // _FINER, height // _FINER)) if width else large


def write(surface: pygame.Surface, text: str, point: complex, size: int, colour: Colour, align: float) -> None:
    """Write with the left end (align 0), the middle (0.5) or the right end (1) at ``point``, half way down.

    Args:
        surface: to write on.
        text: a hyphen becomes a minus sign.
        point: [px].
        size: of the letters [px].
        colour: of the letters.
        align: which end is at ``point``.
    """
    image = _written(text.replace("-", "\N{MINUS SIGN}"), size, colour)
    width, height = image.get_size()
    surface.blit(image, (round(point.real - align * width), round(point.imag - 0.5 * height)))


class Canvas:
    """Surfaces of a frame. They are made anew when needed, and never pickled.

    Args:
        size: width and height of the frame [px].

    Raises:
        gymnasium.error.DependencyNotInstalled: pygame is missing.
    """

    def __init__(self, size: tuple[int, int] = (SIZE, SIZE)) -> None:
        self.pygame = import_pygame()
        self.surface: pygame.Surface = self.pygame.Surface(size, 0, 32)
        self._times = 4 if min(size) < _SMALL else 2
        self._large: pygame.Surface = self.pygame.Surface((self._times * size[0], self._times * size[1]), 0, 32)

    def smooth(self) -> None:
        """Scale what was drawn down onto the frame."""
        self.pygame.transform.smoothscale(self._large, self.surface.get_size(), self.surface)

    def pixels(self) -> NDArray[np.uint8]:
        """Return the frame as a fresh array, shape (height, width, 3)."""
        colours = self.pygame.surfarray.pixels3d(self.surface)  # (width, height, 3)
        frame = np.empty((colours.shape[1], colours.shape[0], 3), dtype=np.uint8)
        for colour in range(3):  # one by one is three times as fast
            frame[..., colour] = colours[..., colour].T
        return frame

    def fill(self, colour: Colour) -> None:
        """Fill the frame with one colour."""
        self._large.fill(colour)

    def line(self, at: float, axis: int, colour: Colour) -> None:
        """Draw a line of 1 px across the whole frame, where x (axis 0) or y (1) is ``at`` [px]."""
        start = round(self._times * at)
        area = (start, 0, self._times, self._large.get_height())
        self._large.fill(colour, area if axis == 0 else (0, start, self._large.get_width(), self._times))

    def _on_large(self, point: complex, off: float = 0.0) -> tuple[int, int]:
        """A point on the large surface, ``off`` less both ways."""
        x, y = self._times * (point.real + 0.5) - off, self._times * (point.imag + 0.5) - off
        return round(x), round(y)

    def polygon(self, corners: Sequence[complex], colour: Colour) -> None:
        """Fill a polygon."""
        self.pygame.draw.polygon(self._large, colour, [self._on_large(corner, 0.5) for corner in corners])

    def band(self, start: complex, end: complex, width: float, colour: Colour) -> None:
        """Draw a band of some width [px] with square ends."""
        # A polygon includes its edges, half a pixel of the large surface more on each side.
        beside = 0.5j * (end - start) / abs(end - start) * (width - 1.0 / self._times)
        self.polygon([start + beside, end + beside, end - beside, start - beside], colour)

    def disc(self, centre: complex, radius: float, colour: Colour) -> None:
        """Draw a disc."""
        self.pygame.draw.circle(self._large, colour, self._on_large(centre), max(1, round(self._times * radius)))

    def glow(self, centre: complex, radius: float, share: float, colour: Colour) -> None:
        """Draw a ring and a disc in it, as opaque as ``share``, from 0 to 1."""
        reach = max(2, round(self._times * radius))
        image = self.pygame.Surface((2 * reach, 2 * reach), self.pygame.SRCALPHA)
        for part, width, opacity in ((0.6, 0, 200), (1.0, 2 * self._times, 230)):
            self.pygame.draw.circle(image, (*colour, round(opacity * share)), (reach, reach), part * reach, width)
        self._large.blit(image, self._on_large(centre, reach))
