"""Fixtures of these tests."""

from __future__ import annotations

from typing import Any

import pytest

from jackbox_env.render.canvas import Canvas
from tests.rendering.pixels import Words


@pytest.fixture
def words(monkeypatch: pytest.MonkeyPatch) -> Words:
    """Every string drawn, and the last place where it was drawn."""
    written: Words = {}
    write = Canvas.text

    def noting(self: Canvas, text: str, place: tuple[float, float], *rest: Any, **more: Any) -> None:
        written[text] = place
        write(self, text, place, *rest, **more)

    monkeypatch.setattr(Canvas, "text", noting)
    return written
