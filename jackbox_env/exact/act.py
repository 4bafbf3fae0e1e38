"""Torques of actions in compiled code, of one state or of a block of rows.

``run.py`` calls :func:`act_block` by its address before each step of a block. It is compiled for each action but the
default, with its function in place of :func:`action_torque` and a reader of its actions for :func:`action_in`.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from typing import Any

from jackbox_env.exact.compiler import called_at, fixed_tuple
from jackbox_env.exact.glide import OVER, TIME
from jackbox_env.exact.observe import state_in
from jackbox_env.exact.step import make_numbers
from jackbox_env.exact.workspace import APPLIED
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import Array, State

block_actor = called_at("i8(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[:, ::1], i8, i8, f8)")


def action_torque(scene: SceneNumbers, state: State, action: Any, time: float, dt: float) -> float:
    """Placeholder for the function of an action, which replaces it when that is compiled."""
    raise NotImplementedError


def action_in(controls: Array, number: int) -> Any:
    """Placeholder for the reader of one environment's action, as :func:`pair_in`."""
    raise NotImplementedError


def pair_in(controls: Array, number: int) -> tuple[float, float]:
    """The two numbers of an action."""
    return controls[0, number], controls[1, number]


def choice_in(controls: Array, number: int) -> int:
    """The whole number of an action."""
    return int(controls[0, number])


@cache
def tuple_in(size: int) -> Callable[[Array, int], tuple[float, ...]]:
    """A reader of actions of ``size`` numbers."""

    def numbers_in(controls: Array, number: int) -> tuple[float, ...]:
        return fixed_tuple(controls[:, number], size)

    return numbers_in


def act_block(values: Array, before: Array, lanes: Array, controls: Array, first: int, size: int, dt: float) -> int:
    """Fill in the torques of a step of a block; return the first row whose torque is NaN, or -1.

    Args:
        values: the scenes' numbers, one row for all environments or one for each.
        before: the block before the step.
        lanes: whose row ``APPLIED`` is filled in [N m]; 0 for episodes that are over.
        controls: actions of all environments, shape (n, N).
        first: number of the block's first environment.
        size: rows of the block.
        dt: control step [s].
    """
    several = values.shape[0] > 1
    for k in range(size):
        lanes[APPLIED, k] = 0.0
        if before[OVER, k] == 0.0:
            number = first + k
            scene, state = make_numbers(values[number if several else 0]), state_in(before[:, k])
            share = 1.0 * action_torque(scene, state, action_in(controls, number), before[TIME, k], dt)  # of a bool too
            if share != share:
                return k
            lanes[APPLIED, k] = max(-1.0, min(1.0, share)) * scene.torque_limit
    return -1


def act_one(values: Array, state: Array, controls: Array, time: float, dt: float) -> float:
    """The torque over its limit of one environment's action, shape (n, 1), not clipped."""
    return 1.0 * action_torque(make_numbers(values), state_in(state), action_in(controls, 0), time, dt)
