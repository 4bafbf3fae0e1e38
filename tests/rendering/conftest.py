"""Fixtures of these tests."""

from __future__ import annotations

from tests.rendering.pixels import words

__all__ = ["words"]
