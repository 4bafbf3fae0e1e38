"""Pictures of several environments in a grid."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from jackbox_env.render.canvas import TRACK
from jackbox_env.render.renderer import Renderer
from jackbox_env.scene import Scene
from jackbox_env.states import Array

GAP = 2  # [px] between tiles


def tiled(scenes: Sequence[Scene], states: Array, times: Array, size: tuple[int, int]) -> NDArray[np.uint8]:
    """Draw states, shape (>= k, 12), of k scenes, each as a tile without overlay, row by row in a square-like grid.

    Args:
        scenes: k of them, at least one.
        states: SI units.
        times: shape (>= k,) [s].
        size: width and height of a tile [px].

    Returns:
        uint8, shape (height, width, 3). What is left over in the last row is grey.
    """
    width, height = size
    columns = math.ceil(math.sqrt(len(scenes)))
    rows = math.ceil(len(scenes) / columns)
    picture = np.empty((rows * (height + GAP) - GAP, columns * (width + GAP) - GAP, 3), dtype=np.uint8)
    picture[:] = TRACK
    renderer = Renderer(scenes[0], "rgb_array", 1, size=size, overlay=False)
    for number, scene in enumerate(scenes):
        renderer.show(scene)
        renderer.reset(states[number], float(times[number]))
        frame = renderer.render()
        assert frame is not None
        row, column = divmod(number, columns)
        top, left = row * (height + GAP), column * (width + GAP)
        picture[top : top + height, left : left + width] = frame
    return picture
