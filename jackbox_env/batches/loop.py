"""Many environments of the exact contact model in one loop: step, reward, count, observe, restart.

Environments are held in blocks, shape (blocks, 16, width): row k of a block has the k-th number of each environment,
its state first, then what is named below, so that one machine instruction moves several environments. A step reads
one array of blocks and writes another: a step that fails leaves all as it was. Environments in free flight are moved
together, those near a wall one by one by ``simulators.step``. Everything here is compiled as it stands.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from jackbox_env.batches.generator import Words, uniform
from jackbox_env.observation import seen
from jackbox_env.scene import SceneNumbers
from jackbox_env.simulators.base import LATEST_TIME
from jackbox_env.simulators.kernel import DONE, STEEPEST
from jackbox_env.simulators.step import (
    CHIRP,
    NO_DRIVE,
    Plan,
    clear_tally,
    fallen,
    make_numbers,
    make_plan,
    moved,
    stays_clear,
    step,
    step_near,
    turned,
)
from jackbox_env.simulators.workspace import AFTER, BEFORE, HITS, IMPULSE, TALLY, WORK, Workspace
from jackbox_env.tasks import juggle, rattle, spin, start_pose
from jackbox_env.trigonometry import LARGEST, cos_sin, cos_sin_within

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]

WIDTH = 16
TIME, STEPS, OVER = 12, 13, 14  # [s], steps in the episode, 1 where it has ended
BAD_ACTION, TOO_LATE, PAUSED = 4, 5, 6  # how a step ended, besides the ways of simulators.step
PATIENCE = 2_000_000  # gaps evaluated before it pauses: 0.3 s, 1.2 s where most are followed by impacts
# Columns of a report: what a step's info holds beside state and time.
REPORTED_TORQUE, REPORTED_HITS, REPORTED_IMPULSE, TERMS = range(4)
# Rows of a thread's memory for a block; 0 to 3 are for what is needed in passing.
TORQUE, ALPHA, NEAR, HIT, IMPULSES = range(4, 9)
LANES = 9
WIDEST = 128  # environments in a block
REPORT_WIDTH = 5  # two terms at most
JUGGLE, SPIN, RATTLE = range(3)  # the tasks, in the order of tasks.TASKS


def look(n: SceneNumbers, state: Array, observation: Floats) -> None:
    """Write the observation of a state, shape (10,)."""
    cosine, sine = cos_sin(state[2])
    cosine_4, sine_4 = cos_sin(4.0 * (state[5] - state[2]))
    write(n, state, cosine, sine, cosine_4, sine_4, observation)


def look_block(n: SceneNumbers, block: Array, count: int, lanes: Array, low: int, observations: Floats) -> None:
    """Write the observations of a block's first ``count`` environments: the same as :func:`look`, many at a time."""
    angle, jack_angle = block[2], block[5]
    cosine, sine, cosine_4, sine_4 = lanes[0], lanes[1], lanes[2], lanes[3]
    largest = 0.0
    for k in range(count):
        cosine[k] = angle[k]
        cosine_4[k] = 4.0 * (jack_angle[k] - angle[k])
        largest = max(largest, max(abs(cosine[k]), abs(cosine_4[k])))
    if largest < LARGEST:
        for k in range(count):
            cosine[k], sine[k] = cos_sin_within(cosine[k])
        for k in range(count):
            cosine_4[k], sine_4[k] = cos_sin_within(cosine_4[k])
    else:
        for k in range(count):
            cosine[k], sine[k] = cos_sin(cosine[k])
            cosine_4[k], sine_4[k] = cos_sin(cosine_4[k])
    for k in range(count):
        write(n, block[:, k], cosine[k], sine[k], cosine_4[k], sine_4[k], observations[low + k])


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


def step_blocks(
    values: Array, dt: float, drive: int, task: int, limit: float, blocks: Array, after: Array, actions: Array,
    table: Array, ranges: Counts, low: int, high: int, observations: Floats, rewards: Array, truncations: Flags,
    reports: Array, lanes: Array, w: Workspace,
) -> tuple[int, int, int]:  # fmt: skip
    """Step the environments of blocks ``low`` to ``high`` whose episodes are not over.

    Args:
        values: the scene's numbers.
        dt: control step [s].
        drive: kind of the scene's drive.
        task: number of the task.
        limit: steps after which an episode is truncated.
        blocks: environments, shape (blocks, 16, width).
        after: where they go, likewise.
        actions: shape (N,), clipped to [-1, 1]; shape (0,): the drive acts.
        table: pieces of a drive of functions, shape (pieces, TABLE_WIDTH).
        ranges: first and past the last of each environment's, shape (N, 2), or (0, 2) where there are none.
        low: first block.
        high: past the last.
        observations: to be filled, shape (N, 10).
        rewards: to be filled, shape (N,).
        truncations: to be filled, shape (N,).
        reports: to be filled, shape (N, REPORT_WIDTH), or (0, REPORT_WIDTH) if nobody asks.
        lanes: memory to work in, shape (LANES, width).
        w: memory to work in.

    Returns:
        How it ended: DONE, how a step that failed ended, or PAUSED after long work; the environment that failed or the
        block that is next; and the number of episodes that ended.
    """
    n = make_numbers(values)
    plan = make_plan(n, dt, drive)
    finished, worked, width = 0, 0.0, blocks.shape[2]
    for number in range(low, high):
        if number > low and worked > PATIENCE:
            return PAUSED, number, finished
        first = number * width
        count = min(width, rewards.shape[0] - first)
        block, new = blocks[number], after[number]
        bad = take_actions(n, actions, block[OVER], first, count, lanes)
        if bad >= 0:
            return BAD_ACTION, first + bad, finished
        alone = not (drive == NO_DRIVE or (drive == CHIRP and actions.shape[0] > 0))
        if not alone:
            glide_block(n, plan, block, new, count, lanes)
        for k in range(count):
            if block[OVER, k] != 0.0:
                continue
            time = block[TIME, k]
            if time + dt == time or time + dt > LATEST_TIME:
                return TOO_LATE, first + k, finished
            if not alone and lanes[NEAR, k] == 0.0:
                continue
            for place in range(12):
                w[BEFORE, place] = block[place, k]
            if alone:
                begin, end = 0, 0
                if ranges.shape[0]:
                    begin, end = ranges[first + k, 0], ranges[first + k, 1]
                torque = lanes[TORQUE, k]
                ended, lanes[TORQUE, k] = step(n, plan, w[BEFORE], w[AFTER], time, torque, table, begin, end, w)
            else:
                clear_tally(w)
                ended = step_near(n, plan, w[BEFORE], w[AFTER], lanes[ALPHA, k], w)
            if ended != DONE:
                return ended, first + k, finished
            for place in range(12):
                new[place, k] = w[AFTER, place]
            lanes[HIT, k], lanes[IMPULSES, k] = w[TALLY, HITS], w[TALLY, IMPULSE]
            worked += w[TALLY, WORK]
        finished += close_block(n, task, limit, dt, block, new, first, count, lanes, rewards, truncations, reports)
        look_block(n, new, count, lanes, first, observations)
    return DONE, -1, finished


def take_actions(n: SceneNumbers, actions: Array, over: Array, first: int, count: int, lanes: Array) -> int:
    """Fill in the torques, NaN where the drive acts; return the place of an unusable action, or -1.

    An action for an episode that is ``over`` and waits is not looked at.
    """
    torque = lanes[TORQUE]
    if actions.shape[0] == 0:
        for k in range(count):
            torque[k] = math.nan
        return -1
    bad = -1
    for k in range(count):
        action = actions[first + k]
        torque[k] = max(-1.0, min(1.0, action)) * n.torque_limit
    for k in range(count):
        if not abs(actions[first + k]) < math.inf and over[k] == 0.0:
            bad = k if bad < 0 else bad
    return bad


def glide_block(n: SceneNumbers, plan: Plan, before: Array, after: Array, count: int, lanes: Array) -> None:
    """Fly all lanes of a block for a step, many at a time, and mark those where a foot may touch a wall.

    The law is that of ``simulators.step.glide``; one coordinate per loop is what the compiler makes wide.
    """
    dt, fall, torque, near = plan.dt, n.gravity * plan.dt, lanes[TORQUE], lanes[NEAR]
    alpha, hits, impulses = lanes[ALPHA], lanes[HIT], lanes[IMPULSES]
    for k in range(count):
        alpha[k] = torque[k] / n.box_inertia if torque[k] == torque[k] else 0.0
    for k in range(count):
        torque[k] = n.box_inertia * alpha[k]
        hits[k] = impulses[k] = 0.0
    x, y, vx, vy = lanes[0], lanes[1], lanes[2], lanes[3]
    for place in range(2):
        own, other, difference = before[place], before[3 + place], lanes[place]
        rate, other_rate, rates = before[6 + place], before[9 + place], lanes[2 + place]
        for k in range(count):
            difference[k] = other[k] - own[k]
        for k in range(count):
            rates[k] = other_rate[k] - rate[k]
    for k in range(count):
        clear = stays_clear(x[k], y[k], vx[k], vy[k], fall, plan) & (abs(alpha[k]) < STEEPEST)
        near[k] = 0.0 if clear else 1.0
    for place in (0, 1, 3, 5):
        here, rate, there = before[place], before[6 + place], after[place]
        for k in range(count):
            there[k] = moved(here[k], rate[k], dt)
    angle, omega, new_angle, new_omega = before[2], before[8], after[2], after[8]
    for k in range(count):
        new_angle[k] = turned(angle[k], omega[k], alpha[k], dt)
    for k in range(count):
        new_omega[k] = omega[k] + alpha[k] * dt
    height, climb, new_height, new_climb = before[4], before[10], after[4], after[10]
    for k in range(count):
        new_height[k] = fallen(height[k], climb[k], fall, dt)
    for k in range(count):
        new_climb[k] = climb[k] - fall
    for place in (6, 7, 9, 11):
        here, there = before[place], after[place]
        for k in range(count):
            there[k] = here[k]


def close_block(
    n: SceneNumbers, task: int, limit: float, dt: float, before: Array, after: Array, first: int, count: int,
    lanes: Array, rewards: Array, truncations: Flags, reports: Array,
) -> int:  # fmt: skip
    """Reward, count and report a step; leave what is over as it was. Return the number of episodes that ended."""
    torque, hits, impulses = lanes[TORQUE], lanes[HIT], lanes[IMPULSES]
    for k in range(count):
        one, two = reward_terms(n, task, after[:, k], torque[k], impulses[k])
        rewards[first + k] = one + two
    if reports.shape[0]:
        for k in range(count):
            report = reports[first + k]
            report[REPORTED_TORQUE], report[REPORTED_HITS], report[REPORTED_IMPULSE] = torque[k], hits[k], impulses[k]
            report[TERMS], report[TERMS + 1] = reward_terms(n, task, after[:, k], torque[k], impulses[k])
    time, steps, over = before[TIME], before[STEPS], before[OVER]
    new_time, new_steps, new_over = after[TIME], after[STEPS], after[OVER]
    waiting = 0.0
    for k in range(count):
        new_time[k] = time[k] + dt
    for k in range(count):
        new_steps[k] = steps[k] + 1.0
        waiting += over[k]
    ended = 0
    for k in range(count):
        truncated = new_steps[k] >= limit
        truncations[first + k] = truncated
        new_over[k] = 1.0 if truncated else 0.0
        ended += 1 if truncated else 0
    if waiting > 0.0:
        for k in range(count):
            if over[k] != 0.0:
                ended -= 1 if truncations[first + k] else 0
                rewards[first + k], truncations[first + k] = 0.0, False
                for place in range(WIDTH):
                    after[place, k] = before[place, k]
                for place in range(reports.shape[1] if reports.shape[0] else 0):
                    reports[first + k, place] = 0.0
    return ended


def restart_blocks(values: Array, blocks: Array, numbers: Counts, words: Words) -> None:
    """Draw a start for each environment of ``numbers``, at time 0, from its generator in ``words``, shape (k, 4)."""
    n, width = make_numbers(values), blocks.shape[2]
    for k in range(numbers.shape[0]):
        row = blocks[numbers[k] // width, :, numbers[k] % width]
        for place in range(WIDTH):
            row[place] = 0.0
        x = -1.0 + 2.0 * uniform(words[k])
        y = -1.0 + 2.0 * uniform(words[k])
        angle = -1.0 + 2.0 * uniform(words[k])
        row[3], row[4], row[5] = start_pose(n, x, y, angle)


def look_blocks(values: Array, blocks: Array, chosen: Flags, observations: Floats) -> None:
    """Write the observations of the ``chosen`` environments."""
    n, width = make_numbers(values), blocks.shape[2]
    for i in range(chosen.shape[0]):
        if chosen[i]:
            look(n, blocks[i // width, :, i % width], observations[i])


def score_one(
    values: Array, task: int, state: Array, torque: float, impulse: float, observation: Floats
) -> tuple[float, float]:
    """Observe one state; return the values of its reward's terms."""
    n = make_numbers(values)
    look(n, state, observation)
    return reward_terms(n, task, state, torque, impulse)
