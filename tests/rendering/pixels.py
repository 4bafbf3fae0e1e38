"""Frames and their pixels, as the tests of the renderer read them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jackbox_env.model.scene import Scene
from jackbox_env.render.renderer import Renderer

Frame = NDArray[np.uint8]
Mask = NDArray[np.bool_]
Words = dict[str, tuple[float, float]]

L, ARM = 6.0, 1.0  # [m] the default scene's half width and jack arm
AT_REST = (0.0,) * 6


def state(box: tuple[float, ...] = (0.0, 0.0, 0.0), jack: tuple[float, ...] = (0.0, 0.0, 0.0)) -> list[float]:
    return [*box, *jack, *AT_REST]


def renderer_at(start: list[float], scene: Scene | None = None, time: float = 0.0) -> Renderer:
    renderer = Renderer(scene or Scene(), "rgb_array", 1000)
    renderer.reset(start, time)
    return renderer


def draw(renderer: Renderer) -> Frame:
    frame = renderer.render()
    assert isinstance(frame, np.ndarray)
    return frame


def place(x: float, y: float, box: tuple[float, float] = (0.0, 0.0)) -> tuple[float, float]:
    """The point of a frame of the default size and scene [px] for (x, y) [m] in the world; the box is in the middle."""
    scale = (224.0 / math.sqrt(2.0) - 6.0) / L
    return 256.0 + scale * (x - box[0]), 256.0 - scale * (y - box[1])


def pixel(frame: Frame, point: tuple[float, float]) -> tuple[int, int, int]:
    red, green, blue = frame[round(point[1]), round(point[0])].tolist()
    return red, green, blue


def red(colour: NDArray[np.uint8] | tuple[int, int, int]) -> Mask:
    parts = np.asarray(colour, dtype=int)
    return (parts[..., 0] > 180) & (parts[..., 1] < 110) & (parts[..., 2] < 110)


def blue(colour: NDArray[np.uint8] | tuple[int, int, int]) -> Mask:
    parts = np.asarray(colour, dtype=int)
    return (parts[..., 0] < 80) & (parts[..., 1] < 130) & (parts[..., 2] > 150)
