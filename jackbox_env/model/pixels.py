"""Observations that are pictures: what is drawn and in which shades; ``render/raster.py`` draws them."""

from __future__ import annotations

import math
import re
from dataclasses import dataclass

from jackbox_env.tools import checks as check

_NAME = re.compile(r"pixels-(\d{1,6})x(\d{1,6})x(\d{1,6})", re.ASCII)
_MOST = 100_000_000  # of an observation


@dataclass(frozen=True)
class Pixels:
    """An agent's observation by pictures: grey, of the last control steps, uint8, shape (height, width, stack).

    ``gym.make("JackInBox-v0", observation=Pixels(size=(64, 64), stack=4))``. ``"pixels"`` is the default one, and
    ``"pixels-64x64x4"`` (width, height, stack) this one, where only text can be passed.

    The last channel is the present; before it come the states after the previous control steps, across impacts. The
    first state of an episode, or one that is set, stands for those before it. A picture shows the box, whose centre is
    in its middle, and the jack: from 0, the ground, over arms 90, walls 120, feet 160 and the first wall 200 to the
    first foot 255. So it determines the jack's pose in the box and the box's angle.

    Attributes:
        size: width and height [px], from 16 to 4096. Stable-Baselines3's ``CnnPolicy`` needs at least 36 x 36.
        stack: number of pictures, at least 1 and below the smaller side, because Stable-Baselines3 takes the smallest
            side for the channels.

    Raises:
        TypeError, ValueError: a number out of its range.
    """

    size: tuple[int, int] = (84, 84)
    stack: int = 1

    def __post_init__(self) -> None:
        """Check both."""
        object.__setattr__(self, "size", check.size("size of Pixels", self.size, at_least=16, at_most=4096))
        object.__setattr__(
            self, "stack",
            check.whole("stack of Pixels, below the smaller side,", self.stack, at_least=1, at_most=min(self.size) - 1),
        )  # fmt: skip
        if math.prod(self.shape) > _MOST:
            raise ValueError(f"Pixels must be at most {_MOST:,} in all pictures, got {check.shown(self)}")

    @property
    def shape(self) -> tuple[int, int, int]:
        """Height and width [px] and number of pictures."""
        return self.size[1], self.size[0], self.stack

    @property
    def name(self) -> str:
        """The text that stands for it as an environment's ``observation``."""
        return "pixels" if self == Pixels() else f"pixels-{self.size[0]}x{self.size[1]}x{self.stack}"


def pixels_named(name: str) -> Pixels | None:
    """The pictures of that name; None if the name is of something else.

    Raises:
        ValueError: a number out of its range.
    """
    numbers = _NAME.fullmatch(name)
    if numbers is None:
        return Pixels() if name == "pixels" else None
    width, height, stack = map(int, numbers.groups())
    return Pixels((width, height), stack)
