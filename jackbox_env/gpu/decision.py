"""A decision of an environment, and the start of its next episode, as one thread of a GPU makes them.

The loop is :func:`jackbox_env.exact.run.run` itself, over a block of one row. What a GPU leaves to the CPU is that of
:mod:`jackbox_env.gpu.row`.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.exact.geometry import FARTHEST
from jackbox_env.exact.glide import write_scene_params
from jackbox_env.exact.pcg64 import draw_scenes, restart_blocks
from jackbox_env.exact.run import run
from jackbox_env.exact.score import act_block, observe_chosen, observe_rows, score_block
from jackbox_env.exact.workspace import (
    LIMIT,
    OVER,
    SCRATCH,
    Arguments,
    Status,
    ThreadMemory,
    Workspaces,
    new_log,
    new_workspaces,
    scene_at,
)
from jackbox_env.exact.workspace import example as example_of_run
from jackbox_env.gpu.row import SUBSTITUTES, farthest_angle
from jackbox_env.jit.compiler import PACKED, packed, unpacked_as
from jackbox_env.model.scene import remainder
from jackbox_env.model.states import Array, Counts, Flags, Floats


class Decision(NamedTuple):
    """What :func:`decide` reads and writes."""

    ended: Counts  # (N,) a Status; the first field, see ptx.py
    made: Counts  # (N,) steps before one that failed
    arguments: Arguments  # with blocks of one row, and no memory


class Beginning(NamedTuple):
    """What :func:`begin` reads and writes."""

    ended: Counts  # (N,) a Status; the first field, see ptx.py
    chosen: Flags  # (N,) whether an episode begins
    numbers: Counts  # (N,) of the environments
    dt: float  # [s]
    values: Array  # (1 or N, numbers of a scene)
    scene_params: Array  # (1 or N, SCENE_PARAMS, 1)
    ranges: Array  # what is drawn, see ``pcg64.draw_scenes``; (0, 3): nothing
    derived: Flags  # (1 or N, 2), likewise
    words: NDArray[np.uint64]  # (N, 6), the generators
    blocks: Array  # (N, 16, 1)
    observations: Floats  # (N, numbers)


def example() -> Decision:
    """Arguments of the types that :func:`decide` is compiled for."""
    counts = np.zeros(0, np.int64)
    return Decision(counts, counts, example_of_run())


def example_of_begin() -> Beginning:
    """Arguments of the types that :func:`begin` is compiled for."""
    counts, table, cube = np.zeros(0, np.int64), np.zeros((0, 0)), np.zeros((0, 0, 0))
    flags, words = np.zeros((0, 0), np.bool_), np.zeros((0, 0), np.uint64)
    return Beginning(
        counts, np.zeros(0, np.bool_), counts, 0.0, table, cube, table, flags, words, cube,
        np.zeros((0, 0), np.float32),
    )  # fmt: skip


decision_at, beginning_at = unpacked_as(example), unpacked_as(example_of_begin)


def arguments() -> tuple[Any, ...]:
    """Arguments of :func:`decide`."""
    return 0, np.zeros(PACKED), new_workspaces(), np.zeros((SCRATCH, 1)), new_log(), 0


def decide(address: Any, buffer: Array, workspaces: Workspaces, scratch: Array, log: Array, row: int) -> None:
    """Make a decision in an environment of a :class:`Decision` at this address.

    Args:
        address: of the decision.
        buffer: memory for the arguments of ``run``.
        workspaces: of this thread, whatever is in it.
        scratch: likewise.
        log: of no impacts.
        row: the environment, >= 0.
    """
    decision, memory = decision_at(address), workspaces[0]
    call = decision.arguments
    before, scene = call.before[row], scene_at(call.scenes.values, row)
    limit = call.scenes.scene_params[row if call.scenes.scene_params.shape[0] > 1 else 0, LIMIT, 0]
    longest = call.rules.dt * call.rules.steps
    if before[OVER, 0] == 0.0 and not farthest_angle(scene, before[:, 0], limit, longest) < 0.125 * FARTHEST:
        decision.ended[row] = Status.UNCOMPILED.value
        return
    memory.held.holding = memory.held.released = memory.lane = 0
    own = Arguments(
        call.scenes, call.rules, call.before, call.after, call.controls, call.results,
        ThreadMemory(scratch, workspaces, log),
    )  # fmt: skip
    decision.ended[row], _, decision.made[row], _, _ = run(packed(buffer.ctypes.data, own), row, row + 1, 0)


def begin(address: Any, row: int) -> None:
    """Begin an episode in an environment of a :class:`Beginning` at this address, if it is chosen."""
    call = beginning_at(address)
    if not call.chosen[row]:
        return
    own, words = call.numbers[row : row + 1], call.words[row : row + 1]
    first = row if call.values.shape[0] > 1 else 0
    values = call.values[first : first + 1]
    if call.ranges.shape[0]:
        follows = row if call.derived.shape[0] > 1 else 0
        draw_scenes(values, call.ranges, call.derived[follows : follows + 1], words)
        write_scene_params(values, call.dt, call.scene_params, own)
    restart_blocks(values, call.blocks, own, words)
    if observe_chosen(values, call.blocks, own, call.observations) >= 0:
        call.ended[row] = Status.BAD_OBSERVATION.value


# -- in place of functions of exact/ -----------------------------------------------------------------------------------


def scorer_of(_address: Any) -> Any:
    """For the call by an address."""
    return score_block


def observer_of(_address: Any) -> Any:
    """Likewise."""
    return observe_rows


def actor_of(_address: Any) -> Any:
    """Likewise."""
    return act_block


def no_actor_of(_address: Any) -> Any:
    """Likewise, for shares of the torque's limit, which need none."""
    return no_act_block


def no_act_block(
    _values: Array, _before: Array, _scratch: Array, _controls: Array, _first: int, _size: int, _dt: float
) -> int:
    """Never called."""
    return -1


def never_together(*_arguments: Any) -> bool:
    """For the flight of several rows together."""
    return False


OF_DECISIONS: dict[str, Any] = SUBSTITUTES | {
    "less_quarters": remainder, "fly_block": never_together, "block_scorer": scorer_of, "block_observer": observer_of,
}  # fmt: skip
