"""Draws states of the jack in the box, as arrays or in a window; no physics is computed here.

The camera follows the box's centre, so the box stays in the middle of the picture and turns there. Ruled lines fixed to
the world move past it as it sinks. One foot of the jack has another colour, so that the cross visibly turns. A small
frame has no text. Without the overlay a frame is box, jack and ruled lines alone. pygame is imported with this file and
used off-screen: only the human mode opens a window.

Points in the frame and in the world are complex numbers; see `canvas.py` for those in the frame.
"""

from __future__ import annotations

import cmath
import copy
import math
import os
from collections import deque
from collections.abc import Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from jackbox_env.model.scene import Scene
from jackbox_env.model.states import RATES, Array
from jackbox_env.render.canvas import INK, PALE_INK, SIZE, TRACK, Canvas, written
from jackbox_env.render.raster import LEAST_WALL, REACH, WALL_WIDTH
from jackbox_env.simulators.base import Impact
from jackbox_env.tools.colours import FIRST_FOOT, JACK, TORQUE, WALL, Colour

# Layout [px] of a frame of 512 x 512, scaled in others: text in the corners, the rest for the box, which turns freely.
_MARGIN = 10.0
_BEAD = 1.75  # radius of the trail's beads
_FOOT = 6.0  # greatest radius of a foot
_GAUGE = 18.0  # radius
_LETTERED = 400  # a frame less wide or high has no readings: their letters would be 6 px high
GAP = 2  # between tiles, of any size

# Times in units of L / v0, a fall's time scale (0.55 s in the default scene), and at least this many control steps.
_FLASH_TIME, _FLASH_STEPS = 0.45, 3  # 0.25 s
_TRAIL_TIME, _TRAIL_STEPS = 1.6, 12  # 0.88 s
_TRAIL_POINTS = 48
_MOST_FLASHES = 32
_LONGEST_TASK = 18  # letters

_PAPER: Colour = (243, 245, 248)
_INTERIOR: Colour = (255, 255, 255)
_RULE_DARKER: Colour = (28, 22, 12)  # a ruled line than its ground
_FLASH: Colour = (255, 176, 0)
_TRAIL: Colour = (120, 158, 214)

# The trail's colours from new to old.
_FADING: list[Colour] = [(r, g, b) for r, g, b in np.linspace(_TRAIL, _INTERIOR, 16).astype(int).tolist()]

# Attributes that change during an episode.
_OF_EPISODE = (
    "_trail", "_flashes", "_count", "_torque", "_return", "_interval", "_box", "_jack", "_angle", "_jack_angle",
    "_time",
)  # fmt: skip

_PREFIXES = {-9: "n", -6: "µ", -3: "m", 0: "", 3: "k", 6: "M", 9: "G", 12: "T"}


def _unit(size: float, name: str) -> tuple[float, str]:
    """Return the unit for numbers of about ``size``, as its value and its symbol.

    >>> _unit(90000.0, "N m")
    (1000.0, 'kN m')
    """
    exponent = 3 * math.floor(math.log10(size) / 3.0 + 1e-9)
    exponent = min(max(exponent, min(_PREFIXES)), max(_PREFIXES))
    return 10.0**exponent, _PREFIXES[exponent] + name


def _round_step(least: float) -> float:
    """Return the smallest of 1, 2, 5 times a power of ten that is at least ``least``."""
    power = 10.0 ** math.floor(math.log10(least))
    return next(step for step in (power, 2.0 * power, 5.0 * power, 10.0 * power) if step >= 0.999 * least)


def _number(value: float) -> str:
    """Format with one decimal, large numbers with an exponent."""
    return f"{value:z.1f}" if abs(value) < 1e6 else f"{value:.1e}"


class Renderer:
    """Draws the states of one scene, as arrays or in a window.

    It can be pickled and copied, without surfaces and window: those are made again when needed.

    Args:
        scene: its sizes are drawn.
        render_mode: ``"rgb_array"``, ``"human"``, or ``"rgb_array_list"``, which draws each recorded state.
        fps: frames per second of the window [Hz].
        task: its name, which is written into the frame.
        size: width and height of the frame [px].
        overlay: draw readings, trail and flashes too; below 400 px only trail, flashes and the torque's gauge.
    """

    def __init__(
        self, scene: Scene, render_mode: str, fps: float, task: str = "", size: tuple[int, int] = (SIZE, SIZE),
        overlay: bool = True,
    ) -> None:  # fmt: skip
        self._mode, self._fps, self._size, self._overlay = render_mode, fps, size, overlay
        self._task = task if len(task) <= _LONGEST_TASK else task[: _LONGEST_TASK - 1] + "…"
        self._lettered = overlay and min(size) >= _LETTERED
        # [px] of this frame for a pixel of 512
        self._px = min(size) / SIZE if self._lettered else (0.485 * min(size) - 1.0) / REACH
        self._centre = 0.5 * complex(*size)  # of the box
        self._wall = max(WALL_WIDTH * self._px, LEAST_WALL)
        self._trail: deque[tuple[float, complex]] = deque(maxlen=_TRAIL_POINTS)  # time [s], the jack's position [m]
        # Time [s], point in the box frame [m], radius [px].
        self._flashes: deque[tuple[float, complex, float]] = deque(maxlen=_MOST_FLASHES)
        self._canvas: Canvas | None = Canvas(size)
        self._window: Any = None
        self._clock: Any = None
        self.show(scene)
        self.reset([0.0] * 12, 0.0)

    def __getstate__(self) -> dict[str, Any]:
        return {**self.__dict__, "_canvas": None, "_window": None, "_clock": None}

    def show(self, scene: Scene) -> None:
        """Draw another scene from now on; call :meth:`reset` next."""
        self._scene = scene
        half_width = REACH * self._px / math.sqrt(2.0) - self._wall
        self._scale = half_width / scene.box_half_width  # [px/m]
        self._time_scale = scene.box_half_width / scene.speed_scale  # [s]
        self._spacing = _round_step(scene.box_half_width / 3.5)  # [m] of the ruled lines

    def reset(self, state: Sequence[float] | Array, time: float) -> None:
        """Start anew from ``state``, shape (12,), SI units, at ``time`` [s], without a past."""
        self._trail.clear()
        self._flashes.clear()
        self._count = 0
        self._torque, self._return = 0.0, 0.0  # [N m]; sum of the rewards
        self._interval = 0.0  # [s] last control step
        self._frames = list[NDArray[np.uint8]]()
        self._set(state, time)
        self._add_frame()

    def _set(self, state: Sequence[float] | Array, time: float) -> None:
        x, y, self._angle, jack_x, jack_y, self._jack_angle = map(float, state[:RATES])
        self._box, self._jack, self._time = complex(x, y), complex(jack_x, jack_y), float(time)
        since = self._time - self._trail[-1][0] if self._trail else math.inf
        if self._overlay and since >= 0.99 * _TRAIL_TIME * self._time_scale / _TRAIL_POINTS:
            self._trail.append((self._time, self._jack))

    def record(
        self, state: Sequence[float] | Array, time: float, torque: float, impacts: Sequence[Impact], reward: float = 0.0
    ) -> None:
        """Record the state after a control step, shape (12,), SI units.

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
        for impact in impacts if self._overlay else ():
            strength = impact.impulse / (2.0 * self._scene.jack_mass * self._scene.speed_scale)
            radius = max(2.0, (8.0 + 8.0 * min(strength, 1.0)) * self._px)
            self._flashes.append((impact.time, self._contact_point(impact, state), radius))
        self._add_frame()

    def _add_frame(self) -> None:
        if self._mode == "rgb_array_list":
            self._frames.append(self.drawn())

    def snapshot(self) -> dict[str, Any]:
        """A copy of all that a frame shows of the present scene, for :meth:`restore`."""
        return {name: copy.copy(getattr(self, name)) for name in _OF_EPISODE}

    def restore(self, snapshot: dict[str, Any]) -> None:
        """Return to the moment of a :meth:`snapshot`."""
        vars(self).update({name: copy.copy(value) for name, value in snapshot.items()})

    def _contact_point(self, impact: Impact, state: Sequence[float] | Array) -> complex:
        """Return the point of the wall that the foot struck, in the box frame [m].

        The pose follows from the step's end by the velocities after the impact, and is moved onto the wall.
        """
        pose = [float(state[i]) - float(state[i + RATES]) * (self._time - impact.time) for i in range(RATES)]
        if not all(map(math.isfinite, pose)):
            return complex(math.nan, math.nan)  # rates too large for a float
        x, y, angle, jack_x, jack_y, jack_angle = pose
        arm = cmath.rect(self._scene.jack_arm, jack_angle + impact.foot * math.pi / 2)
        foot = complex(jack_x - x, jack_y - y) + arm
        limit = self._scene.box_half_width
        sideways = (foot * cmath.rect(1.0, -angle) * (-1j) ** impact.wall).imag
        return complex(limit, min(max(sideways, -limit), limit)) * 1j**impact.wall

    def _in_frame(self, offset: complex) -> complex:
        """Return the point of the frame [px] at ``offset`` [m] from the box's centre.

        Relative, because adding and taking away a far-off position would cost digits.
        """
        return self._centre + self._scale * offset.conjugate()

    def _near(self, point: complex) -> bool:
        """Whether a point is close enough to the frame to be drawn; False after an overflow."""
        return max(abs(point.real), abs(point.imag)) < 4.0 * max(self._size)

    def render(self) -> NDArray[np.uint8] | list[NDArray[np.uint8]] | None:
        """Draw the last state that was recorded or reset to.

        Returns:
            A fresh array (height, width, 3) of uint8. In the human mode None: the frame is shown in the window, which
            waits for the next frame's time. With "rgb_array_list" the frames since the last call or reset.
        """
        if self._mode == "rgb_array_list":
            frames, self._frames = self._frames, []
            return frames
        if self._mode == "human":
            self._show(self._drawn())
            return None
        return self.drawn()

    def drawn(self) -> NDArray[np.uint8]:
        """A frame of the last state, a fresh array (height, width, 3) of uint8, in any mode."""
        return self._drawn().pixels()

    def _drawn(self) -> Canvas:
        if self._canvas is None:
            self._canvas = Canvas(self._size)
        canvas = self._canvas
        turn = cmath.rect(1.0, self._angle)  # a box axis in the world
        self._draw_background(canvas, turn)
        self._draw_trail(canvas)
        self._draw_walls(canvas, turn)
        self._draw_flashes(canvas, turn)
        self._draw_jack(canvas)
        if self._overlay:
            self._draw_gauge(canvas)
        if self._lettered:
            self._write_readings(canvas)
        return canvas

    def close(self) -> None:
        """Destroy the window and the surfaces; a second call does nothing. Other renderers continue."""
        if self._window is not None:
            self._window.destroy()
        self._canvas = self._window = self._clock = None

    def _show(self, canvas: Canvas) -> None:
        import pygame

        try:
            shown = self._window and self._window.get_surface()
        except pygame.error:  # somebody else has called pygame.quit()
            # Released before the next one is made: that may get its address, and would be destroyed with it.
            self._window = shown = None
        if shown is None:
            # Or SDL handles SIGTERM, also once the window is closed, and the process goes on. A user may set it to 0.
            os.environ.setdefault("SDL_NO_SIGNAL_HANDLERS", "1")
            self._window, self._clock = pygame.Window("Jack in a box", self._size), pygame.time.Clock()
            shown = self._window.get_surface()
        shown.blit(canvas.surface, (0, 0))
        pygame.event.pump()
        self._window.flip()
        self._clock.tick(self._fps)

    # -- the parts of a frame, from back to front ----------------------------------------------------------------------

    def _draw_background(self, canvas: Canvas, turn: complex) -> None:
        canvas.surface.fill(_PAPER)
        corner = (self._scene.box_half_width + 0.5 * self._wall / self._scale) * (1 + 1j)  # beneath the walls
        canvas.polygon([self._in_frame(corner * turn * 1j**number) for number in range(4)], _INTERIOR)
        for axis in (0, 1):
            for pixel in self._rules(axis):
                canvas.line(pixel, axis, _RULE_DARKER)

    def _rules(self, axis: int) -> Iterator[float]:
        """Yield the ruled lines of the frame [px], along x (axis 0) or y (1)."""
        camera, centre = ((self._box.real, self._centre.real), (self._box.imag, self._centre.imag))[axis]
        beyond = math.fmod(camera, self._spacing)  # exact, however far off the camera is
        step = self._spacing * self._scale * (1.0, -1.0)[axis]  # [px]
        nearest = centre - beyond / self._spacing * step
        low, high = sorted((-nearest / step, (self._size[axis] - nearest) / step))
        for number in range(math.ceil(low), math.floor(high) + 1):
            yield nearest + number * step

    def _draw_trail(self, canvas: Canvas) -> None:
        """Draw the path of the jack's centre through the world, a bead for each recorded point."""
        lasts = max(_TRAIL_TIME * self._time_scale, _TRAIL_STEPS * self._interval)
        for time, jack in self._trail:
            point, share = self._in_frame(jack - self._box), max(0.0, self._time - time) / lasts
            if share < 1.0 and self._near(point):
                canvas.disc(point, _BEAD * self._px, _FADING[int(len(_FADING) * share)])

    def _draw_walls(self, canvas: Canvas, turn: complex) -> None:
        thickness = self._wall / self._scale  # [m]
        middle, end = self._scene.box_half_width + 0.5 * thickness, self._scene.box_half_width + thickness
        for normal in (turn * 1j**wall for wall in range(4)):
            ends = [self._in_frame(normal * complex(middle, sideways)) for sideways in (-end, end)]
            canvas.band(ends[0], ends[1], self._wall, WALL)

    def _draw_flashes(self, canvas: Canvas, turn: complex) -> None:
        lasts = max(_FLASH_TIME * self._time_scale, _FLASH_STEPS * self._interval)
        for time, in_box, radius in self._flashes:
            point, share = self._in_frame(in_box * turn), 1.0 - max(0.0, self._time - time) / lasts
            if share > 0.0 and self._near(point):
                canvas.glow(point, radius, share, _FLASH)

    def _draw_jack(self, canvas: Canvas) -> None:
        jack = self._jack - self._box
        arms = [cmath.rect(self._scene.jack_arm, self._jack_angle + foot * math.pi / 2) for foot in range(4)]
        feet = [self._in_frame(jack + arm) for arm in arms]
        if not all(map(self._near, feet)):
            return
        radius = max(min(0.17 * self._scene.jack_arm * self._scale, _FOOT * self._px), 1.5)
        for foot in feet:
            canvas.disc(foot, radius + 1.0, _INTERIOR)  # a rim sets a foot off against the wall
        for start, end in ((feet[0], feet[2]), (feet[1], feet[3])):
            canvas.band(start, end, radius, JACK)
        canvas.disc(self._in_frame(jack), 0.8 * radius, JACK)
        for foot, colour in zip(feet, (FIRST_FOOT, WALL, WALL, WALL), strict=True):
            canvas.disc(foot, radius, colour)

    def _draw_gauge(self, canvas: Canvas) -> None:
        """Draw an arc in the direction of the torque, at most 140 degrees from the top."""
        middle, radius = complex(34.0 * self._px, self._size[1] - 28.0 * self._px), _GAUGE * self._px
        share = min(max(self._torque / self._scene.torque_limit, -1.0), 1.0)

        def at(degrees: float, beside: float = 0.0) -> complex:
            return middle - 1j * cmath.rect(radius + beside, -math.radians(degrees))

        tip, sign = 140.0 * share, math.copysign(1.0, share)
        head = sign * min(26.0, abs(tip))
        for degrees in sorted(range(-140, 141, 5), key=abs, reverse=True):
            canvas.disc(at(degrees), 2.0 * self._px, TORQUE if 0.0 <= sign * degrees < abs(tip - head) else TRACK)
        if share:
            side = 0.2 * radius * head * sign / 20.0
            canvas.polygon([at(tip), at(tip - head, side), at(tip - head, -side)], TORQUE)

    def _write_readings(self, canvas: Canvas) -> None:
        unit, symbol = _unit(self._scene.torque_limit, "N m")
        left, right = _MARGIN * self._px, self._size[0] - _MARGIN * self._px
        first, second = 18j * self._px, 36j * self._px
        impacts = f"{self._count} impact{'' if self._count == 1 else 's'}"
        self._write(canvas, f"t = {self._time:.2f} s", left + first)
        self._write(canvas, impacts, left + second, 17, PALE_INK)
        self._write(canvas, f"return {_number(self._return)}", right + first, align=1.0)
        self._write(canvas, self._task, right + second, 17, PALE_INK, 1.0)
        beside = complex(64.0 * self._px, self._size[1])  # the gauge
        self._write(canvas, "torque", beside - 35j * self._px, 17, PALE_INK)
        self._write(canvas, f"{_number(self._torque / unit)} {symbol}", beside - 20j * self._px)

    def _write(
        self, canvas: Canvas, text: str, point: complex, size: float = 22.0, colour: Colour = INK,
        align: float = 0.0,
    ) -> None:  # fmt: skip
        """Write with the left end (align 0) or the right end (1) at ``point``, half way down; all in [px]."""
        image = written(text.replace("-", "\N{MINUS SIGN}"), max(1, round(size * self._px)), colour)
        width, height = image.get_size()
        canvas.surface.blit(image, (round(point.real - align * width), round(point.imag - 0.5 * height)))


def tiled(scenes: Sequence[Scene], states: Array, times: Array, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Draw states, shape (>= k, 12), of k scenes as tiles without overlay, row by row in a nearly square grid.

    Args:
        scenes: k of them, at least one.
        states: SI units.
        times: shape (>= k,) [s].
        size: width and height of a tile [px].

    Returns:
        uint8, shape (height, width, 3). The rest of the last row is grey.
    """
    columns = math.ceil(math.sqrt(len(scenes)))
    rows = math.ceil(len(scenes) / columns)
    tiles = np.empty((rows, size[1] + GAP, columns, size[0] + GAP, 3), dtype=np.uint8)
    tiles[:] = TRACK
    renderer = Renderer(scenes[0], "rgb_array", 1, size=size, overlay=False)
    for number, scene in enumerate(scenes):
        renderer.show(scene)
        renderer.reset(states[number], float(times[number]))
        tiles[number // columns, : size[1], number % columns, : size[0]] = renderer.drawn()
    return np.ascontiguousarray(tiles.reshape(rows * (size[1] + GAP), -1, 3)[:-GAP, : columns * (size[0] + GAP) - GAP])
