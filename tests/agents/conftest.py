"""Fixtures of these tests."""

from __future__ import annotations

from tests.agents.small_run import run

__all__ = ["run"]
