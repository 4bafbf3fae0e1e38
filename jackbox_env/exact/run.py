"""The loop of the exact contact model: :func:`run` steps many rows, each a jack in its box, through one or many steps.

Simulators, batches and rollouts call it: 1 row and 1 step, N rows and 1 step, N rows and H steps. In each step
``glide.py`` moves the rows in free flight together, ``step.py`` moves those near a wall one by one, and ``score.py``
rewards them; then :func:`record` fills in the results.
Rows are stored in blocks, shape (blocks, 16, width): the 12 numbers of the state, then those named in ``glide.py``.
Each row is a lane of its block. One number of all lanes lies side by side, so one instruction moves several rows.
A step reads one array of blocks and writes the other, so a step that fails changes nothing.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from jackbox_env.exact.compiler import PACKED, block_score, compiled, packed, unpacked_as
from jackbox_env.exact.glide import LIMIT, OVER, STEPS, TIME, Block, glide_block, glide_under_chirp
from jackbox_env.exact.score import observe_block
from jackbox_env.exact.step import CHIRP, CONSTANT, Pieces, Plan, effort, make_numbers, make_plan, step
from jackbox_env.exact.workspace import (
    HIT,
    IMPULSE_SUM,
    NEAR,
    NOTHING,
    TORQUE,
    UNSCORED,
    Arguments,
    Array,
    Flags,
    Memory,
    Results,
    Rules,
    Scenes,
    Status,
    Workspace,
    new_workspaces,
)
from jackbox_env.mechanics import energy_of
from jackbox_env.scene import SceneNumbers
from jackbox_env.states import LATEST_TIME

PATIENCE = 2e6  # gap evaluations before a call pauses: 0.3 s, 1.2 s if most of them find impacts


def run(address: Any, low: int, high: int, first: int) -> tuple[int, int, int, int, int]:
    """Step the rows of some blocks through all steps.

    Args:
        address: of the :class:`Arguments`.
        low: first block.
        high: past the last block.
        first: step at which the first block begins.

    Returns:
        How it ended: DONE, PAUSED after long work, FULL if the log has no room for a step's impacts, or the status of
        the step that failed. The row that failed, or the block to go on with. The step that failed or is next. The
        number of episodes that ended. The number of impacts recorded.
    """
    call = arguments_at(address)
    scenes, rules, results, lanes = call.scenes, call.rules, call.results, call.memory.lanes
    memory, score = call.memory.workspaces[0], block_score(rules.score)
    scene = make_numbers(scenes.values[0])
    plan = make_plan(scene, rules.dt, scenes.kinds[0])
    width, count = call.before.shape[2], results.terminations.shape[0]
    finished, recorded, worked = 0, 0, 0.0
    for number in range(low, high):
        for k in range(first if number == low else 0, rules.steps):
            if worked > rules.patience and worked > 0.0:
                return Status.PAUSED.value, number, k, finished, recorded
            block = Block(
                (call.after if k & 1 else call.before)[number], (call.before if k & 1 else call.after)[number], lanes,
                scenes.lanes[number if scenes.lanes.shape[0] > 1 else 0], number * width,
                min(width, count - number * width),
            )  # fmt: skip
            # Move: rows in free flight together, then the others one by one.
            bad = set_torques(address, block, k)
            if bad >= 0:
                return Status.BAD_ACTION.value, block.first + bad, k, finished, recorded
            glided = glide(scene, plan, scenes, block, memory)
            ended, lane, evaluations, recorded = step_lanes(scene, plan, address, block, k, glided, recorded)
            if ended == Status.FULL:
                return ended.value, number, k, finished, recorded
            if ended != Status.DONE:
                return ended.value, block.first + lane, k, finished, recorded
            worked += block.size + evaluations
            # Reward.
            waiting = keep_waiting(block)
            unscored, skipped, ends = block.before[OVER], waiting, 0
            if rules.goes_on:
                unscored, skipped = lanes[UNSCORED], mark_unscored(block, results.terminations)
            if results.rewards.shape[0]:
                ends = score(
                    scenes.values, block.after, lanes, unscored, skipped, block.first, results.rewards[k],
                    results.terminations, results.reports,
                )  # fmt: skip
            if ends < 0:
                bad = first_unusable(block, results.rewards[k])
                return Status.BAD_REWARD.value, block.first + bad, k, finished, recorded
            # End episodes, and record.
            finished += close_block(rules, block, results, waiting > 0, ends != 0)
            record(address, scene, block, k)
        if results.observations.shape[0]:
            after = (call.after if rules.steps & 1 else call.before)[number]
            size = min(width, count - number * width)
            observe_block(scenes.values, after, size, lanes, number * width, results.observations)
    return Status.DONE.value, -1, rules.steps, finished, recorded


def set_torques(address: Any, block: Block, k: int) -> int:
    """Fill in the torques of a step, 0 under a drive; return the index of a control that is NaN or infinite, or -1.

    Controls of episodes that are over are not checked.
    """
    call = arguments_at(address)
    torque, limit, controls = block.lanes[TORQUE], block.scenes[LIMIT], call.controls
    if not controls.shape[0]:
        for lane in range(block.size):
            torque[lane] = 0.0
        return -1
    step_controls = controls[k // (call.rules.steps // controls.shape[0])]
    for lane in range(block.size):
        torque[lane] = torque_of(call.rules, step_controls[block.first + lane], limit[lane])
    unusable = 0
    for lane in range(block.size):
        unusable += 0 if abs(step_controls[block.first + lane]) < math.inf else 1
    return first_unusable(block, step_controls) if unusable else -1


def torque_of(rules: Rules, control: float, limit: float) -> float:
    """The torque of a control [N m]."""
    return max(-1.0, min(1.0, control)) * limit if rules.actions else control


def first_unusable(block: Block, numbers: Array) -> int:
    """The first lane of a block whose episode goes on and whose number, of (N,), is NaN or infinite; or -1."""
    for lane in range(block.size):
        if not abs(numbers[block.first + lane]) < math.inf and block.before[OVER, lane] == 0.0:
            return lane
    return -1


def glide(scene: SceneNumbers, plan: Plan, scenes: Scenes, block: Block, memory: Workspace) -> bool:
    """Move the rows of a block that are in free flight; return whether it did. A block of one row is not moved.

    ``scene`` and ``plan`` are those of the first row, and of all rows if they share a scene.
    """
    if block.before.shape[1] == 1:
        return False
    constant = plan.kind == CONSTANT
    if scenes.values.shape[0] > 1:
        for lane in range(block.size):
            constant = constant or scenes.kinds[block.first + lane] == CONSTANT
    elif plan.kind == CHIRP and plan.per_radian == 0.0:
        # Not with loss: a single step then takes whole turns off the angles, which rounds differently.
        return glide_under_chirp(scene, plan, block, memory)
    if constant:
        glide_block(plan.dt, block)
    return constant


def step_lanes(
    scene: SceneNumbers, plan: Plan, address: Any, block: Block, k: int, glided: bool, recorded: int
) -> tuple[Status, int, float, int]:
    """Step the rows of a block one by one, except those that glided and stay off the walls.

    Returns:
        How it ended, the lane that failed, gap evaluations, and the number of impacts in the log.
    """
    before, after, lanes, evaluations, already = block.before, block.after, block.lanes, 0.0, recorded
    call = arguments_at(address)
    scenes, memory, log, nonsmooth = call.scenes, call.memory.workspaces[0], call.memory.log, call.results.nonsmooth
    varied = scenes.values.shape[0] > 1
    for lane in range(block.size):
        if before[OVER, lane] != 0.0:
            continue
        time = before[TIME, lane]
        if time + plan.dt == time or time + plan.dt > LATEST_TIME:
            return Status.TOO_LATE, lane, evaluations, recorded
        row = block.first + lane
        kind = scenes.kinds[row] if varied else plan.kind
        if glided and lanes[NEAR, lane] == 0.0 and (kind == CONSTANT or not varied):
            continue
        row_scene, row_plan = scene, plan
        if varied:
            row_scene = make_numbers(scenes.values[row])
            row_plan = make_plan(row_scene, plan.dt, kind)
        torque = 0.0
        if call.controls.shape[0]:  # not from the lanes, where gliding rounds it
            control = call.controls[k // (call.rules.steps // call.controls.shape[0]), row]
            torque = torque_of(call.rules, control, row_scene.torque_limit)
        pieces = Pieces(scenes.table, 0, 0)
        if scenes.begins.shape[0]:
            begin = scenes.begins[row if scenes.begins.shape[0] > 1 else 0] + k
            pieces = Pieces(scenes.table, scenes.ends[begin], scenes.ends[begin + 1])
        room = log[recorded:]
        ended, lanes[TORQUE, lane] = step(
            row_scene, row_plan, before[:, lane], after[:, lane], time, torque, pieces, memory, room
        )  # fmt: skip
        if ended != Status.DONE:
            return ended, lane, evaluations, recorded
        if log.shape[0]:
            if memory.hits > room.shape[0]:
                return Status.FULL, lane, evaluations, already
            recorded += memory.hits
        if nonsmooth.shape[0]:
            nonsmooth[row, k] = memory.nonsmooth != 0
        lanes[HIT, lane], lanes[IMPULSE_SUM, lane] = memory.hits, memory.impulse
        evaluations += effort(memory)
    return Status.DONE, -1, evaluations, recorded


def keep_waiting(block: Block) -> int:
    """Copy the states of episodes that are over; return their number."""
    over, waiting = block.before[OVER], 0
    for lane in range(block.size):
        waiting += 1 if over[lane] != 0.0 else 0
    for lane in range(block.size if waiting else 0):
        if over[lane] != 0.0:
            for column in range(12):
                block.after[column, lane] = block.before[column, lane]
    return waiting


def mark_unscored(block: Block, terminations: Flags) -> int:
    """Mark the rows that earn nothing: episodes that are over, or that the task has ended. Return their number."""
    over, unscored, count = block.before[OVER], block.lanes[UNSCORED], 0
    for lane in range(block.size):
        unscored[lane] = 1.0 if over[lane] != 0.0 or terminations[block.first + lane] else 0.0
        count += 1 if unscored[lane] != 0.0 else 0
    return count


def close_block(rules: Rules, block: Block, results: Results, waiting: bool, ends: bool) -> int:
    """Advance times and step counts, and end episodes; return the number of episodes that ended.

    ``waiting``: whether some episodes were over before the step; those stay as they are. ``ends``: whether the task
    ended some.
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
        new_over[k] = 1.0 if new_steps[k] >= rules.longest else 0.0
    for k in range(count):
        truncations[first + k] = new_over[k] != 0.0
    for k in range(count if ends and not rules.goes_on else 0):
        new_over[k] = 1.0 if terminations[first + k] else new_over[k]
    for k in range(count if rules.until_impact else 0):
        new_over[k] = 1.0 if block.lanes[HIT, k] > 0.0 else new_over[k]
    for k in range(count):
        ended += 1 if new_over[k] != 0.0 else 0
    if waiting:
        for k in range(count):
            if over[k] != 0.0:
                ended -= 1 if new_over[k] != 0.0 else 0
                truncations[first + k] = False
                new_time[k], new_steps[k], new_over[k] = time[k], steps[k], over[k]
    return ended


def record(address: Any, scene: SceneNumbers, block: Block, k: int) -> None:
    """Record what the caller wants of a step: states, energies, impacts, ends of episodes."""
    call = arguments_at(address)
    results, steps = call.results, call.rules.steps
    trajectories, energies, hits, lengths = results.trajectories, results.energies, results.hits, results.lengths
    if not trajectories.shape[0] + energies.shape[0] + hits.shape[0] + lengths.shape[0]:
        return
    values = call.scenes.values
    for lane in range(block.size):
        row = block.first + lane
        if trajectories.shape[0]:
            for column in range(12):
                trajectories[row, k + 1, column] = block.after[column, lane]
        if energies.shape[0]:
            row_scene = make_numbers(values[row]) if values.shape[0] > 1 else scene
            if k == 0:
                energies[row, 0] = energy_of(row_scene, block.before[:, lane])
            energies[row, k + 1] = energy_of(row_scene, block.after[:, lane])
        if hits.shape[0] and block.before[OVER, lane] == 0.0:
            hits[k, row], results.impulses[k, row] = int(block.lanes[HIT, lane]), block.lanes[IMPULSE_SUM, lane]
        if lengths.shape[0] and results.terminations[row] and lengths[row] == steps:
            lengths[row] = k + 1


def example() -> Arguments:
    """Empty arguments of the types that :func:`run` is compiled for."""
    none, cube, counts = np.zeros((0, 0)), np.zeros((0, 0, 0)), np.zeros(0, np.int64)
    rules = Rules(0.02, 1, math.inf, False, False, False, 0, PATIENCE)
    memory = Memory(none, new_workspaces(), none)
    return Arguments(Scenes(none, cube, counts, none, counts, counts), rules, cube, cube, none, NOTHING, memory)


arguments_at = unpacked_as(example)


class Call:
    """A call of :func:`run`: its arguments at an ``address``, and the memory of the thread that calls."""

    def __init__(self, memory: Memory) -> None:
        self.memory = memory
        self._packed = np.zeros(PACKED)  # the arguments as compiled code reads them
        self.address, self._pack = 0, compiled(pack)

    def prepare(
        self, scenes: Scenes, rules: Rules, before: Array, after: Array, controls: Array, results: Results
    ) -> None:
        """Set the arguments. Numba unpacks plain tuples faster than named ones."""
        self._arguments = scenes, rules, before, after, controls, results  # keeps the arrays alive
        self.address = self._pack(
            self._packed, tuple(scenes), tuple(rules), before, after, controls, tuple(results), tuple(self.memory)
        )

    def with_room(self) -> Call:
        """A copy of this call whose log has room for twice as many impacts; an interruption leaves this one intact."""
        log = self.memory.log
        twin = Call(self.memory._replace(log=np.zeros((2 * len(log), log.shape[1]))))
        twin.prepare(*self._arguments)
        return twin


def pack(
    memory: Array, scenes: Any, rules: Any, before: Array, after: Array, controls: Array, results: Any, work: Any
) -> Any:
    """Store the arguments of :func:`run` in ``memory``; return the address there."""
    return packed(
        memory,
        Arguments(
            Scenes(scenes[0], scenes[1], scenes[2], scenes[3], scenes[4], scenes[5]),
            Rules(rules[0], rules[1], rules[2], rules[3], rules[4], rules[5], rules[6], rules[7]),
            before, after, controls,
            Results(
                results[0], results[1], results[2], results[3], results[4], results[5], results[6], results[7],
                results[8], results[9], results[10],
            ),
            Memory(work[0], work[1], work[2]),
        ),
    )  # fmt: skip
