"""A frame's pixels and anti-aliased marks on them; knows nothing of boxes and jacks.

Pixel coordinates count from the top left, x to the right and y down; pixel (i, j) has its centre at x = i, y = j.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import lru_cache
from types import ModuleType
from typing import TYPE_CHECKING

import numpy as np
from gymnasium.error import DependencyNotInstalled
from numpy.typing import NDArray

from jackbox_env import _validation as check

if TYPE_CHECKING:
    import pygame

Point = tuple[float, float]
Colour = tuple[int, int, int]

SIZE = 512  # [px] width and height of a frame unless another is asked for

_RULE: Colour = (34, 27, 16)  # taken from what lies beneath
_AMBER: Colour = (255, 168, 0)
INK: Colour = (38, 46, 60)
TRACK: Colour = (205, 212, 222)
_TEAL: Colour = (0, 128, 128)

_GAUGE_RADIUS = 18.0  # [px] in a frame of the usual size, as all that follows
_GAUGE_STROKE = 2.0  # half width
_FONTS = (17, 22)


def import_pygame() -> ModuleType:
    """Return pygame.

    Raises:
        gymnasium.error.DependencyNotInstalled: it is missing; the sentence says what to install.
    """
    try:
        import pygame
        import pygame.font
    except ImportError as error:
        raise DependencyNotInstalled(check.extra_needed("drawing", "pygame", "render")) from error
    return pygame


@lru_cache(maxsize=68)
def _shades(sixteenths: int, width: int) -> NDArray[np.uint8]:
    """Return what a line so far below a pixel's centre takes from that pixel and the next, shape (2, width, 3)."""
    share = sixteenths / 16.0
    shades: NDArray[np.uint8] = np.rint(np.outer((1.0 - share, share), _RULE)).astype(np.uint8)
    return np.repeat(shades[:, None], width, axis=1)


class Canvas:
    """A frame's pixels with anti-aliased marks. Everything here can be made anew, nothing of it is pickled.

    Args:
        size: width and height of the frame [px].
        scale: of writing and gauge; 1 in a frame of the usual size.

    Raises:
        gymnasium.error.DependencyNotInstalled: pygame is missing.
    """

    def __init__(self, size: tuple[int, int] = (SIZE, SIZE), scale: float = 1.0) -> None:
        self.pygame = import_pygame()
        self.size, self._scale = size, scale
        self.pixels = np.zeros((size[1], size[0], 3), dtype=np.uint8)  # (row, column, RGB)
        # The surface draws into the array itself: a frame costs one copy, no conversion.
        self.surface = self.pygame.image.frombuffer(self.pixels, size, "RGB")
        self._words = self.pixels.reshape(-1).view("V3")  # a pixel as one item, which numpy moves fastest
        self._disc = lru_cache(maxsize=1024)(self._make_disc)
        self._glow = lru_cache(maxsize=256)(self._make_glow)
        self._gauge = lru_cache(maxsize=256)(self._make_gauge)
        self._write: Callable[[str, int, Colour], pygame.Surface] | None = None

    def _open_fonts(self) -> Callable[[str, int, Colour], pygame.Surface]:
        """Return what writes a text as a surface; nothing is opened where nothing is written."""
        self.pygame.font.init()
        # The font that comes with pygame.
        fonts = {size: self.pygame.font.Font(None, max(1, round(size * self._scale))) for size in _FONTS}

        @lru_cache(maxsize=128)
        def write(text: str, size: int, colour: Colour) -> pygame.Surface:
            image: pygame.Surface = fonts[size].render(text, True, colour)
            return image

        self._write = write
        return write

    def text(self, text: str, place: Point, align: float = 0.0, size: int = 22, colour: Colour = INK) -> None:
        """Write with the middle of the left (align 0) or right (1) end at ``place``."""
        try:
            image = (self._write or self._open_fonts())(text, size, colour)
        except self.pygame.error:  # somebody else in this process has called pygame.quit()
            image = self._open_fonts()(text, size, colour)
        width, height = image.get_size()
        self.surface.blit(image, (round(place[0] - align * width), round(place[1] - 0.5 * height)))

    def rules(self, across: Sequence[float], down: Sequence[float]) -> None:
        """Darken lines of 1 px at the given columns and rows [px], each shared by the two pixels that it lies on."""
        width, height = self.size
        shade = np.zeros((width + 1, 3), dtype=np.uint8)
        for at in across:
            first = math.floor(at)
            shade[first : first + 2] = _shades(round(16.0 * (at - first)), width)[:, 0]
        lines = self.pixels.reshape(height, -1)  # (height, 3 width)
        np.subtract(lines, shade[:width].reshape(-1), out=lines)
        for at in down:
            first = math.floor(at)
            pair = self.pixels[first : first + 2]  # the last row of all has no next
            np.subtract(pair, _shades(round(16.0 * (at - first)), width)[: len(pair)], out=pair)

    def disc(self, centre: Point, radius: float, colour: Colour) -> None:
        """Draw a disc, its centre rounded to a quarter of a pixel."""
        x, y = round(4.0 * centre[0]), round(4.0 * centre[1])
        image = self._disc(radius, colour, x % 4, y % 4)
        half = image.get_width() // 2
        self.surface.blit(image, (x // 4 - half, y // 4 - half))

    def glow(self, centre: Point, radius: int, fade: float) -> None:
        """Draw an impact's flash, ``fade`` from 1 (new) to 0 (gone)."""
        image = self._glow(radius, math.ceil(12.0 * fade))
        half = image.get_width() // 2
        self.surface.blit(image, (round(centre[0]) - half, round(centre[1]) - half))

    def gauge(self, centre: Point, share: float) -> None:
        """Draw an arc about ``centre`` that turns the way of the torque; ``share`` of its limit, cut to [-1, 1]."""
        image = self._gauge(round(100.0 * min(max(share, -1.0), 1.0)))
        half = image.get_width() // 2
        self.surface.blit(image, (round(centre[0]) - half, round(centre[1]) - half))

    def bands(self, middles: Sequence[Point], span: Point, half_width: float, colour: Colour) -> None:
        """Draw parallel bands with square ends, each pixel covered by its distance from the band's edges.

        Only the pixels about them are visited: a run across the band per step along its longer axis, here called x.
        ``middles`` are the bands' centres, they must not overlap; ``span`` goes from one end to the other [px].
        """
        length = math.hypot(*span)
        axis = 0 if abs(span[0]) >= abs(span[1]) else 1
        along, across = np.float32(span[axis] / length), np.float32(span[1 - axis] / length)
        extent = 0.5 * abs(span[axis]) + half_width + 1.0
        x = np.array([middle[axis] for middle in middles], dtype=np.float32)[:, None]
        y = np.array([middle[1 - axis] for middle in middles], dtype=np.float32)[:, None]
        columns = np.floor(x - np.float32(extent)) + np.arange(math.ceil(2.0 * extent) + 2, dtype=np.float32)
        beside = columns - x
        middle = y + beside * (across / along)
        reach = (half_width + 0.5) / abs(float(along))
        first = np.ceil(middle - np.float32(reach))
        run = np.arange(math.ceil(2.0 * reach) + 1)
        longest, widest = self.size[axis], self.size[1 - axis]
        inside = (columns >= 0) & (columns < longest) & (first >= 0) & (first + len(run) <= widest)
        columns, beside, middle, first = columns[inside], beside[inside], middle[inside], first[inside]
        offset = (first - middle)[:, None] + run.astype(np.float32)
        cover = np.float32(half_width + 0.5) - np.abs(offset * along)
        lengthwise = (beside / along)[:, None] + offset * across
        np.minimum(cover, np.float32(0.5 * length + 0.5) - np.abs(lengthwise), out=cover)
        strides = (1, self.size[0]) if axis == 0 else (self.size[0], 1)
        corners = columns.astype(np.intp) * strides[0] + first.astype(np.intp) * strides[1]
        self._blend(corners[:, None] + run * strides[1], cover, colour)

    def square(self, centre: Point, direction: Point, inner: float, outer: float, colour: Colour) -> None:
        """Draw the band between two squares about ``centre``, of half widths ``inner`` and ``outer``.

        It looks at every pixel of the frame: in a small one that is faster than four bands. ``direction`` is the unit
        vector of a side.
        """
        columns, rows = self._turned(centre, direction, (0, 0), self.size)
        beside = np.maximum(columns, rows, out=columns)
        cover = np.minimum(np.float32(outer + 0.5) - beside, beside - np.float32(inner - 0.5)).ravel()
        places = np.flatnonzero(cover > 0.0)
        self._blend(places[:, None], cover[places][:, None], colour)

    def cross(self, centre: Point, direction: Point, half_length: float, half_width: float, colour: Colour) -> None:
        """Draw two bands that cross each other in their middles; ``direction`` is the unit vector of one."""
        reach = math.ceil(half_length * max(abs(direction[0]), abs(direction[1])) + half_width) + 1
        middle = math.floor(centre[0]), math.floor(centre[1])
        low = max(0, middle[0] - reach), max(0, middle[1] - reach)
        high = min(self.size[0], middle[0] + reach + 2), min(self.size[1], middle[1] + reach + 2)
        if low[0] >= high[0] or low[1] >= high[1]:
            return
        columns, rows = self._turned(centre, direction, low, high)
        cover = np.minimum(
            np.float32(half_width + 0.5) - np.minimum(columns, rows),
            np.float32(half_length + 0.5) - np.maximum(columns, rows),
        )
        places = np.flatnonzero(cover > 0.0)
        row, column = np.divmod(places, high[0] - low[0])
        places_in_frame = (row + low[1]) * self.size[0] + column + low[0]
        self._blend(places_in_frame[:, None], cover.ravel()[places][:, None], colour)

    @staticmethod
    def _turned(
        centre: Point, direction: Point, low: tuple[int, int], high: tuple[int, int]
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return how far the pixels of a part of the frame are from ``centre``, along ``direction`` and beside it."""
        x = np.arange(low[0], high[0], dtype=np.float32) - np.float32(centre[0])
        y = np.arange(low[1], high[1], dtype=np.float32)[:, None] - np.float32(centre[1])
        along, across = np.float32(direction[0]), np.float32(direction[1])
        return np.abs(x * along + y * across), np.abs(y * along - x * across)

    def _blend(self, places: NDArray[np.intp], cover: NDArray[np.float32], colour: Colour) -> None:
        """Mix ``colour`` into the pixels at flat ``places`` (n, m) by ``cover`` (n, m), cut to [0, 1]."""
        np.clip(cover, 0.0, 1.0, out=cover)
        parts = (np.float32(256.0) * cover).astype(np.uint16).repeat(3, axis=1)  # (n, 3 m)
        old = self._words.take(places).view(np.uint8).reshape(parts.shape)
        paint = np.array(colour * places.shape[1], dtype=np.uint16)
        mixed = (old * (256 - parts) + paint * parts) >> 8
        self._words.put(places, mixed.astype(np.uint8).view("V3"), mode="wrap")  # all inside: wrap skips the check

    def _sprite(self, cover: NDArray[np.float64], colour: Colour) -> pygame.Surface:
        image = np.empty((*cover.shape, 4), dtype=np.uint8)
        image[..., :3] = colour
        image[..., 3] = np.rint(255.0 * np.clip(cover, 0.0, 1.0))
        surface: pygame.Surface = self.pygame.image.frombuffer(image.tobytes(), cover.shape[::-1], "RGBA")
        return surface

    @staticmethod
    def _grid(half: int) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        y, x = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
        return x, y

    def _make_disc(self, radius: float, colour: Colour, quarters_x: int, quarters_y: int) -> pygame.Surface:
        x, y = self._grid(math.ceil(radius) + 2)
        return self._sprite(radius + 0.5 - np.hypot(x - 0.25 * quarters_x, y - 0.25 * quarters_y), colour)

    def _make_glow(self, radius: int, twelfths: int) -> pygame.Surface:
        x, y = self._grid(radius + 3)
        distance = np.hypot(x, y)
        fade = twelfths / 12.0
        ring = np.clip(1.6 - np.abs(distance - radius * (1.0 - 0.55 * fade)), 0.0, 1.0)
        return self._sprite(fade * np.maximum(0.9 * ring, np.exp(-((distance / (0.55 * radius)) ** 2))), _AMBER)

    def _make_gauge(self, percent: int) -> pygame.Surface:
        scale, radius = self._scale, _GAUGE_RADIUS * self._scale
        x, y = self._grid(math.ceil(radius) + math.ceil(8.0 * scale))
        beside = np.hypot(x, y) - radius
        stroke = _GAUGE_STROKE * scale + 0.5 - np.abs(beside)
        along = np.arctan2(-x, -y) * math.copysign(radius, percent)  # [px] from the top, the torque's way
        full = math.radians(140.0) * radius
        image = self._sprite(np.minimum(stroke, full + 0.5 - np.abs(along)), TRACK)
        tip = full * abs(percent) / 100.0
        head = min(8.0 * scale, tip)
        shaft = np.minimum(stroke, np.minimum(along, tip - head - along) + 0.5)
        arrow = np.minimum(along - (tip - head), 0.6 * (tip - along) - np.abs(beside)) + 0.5
        image.blit(self._sprite(np.maximum(shaft, arrow), _TEAL), (0, 0))
        return image
