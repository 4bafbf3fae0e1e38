"""Many trajectories of the exact contact model in one loop. Everything here is compiled as it stands."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.address import step_score
from jackbox_env.compiled.score import ENDS, UNUSABLE
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.step import Pieces, effort, make_numbers, make_plan, step
from jackbox_env.compiled.workspace import Workspaces
from jackbox_env.mechanics import energy_of
from jackbox_env.states import clearance

Array = NDArray[np.float64]
Counts = NDArray[np.int64]
Flags = NDArray[np.bool_]

_ORDINARY = 1e9  # over L: below it a state's numbers need no closer look


def outside(values: Array, states: Array, deepest: Array) -> int:
    """The first state, of shape (N, 12), that a closer look may refuse, or -1; in one scene or a row for each state."""
    for i in range(states.shape[0]):
        row = i if values.shape[0] > 1 else 0
        scene = make_numbers(values[row])
        for place in range(12):
            if not abs(states[i, place]) < _ORDINARY * scene.box_half_width:
                return i
        if not -clearance(scene, states[i]) <= deepest[row]:
            return i
    return -1


class RolloutArrays(NamedTuple):
    """Where a rollout is written; arrays of length 0 where nobody asks."""

    trajectories: Array  # (N, H + 1, 12), the first states given; (N, 2, 12): states of even and of odd steps, in turn
    hits: Counts  # (N, H) impacts in each step, or (0, H)
    impulses: Array  # (N, H) their sum [N s], or (0, H)
    energies: Array  # (N, H + 1) [J], or (0, H + 1)
    rewards: Array  # (N, H), zeros, or (0, H)
    lengths: Counts  # (N,) steps until the task ends an episode, H given


def roll(
    scenes: tuple[Array, Counts, Counts], dt: float, torques: Array, drive: tuple[Array, Array, Counts],
    span: tuple[int, int, int], results: tuple[Array, Counts, Array, Array, Array, Counts], score: int,
    until_impact: bool, patience: float, memories: tuple[Workspaces, Array], tape: tuple[Array, Counts, Flags],
) -> tuple[int, int, int]:  # fmt: skip
    """Fill in trajectories from their first states.

    Args:
        scenes: one row for all trajectories or one for each: numbers, shape (1 or N, numbers of a scene); what turns
            the box besides the torques; where the pieces of its drive begin in the list of first pieces.
        dt: [s].
        torques: [N m], shape (N, whole part of H), each held for as many steps as H has of them.
        drive: times [s], shape (H + 1,); pieces of the drives' functions, shape (pieces, TABLE_WIDTH); the first piece
            of each step of the first drive, of the next drive and so on, and past the last one's.
        span: first trajectory, past the last, and the step of the first one to begin with.
        results: the fields of :class:`RolloutArrays`.
        score: address of the task's ``score_step``; called only where rewards are asked for.
        until_impact: end each trajectory with the step of its first impact.
        patience: gaps evaluated before the call pauses.
        memories: to work in: a workspace, and room to record a step's impacts, of none where nobody asks.
        tape: where that record is kept for derivatives: the wide log's rows of one step after the other, shape
            (rows, WIDE), how many there are, shape (1,), and which steps have no derivative, shape (N, H). Arrays of
            length 0 where nobody asks.

    Returns:
        How it ended: DONE, how a step that failed ended, PAUSED after long work or FULL where the record has no room;
        the trajectory and step that failed or is next.
    """
    values, kinds, begins = scenes
    scene = make_numbers(values[0])
    plan = make_plan(scene, dt, kinds[0])
    times, table, ends = drive
    low, high, first = span
    played = RolloutArrays(results[0], results[1], results[2], results[3], results[4], results[5])
    pay = step_score(score)
    memory, log = memories[0][0], memories[1]
    rows, used, rough = tape
    worked, steps = 0.0, times.shape[0] - 1
    whole, repeat = played.trajectories.shape[1] > steps, max(1, steps // max(1, torques.shape[1]))
    begin = begins[0]
    for i in range(low, high):
        if values.shape[0] > 1:
            scene = make_numbers(values[i])
            plan, begin = make_plan(scene, dt, kinds[i]), begins[i]
        if played.energies.shape[0]:
            played.energies[i, 0] = energy_of(scene, played.trajectories[i, 0])
        for k in range(first if i == low else 0, steps):
            if worked > patience:
                return Status.PAUSED.value, i, k
            torque = torques[i, k if repeat == 1 else k // repeat]
            before = played.trajectories[i, k if whole else k & 1]
            after = played.trajectories[i, k + 1 if whole else (k + 1) & 1]
            pieces = Pieces(table, ends[begin + k], ends[begin + k + 1])
            ended, mean = step(scene, plan, before, after, times[k], torque, pieces, memory, log)
            if ended != Status.DONE:
                return ended.value, i, k
            worked += 1.0 + effort(memory)
            if rough.shape[0]:
                if not keep(memory.hits, log, rows, used):
                    return Status.FULL.value, i, k
                rough[i, k] = memory.rough != 0
            if played.hits.shape[0]:
                played.hits[i, k], played.impulses[i, k] = memory.hits, memory.impulse
            if played.energies.shape[0]:
                played.energies[i, k + 1] = energy_of(scene, after)
            if played.rewards.shape[0] and k < played.lengths[i]:
                row = values[i if values.shape[0] > 1 else 0]
                became = pay(row, after, mean, memory.impulse, played.rewards[i], k)
                if became == UNUSABLE:
                    return Status.BAD_REWARD.value, i, k
                if became == ENDS:
                    played.lengths[i] = k + 1
            if until_impact and memory.hits > 0:
                break
    return Status.DONE.value, -1, -1


def keep(hits: int, log: Array, rows: Array, used: Counts) -> bool:
    """Keep the rows of a step's log behind the ``used`` ones; False where one of both has no room for them."""
    first = used[0]
    if hits > log.shape[0] or first + hits > rows.shape[0]:
        return False
    for hit in range(hits):
        for place in range(rows.shape[1]):
            rows[first + hit, place] = log[hit, place]
    used[0] = first + hits
    return True
