"""The past that pictures show: the poses of the last control steps."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from jackbox_env.envs.decisions import ControlStep
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import RATES, Array
from jackbox_env.render.raster import draw_pixels


class Past(NamedTuple):
    """The poses of one environment that its pictures show."""

    pixels: Pixels
    poses: Array  # (stack, 6), the oldest first; never written

    @classmethod
    def at(cls, pixels: Pixels, state: Array) -> Self:
        """That of a first state."""
        return cls(pixels, np.tile(state[:RATES], (pixels.stack, 1)))

    def after(self, steps: Sequence[ControlStep]) -> Past:
        """That after control steps."""
        last = [step.state[:RATES] for step in steps[-self.pixels.stack :]]
        return self._replace(poses=np.concatenate([self.poses[len(last) :], last]))

    def observed(self, scene: Scene) -> NDArray[np.uint8]:
        """The pictures: a fresh array."""
        frames = np.empty(self.pixels.shape, np.uint8)
        draw_pixels(self.pixels, np.array([scene.numbers]), self.poses[None], frames[None])
        return frames
