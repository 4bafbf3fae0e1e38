"""Small frames drawn by compiled code from states alone: observations of pixels, and pictures without overlay.

Each mark is the set of points within some distance of a line segment, and a pixel's share of it is the distance of the
pixel's centre from the mark's edge, clipped to [0, 1]. Cosines and sines are those of the exact model, square roots are
exact, and nothing is summed in another order: a frame has the same bits on every machine.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jackbox_env.exact.compiler import compiled
from jackbox_env.exact.geometry import cos_sin, quarter
from jackbox_env.exact.workspace import make_numbers
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array

Frames = NDArray[np.uint8]  # (n, height, width, channels)

# Layout [px] of a frame of 512 x 512.
REACH = 224.0  # of the box's outer corners from its centre, at any angle
WALL_WIDTH, LEAST_WALL = 6.0, 1.5  # of a wall, outwards from its inside face; of a small frame, so that it is seen
_FOOT = 6.0  # greatest radius of a foot
_FOOT_PER_ARM = 0.25
_LEAST_FOOT = 1.0  # radius of a foot of a small frame
# Numbers of a view: the box's centre from the top left corner, half the box, the wall's width, the greatest foot.
_CENTRE_X, _CENTRE_Y, _HALF, _WIDTH, _GREATEST = range(5)
# Rows of the shades: of the first wall and the others, of the arms, of the first foot and the others.
FIRST_WALL, WALLS, ARMS, FIRST, FEET = range(5)
_GREYS: Array = np.array([[200.0], [120.0], [90.0], [255.0], [160.0]])


def view_of(size: tuple[int, int], centre: complex) -> Array:
    """Where a frame without overlay of width and height [px] shows the box, whose centre is at ``centre`` [px]."""
    pixel = (0.485 * min(size) - 1.0) / REACH  # of this frame for a pixel of 512
    wall = max(WALL_WIDTH * pixel, LEAST_WALL)
    half = REACH * pixel / math.sqrt(2.0) - wall
    return np.array([centre.real, centre.imag, half, wall, max(_FOOT * pixel, 1.5 * _LEAST_FOOT)])


def draw_pixels(pixels: Pixels, values: Array, poses: Array, frames: Frames) -> None:
    """Draw observations, shape (n, h, w, stack), of ``poses``, shape (n, stack, 6).

    Args:
        pixels: size and stack.
        values: the scenes' numbers, one row for all or one for each.
        poses: the first six numbers of states, the oldest first.
        frames: to be overwritten.
    """
    frames.fill(0)
    view = view_of(pixels.size, 0.5 * complex(*pixels.size))
    compiled(draw)(frames, np.ascontiguousarray(poses), values, view, _GREYS)


def draw_colours(frame: Frames, pose: Sequence[float], scene: Scene, centre: complex, colours: Array) -> None:
    """Draw box and jack over a frame, shape (h, w, 3), in colours by the rows above, shape (5, 3)."""
    view, poses = view_of((frame.shape[1], frame.shape[0]), centre), np.array(pose).reshape(1, 1, -1)
    compiled(draw)(frame[None], poses, np.array([scene.numbers]), view, colours)


def draw(frames: Frames, poses: Array, values: Array, view: Array, shades: Array) -> None:
    """Draw frames over their ground.

    Args:
        frames: (n, h, w, stack * channels).
        poses: (n, stack, 6).
        values: the scenes' numbers, one row for all or one for each.
        view: as of :func:`view_of`.
        shades: of the marks in each channel, (5, channels).
    """
    for number in range(frames.shape[0]):
        row = values[number if values.shape[0] > 1 else 0]
        for past in range(poses.shape[1]):
            draw_one(frames[number], past * shades.shape[1], poses[number, past], row, view, shades)


def draw_one(frame: Frames, channel: int, pose: Array, row: Array, view: Array, shades: Array) -> None:
    """Draw one pose into channels of a frame from ``channel`` on; ``row`` has the scene's numbers."""
    scene = make_numbers(row)
    scale = view[_HALF] / scene.box_half_width  # [px/m]
    middle_x, middle_y = view[_CENTRE_X], view[_CENTRE_Y]
    cosine, sine = cos_sin(pose[2])
    thickness = 0.5 * view[_WIDTH]
    middle = view[_HALF] + thickness
    for wall in range(3, -1, -1):  # the first one last
        x, y = quarter(cosine, sine, wall)
        ahead_x, ahead_y, beside_x, beside_y = middle * x, -middle * y, middle * y, middle * x
        stroke(
            frame, channel, middle_x + ahead_x - beside_x, middle_y + ahead_y - beside_y,
            middle_x + ahead_x + beside_x, middle_y + ahead_y + beside_y, thickness,
            shades[FIRST_WALL if wall == 0 else WALLS],
        )  # fmt: skip
    jack_x, jack_y = middle_x + scale * (pose[3] - pose[0]), middle_y - scale * (pose[4] - pose[1])
    cosine, sine = cos_sin(pose[5])
    arm = scale * scene.jack_arm
    radius = min(max(_FOOT_PER_ARM * arm, _LEAST_FOOT), view[_GREATEST])
    for foot in range(2):
        x, y = quarter(arm * cosine, arm * sine, foot)
        stroke(frame, channel, jack_x - x, jack_y + y, jack_x + x, jack_y - y, 0.5 * radius, shades[ARMS])
    for foot in range(3, -1, -1):
        x, y = quarter(arm * cosine, arm * sine, foot)
        shade = shades[FIRST if foot == 0 else FEET]
        stroke(frame, channel, jack_x + x, jack_y - y, jack_x + x, jack_y - y, radius, shade)


def stroke(
    frame: Frames, channel: int, x: float, y: float, end_x: float, end_y: float, radius: float, shade: Array
) -> None:
    """Draw what is within ``radius`` [px] of a segment over a frame, in one or several channels; nothing if far off."""
    height, width = frame.shape[0], frame.shape[1]
    far = 4.0 * max(height, width)
    if not max(abs(x), abs(y), abs(end_x), abs(end_y)) < far:  # not if one is NaN either
        return
    along_x, along_y = end_x - x, end_y - y
    length = math.sqrt(along_x * along_x + along_y * along_y)
    if length > 0.0:
        along_x, along_y = along_x / length, along_y / length
    beyond = radius + 0.5  # of the segment, where the mark ends
    left, right = max(0, int(min(x, end_x) - beyond)), min(width - 1, int(max(x, end_x) + beyond))
    top, bottom = max(0, int(min(y, end_y) - beyond)), min(height - 1, int(max(y, end_y) + beyond))
    steep = abs(along_y) > 1e-3
    for j in range(top, bottom + 1):
        down, low, high = j + 0.5 - y, left, right
        if steep:  # the columns of this row near the whole line
            here, reach = x + down * along_x / along_y, beyond / abs(along_y)
            low = max(low, int(min(max(here - reach - 0.5, 0.0), far)))
            high = min(high, int(min(max(here + reach + 0.5, -1.0), far)))
        for i in range(low, high + 1):
            across = i + 0.5 - x
            foot = min(max(across * along_x + down * along_y, 0.0), length)
            off_x, off_y = across - foot * along_x, down - foot * along_y
            share = min(beyond - math.sqrt(off_x * off_x + off_y * off_y), 1.0)
            if share > 0.0:
                for one in range(shade.shape[0]):
                    ground = 1.0 * frame[j, i, channel + one]
                    frame[j, i, channel + one] = int(ground + (shade[one] - ground) * share + 0.5)
