"""A frame's surface and the marks on it, for the renderer.

Edges are smooth: those of bands are anti-aliased lines, and discs are images that were scaled down once. Points are
complex numbers in pixels of the frame: x to the right, y (imaginary) down from the top left, where pixel (i, j) has its
centre at i + j * 1j.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from jackbox_env.tools.colours import Colour

try:
    import pygame
    import pygame.font
except ImportError as error:
    raise DependencyNotInstalled("drawing needs pygame: pip install pygame-ce") from error

SIZE = 512  # [px] width and height of a frame by default

INK: Colour = (38, 46, 60)
PALE_INK: Colour = (112, 122, 138)
TRACK: Colour = (205, 212, 222)

_FINER = 4  # letters are drawn so many times as large: at their own size whole pixels leave uneven gaps


@lru_cache
def _font(size: int) -> pygame.font.Font:
    pygame.font.init()
    return pygame.font.Font(None, size)  # the one that comes with pygame


@lru_cache(maxsize=256)
def written(text: str, size: int, colour: Colour) -> pygame.Surface:
    """A text in letters of a size [px]."""
    try:
        large = _font(_FINER * size).render(text, True, colour)
    except pygame.error:  # somebody else in this process has called pygame.quit()
        _font.cache_clear()
        large = _font(_FINER * size).render(text, True, colour)
    width, height = large.get_size()
    return pygame.transform.smoothscale(large, (width // _FINER, height // _FINER)) if width else large


class Canvas:
    """The surface of a frame. It is made anew when needed, and never pickled.

    Args:
        size: width and height of the frame [px].
    """

    def __init__(self, size: tuple[int, int] = (SIZE, SIZE)) -> None:
        self.surface = pygame.Surface(size, 0, 32)
        self._packed = pygame.Surface(size, 0, 24, (0xFF, 0xFF00, 0xFF0000, 0))  # bytes r, g, b

    def pixels(self) -> NDArray[np.uint8]:
        """Return the frame as a fresh array, shape (height, width, 3)."""
        self._packed.blit(self.surface, (0, 0))  # faster than a copy of each colour by numpy
        return pygame.surfarray.pixels3d(self._packed).transpose(1, 0, 2).copy()

    def line(self, at: float, axis: int, darker: Colour) -> None:
        """Darken a line of 1 px across the whole frame, where x (axis 0) or y (1) is ``at`` [px]."""
        first, halves = divmod(round(2.0 * at), 2)  # on one pixel, or on half of each of two
        for pixel in range(first, first + 1 + halves):
            area = (pixel, 0, 1, self.surface.get_height()) if axis == 0 else (0, pixel, self.surface.get_width(), 1)
            share = [part // (1 + halves) for part in darker]
            self.surface.fill(share, area, pygame.BLEND_SUB)

    def polygon(self, corners: Sequence[complex], colour: Colour) -> None:
        """Fill a polygon, its edges included."""
        pygame.draw.polygon(self.surface, colour, [(round(one.real), round(one.imag)) for one in corners])

    def band(self, start: complex, end: complex, width: float, colour: Colour) -> None:
        """Draw a band of some width [px] with square ends."""
        # An edge is a line of 1 px, with its middle half a pixel within the band. The polygon between edges is rounded
        # to pixels; of a wide band a second line at each edge closes the gap.
        along = (end - start) / abs(end - start)
        start, end, inner = start + 0.5 * along, end - 0.5 * along, 0.5j * along * (width - 2.0)
        if width > 2.0:
            self.polygon([start + inner, end + inner, end - inner, start - inner], colour)
        beside = 0.5j * along * max(0.0, width - 1.0)
        for side in (inner, -inner, beside, -beside) if width > 4.0 else (beside, -beside):
            first, last = start + side, end + side
            pygame.draw.aaline(self.surface, colour, (first.real, first.imag), (last.real, last.imag))

    def disc(self, centre: complex, radius: float, colour: Colour) -> None:
        """Draw a disc."""
        quarters = round(4.0 * centre.real), round(4.0 * centre.imag)
        image = _disc(max(1, round(16.0 * radius)), colour, quarters[0] % 4, quarters[1] % 4)
        reach = image.get_width() // 2
        self.surface.blit(image, (quarters[0] // 4 - reach, quarters[1] // 4 - reach))

    def glow(self, centre: complex, radius: float, share: float, colour: Colour) -> None:
        """Draw a ring and a disc in it, as opaque as ``share``, from 0 to 1."""
        reach = max(2, round(2.0 * radius))
        image = pygame.Surface((2 * reach, 2 * reach), pygame.SRCALPHA)
        for part, width, opacity in ((0.6, 0, 200), (1.0, 4, 230)):
            pygame.draw.circle(image, (*colour, round(opacity * share)), (reach, reach), part * reach, width)
        small = pygame.transform.smoothscale(image, (reach, reach))
        self.surface.blit(small, (round(centre.real - 0.5 * reach + 0.5), round(centre.imag - 0.5 * reach + 0.5)))


@lru_cache(maxsize=4096)
def _disc(radius: int, colour: Colour, right: int, down: int) -> pygame.Surface:
    """A disc of a radius in sixteenths of a pixel, its centre so many quarters of a pixel off that of the image."""
    reach = radius // 16 + 2
    large = pygame.Surface((8 * (2 * reach + 1), 8 * (2 * reach + 1)), pygame.SRCALPHA)
    large.fill((*colour, 0))
    centre = 8 * reach + 4 + 2 * right, 8 * reach + 4 + 2 * down
    pygame.draw.circle(large, colour, centre, max(1, radius // 2))
    return pygame.transform.smoothscale(large, (2 * reach + 1, 2 * reach + 1))
