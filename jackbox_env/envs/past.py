"""The past that pictures show: the poses of the last control steps of one or many environments."""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np

from jackbox_env.exact.threads import Halt, Threads
from jackbox_env.jit.compiler import compiled
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
        """That after control steps that all environments have made, to ``states``, shape (N, steps, 12)."""
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
