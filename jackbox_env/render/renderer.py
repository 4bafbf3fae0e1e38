"""Draws the jack in the box: reads states, computes no physics.

The camera follows the box's centre, so the box stays in the middle of the picture and turns there. Ruled lines fixed to
the world move past it as it sinks, and the rulers on the left and at the bottom tell where it is. One foot of the jack
has a colour of its own, so that a turn of the cross is seen. Without the overlay a frame is box, jack and ruled lines
alone. pygame is imported when the first `Renderer` is made and used off-screen: only the human mode opens a window.

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

from jackbox_env.render.canvas import SIZE, TRACK, Canvas, Colour, Point, import_pygame
from jackbox_env.scene import Scene
from jackbox_env.simulators.base import Impact
from jackbox_env.states import Array

if TYPE_CHECKING:
    import pygame


# Layout [px] of a frame of 512 x 512, scaled in others: a ruler on the left and one at the bottom; the box may turn
# freely in the rest, the corners are left to the text.
_RULER, _FLOOR = 54.0, 20.0
_WALL = 6.0  # thickness of a wall, outwards from its inside face
_REACH = 224.0  # of the box's outer corners from its centre, at any angle
_MARGIN = 10.0
_BEAD = 1.75  # radius of the trail's beads
_SMALL = 160 * 160  # pixels of a frame in which it is fastest to look at each
_SHORT = 60.0  # [px] length of an arm, alike
_LEAST_WALL = 1.5  # of a small frame, so that the wall is seen

# Times in units of L / v0, a fall's time scale (0.55 s in the default scene), and at least this many control steps.
_FLASH_TIME, _FLASH_STEPS = 0.45, 3  # 0.25 s
_TRAIL_TIME, _TRAIL_STEPS = 1.6, 12  # 0.88 s
_TRAIL_POINTS = 48
_MOST_FLASHES = 32
_LONGEST_TASK = 18  # letters
_ROOM = 50.0  # [px] that the longest label takes

_PAPER: Colour = (243, 245, 248)
_INTERIOR: Colour = (255, 255, 255)
_RULER_TINT: Colour = (236, 239, 244)
_RED: Colour = (204, 36, 41)
_FIRST_FOOT: Colour = (255, 176, 0)
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


class Layout:
    """Where things are in a frame of one size [px].

    Args:
        size: width and height.
        overlay: whether room is left to rulers and text.
    """

    def __init__(self, size: tuple[int, int], overlay: bool) -> None:
        self.size = size
        self.unit = min(size) / SIZE if overlay else (0.485 * min(size) - 1.0) / _REACH
        self.ruler, self.floor = (_RULER * self.unit, _FLOOR * self.unit) if overlay else (0.0, 0.0)
        self.margin = _MARGIN * self.unit
        self.centre = (0.5 * (self.ruler + size[0]), 0.5 * size[1])  # of the box
        self.wall = max(_WALL * self.unit, _LEAST_WALL)
        self.half_width = _REACH * self.unit / math.sqrt(2.0) - self.wall  # L on the screen
        self.gauge_at = (self.ruler + 34.0 * self.unit, size[1] - self.floor - 28.0 * self.unit)

    def near(self, point: Point) -> bool:
        """Tell whether a point is close enough to the frame to be drawn; False for what has overflowed."""
        far = 4.0 * max(self.size)
        return abs(point[0]) < far and abs(point[1]) < far


class Renderer:
    """Draws the states of one scene, as arrays or in a window.

    It can be pickled and copied: surfaces, fonts and the window are left behind and made again when needed.

    Args:
        scene: gives the sizes.
        render_mode: ``"rgb_array"`` or ``"human"``.
        fps: frames per second of the window [Hz].
        task: its name, which is written into the frame.
        size: width and height of the frame [px].
        overlay: draw rulers, readings, trail and flashes too.

    Raises:
        gymnasium.error.DependencyNotInstalled: pygame is missing.
    """

    def __init__(
        self, scene: Scene, render_mode: str, fps: float, task: str = "", size: tuple[int, int] = (SIZE, SIZE),
        overlay: bool = True,
    ) -> None:  # fmt: skip
        self._human = render_mode == "human"
        self._fps = fps
        self._task = task if len(task) <= _LONGEST_TASK else task[: _LONGEST_TASK - 1] + "…"
        self._layout, self._overlay = Layout(size, overlay), overlay
        self._trail: deque[tuple[float, float, float]] = deque(maxlen=_TRAIL_POINTS)  # x, y of the jack [m], time [s]
        self._flashes: deque[tuple[Impact, float, list[float]]] = deque(maxlen=_MOST_FLASHES)  # time [s], state after
        self._canvas: Canvas | None = self._fresh_canvas()
        self._clock: pygame.time.Clock | None = None
        self.show(scene)
        self.reset([0.0] * 12, 0.0)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_canvas": None, "_clock": None}

    def _fresh_canvas(self) -> Canvas:
        return Canvas(self._layout.size, self._layout.unit)

    def show(self, scene: Scene) -> None:
        """Take the sizes from another scene; :meth:`reset` comes next."""
        self._scene = scene
        self._scale = self._layout.half_width / scene.box_half_width  # [px/m]
        self._time_scale = scene.box_half_width / scene.speed_scale  # [s]
        self._decimals = min(max(2, math.ceil(-math.log10(self._time_scale / 50.0))), 6)  # of the time
        self._spacing = _round_step(scene.box_half_width / 3.5)  # [m] of the ruled lines

    def reset(self, state: Sequence[float] | Array, time: float) -> None:
        """Start anew from ``state``, shape (12,), SI units, at ``time`` [s], without a past."""
        self._trail.clear()
        self._flashes.clear()
        self._count = 0
        self._torque, self._return = 0.0, 0.0  # [N m]; sum of the rewards
        self._interval = 0.0  # [s] last control step
        self._set(state, time)

    def _set(self, state: Sequence[float] | Array, time: float) -> None:
        self._state: list[float] = np.array(state, dtype=np.float64).tolist()  # a copy: the caller's may change
        self._time = float(time)
        if not self._overlay:
            return
        kept = self._trail[-1][2] if self._trail else -math.inf
        if self._time - kept >= 0.99 * _TRAIL_TIME * self._time_scale / _TRAIL_POINTS:
            self._trail.append((self._state[3], self._state[4], self._time))

    def record(
        self, state: Sequence[float] | Array, time: float, torque: float, impacts: Sequence[Impact], reward: float = 0.0
    ) -> None:
        """Note the state after a control step, shape (12,), SI units; nothing is drawn.

        Args:
            state: at the end of the step.
            time: at the end of the step [s].
            torque: mean torque on the box over the step [N m].
            impacts: the impacts of the step.
            reward: of the step.
        """
        self._interval = max(0.0, float(time) - self._time)
        self._torque = float(torque)
        self._count += len(impacts)
        self._return += float(reward)
        self._set(state, time)
        if self._overlay:
            self._flashes.extend((impact, self._time, self._state) for impact in impacts)

    def to_pixels(self, x: float, y: float) -> Point:
        """Return where the point (x, y) [m] of the world lies in the frame [px], x to the right and y down."""
        middle = self._layout.centre
        return middle[0] + (x - self._state[0]) * self._scale, middle[1] - (y - self._state[1]) * self._scale

    def render(self) -> NDArray[np.uint8] | None:
        """Draw the last state that was recorded or reset to.

        Returns:
            A fresh array (height, width, 3) of uint8, or None in the human mode, which shows it in the window and waits
            for the next frame's time.
        """
        if self._canvas is None:
            self._canvas = self._fresh_canvas()
        canvas = self._canvas
        self._draw_background(canvas)
        self._draw_trail(canvas)
        self._draw_box(canvas)
        self._draw_flashes(canvas)
        self._draw_jack(canvas)
        if self._overlay:
            self._draw_rulers(canvas)
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
            if not _windowed and window is not None and window.get_size() == self._layout.size:
                display.quit()

    def _show(self, canvas: Canvas) -> None:
        display = canvas.pygame.display
        window = display.get_surface()  # asked for each time: somebody else may have closed or resized it
        if window is None or window.get_size() != self._layout.size:
            window = display.set_mode(self._layout.size)
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
        side = (
            self._scene.box_half_width + 0.5 * self._layout.wall / self._scale
        )  # its edge is hidden beneath the walls
        corners = [self._in_box(x, y) for x, y in ((side, side), (-side, side), (-side, -side), (side, -side))]
        canvas.pygame.draw.polygon(canvas.surface, _INTERIOR, corners)
        canvas.rules([pixel for pixel, _ in self._rules(0)], [pixel for pixel, _ in self._rules(1)])

    def _rules(self, axis: int) -> list[tuple[float, float]]:
        """Return the ruled lines of the frame as (place [px], coordinate [m]), along x (axis 0) or y (1)."""
        camera = self._state[axis]
        beyond = math.fmod(camera, self._spacing)  # exact, however far off the camera is
        step = self._spacing * self._scale * (1.0, -1.0)[axis]  # [px]
        nearest = self._layout.centre[axis] - beyond / self._spacing * step
        ends = sorted((-nearest / step, (self._layout.size[axis] - nearest) / step))
        numbers = range(math.ceil(ends[0]), math.floor(ends[1]) + 1)
        return [(nearest + number * step, camera - beyond + number * self._spacing) for number in numbers]

    def _draw_trail(self, canvas: Canvas) -> None:
        """Draw the way of the jack's centre through the world, a bead for each recorded place."""
        lasts = max(_TRAIL_TIME * self._time_scale, _TRAIL_STEPS * self._interval)
        for x, y, time in self._trail:
            place = self.to_pixels(x, y)
            share = max(0.0, self._time - time) / lasts
            if share < 1.0 and self._layout.near(place):
                canvas.disc(place, _BEAD * self._layout.unit, _FADING[int(len(_FADING) * share)])

    def _draw_box(self, canvas: Canvas) -> None:
        thickness = self._layout.wall
        if self._layout.size[0] * self._layout.size[1] <= _SMALL:
            inner, direction = self._layout.half_width, (math.cos(self._state[2]), -math.sin(self._state[2]))
            canvas.square(self._layout.centre, direction, inner, inner + thickness, _RED)
            return
        middle = self._scene.box_half_width + 0.5 * thickness / self._scale
        end = 2.0 * (self._layout.half_width + thickness)  # [px] a wall's length, corners included
        cosine, sine = math.cos(self._state[2]), math.sin(self._state[2])
        vertical = [self._in_box(middle, 0.0), self._in_box(-middle, 0.0)]
        canvas.bands(vertical, (-sine * end, -cosine * end), 0.5 * thickness, _RED)
        horizontal = [self._in_box(0.0, middle), self._in_box(0.0, -middle)]
        canvas.bands(horizontal, (cosine * end, -sine * end), 0.5 * thickness, _RED)

    def _in_box(self, x: float, y: float) -> Point:
        """Return where the point (x, y) [m] of the box frame lies in the frame [px]."""
        cosine, sine = math.cos(self._state[2]), math.sin(self._state[2])
        # Straight from the frame's middle: adding and taking away a far-off position would cost digits.
        middle = self._layout.centre
        return middle[0] + (cosine * x - sine * y) * self._scale, middle[1] - (sine * x + cosine * y) * self._scale

    def _draw_flashes(self, canvas: Canvas) -> None:
        lasts = max(_FLASH_TIME * self._time_scale, _FLASH_STEPS * self._interval)
        for impact, time, state in self._flashes:
            fade = 1.0 - max(0.0, self._time - impact.time) / lasts
            place = self._in_box(*self._foot_at_impact(impact, time, state)) if fade > 0.0 else (math.inf, math.inf)
            if self._layout.near(place):
                strength = impact.impulse / (2.0 * self._scene.jack_mass * self._scene.speed_scale)
                canvas.glow(place, max(2, round((10.0 + 10.0 * min(strength, 1.0)) * self._layout.unit)), fade)

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
        if not self._layout.near((x, y)):
            return
        arm = self._scene.jack_arm * self._scale  # [px]
        radius = max(min(0.25 * round(0.68 * arm), 6.0 * self._layout.unit), 1.5)  # of a foot
        across, up = arm * math.cos(self._state[5]), arm * math.sin(self._state[5])
        feet = ((x + across, y - up), (x - up, y - across), (x - across, y + up), (x + up, y + across))
        for foot in feet:
            canvas.disc(foot, radius + 1.0, _INTERIOR)  # a rim sets a foot off against the wall
        if arm <= _SHORT:
            canvas.cross((x, y), (across / arm, -up / arm), arm, 0.5 * radius, _BLUE)
        else:
            for span in ((2.0 * across, -2.0 * up), (-2.0 * up, -2.0 * across)):
                canvas.bands([(x, y)], span, 0.5 * radius, _BLUE)
        canvas.disc((x, y), 0.8 * radius, _BLUE)
        for foot, colour in zip(feet, (_FIRST_FOOT, _RED, _RED, _RED), strict=True):
            canvas.disc(foot, radius, colour)

    def _draw_rulers(self, canvas: Canvas) -> None:
        """Draw the scales of heights, on the left, and of places along x, at the bottom; ticks pass under the corner.

        A number too long for its scale keeps its last digits, which show the motion.
        """
        layout, surface = self._layout, canvas.surface
        left, floor, one = round(layout.ruler), round(layout.size[1] - layout.floor), max(1, round(layout.unit))
        tick = round(4.0 * layout.unit)
        surface.fill(_RULER_TINT, (0, 0, left, layout.size[1]))
        surface.fill(TRACK, (left, 0, one, floor))
        for pixel, height in self._rules(1):
            surface.fill(TRACK, (left - tick, round(pixel), tick, one))
            place = (layout.ruler - 7.0 * layout.unit, pixel)
            canvas.text(self._place_label(height), place, align=1.0, size=17, colour=_PALE_INK)
        surface.fill(_RULER_TINT, (0, floor, layout.size[0], layout.size[1] - floor))
        surface.fill(TRACK, (left, floor, layout.size[0] - left, one))
        with_unit = self._spacing * self._scale >= _ROOM * layout.unit
        for pixel, place_x in self._rules(0):
            surface.fill(TRACK, (round(pixel), floor, one, tick))
            label = self._place_label(place_x, with_unit)
            canvas.text(label, (pixel, floor + 12.0 * layout.unit), align=0.5, size=17, colour=_PALE_INK)
        surface.fill(_RULER_TINT, (0, floor, left, layout.size[1] - floor))

    def _place_label(self, place: float, with_unit: bool = True) -> str:
        """Return a place [m] as the rulers write it."""
        unit, symbol = _unit(self._scene.box_half_width, "m")
        value = _number(place / unit, max(0, -math.floor(math.log10(self._spacing / unit) + 1e-9)))
        room = 6 - len(symbol)
        value = value if len(value) <= room else "…" + value[1 - room :]
        return f"{value} {symbol}" if with_unit else value

    def _draw_readings(self, canvas: Canvas) -> None:
        layout, (unit, symbol) = self._layout, _unit(self._scene.torque_limit, "N m")
        x, y = layout.gauge_at
        canvas.gauge((x, y), self._torque / self._scene.torque_limit)
        canvas.text("torque", (x + 30.0 * layout.unit, y - 7.0 * layout.unit), size=17, colour=_PALE_INK)
        value = self._torque / unit
        reading = _number(value, 1, "+") if abs(value) < 1e5 else f"{value:+.1e}"
        canvas.text(f"{reading} {symbol}", (x + 30.0 * layout.unit, y + 8.0 * layout.unit))
        left, right = layout.ruler + layout.margin, layout.size[0] - layout.margin
        first, second = 18.0 * layout.unit, 36.0 * layout.unit
        canvas.text(f"t = {_number(self._time, self._decimals)} s", (left, first))
        impacts = f"{self._count} impact{'' if self._count == 1 else 's'}"
        canvas.text(impacts, (left, second), size=17, colour=_PALE_INK)
        earned = _number(self._return, 1) if abs(self._return) < 1e6 else f"{self._return:.1e}"
        canvas.text(f"return {earned}", (right, first), align=1.0)
        canvas.text(self._task, (right, second), align=1.0, size=17, colour=_PALE_INK)
