"""Many environments of the exact contact model in one loop: step, reward, count, observe, restart.

An environment is one row of ``rows``, shape (N, 16): its state, then the places named below. A step reads one array of
rows and writes another, so that a step that fails leaves all as it was. Everything here is compiled as it stands.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jackbox_env.batches.generator import Words, uniform
from jackbox_env.observation import seen
from jackbox_env.scene import SceneNumbers
from jackbox_env.simulators.base import LATEST_TIME
from jackbox_env.simulators.kernel import DONE
from jackbox_env.simulators.step import make_numbers, make_plan, step
from jackbox_env.simulators.workspace import HITS, IMPULSE, TALLY, WORK, Workspace
from jackbox_env.tasks import juggle, rattle, spin, start_pose
from jackbox_env.trigonometry import LARGEST, cos_sin, cos_sin_within

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]

WIDTH = 16
TIME, STEPS, OVER = 12, 13, 14  # [s], steps in the episode, 1 where it has ended
BAD_ACTION, TOO_LATE, PAUSED = 4, 5, 6  # how a step ended, besides the ways of simulators.step
PATIENCE = 20_000_000  # gaps evaluated before it pauses, about a second
# Columns of a report: what a step's info holds beside state and time.
TORQUE, IMPACTS, IMPULSES, TERMS = range(4)
BLOCK = 64  # environments that are observed together
REPORT_WIDTH = 5  # two terms at most
JUGGLE, SPIN, RATTLE = range(3)  # the tasks, in the order of tasks.TASKS


def look(n: SceneNumbers, state: Array, observation: Floats) -> None:
    """Write the observation of a state, shape (10,)."""
    cosine, sine = cos_sin(state[2])
    cosine_4, sine_4 = cos_sin(4.0 * (state[5] - state[2]))
    write(n, state, cosine, sine, cosine_4, sine_4, observation)


def look_block(n: SceneNumbers, rows: Array, low: int, high: int, trig: Array, observations: Floats) -> None:
    """Write the observations of up to ``BLOCK`` environments: the same as :func:`look`, several angles at once."""
    count = high - low
    largest = 0.0
    for k in range(count):
        trig[0, k] = rows[low + k, 2]
        trig[2, k] = 4.0 * (rows[low + k, 5] - rows[low + k, 2])
        largest = max(largest, max(abs(trig[0, k]), abs(trig[2, k])))
    if largest < LARGEST:
        for k in range(count):
            trig[0, k], trig[1, k] = cos_sin_within(trig[0, k])
        for k in range(count):
            trig[2, k], trig[3, k] = cos_sin_within(trig[2, k])
    else:
        for k in range(count):
            trig[0, k], trig[1, k] = cos_sin(trig[0, k])
            trig[2, k], trig[3, k] = cos_sin(trig[2, k])
    for k in range(count):
        write(n, rows[low + k], trig[0, k], trig[1, k], trig[2, k], trig[3, k], observations[low + k])


def write(
    n: SceneNumbers, state: Array, cosine: float, sine: float, cosine_4: float, sine_4: float, observation: Floats
) -> None:
    """Write the ten numbers."""
    a, b, c, d, e, f, g, h, i, j = seen(n, state, cosine, sine, cosine_4, sine_4)
    observation[0], observation[1], observation[2], observation[3], observation[4] = a, b, c, d, e
    observation[5], observation[6], observation[7], observation[8], observation[9] = f, g, h, i, j


def reward_terms(n: SceneNumbers, task: int, state: Array, torque: float, impulse: float) -> tuple[float, float]:
    """The values of a task's terms, 0 for a second one it does not have."""
    if task == RATTLE:
        return rattle(n, state, torque, impulse)
    if task == SPIN:
        return spin(n, state, torque, impulse)[0], 0.0
    return juggle(n, state, torque, impulse)[0], 0.0


def step_rows(
    values: Array, dt: float, drive: int, task: int, limit: float, rows: Array, after: Array, actions: Array,
    table: Array, ranges: Counts, low: int, high: int, observations: Floats, rewards: Array, truncations: Flags,
    reports: Array, trig: Array, w: Workspace,
) -> tuple[int, int, int]:  # fmt: skip
    """Step environments ``low`` to ``high`` whose episodes are not over.

    Args:
        values: the scene's numbers.
        dt: control step [s].
        drive: kind of the scene's drive.
        task: number of the task.
        limit: steps after which an episode is truncated.
        rows: environments, shape (N, 16).
        after: where they go, shape (N, 16).
        actions: shape (N,), clipped to [-1, 1]; shape (0,): the drive acts.
        table: pieces of a drive of functions, shape (pieces, TABLE_WIDTH).
        ranges: first and past the last of each environment's, shape (N, 2), or (0, 2) where there are none.
        low: first environment.
        high: past the last.
        observations: to be filled, shape (N, 10).
        rewards: to be filled, shape (N,).
        truncations: to be filled, shape (N,).
        reports: to be filled, shape (N, REPORT_WIDTH), or (0, REPORT_WIDTH) if nobody asks.
        trig: memory to work in, shape (4, BLOCK).
        w: memory to work in.

    Returns:
        How it ended: DONE, how a step that failed ended, or PAUSED after long work; the environment that failed or is
        next; and the number of episodes that ended.
    """
    n = make_numbers(values)
    plan = make_plan(n, dt, drive)
    driven, first, last, finished, worked = actions.shape[0] == 0, 0, 0, 0, 0.0
    for i in range(low, high):
        if i > low and (i - low) % BLOCK == 0:
            look_block(n, after, i - BLOCK, i, trig, observations)
            if worked > PATIENCE:
                return PAUSED, i, finished
        row, new = rows[i], after[i]
        if row[OVER] != 0.0:
            for place in range(WIDTH):
                new[place] = row[place]
            rewards[i], truncations[i] = 0.0, False
            continue
        time = row[TIME]
        if time + dt == time or time + dt > LATEST_TIME:
            return TOO_LATE, i, finished
        torque = math.nan
        if not driven:
            action = actions[i]
            if not abs(action) < math.inf:
                return BAD_ACTION, i, finished
            torque = max(-1.0, min(1.0, action)) * n.torque_limit
        if ranges.shape[0]:
            first, last = ranges[i, 0], ranges[i, 1]
        ended, torque = step(n, plan, row, new, time, torque, table, first, last, w)
        if ended != DONE:
            return ended, i, finished
        worked += w[TALLY, WORK]
        one, two = reward_terms(n, task, new, torque, w[TALLY, IMPULSE])
        rewards[i] = one + two
        new[TIME] = time + dt
        new[STEPS] = row[STEPS] + 1.0
        truncated = new[STEPS] >= limit
        truncations[i] = truncated
        new[OVER] = 0.0
        if truncated:
            new[OVER] = 1.0
            finished += 1
        if reports.shape[0]:
            reports[i, TORQUE], reports[i, IMPACTS], reports[i, IMPULSES] = torque, w[TALLY, HITS], w[TALLY, IMPULSE]
            reports[i, TERMS], reports[i, TERMS + 1] = one, two
    seen_so_far = low + (max(high - low - 1, 0) // BLOCK) * BLOCK
    look_block(n, after, seen_so_far, high, trig, observations)
    return DONE, -1, finished


def restart_rows(values: Array, rows: Array, generators: Words, chosen: Flags) -> None:
    """Draw a start for each of the ``chosen`` environments, at time 0."""
    n = make_numbers(values)
    for i in range(rows.shape[0]):
        if chosen[i]:
            row = rows[i]
            for place in range(WIDTH):
                row[place] = 0.0
            x = -1.0 + 2.0 * uniform(generators[i])
            y = -1.0 + 2.0 * uniform(generators[i])
            angle = -1.0 + 2.0 * uniform(generators[i])
            row[3], row[4], row[5] = start_pose(n, x, y, angle)


def look_rows(values: Array, rows: Array, chosen: Flags, observations: Floats) -> None:
    """Write the observations of the ``chosen`` environments."""
    n = make_numbers(values)
    for i in range(rows.shape[0]):
        if chosen[i]:
            look(n, rows[i], observations[i])


def score_one(
    values: Array, task: int, state: Array, torque: float, impulse: float, observation: Floats
) -> tuple[float, float]:
    """Observe one state; return the values of its reward's terms."""
    n = make_numbers(values)
    look(n, state, observation)
    return reward_terms(n, task, state, torque, impulse)
