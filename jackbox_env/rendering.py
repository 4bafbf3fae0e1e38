"""Draws the jack in the box: reads states, computes no physics.

The camera follows the box's centre, so the box stays in the middle of the picture and turns there; ruled lines fixed to
the world move past it as it sinks, and the ruler on the left tells its height. pygame is imported when the first
`Renderer` is made and used off-screen: only the human mode opens a window.

Pixel coordinates count from the top left, x to the right and y down; pixel (i, j) has its centre at x = i, y = j.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any
from weakref import WeakSet

import numpy as np
from numpy.typing import NDArray

from jackbox_env.canvas import SIZE, TRACK, Canvas, Colour, Point, import_pygame
from jackbox_env.scene import Scene
from jackbox_env.simulators.base import Impact
from jackbox_env.states import Array

if TYPE_CHECKING:
    import pygame


# Layout [px]: a ruler on the left; the box may turn freely in the rest, the corners are left to the text.
_RULER = 54
_CENTRE = (0.5 * (_RULER + SIZE), 0.5 * SIZE)
_WALL = 6.0  # thickness of a wall, outwards from its inside face
_REACH = 224.0  # of the box's outer corners from its centre, at any angle
_HALF_WIDTH = _REACH / math.sqrt(2.0) - _WALL  # L on the screen
_MARGIN = 10
_BEAD = 1.75  # radius of the trail's beads
_GAUGE_AT = (_RULER + 34, SIZE - 34)

# Times in units of L / v0, a fall's time scale (0.55 s in the default scene), and at least this many control steps.
_FLASH_TIME, _FLASH_STEPS = 0.45, 3  # 0.25 s
_TRAIL_TIME, _TRAIL_STEPS = 1.6, 12  # 0.88 s
_TRAIL_POINTS = 48
_MOST_FLASHES = 32

_PAPER: Colour = (243, 245, 248)
_INTERIOR: Colour = (255, 255, 255)
_RULER_TINT: Colour = (236, 239, 244)
_RED: Colour = (204, 36, 41)
_BLUE: Colour = (31, 90, 180)
_TRAIL: Colour = (120, 158, 214)
_PALE_INK: Colour = (112, 122, 138)

# The trail's colours from new to old.
_FADING: list[Colour] = [(r, g, b) for r, g, b in np.linspace(_TRAIL, _INTERIOR, 16).astype(int).tolist()]

_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}

_windowed: WeakSet[Renderer] = WeakSet()  # the renderers that share the display's one window


def _unit(size: float, name: str) -> tuple[float, str]:
    """Return the unit to write numbers of about ``size`` in, as its value and its symbol: (1e3, "kN m")."""
    exponent = 3 * math.floor(math.log10(size) / 3.0 + 1e-9)
    exponent = min(max(exponent, min(_PREFIXES)), max(_PREFIXES))
    return 10.0**exponent, _PREFIXES[exponent] + name


def _round_step(least: float) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that is at least ``least``."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(step for step in (power, 2.0 * power, 5.0 * power, 10.0 * power) if step >= 0.999 * least)


def _number(value: float, decimals: int, sign: str = "") -> str:
    """Format with a true minus sign, and no sign for zero."""
    rounded = round(value, decimals) or 0.0
    return format(rounded, f"{sign if rounded else ''}.{decimals}f").replace("-", "\N{MINUS SIGN}")


class Renderer:
    """Draws the states of one scene, as arrays or in a window.

    It can be pickled and copied: surfaces, fonts and the window are left behind and made again when needed.

    Args:
        scene: gives the sizes.
        render_mode: ``"rgb_array"`` or ``"human"``.
        fps: frames per second of the window [Hz].

    Raises:
        gymnasium.error.DependencyNotInstalled: pygame is missing.
    """

    def __init__(self, scene: Scene, render_mode: str, fps: float) -> None:
        self._human = render_mode == "human"
        self._fps = fps
        self._trail: deque[tuple[float, float, float]] = deque(maxlen=_TRAIL_POINTS)  # x, y of the jack [m], time [s]
        self._flashes: deque[tuple[Impact, float, list[float]]] = deque(maxlen=_MOST_FLASHES)  # time [s], state after
        self._canvas: Canvas | None = Canvas()
        self._clock: pygame.time.Clock | None = None
        self.show(scene)
        self.reset([0.0] * 12, 0.0)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_canvas": None, "_clock": None}

    def show(self, scene: Scene) -> None:
        """Take the sizes from another scene; :meth:`reset` comes next."""
        self._scene = scene
        self._scale = _HALF_WIDTH / scene.box_half_width  # [px/m]
        self._time_scale = scene.box_half_width / scene.speed_scale  # [s]
        self._decimals = min(max(2, math.ceil(-math.log10(self._time_scale / 50.0))), 6)  # of the time
        self._spacing = _round_step(scene.box_half_width / 3.5)  # [m] of the ruled lines

    def reset(self, state: Sequence[float] | Array, time: float) -> None:
        """Start anew from ``state``, shape (12,), SI units, at ``time`` [s]: no trail, no flashes, no impacts yet."""
        self._trail.clear()
        self._flashes.clear()
        self._count = 0
        self._torque = 0.0  # [N m]
        self._interval = 0.0  # [s] last control step
        self._set(state, time)

    def _set(self, state: Sequence[float] | Array, time: float) -> None:
        self._state: list[float] = np.array(state, dtype=np.float64).tolist()  # a copy: the caller's may change
        self._time = float(time)
        kept = self._trail[-1][2] if self._trail else -math.inf
        if self._time - kept >= 0.99 * _TRAIL_TIME * self._time_scale / _TRAIL_POINTS:
            self._trail.append((self._state[3], self._state[4], self._time))

    def record(self, state: Sequence[float] | Array, time: float, torque: float, impacts: Sequence[Impact]) -> None:
        """Note the state after a control step, shape (12,), SI units; nothing is drawn.

        Args:
            state: at the end of the step.
            time: at the end of the step [s].
            torque: mean torque on the box over the step [N m].
            impacts: the impacts of the step.
        """
        self._interval = max(0.0, float(time) - self._time)
        self._torque = float(torque)
        self._count += len(impacts)
        self._set(state, time)
        self._flashes.extend((impact, self._time, self._state) for impact in impacts)

    def to_pixels(self, x: float, y: float) -> Point:
        """Return where the point (x, y) [m] of the world lies in the frame [px], x to the right and y down."""
        return _CENTRE[0] + (x - self._state[0]) * self._scale, _CENTRE[1] - (y - self._state[1]) * self._scale

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the last state that was recorded or reset to.

        Returns:
            A fresh array (512, 512, 3) of uint8, or None in the human mode, which shows it in the window and waits for
            the next frame's time.
        """
        if self._canvas is None:
            self._canvas = Canvas()
        canvas = self._canvas
        self._draw_background(canvas)
        self._draw_trail(canvas)
        self._draw_box(canvas)
        self._draw_flashes(canvas)
        self._draw_jack(canvas)
        self._draw_ruler(canvas)
        self._draw_readings(canvas)
        if self._human:
            self._show(canvas)
            return None
        return canvas.pixels.copy()

    def close(self) -> None:
        """Let go of the window and the surfaces; calling it again does nothing. Other renderers go on."""
        self._canvas = self._clock = None
        if self in _windowed:
            _windowed.remove(self)
            display = import_pygame().display
            window = display.get_surface() if display.get_init() else None
            # The process has one window: it stays while others of ours use it, or somebody else has resized it.
            if not _windowed and window is not None and window.get_size() == (SIZE, SIZE):
                display.quit()

    def _show(self, canvas: Canvas) -> None:
        display = canvas.pygame.display
        window = display.get_surface()  # asked for each time: somebody else may have closed or resized it
        if window is None or window.get_size() != (SIZE, SIZE):
            window = display.set_mode((SIZE, SIZE))
            display.set_caption("Jack in a box")
        _windowed.add(self)
        if self._clock is None:
            self._clock = canvas.pygame.time.Clock()
        window.blit(canvas.surface, (0, 0))
        canvas.pygame.event.pump()
        display.flip()
        self._clock.tick(self._fps)

    # -- the parts of a frame, from back to front ----------------------------------------------------------------------

    def _draw_background(self, canvas: Canvas) -> None:
        canvas.surface.fill(_PAPER)
        side = self._scene.box_half_width + 0.5 * _WALL / self._scale  # its edge is hidden beneath the walls
        corners = [self._in_box(x, y) for x, y in ((side, side), (-side, side), (-side, -side), (side, -side))]
        canvas.pygame.draw.polygon(canvas.surface, _INTERIOR, corners)
        canvas.rules([pixel for pixel, _ in self._rules(0)], [pixel for pixel, _ in self._rules(1)])

    def _rules(self, axis: int) -> list[tuple[float, float]]:
        """Return the ruled lines of the frame as (place [px], coordinate [m]), along x (axis 0) or y (1)."""
        camera = self._state[axis]
        beyond = math.fmod(camera, self._spacing)  # exact, however far off the camera is
        step = self._spacing * self._scale * (1.0, -1.0)[axis]  # [px]
        nearest = _CENTRE[axis] - beyond / self._spacing * step
        ends = sorted((-nearest / step, (SIZE - nearest) / step))
        numbers = range(math.ceil(ends[0]), math.floor(ends[1]) + 1)
        return [(nearest + number * step, camera - beyond + number * self._spacing) for number in numbers]

    def _draw_trail(self, canvas: Canvas) -> None:
        """Draw the way of the jack's centre through the world, a bead for each recorded place."""
        lasts = max(_TRAIL_TIME * self._time_scale, _TRAIL_STEPS * self._interval)
        for x, y, time in self._trail:
            place = self.to_pixels(x, y)
            share = max(0.0, self._time - time) / lasts
            if share < 1.0 and _near(place):
                canvas.disc(place, _BEAD, _FADING[int(len(_FADING) * share)])

    def _draw_box(self, canvas: Canvas) -> None:
        middle = self._scene.box_half_width + 0.5 * _WALL / self._scale
        end = 2.0 * (_HALF_WIDTH + _WALL)  # [px] a wall's length, corners included
        cosine, sine = math.cos(self._state[2]), math.sin(self._state[2])
        vertical = [self._in_box(middle, 0.0), self._in_box(-middle, 0.0)]
        canvas.bands(vertical, (-sine * end, -cosine * end), 0.5 * _WALL, _RED)
        horizontal = [self._in_box(0.0, middle), self._in_box(0.0, -middle)]
        canvas.bands(horizontal, (cosine * end, -sine * end), 0.5 * _WALL, _RED)

    def _in_box(self, x: float, y: float) -> Point:
        """Return where the point (x, y) [m] of the box frame lies in the frame [px]."""
        cosine, sine = math.cos(self._state[2]), math.sin(self._state[2])
        # Straight from the frame's middle: adding and taking away a far-off position would cost digits.
        return _CENTRE[0] + (cosine * x - sine * y) * self._scale, _CENTRE[1] - (sine * x + cosine * y) * self._scale

    def _draw_flashes(self, canvas: Canvas) -> None:
        lasts = max(_FLASH_TIME * self._time_scale, _FLASH_STEPS * self._interval)
        for impact, time, state in self._flashes:
            fade = 1.0 - max(0.0, self._time - impact.time) / lasts
            place = self._in_box(*self._foot_at_impact(impact, time, state)) if fade > 0.0 else (math.inf, math.inf)
            if _near(place):
                strength = impact.impulse / (2.0 * self._scene.jack_mass * self._scene.speed_scale)
                canvas.glow(place, round(10.0 + 10.0 * min(strength, 1.0)), fade)

    def _foot_at_impact(self, impact: Impact, time: float, state: Sequence[float]) -> Point:
        """Return where the foot met the wall, in the box frame [m].

        The pose is carried back from the end of the step by the velocities after the impact, and put onto the wall.
        """
        pose = [place - rate * (time - impact.time) for place, rate in zip(state[:6], state[6:], strict=True)]
        if not all(map(math.isfinite, pose)):
            return math.inf, math.inf  # rates too large for a float
        foot = pose[5] + impact.foot * math.pi / 2.0
        wall = pose[2] + impact.wall * math.pi / 2.0
        x = pose[3] - pose[0] + self._scene.jack_arm * math.cos(foot)
        y = pose[4] - pose[1] + self._scene.jack_arm * math.sin(foot)
        limit = self._scene.box_half_width
        sideways = min(max(math.cos(wall) * y - math.sin(wall) * x, -limit), limit)
        return ((limit, sideways), (-sideways, limit), (-limit, -sideways), (sideways, -limit))[impact.wall]

    def _draw_jack(self, canvas: Canvas) -> None:
        x, y = self.to_pixels(self._state[3], self._state[4])
        if not _near((x, y)):
            return
        arm = self._scene.jack_arm * self._scale  # [px]
        radius = min(max(0.25 * round(0.68 * arm), 1.5), 6.0)  # of a foot
        across, up = arm * math.cos(self._state[5]), arm * math.sin(self._state[5])
        feet = ((x + across, y - up), (x - up, y - across), (x - across, y + up), (x + up, y + across))
        for foot in feet:
            canvas.disc(foot, radius + 1.0, _INTERIOR)  # a rim sets a foot off against the wall
        for span in ((2.0 * across, -2.0 * up), (-2.0 * up, -2.0 * across)):
            canvas.bands([(x, y)], span, 0.5 * radius, _BLUE)
        canvas.disc((x, y), 0.8 * radius, _BLUE)
        for foot in feet:
            canvas.disc(foot, radius, _RED)

    def _draw_ruler(self, canvas: Canvas) -> None:
        """Draw the scale of heights; a number too long for it keeps its last digits, which show the motion."""
        canvas.surface.fill(_RULER_TINT, (0, 0, _RULER, SIZE))
        canvas.surface.fill(TRACK, (_RULER, 0, 1, SIZE))
        unit, symbol = _unit(self._scene.box_half_width, "m")
        decimals = max(0, -math.floor(math.log10(self._spacing / unit) + 1e-9))
        for pixel, height in self._rules(1):
            value = _number(height / unit, decimals)
            room = 6 - len(symbol)
            label = value if len(value) <= room else "…" + value[1 - room :]
            canvas.surface.fill(TRACK, (_RULER - 4, round(pixel), 4, 1))
            canvas.text(f"{label} {symbol}", (_RULER - 7, pixel), align=1.0, size=17, colour=_PALE_INK)

    def _draw_readings(self, canvas: Canvas) -> None:
        unit, symbol = _unit(self._scene.torque_limit, "N m")
        canvas.gauge(_GAUGE_AT, self._torque / self._scene.torque_limit)
        canvas.text("torque", (_GAUGE_AT[0] + 30, _GAUGE_AT[1] + 1), size=17, colour=_PALE_INK)
        value = self._torque / unit
        reading = _number(value, 1, "+") if abs(value) < 1e5 else f"{value:+.1e}"
        canvas.text(f"{reading} {symbol}", (_GAUGE_AT[0] + 30, _GAUGE_AT[1] + 16))
        canvas.text(f"t = {_number(self._time, self._decimals)} s", (_RULER + _MARGIN, 18))
        canvas.text(f"{self._count} impact{'' if self._count == 1 else 's'}", (SIZE - _MARGIN, 18), align=1.0)


def _near(point: Point) -> bool:
    """Tell whether a point [px] is close enough to the frame to be drawn; False for what has overflowed."""
    return abs(point[0]) < 4.0 * SIZE and abs(point[1]) < 4.0 * SIZE
