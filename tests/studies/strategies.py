"""What hypothesis draws for the property tests, and how much of it.

``HYPOTHESIS_PROFILE=soak`` draws fifty times as much, from a new seed each time; the default draws the same each time.
"""

from __future__ import annotations

import os
import random
from collections.abc import Callable, Sequence
from typing import Any, TypeVar

from hypothesis import HealthCheck, settings
from hypothesis import strategies as st

from scripts.studies.laws.random_cases import Case, draw_case

T = TypeVar("T")
STEPS = 24  # control steps of a case
_SLOW = [HealthCheck.too_slow, HealthCheck.data_too_large, HealthCheck.large_base_example]

settings.register_profile(
    "quick", max_examples=120, derandomize=True, print_blob=True, deadline=None, suppress_health_check=_SLOW
)
settings.register_profile("soak", max_examples=6000, print_blob=True, deadline=None, suppress_health_check=_SLOW)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "quick"))


class HypothesisDraw(random.Random):
    """A generator whose choices are hypothesis's, which it shrinks."""

    def __init__(self, draw: Callable[[st.SearchStrategy[Any]], Any]) -> None:
        super().__init__()
        self._draw = draw

    def uniform(self, low: float, high: float) -> float:
        # Any float but the tiny: products of those with lengths and times would leave the range of scenes.
        number: float = self._draw(st.floats(low, high).filter(lambda x: x == 0.0 or abs(x) > 1e-12))
        return number

    def randint(self, low: int, high: int) -> int:
        number: int = self._draw(st.integers(low, high))
        return number

    def choice(self, options: Sequence[T]) -> T:  # type: ignore[override]
        option: T = self._draw(st.sampled_from(options))
        return option


@st.composite
def cases(draw: st.DrawFn, contact: str) -> Case:
    """A scene, a start and actions for a contact model."""
    return draw_case(HypothesisDraw(draw), contact, steps=STEPS)
