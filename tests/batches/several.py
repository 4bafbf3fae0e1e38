"""What the tests of vector environments share."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

EVERY_MODEL = pytest.mark.parametrize("contact", ["exact", "pymunk"])


# 1: NumPy easily makes a view where a copy is meant. 300: more than two blocks.
SIZES = [("exact", 1), ("exact", 2), ("exact", 300), ("pymunk", 1), ("pymunk", 3)]


EVERY_SIZE = pytest.mark.parametrize(("contact", "count"), SIZES)


def actions_at(step: int, count: int) -> Any:
    return np.random.default_rng(step).uniform(-1.2, 1.2, (count, 1)).astype(np.float32)


def assert_same(found: Any, expected: Any, path: str = "") -> None:
    """Equal in kind and in every bit, dicts and arrays of arrays included."""
    if isinstance(expected, tuple):
        assert_same(dict(enumerate(found)), dict(enumerate(expected)), path)
    elif isinstance(expected, dict):
        assert set(found) == set(expected), path
        for name in expected:
            assert_same(found[name], expected[name], f"{path}/{name}")
    elif isinstance(expected, np.ndarray) and expected.dtype == object:
        for one, other in zip(found, expected, strict=True):
            assert_same(one, other, path)
    elif isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype, path
        np.testing.assert_array_equal(found, expected, err_msg=path)
    else:
        assert found == expected, path
