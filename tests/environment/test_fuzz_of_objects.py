"""Hostile values for every public method, on objects that must go on unharmed."""

from __future__ import annotations

import pytest

from tests.environment.subjects import CALLS, EVERY_MODEL, SHOWN_BY_GYMNASIUM, hurt
from tests.hostile import EVERYTHING


@EVERY_MODEL
@pytest.mark.parametrize("name", CALLS)
def test_calls_of_objects(name: str, contact: str) -> None:
    subject, _, call, more = CALLS[name]
    values = SHOWN_BY_GYMNASIUM if name in ("env seed", "made seed") else EVERYTHING
    assert not hurt(subject(contact), call, {**values, **more})
