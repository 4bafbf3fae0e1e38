"""Fixtures of these tests."""

from __future__ import annotations

from typing import Any

import pytest

from jackbox_env.render.renderer import Renderer
from tests.rendering.pixels import Words


@pytest.fixture
def words(monkeypatch: pytest.MonkeyPatch) -> Words:
    """Every string drawn, and the last position where it was drawn."""
    written: Words = {}
    write = Renderer._write

    def noting(renderer: Renderer, canvas: Any, text: str, position: complex, *rest: Any, **more: Any) -> None:
        written[text] = position.real, position.imag
        write(renderer, canvas, text, position, *rest, **more)

    monkeypatch.setattr(Renderer, "_write", noting)
    return written
