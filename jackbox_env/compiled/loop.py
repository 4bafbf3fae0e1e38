"""Many environments of the exact contact model in one loop: step, reward, count, observe, restart.

Environments are held in blocks, shape (blocks, 16, width): row k of a block has the k-th number of each environment,
its state first, then what is named below, so that one machine instruction moves several environments. A step reads
one array of blocks and writes another: a step that fails leaves all as it was. Environments in free flight are moved
together, those near a wall one by one by ``compiled.step``. Everything here is compiled as it stands.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.compiled.generator import Words, uniform
from jackbox_env.compiled.score import look, look_block, reward_terms
from jackbox_env.compiled.search import STEEPEST
from jackbox_env.compiled.status import Status
from jackbox_env.compiled.step import (
    HELD,
    Pieces,
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
from jackbox_env.compiled.workspace import AFTER, BEFORE, HITS, IMPULSE, TALLY, WORK, Workspace
from jackbox_env.scene import SceneNumbers
from jackbox_env.states import LATEST_TIME
from jackbox_env.tasks import start_pose

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]

WIDTH = 16
TIME, STEPS, OVER = 12, 13, 14  # [s], steps in the episode, 1 where it has ended
PATIENCE = 2_000_000  # gaps evaluated before it pauses: 0.3 s, 1.2 s where most are followed by impacts
# Columns of a report: what a step's info holds beside state and time.
REPORTED_TORQUE, REPORTED_HITS, REPORTED_IMPULSE, TERMS = range(4)
# Rows of a thread's memory for a block; 0 to 3 are for what is needed in passing.
TORQUE, TURNING, NEAR, HIT, IMPULSES = range(4, 9)  # TURNING: the box's angular acceleration [rad/s^2]
LANES = 9
WIDEST = 128  # environments in a block
REPORT_WIDTH = 5  # two terms at most


class Rules(NamedTuple):
    """What all environments of a call have in common besides the scene."""

    dt: float  # control step [s]
    kind: int  # what turns the boxes, see compiled.step
    task: int  # number of the task
    limit: float  # steps after which an episode is truncated


class Given(NamedTuple):
    """What a step is given."""

    actions: Array  # (N,), clipped to [-1, 1]; (0,): the drive acts
    table: Array  # pieces of a drive of functions, (pieces, TABLE_WIDTH)
    ranges: Counts  # first and past the last of each environment's, (N, 2), or (0, 2) where there are none


class Results(NamedTuple):
    """What a step fills in."""

    observations: Floats  # (N, 10)
    rewards: Array  # (N,)
    truncations: Flags  # (N,)
    reports: Array  # (N, REPORT_WIDTH), or (0, REPORT_WIDTH) if nobody asks


class Block(NamedTuple):
    """Environments that are stepped together."""

    before: Array  # (16, width)
    after: Array  # (16, width), where they go
    lanes: Array  # (LANES, width), memory to work in
    first: int  # number of its first environment
    size: int  # number of its environments


def step_blocks(
    values: Array, rules: tuple[float, int, int, float], blocks: tuple[Array, Array],
    given: tuple[Array, Array, Counts], span: tuple[int, int], results: tuple[Floats, Array, Flags, Array],
    memory: tuple[Array, Workspace],
) -> tuple[int, int, int]:  # fmt: skip
    """Step the environments of some blocks whose episodes are not over.

    Args:
        values: the scene's numbers.
        rules: the fields of :class:`Rules`. Plain tuples are handed in because numba takes them in faster.
        blocks: environments, shape (blocks, 16, width), and where they go, likewise.
        given: the fields of :class:`Given`.
        span: first block, and past the last.
        results: the fields of :class:`Results`.
        memory: to work in: lanes, shape (LANES, width), and a workspace.

    Returns:
        How it ended: DONE, how a step that failed ended, or PAUSED after long work; the environment that failed or the
        block that is next; and the number of episodes that ended.
    """
    scene = make_numbers(values)
    common = Rules(rules[0], rules[1], rules[2], rules[3])
    asked = Given(given[0], given[1], given[2])
    filled = Results(results[0], results[1], results[2], results[3])
    before, after = blocks
    lanes, work = memory
    plan = make_plan(scene, common.dt, common.kind)
    finished, worked, width = 0, 0.0, before.shape[2]
    for number in range(span[0], span[1]):
        if number > span[0] and worked > PATIENCE:
            return Status.PAUSED.value, number, finished
        first = number * width
        block = Block(before[number], after[number], lanes, first, min(width, filled.rewards.shape[0] - first))
        bad = take_actions(scene, asked.actions, block)
        if bad >= 0:
            return Status.BAD_ACTION.value, first + bad, finished
        if plan.kind == HELD:
            glide_block(scene, plan, block)
        ended, lane, looks = step_lanes(scene, plan, block, asked, work)
        if ended != Status.DONE:
            return ended.value, first + lane, finished
        worked += looks
        finished += close_block(scene, common, block, filled)
        look_block(scene, block.after, block.size, lanes, first, filled.observations)
    return Status.DONE.value, -1, finished


def step_lanes(
    scene: SceneNumbers, plan: Plan, block: Block, given: Given, work: Workspace
) -> tuple[Status, int, float]:
    """Step one by one what :func:`glide_block` has not moved; return how it ended, the last lane, gaps evaluated."""
    before, after, lanes, looks = block.before, block.after, block.lanes, 0.0
    for k in range(block.size):
        if before[OVER, k] != 0.0:
            continue
        time = before[TIME, k]
        if time + plan.dt == time or time + plan.dt > LATEST_TIME:
            return Status.TOO_LATE, k, looks
        if plan.kind == HELD and lanes[NEAR, k] == 0.0:
            continue
        for place in range(12):
            work[BEFORE, place] = before[place, k]
        if plan.kind == HELD:
            clear_tally(work)
            ended = step_near(scene, plan, work[BEFORE], work[AFTER], lanes[TURNING, k], work)
        else:
            pieces = Pieces(given.table, 0, 0)
            if given.ranges.shape[0]:
                number = block.first + k
                pieces = Pieces(given.table, given.ranges[number, 0], given.ranges[number, 1])
            ended, lanes[TORQUE, k] = step(scene, plan, work[BEFORE], work[AFTER], time, lanes[TORQUE, k], pieces, work)
        if ended != Status.DONE:
            return ended, k, looks
        for place in range(12):
            after[place, k] = work[AFTER, place]
        lanes[HIT, k], lanes[IMPULSES, k] = work[TALLY, HITS], work[TALLY, IMPULSE]
        looks += work[TALLY, WORK]
    return Status.DONE, -1, looks


def take_actions(scene: SceneNumbers, actions: Array, block: Block) -> int:
    """Fill in the torques, 0 where the drive acts; return the place of an unusable action, or -1.

    An action for an episode that is over and waits is not looked at.
    """
    torque, over = block.lanes[TORQUE], block.before[OVER]
    if actions.shape[0] == 0:
        for k in range(block.size):
            torque[k] = 0.0
        return -1
    bad = -1
    for k in range(block.size):
        action = actions[block.first + k]
        torque[k] = max(-1.0, min(1.0, action)) * scene.torque_limit
    for k in range(block.size):
        if not abs(actions[block.first + k]) < math.inf and over[k] == 0.0:
            bad = k if bad < 0 else bad
    return bad


def glide_block(scene: SceneNumbers, plan: Plan, block: Block) -> None:
    """Fly all lanes of a block for a step, many at a time, and mark those where a foot may touch a wall.

    The law is that of ``compiled.step.glide``; one coordinate per loop is what the compiler makes wide.
    """
    before, after, lanes, count = block.before, block.after, block.lanes, block.size
    dt, fall, torque, near = plan.dt, scene.gravity * plan.dt, lanes[TORQUE], lanes[NEAR]
    alpha, hits, impulses = lanes[TURNING], lanes[HIT], lanes[IMPULSES]
    for k in range(count):
        alpha[k] = torque[k] / scene.box_inertia
    for k in range(count):
        torque[k] = scene.box_inertia * alpha[k]
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


def close_block(scene: SceneNumbers, rules: Rules, block: Block, results: Results) -> int:
    """Reward, count and report a step; leave what is over as it was. Return the number of episodes that ended."""
    before, after, first, count = block.before, block.after, block.first, block.size
    rewards, truncations, reports = results.rewards, results.truncations, results.reports
    torque, hits, impulses = block.lanes[TORQUE], block.lanes[HIT], block.lanes[IMPULSES]
    for k in range(count):
        one, two = reward_terms(scene, rules.task, after[:, k], torque[k], impulses[k])
        rewards[first + k] = one + two
    if reports.shape[0]:
        for k in range(count):
            report = reports[first + k]
            report[REPORTED_TORQUE], report[REPORTED_HITS], report[REPORTED_IMPULSE] = torque[k], hits[k], impulses[k]
            report[TERMS], report[TERMS + 1] = reward_terms(scene, rules.task, after[:, k], torque[k], impulses[k])
    time, steps, over = before[TIME], before[STEPS], before[OVER]
    new_time, new_steps, new_over = after[TIME], after[STEPS], after[OVER]
    waiting = 0.0
    for k in range(count):
        new_time[k] = time[k] + rules.dt
    for k in range(count):
        new_steps[k] = steps[k] + 1.0
        waiting += over[k]
    ended = 0
    for k in range(count):
        truncated = new_steps[k] >= rules.limit
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
    scene, width = make_numbers(values), blocks.shape[2]
    for k in range(numbers.shape[0]):
        row = blocks[numbers[k] // width, :, numbers[k] % width]
        for place in range(WIDTH):
            row[place] = 0.0
        x = -1.0 + 2.0 * uniform(words[k])
        y = -1.0 + 2.0 * uniform(words[k])
        angle = -1.0 + 2.0 * uniform(words[k])
        row[3], row[4], row[5] = start_pose(scene, x, y, angle)


def look_blocks(values: Array, blocks: Array, chosen: Flags, observations: Floats) -> None:
    """Write the observations of the ``chosen`` environments."""
    scene, width = make_numbers(values), blocks.shape[2]
    for i in range(chosen.shape[0]):
        if chosen[i]:
            look(scene, blocks[i // width, :, i % width], observations[i])
