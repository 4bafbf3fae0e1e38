"""Fixtures of these tests."""

from __future__ import annotations

from tests.environment.start import env

__all__ = ["env"]
