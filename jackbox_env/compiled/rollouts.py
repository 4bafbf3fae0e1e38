"""Many trajectories of the exact contact model in one loop. Everything here is compiled as it stands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.loop import PATIENCE
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.step import Pieces, make_numbers, make_plan, step
from jackbox_env.compiled.workspace import HITS, IMPULSE, TALLY, WORK, Workspace
from jackbox_env.mechanics import energy_of
from jackbox_env.states import clearance

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

_ORDINARY = 1e9  # over L: below it a state's numbers need no closer look


def outside(values: Array, states: Array, deepest: float) -> int:
    """The first state, of shape (N, 12), that a closer look may refuse, or -1."""
    scene = make_numbers(values)
    for i in range(states.shape[0]):
        for place in range(12):
            if not abs(states[i, place]) < _ORDINARY * scene.box_half_width:
                return i
        if not -clearance(scene, states[i]) <= deepest:
            return i
    return -1


class Played(NamedTuple):
    """Where a rollout is written; arrays of length 0 where nobody asks."""

    trajectories: Array  # (N, H + 1, 12), the first states given
    hits: Counts  # (N, H) impacts in each step, or (0, H)
    impulses: Array  # (N, H) their sum [N s], or (0, H)
    energies: Array  # (N, H + 1) [J], or (0, H + 1)


def roll(
    values: Array, dt: float, kind: int, torques: Array, drive: tuple[Array, Array, Counts],
    span: tuple[int, int, int], results: tuple[Array, Counts, Array, Array], work: Workspace,
) -> tuple[int, int, int]:  # fmt: skip
    """Fill in trajectories from their first states.

    Args:
        values: the scene's numbers.
        dt: [s].
        kind: what turns the box, besides the torques.
        torques: [N m], shape (N, H).
        drive: times [s], shape (H + 1,); pieces of a drive of functions, shape (pieces, TABLE_WIDTH); the first piece
            of each step and past the last one's, shape (H + 1,).
        span: first trajectory, past the last, and the step of the first one to begin with.
        results: the fields of :class:`Played`.
        work: memory to work in.

    Returns:
        How it ended: DONE, how a step that failed ended, or PAUSED after long work; the trajectory and step that failed
        or is next.
    """
    scene = make_numbers(values)
    plan = make_plan(scene, dt, kind)
    times, table, ends = drive
    low, high, first = span
    played = Played(results[0], results[1], results[2], results[3])
    worked = 0.0
    for i in range(low, high):
        if played.energies.shape[0]:
            played.energies[i, 0] = energy_of(scene, played.trajectories[i, 0])
        for k in range(first if i == low else 0, torques.shape[1]):
            if worked > PATIENCE:
                return Status.PAUSED.value, i, k
            before, after = played.trajectories[i, k], played.trajectories[i, k + 1]
            pieces = Pieces(table, ends[k], ends[k + 1])
            ended, _ = step(scene, plan, before, after, times[k], torques[i, k], pieces, work)
            if ended != Status.DONE:
                return ended.value, i, k
            worked += 1.0 + work[TALLY, WORK]
            if played.hits.shape[0]:
                played.hits[i, k], played.impulses[i, k] = int(work[TALLY, HITS]), work[TALLY, IMPULSE]
            if played.energies.shape[0]:
                played.energies[i, k + 1] = energy_of(scene, after)
    return Status.DONE.value, -1, -1
