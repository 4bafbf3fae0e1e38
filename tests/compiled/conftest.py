"""Fixtures of these tests."""

from __future__ import annotations

from tests.compiled.kept_code import place

__all__ = ["place"]
