"""Many trajectories of the exact contact model in one loop. Everything here is compiled as it stands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.loop import PATIENCE, PAUSED
from jackbox_env.compiled.search import DONE
from jackbox_env.compiled.step import make_numbers, make_plan, step
from jackbox_env.compiled.workspace import HITS, IMPULSE, TALLY, WORK, Workspace
from jackbox_env.mechanics import energy_of
from jackbox_env.states import clearance

Array = NDArray[np.float64]
Counts = NDArray[np.int64]

_ORDINARY = 1e9  # over L: below it a state's numbers need no closer look


def outside(values: Array, states: Array, deepest: float) -> int:
    """The first state, of shape (N, 12), that a closer look may refuse, or -1."""
    n = make_numbers(values)
    for i in range(states.shape[0]):
        for place in range(12):
            if not abs(states[i, place]) < _ORDINARY * n.box_half_width:
                return i
        if not -clearance(n, states[i]) <= deepest:
            return i
    return -1


def roll(
    values: Array, dt: float, drive: int, trajectories: Array, torques: Array, times: Array, table: Array, ends: Counts,
    low: int, high: int, first: int, hits: Counts, impulses: Array, energies: Array, w: Workspace,
) -> tuple[int, int, int]:  # fmt: skip
    """Fill in trajectories ``low`` to ``high`` from their first states.

    Args:
        values: the scene's numbers.
        dt: [s].
        drive: kind of the scene's drive.
        trajectories: shape (N, H + 1, 12).
        torques: [N m], shape (N, H).
        times: [s], shape (H + 1,).
        table: pieces of a drive of functions, shape (pieces, TABLE_WIDTH).
        ends: first piece of each step, and past the last one's, shape (H + 1,).
        low: first trajectory.
        high: past the last.
        first: step of trajectory ``low`` to begin with.
        hits: impacts in each step, shape (N, H), or (0, H) if nobody asks.
        impulses: their sum [N s], likewise.
        energies: [J], shape (N, H + 1), or (0, H + 1) if nobody asks.
        w: memory to work in.

    Returns:
        How it ended: DONE, how a step that failed ended, or PAUSED after long work; the trajectory and step that failed
        or is next.
    """
    n = make_numbers(values)
    plan = make_plan(n, dt, drive)
    worked = 0.0
    for i in range(low, high):
        if energies.shape[0]:
            energies[i, 0] = energy_of(n, trajectories[i, 0])
        for k in range(first if i == low else 0, torques.shape[1]):
            if worked > PATIENCE:
                return PAUSED, i, k
            before, after = trajectories[i, k], trajectories[i, k + 1]
            ended, _ = step(n, plan, before, after, times[k], torques[i, k], table, ends[k], ends[k + 1], w)
            if ended != DONE:
                return ended, i, k
            worked += 1.0 + w[TALLY, WORK]
            if hits.shape[0]:
                hits[i, k], impulses[i, k] = int(w[TALLY, HITS]), w[TALLY, IMPULSE]
            if energies.shape[0]:
                energies[i, k + 1] = energy_of(n, after)
    return DONE, -1, -1
