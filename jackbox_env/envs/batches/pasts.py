"""The pasts that the pictures of a batch show: the poses of the last control steps of each environment."""

from __future__ import annotations

from typing import Any, NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

from jackbox_env.envs.batches.threads import Halt, Threads
from jackbox_env.model.pixels import Pixels
from jackbox_env.model.states import RATES, Array, Indices
from jackbox_env.render.raster import draw_pixels

_PIXELS = 1 << 19  # of a range that is drawn at once: about 1 ms
_WAKING = 1 << 17  # that take longer to draw than a thread to wake


class Pasts(NamedTuple):
    """The poses of N environments that their pictures show."""

    pixels: Pixels
    poses: Array  # (N, stack, 6), the oldest first; never written

    @classmethod
    def of(cls, pixels: Pixels, num_envs: int) -> Self:
        """Those of environments that have not begun."""
        return cls(pixels, np.zeros((num_envs, pixels.stack, RATES)))

    @property
    def grain(self) -> int:
        """The environments for which a thread is woken."""
        return max(1, _WAKING // int(np.prod(self.pixels.shape)))

    def begun(self, numbers: Indices, states: Array) -> Pasts:
        """Those after some environments have begun in the rows of ``states``, shape (N, 12), of their numbers."""
        poses = self.poses.copy()
        poses[numbers] = states[numbers, None, :RATES]
        return self._replace(poses=poses)

    def after(self, states: Array, made: Array) -> Pasts:
        """Those after control steps to ``states``, shape (N, steps, 12), of which each environment has made so many."""
        poses = np.concatenate([self.poses, states[..., :RATES]], axis=1)
        last = made.astype(np.int64)[:, None] + np.arange(self.pixels.stack)
        return self._replace(poses=np.take_along_axis(poses, last[..., None], axis=1))

    def draw(self, rows: Array, numbers: Indices, frames: NDArray[Any], threads: Threads) -> None:
        """Draw the pictures of some environments, whose scenes have these ``rows`` of numbers, into their frames."""
        size, halt = max(1, _PIXELS // int(np.prod(self.pixels.shape))), Halt()
        whole = len(numbers) == len(frames)  # all of them, in order

        def work(thread: int, low: int, high: int) -> None:
            for first in range(low, high, size):
                if halt.requested:
                    return
                chosen = slice(first, min(first + size, high))
                values = rows[chosen] if len(rows) > 1 else rows
                if whole:
                    draw_pixels(self.pixels, values, self.poses[chosen], frames[chosen])
                    continue
                for k, number in enumerate(numbers[chosen].tolist()):
                    one = values[k : k + 1] if len(rows) > 1 else rows
                    draw_pixels(self.pixels, one, self.poses[number : number + 1], frames[number : number + 1])

        threads.run(work, len(numbers), grain=self.grain, halt=halt)
