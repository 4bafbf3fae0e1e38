"""The loops of the exact contact model: many environments by one step, many trajectories by many.

Environments are held in blocks, shape (blocks, 16, width): row k of a block has the k-th number of each environment,
its state first, then what ``glide.py`` names, so that one machine instruction moves several environments. A step reads
one array of blocks and writes another: a step that fails leaves all as it was. Environments in free flight are moved
together, those near a wall one by one by ``exact.step``. All have one scene, or each its own. Everything here is
compiled as it stands; the task's function is called by its address.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.exact.compiler import block_score, step_score
from jackbox_env.exact.glide import LIMIT, OVER, STEPS, TIME, Block, glide_block, glide_under_chirp
from jackbox_env.exact.score import ENDS, UNUSABLE, look_block
from jackbox_env.exact.step import (
    CHIRP,
    CONSTANT,
    Pieces,
    Plan,
    clear_tally,
    effort,
    make_numbers,
    make_plan,
    step,
    step_near,
)
from jackbox_env.exact.workspace import HIT, IMPULSE_SUM, NEAR, TORQUE, TURNING, Status, Workspace, Workspaces
from jackbox_env.mechanics import energy_of
from jackbox_env.scene import SceneNumbers
from jackbox_env.states import LATEST_TIME, clearance

Array = NDArray[np.float64]
Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Counts = NDArray[np.int64]

PATIENCE = 2e6  # gaps evaluated before it pauses: 0.3 s, 1.2 s where most are followed by impacts


class Scenes(NamedTuple):
    """The scenes: one row for all environments, or one for each."""

    values: Array  # (1 or N, numbers of a scene)
    lanes: Array  # (1 or blocks, SCENE_LANES, width)
    kinds: Counts  # (1 or N,), what turns the box, see exact.step


class Rules(NamedTuple):
    """What all environments of a call have in common besides the scene."""

    dt: float  # control step [s]
    limit: float  # steps after which an episode is truncated
    gliding: bool  # whether a held torque turns any of the boxes
    patience: float  # gaps evaluated before the call pauses


class Inputs(NamedTuple):
    """What a step is given."""

    actions: Array  # (N,), clipped to [-1, 1]; (0,): the drive acts
    table: Array  # pieces of a drive of functions, (pieces, TABLE_WIDTH)
    ranges: Counts  # first and past the last of each environment's, (N, 2), or (0, 2) where there are none


class Results(NamedTuple):
    """What a step fills in."""

    observations: Floats  # (N, 10)
    rewards: Array  # (N,)
    terminations: Flags  # (N,), False before
    truncations: Flags  # (N,)
    reports: Array  # (N, TERMS + number of terms), 0 before, or (0, ...) if nobody asks


def step_blocks(
    scenes: tuple[Array, Array, Counts], rules: tuple[float, float, bool, float, int], blocks: tuple[Array, Array],
    given: tuple[Array, Array, Counts], span: tuple[int, int], results: tuple[Floats, Array, Flags, Flags, Array],
    memories: tuple[Array, Workspaces, Array],
) -> tuple[int, int, int]:  # fmt: skip
    """Step the environments of some blocks whose episodes are not over.

    Args:
        scenes: the fields of :class:`Scenes`. Plain tuples are handed in because numba takes them in faster.
        rules: the fields of :class:`Rules`, and the address of the task's ``score_block``.
        blocks: environments, shape (blocks, 16, width), and where they go, likewise.
        given: the fields of :class:`Inputs`.
        span: first block, and past the last.
        results: the fields of :class:`Results`.
        memory: to work in: lanes, shape (LANES, width), a workspace, and room to record impacts, of none.

    Returns:
        How it ended: DONE, how a step that failed ended, or PAUSED after long work; the environment that failed or the
        block that is next; and the number of episodes that ended.
    """
    played = Scenes(scenes[0], scenes[1], scenes[2])
    common, score = Rules(rules[0], rules[1], rules[2], rules[3]), block_score(rules[4])
    asked = Inputs(given[0], given[1], given[2])
    filled = Results(results[0], results[1], results[2], results[3], results[4])
    before, after = blocks
    lanes, workspaces, log = memories
    memory = workspaces[0]
    scene = make_numbers(played.values[0])
    plan = make_plan(scene, common.dt, played.kinds[0])
    finished, worked, width = 0, 0.0, before.shape[2]
    for number in range(span[0], span[1]):
        if number > span[0] and worked > common.patience:
            return Status.PAUSED.value, number, finished
        first = number * width
        size = min(width, filled.rewards.shape[0] - first)
        own = played.lanes[number if played.lanes.shape[0] > 1 else 0]
        block = Block(before[number], after[number], lanes, own, first, size)
        bad = take_actions(asked.actions, block)
        if bad >= 0:
            return Status.BAD_ACTION.value, first + bad, finished
        glided = common.gliding
        if glided:
            glide_block(plan.dt, block)
        elif plan.kind == CHIRP and played.values.shape[0] == 1 and plan.per_radian == 0.0:
            # Not with loss: a single step then takes whole turns off the angles, which rounds otherwise.
            glided = glide_under_chirp(scene, plan, block, memory)
        ended, lane, looks = step_lanes(scene, plan, played, block, asked, glided, memory, log)
        if ended != Status.DONE:
            return ended.value, first + lane, finished
        worked += looks
        waiting = keep_waiting(block)
        ends = score(
            played.values, block.after, lanes, block.before[OVER], waiting, first, size, filled.rewards,
            filled.terminations, filled.reports,
        )  # fmt: skip
        if ends < 0:
            return Status.BAD_REWARD.value, first + first_unusable(block, filled.rewards), finished
        finished += close_block(common, block, filled, waiting > 0, ends != 0)
        look_block(played.values, block.after, size, lanes, first, filled.observations)
    return Status.DONE.value, -1, finished


def step_lanes(
    scene: SceneNumbers,
    plan: Plan,
    scenes: Scenes,
    block: Block,
    given: Inputs,
    glided: bool,
    memory: Workspace,
    log: Array,
) -> tuple[Status, int, float]:
    """Step one by one what has not been ``glided``; return how it ended, the last lane, gaps evaluated.

    ``scene`` and ``plan`` are the first environment's, and all others' where they have one scene.
    """
    before, after, lanes, looks = block.before, block.after, block.lanes, 0.0
    varied = scenes.values.shape[0] > 1
    own_before, own_after = memory.before[:], memory.after[:]  # plain arrays to numba, for which step is compiled
    for k in range(block.size):
        if before[OVER, k] != 0.0:
            continue
        time = before[TIME, k]
        if time + plan.dt == time or time + plan.dt > LATEST_TIME:
            return Status.TOO_LATE, k, looks
        number = block.first + k
        kind = scenes.kinds[number] if varied else plan.kind
        if glided and lanes[NEAR, k] == 0.0 and (kind == CONSTANT or not varied):
            continue
        own, its = scene, plan
        if varied:
            own = make_numbers(scenes.values[number])
            its = make_plan(own, plan.dt, kind)
        for place in range(12):
            own_before[place] = before[place, k]
        if kind == CONSTANT:
            clear_tally(memory)
            ended = step_near(own, its, own_before, own_after, lanes[TURNING, k], memory, log)
        else:
            lanes[TORQUE, k] = asked_torque(given.actions, number, own.torque_limit)  # gliding has rounded it
            pieces = Pieces(given.table, 0, 0)
            if given.ranges.shape[0]:
                pieces = Pieces(given.table, given.ranges[number, 0], given.ranges[number, 1])
            ended, lanes[TORQUE, k] = step(own, its, own_before, own_after, time, lanes[TORQUE, k], pieces, memory, log)
        if ended != Status.DONE:
            return ended, k, looks
        for place in range(12):
            after[place, k] = own_after[place]
        lanes[HIT, k], lanes[IMPULSE_SUM, k] = memory.hits, memory.impulse
        looks += effort(memory)
    return Status.DONE, -1, looks


def take_actions(actions: Array, block: Block) -> int:
    """Fill in the torques, 0 where the drive acts; return the place of an unusable action, or -1.

    An action for an episode that is over and waits is not looked at.
    """
    torque, limit = block.lanes[TORQUE], block.scenes[LIMIT]
    for k in range(block.size):
        torque[k] = asked_torque(actions, block.first + k, limit[k])
    if not actions.shape[0]:
        return -1
    unusable = 0
    for k in range(block.size):
        unusable += 0 if abs(actions[block.first + k]) < math.inf else 1
    return first_unusable(block, actions) if unusable else -1


def first_unusable(block: Block, numbers: Array) -> int:
    """The first place in a block whose episode goes on and whose number, of (N,), is NaN or infinite; or -1."""
    for k in range(block.size):
        if not abs(numbers[block.first + k]) < math.inf and block.before[OVER, k] == 0.0:
            return k
    return -1


def asked_torque(actions: Array, number: int, limit: float) -> float:
    """The torque that an environment's action asks for [N m], 0 where the drive acts."""
    return max(-1.0, min(1.0, actions[number])) * limit if actions.shape[0] else 0.0


def keep_waiting(block: Block) -> int:
    """Leave episodes that are over where they are. Return their number."""
    over, waiting = block.before[OVER], 0
    for k in range(block.size):
        waiting += 1 if over[k] != 0.0 else 0
    for k in range(block.size if waiting else 0):
        if over[k] != 0.0:
            for place in range(12):
                block.after[place, k] = block.before[place, k]
    return waiting


def close_block(rules: Rules, block: Block, results: Results, waiting: bool, ends: bool) -> int:
    """Count a step, where some are ``waiting`` not for those. Return the number of episodes that ended.

    ``ends``: whether the task may have ended some.
    """
    before, after, first, count = block.before, block.after, block.first, block.size
    terminations, truncations = results.terminations, results.truncations
    time, steps, over = before[TIME], before[STEPS], before[OVER]
    new_time, new_steps, new_over = after[TIME], after[STEPS], after[OVER]
    ended = 0
    for k in range(count):
        new_time[k] = time[k] + rules.dt
    for k in range(count):
        new_steps[k] = steps[k] + 1.0
    for k in range(count):
        new_over[k] = 1.0 if new_steps[k] >= rules.limit else 0.0
    for k in range(count):
        truncations[first + k] = new_over[k] != 0.0
    for k in range(count if ends else 0):
        new_over[k] = 1.0 if terminations[first + k] else new_over[k]
    for k in range(count):
        ended += 1 if new_over[k] != 0.0 else 0
    if waiting:
        for k in range(count):
            if over[k] != 0.0:
                ended -= 1 if new_over[k] != 0.0 else 0
                truncations[first + k] = False
                new_time[k], new_steps[k], new_over[k] = time[k], steps[k], over[k]
    return ended


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
