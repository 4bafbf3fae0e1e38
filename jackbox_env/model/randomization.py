"""Scenes drawn anew at each reset: fields within ranges, or by a function of the environment's random generator."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from itertools import product
from typing import Any

import numpy as np

from jackbox_env.model.scene import Scene, SceneNumbers
from jackbox_env.model.states import Array
from jackbox_env.tools import checks as check

NUMBERS = tuple(part.name for part in fields(Scene) if part.name in SceneNumbers._fields)  # that have a range
Randomize = Mapping[str, tuple[float, float]] | Callable[[np.random.Generator], Mapping[str, Any]] | None
_INERTIAS = ("box_inertia", "jack_inertia")


class Randomization:
    """The checked ``randomize`` argument of an environment.

    Args:
        randomize: {field of the scene: (least, largest)}, drawn uniformly, one after the other in the order of Scene's
            fields; or a function of a ``numpy.random.Generator`` that returns a dict of fields.
        scenes: those that are changed.
        try_scene: called with scenes at the ends of all ranges; raises if the contact model cannot simulate one.

    Raises:
        TypeError, ValueError: neither of both; an unknown field; a range that includes an invalid scene.
    """

    def __init__(self, randomize: Any, scenes: Sequence[Scene], try_scene: Callable[[Scene], Any]) -> None:
        self.ranges: dict[str, tuple[float, float]] = {}
        self._returned = set[str]()  # fields that the function has drawn so far
        self.function: Callable[[np.random.Generator], Mapping[str, Any]] | None = None
        if isinstance(randomize, Mapping):
            check.known_keys("randomize", randomize, NUMBERS)
            self.ranges = {name: _range(name, randomize[name]) for name in NUMBERS if name in randomize}
        elif callable(randomize):
            self.function = randomize
        else:
            raise TypeError(
                "randomize must be a dict of the scene's fields with their ranges, or a function of a generator that "
                f"returns a dict of fields, got {check.shown(randomize)}"
            )
        for scene in dict.fromkeys(scenes) if self.ranges else ():
            for ends in product(*self.ranges.values()):
                changes = dict(zip(self.ranges, ends, strict=True))
                try:
                    try_scene(scene.changed(**changes))
                except (TypeError, ValueError) as error:
                    drawn = ", ".join(f"{name}={value:g}" for name, value in changes.items())
                    raise ValueError(f"randomize could draw a scene with {drawn}, which is refused: {error}") from error

    def draw(self, scene: Scene, rng: np.random.Generator) -> dict[str, Any]:
        """Draw the fields that change; this advances the generator.

        Raises:
            TypeError: the function does not return a dict.
        """
        if self.function is None:
            return {name: between(low, high, rng.random()) for name, (low, high) in self.ranges.items()}
        drawn = self.function(rng)
        if not isinstance(drawn, Mapping):
            raise TypeError(f"randomize must return a dict of the scene's fields, got {check.shown(drawn)}")
        self._returned |= drawn.keys()
        return dict(drawn)

    @property
    def names(self) -> list[str]:
        """The numeric fields that are drawn, in the order of Scene's; of a function those drawn so far."""
        return [name for name in NUMBERS if name in self.ranges or name in self._returned]

    @property
    def table(self) -> Array:
        """The ranges as rows (index in SceneNumbers, least, largest), shape (k, 3), in the order of drawing."""
        rows = [[SceneNumbers._fields.index(name), *ends] for name, ends in self.ranges.items()]
        return np.array(rows, dtype=np.float64).reshape(-1, 3)

    def derived(self, scene: Scene) -> list[bool]:
        """Whether the inertia of the box, and of the jack, follows mass and size in the drawn scenes."""
        return [name in scene.derived and name not in self.ranges for name in _INERTIAS]


def next_scene(
    original: Scene, randomize: Randomization | None, rng: np.random.Generator, changes: Mapping[str, Any]
) -> Scene:
    """The scene of an episode: the ``original``, with fields that are drawn, then ``changes``.

    Raises:
        TypeError, ValueError: an invalid scene.
    """
    drawn = {} if randomize is None else randomize.draw(original, rng)
    return original.changed(**{**drawn, **changes})


def _range(name: str, ends: Any) -> tuple[float, float]:
    if not isinstance(ends, Sequence | np.ndarray) or isinstance(ends, str) or len(ends) != 2:
        raise TypeError(f"randomize[{name!r}] must be (least, largest), got {check.shown(ends)}")
    low, high = (check.real(f"randomize[{name!r}]", value) for value in ends)
    if low > high:
        raise ValueError(f"randomize[{name!r}] must be (least, largest), got {check.shown(ends)}")
    return low, high


def between(low: float, high: float, share: float) -> float:
    """The number that is ``share`` (0 to 1) of the way from ``low`` to ``high``, never beyond by rounding."""
    return min(high, low + (high - low) * share)
