"""Fixtures of these tests."""

from __future__ import annotations

from typing import Any

import pytest

from jackbox_env.render import canvas, renderer
from tests.rendering.pixels import Words


@pytest.fixture
def words(monkeypatch: pytest.MonkeyPatch) -> Words:
    """Every string drawn, and the last position where it was drawn."""
    written: Words = {}
    write = canvas.write

    def noting(surface: Any, text: str, position: complex, *rest: Any) -> None:
        written[text] = position.real, position.imag
        write(surface, text, position, *rest)

    monkeypatch.setattr(renderer, "write", noting)
    return written
