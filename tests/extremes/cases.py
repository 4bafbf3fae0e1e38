"""All cases, in the order of the page."""

from __future__ import annotations

from tests.extremes import impacts, long_runs, motion, numbers, rest, starts
from tests.extremes.page import CASES

__all__ = ["CASES", "impacts", "long_runs", "motion", "numbers", "rest", "starts"]
