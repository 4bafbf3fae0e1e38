"""The past that pictures show: the poses of the last control steps of one or many environments."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.envs.batches.threads import Halt, Threads
from jackbox_env.exact.compiler import compiled
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.states import RATES, Array, Indices
from jackbox_env.render.raster import GREYS, draw, view_of

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
        """That after some environments have begun in the rows of ``states``, shape (N, 12), of their numbers."""
        poses = self.poses.copy()
        poses[numbers] = states[numbers, None, :RATES]
        return self._replace(poses=poses)

    def after(self, states: Array, made: Array) -> Past:
        """That after control steps to ``states``, shape (N, steps, 12), of which each environment has made so many."""
        poses = np.concatenate([self.poses, states[..., :RATES]], axis=1)
        last = made.astype(np.int64)[:, None] + np.arange(self.pixels.stack)
        return self._replace(poses=np.take_along_axis(poses, last[..., None], axis=1))

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
                compiled(draw)(frames, numbers[some], self.poses, values, view, GREYS, True)

        threads.run(work, len(numbers), grain=self.grain, halt=halt)
        return frames
