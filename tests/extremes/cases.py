"""All cases."""

from __future__ import annotations

from tests.extremes import contacts, long_runs, motion
from tests.extremes.page import CASES

__all__ = ["CASES", "contacts", "long_runs", "motion"]
