"""Observations of pixels, drawn by compiled code from states alone: :class:`Past` has the poses that they show.

Each mark is the set of points within some distance of a line segment, and a pixel's share of it is the distance of the
pixel's centre from the mark's edge, clipped to [0, 1]. Cosines and sines are those of the exact model, square roots are
exact, and nothing is summed in another order: a frame has the same bits on every machine.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.exact.geometry import cos_sin, quarter
from jackbox_env.exact.threads import Halt, Threads
from jackbox_env.exact.workspace import make_numbers
from jackbox_env.jit.compiler import compiled
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import RATES, Array, Indices

Frames = NDArray[np.uint8]  # (n, height, width, channels)

# Layout [px] of a frame of 512 x 512.
REACH = 224.0  # of the box's outer corners from its centre, at any angle
WALL_WIDTH, LEAST_WALL = 6.0, 1.5  # of a wall, outwards from its inside face; of a small frame, so that it is seen
_FOOT, _LEAST_FOOT, _FOOT_PER_ARM = 6.0, 1.0, 0.25  # radius of a foot: greatest, that of a small frame, over the arm
# Numbers of a view: the box's centre from the top left corner, half the box, the wall's width, the greatest foot.
_CENTRE_X, _CENTRE_Y, _HALF, _WIDTH, _GREATEST = range(5)
# Rows of the shades: of the first wall and the others, of the arms, of the first foot and the others.
FIRST_WALL, WALLS, ARMS, FIRST, FEET = range(5)
GREYS: Array = np.array([[200.0], [120.0], [90.0], [255.0], [160.0]])
_RANGE = 1 << 19  # pixels that are drawn at once: in about 1 ms
_WAKING = 1 << 17  # pixels that take longer to draw than a thread to wake


class Past(NamedTuple):
    """The poses of N environments that their pictures show."""

    pixels: Pixels
    poses: Array  # (N, stack, 6), the oldest first; never written

    @property
    def grain(self) -> int:
        """The environments for which a thread is woken."""
        return max(1, _WAKING // math.prod(self.pixels.shape))

    def begun(self, numbers: Indices, states: Array) -> Past:
        """The past after some environments have begun in the rows of ``states``, shape (N, 12), of their numbers."""
        poses = self.poses.copy()
        poses[numbers] = states[numbers, None, :RATES]
        return self._replace(poses=poses)

    def after(self, states: Array, made: Array) -> Past:
        """The past after a decision, of which each environment has made so many control steps, shape (N,).

        ``states``, shape (N, places, 12), has the state after step k, counted from 1, in place k modulo ``places``. So
        it has the last ones; there are as many places as steps, or as pictures.
        """
        stack = self.pixels.stack
        steps = made.astype(np.int64)[:, None] + np.arange(1 - stack, 1)  # whose ends are shown; before the first: < 1
        places = np.where(steps < 1, steps - 1, steps % states.shape[1])
        poses = np.concatenate([states[..., :RATES], self.poses], axis=1)
        return self._replace(poses=np.take_along_axis(poses, places[..., None], axis=1))

    def later(self, states: Array) -> Past:
        """The past after control steps of all environments, which led to ``states``, shape (N, steps, 12)."""
        poses = np.concatenate([self.poses, states[..., :RATES]], axis=1)
        return self._replace(poses=poses[:, -self.pixels.stack :])

    def draw(self, rows: Array, numbers: Indices, frames: Any, threads: Threads) -> Any:
        """Draw the pictures of some environments, whose scenes have these ``rows`` of numbers, into their frames.

        Returns the frames.
        """
        view, halt = view_of(self.pixels.size, 0.5 * complex(*self.pixels.size)), Halt()
        step = max(1, _RANGE // math.prod(self.pixels.shape))

        def work(thread: int, low: int, high: int) -> None:
            for first in range(low, 0 if halt.requested else high, step):
                some = slice(first, min(first + step, high))
                values = rows[some] if len(rows) > 1 else rows
                compiled(draw)(frames, numbers[some], self.poses, values, view, GREYS)

        threads.run(work, len(numbers), grain=self.grain, halt=halt)
        return frames


def view_of(size: tuple[int, int], centre: complex) -> Array:
    """The numbers of a view for a picture of width and height [px] with the box's centre at ``centre`` [px]."""
    pixel = (0.485 * min(size) - 1.0) / REACH  # of this frame for a pixel of 512
    wall = max(WALL_WIDTH * pixel, LEAST_WALL)
    half = REACH * pixel / math.sqrt(2.0) - wall
    return np.array([centre.real, centre.imag, half, wall, max(_FOOT * pixel, 1.5 * _LEAST_FOOT)])


def draw(frames: Frames, numbers: Indices, poses: Array, values: Array, view: Array, shades: Array) -> None:
    """Draw some of N frames.

    Args:
        frames: (N, h, w, stack * channels).
        numbers: of the frames, (k,).
        poses: the first six numbers of states, the oldest first, (N, stack, 6).
        values: the scenes' numbers, one row for all or one for each of ``numbers``.
        view: as of :func:`view_of`.
        shades: of the marks in each channel, (5, channels).
    """
    for k in range(numbers.shape[0]):
        frame, scene = frames[numbers[k]], make_numbers(values[k if values.shape[0] > 1 else 0])
        for j in range(frame.shape[0]):
            frame[j] = 0
        for past in range(poses.shape[1]):
            draw_one(frame, past * shades.shape[1], poses[numbers[k], past], scene, view, shades)


def draw_one(frame: Frames, channel: int, pose: Array, scene: SceneNumbers, view: Array, shades: Array) -> None:
    """Draw one pose into channels of a frame from ``channel`` on."""
    scale, thickness = view[_HALF] / scene.box_half_width, 0.5 * view[_WIDTH]  # [px/m], [px]
    middle, (cosine, sine) = view[_HALF] + thickness, cos_sin(pose[2])
    for wall in range(3, -1, -1):  # the first one last
        x, y = quarter(middle * cosine, middle * sine, wall)
        end_x, end_y, shade = view[_CENTRE_X] + x, view[_CENTRE_Y] - y, shades[FIRST_WALL if wall == 0 else WALLS]
        stroke(frame, channel, end_x - y, end_y - x, end_x + y, end_y + x, thickness, shade)
    arm, (cosine, sine) = scale * scene.jack_arm, cos_sin(pose[5])
    radius = min(max(_FOOT_PER_ARM * arm, _LEAST_FOOT), view[_GREATEST])
    jack_x, jack_y = view[_CENTRE_X] + scale * (pose[3] - pose[0]), view[_CENTRE_Y] - scale * (pose[4] - pose[1])
    for part in range(5, -1, -1):  # two arms, from one foot to the other, then the feet, the first one last
        x, y = quarter(arm * cosine, arm * sine, part)
        end_x, end_y, shade = jack_x + x, jack_y - y, shades[ARMS if part > 3 else FIRST if part == 0 else FEET]
        back, thickness = (2.0, 0.5 * radius) if part > 3 else (0.0, radius)
        stroke(frame, channel, end_x - back * x, end_y + back * y, end_x, end_y, thickness, shade)


def stroke(
    frame: Frames, channel: int, x: float, y: float, end_x: float, end_y: float, radius: float, shade: Array
) -> None:
    """Draw what is within ``radius`` [px] of a segment over a frame, in one or several channels; nothing if far off."""
    height, width = frame.shape[0], frame.shape[1]
    far, beyond = 4.0 * max(height, width), radius + 0.5  # of the segment, where the mark ends
    if not max(abs(x), abs(y), abs(end_x), abs(end_y)) < far:  # not if one is NaN either
        return
    length = math.sqrt((end_x - x) * (end_x - x) + (end_y - y) * (end_y - y))
    along_x, along_y = (end_x - x) / max(length, 1e-300), (end_y - y) / max(length, 1e-300)
    left, right = max(0, int(min(x, end_x) - beyond)), min(width - 1, int(max(x, end_x) + beyond))
    top, bottom = max(0, int(min(y, end_y) - beyond)), min(height - 1, int(max(y, end_y) + beyond))
    for j in range(top, bottom + 1):
        down, low, high = j + 0.5 - y, left, right
        if abs(along_y) > 1e-3:  # the columns of this row near the whole line
            here, reach = x + down * along_x / along_y, beyond / abs(along_y) + 0.5
            low = max(low, int(min(max(here - reach, 0.0), far)))
            high = min(high, int(min(max(here + reach, -1.0), far)))
        for i in range(low, high + 1):
            across = i + 0.5 - x
            foot = min(max(across * along_x + down * along_y, 0.0), length)
            off_x, off_y = across - foot * along_x, down - foot * along_y
            share = min(beyond - math.sqrt(off_x * off_x + off_y * off_y), 1.0)
            for one in range(shade.shape[0] if share > 0.0 else 0):
                ground = 1.0 * frame[j, i, channel + one]
                frame[j, i, channel + one] = int(ground + (shade[one] - ground) * share + 0.5)
