"""The arrow keys of `gymnasium.utils.play`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from jackbox_env.model.action import ACTIONS, Action

_LEFT_AND_RIGHT: dict[Action, tuple[Any, Any]] = {
    ACTIONS["torque"]: (np.ones(1, np.float32), -np.ones(1, np.float32)), ACTIONS["discrete"]: (2, 0),
}  # fmt: skip


def keys_of(action: Action) -> Callable[[], dict[tuple[int, ...], Any]]:
    """A function that returns the actions of the left and the right arrow key.

    Raises:
        AttributeError: the action is neither "torque" nor "discrete", so Gymnasium finds no keys.
    """
    if action not in _LEFT_AND_RIGHT:
        raise AttributeError("there are keys for action='torque' and 'discrete' only")
    left, right = _LEFT_AND_RIGHT[action]

    def keys() -> dict[tuple[int, ...], Any]:
        import pygame

        return {(pygame.K_LEFT,): left, (pygame.K_RIGHT,): right}

    return keys
