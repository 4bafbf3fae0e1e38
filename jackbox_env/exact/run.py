"""The loop of the exact contact model: :func:`run` steps many rows, each a jack in its box, through one or many steps.

Simulators, batches and rollouts call it: 1 row and 1 step, N rows and 1 step, N rows and H steps. In each step
``glide.py`` moves the rows in free flight together, ``step.py`` moves those near a wall one by one, and ``score.py``
rewards them; then :func:`record` fills in the results.
Rows are stored in blocks, shape (blocks, 16, width): the 12 numbers of the state, then those named in ``workspace.py``.
Each row is a lane of its block. One number of all lanes lies side by side, so one instruction moves several rows.
A step reads one array of blocks and writes the other, so a step that fails changes nothing.
"""

from __future__ import annotations

import math
from typing import Any

from jackbox_env.exact.glide import Block, glide_block, glide_under_chirp
from jackbox_env.exact.score import block_actor, block_observer, block_scorer
from jackbox_env.exact.step import CHIRP, CONSTANT, Pieces, StepParameters, effort, make_parameters, step
from jackbox_env.exact.workspace import (
    APPLIED,
    CONTROL_ACTIONS,
    CONTROL_SHARES,
    DECISIONS,
    HEIGHT,
    HITS,
    IMPULSE_SUM,
    LEFT,
    LIMIT,
    NEAR,
    OVER,
    SEPARATED,
    STEPS,
    TIME,
    TORQUE,
    UNSCORED,
    Arguments,
    Results,
    Rules,
    Scenes,
    Status,
    Workspace,
    arguments_at,
    make_numbers,
    scene_at,
)
from jackbox_env.jit.compiler import inlined
from jackbox_env.model.landing import ends_decision
from jackbox_env.model.mechanics import energy_of
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import LATEST_TIME, Array, Flags, copy_numbers

PATIENCE = 2e6  # work before a call pauses, in gap evaluations: 0.3 s, 1.2 s if most of them find impacts
STOPPED = 2.0  # in the row OVER of a block: an impact stopped the row; 1.0: its episode is over


def run(address: Any, low: int, high: int, first: int) -> tuple[int, int, int, int, int]:
    """Step the rows of some blocks through all steps.

    Args:
        address: of the :class:`Arguments`.
        low: first block.
        high: past the last block.
        first: step at which the first block begins.

    Returns:
        How it ended: DONE, PAUSED after long work, FULL if the log has no room for a step's impacts, UNCOMPILED if a
        step needs what is compiled later, or the status of the step that failed. The row that failed, or the block to
        go on with, from ``memory.lane`` on. The step that failed or is next. The number of episodes that ended. The
        number of impacts recorded.
    """
    call = arguments_at(address)
    rules, memory, width = call.rules, call.memory.workspaces[0], call.before.shape[2]
    scene, count = make_numbers(call.scenes.values[0]), call.results.terminations.shape[0]
    params = make_parameters(scene, rules.dt, call.scenes.drive_kinds[0])
    finished, recorded, memory.work = 0, 0, 0.0
    for number in range(low, high):
        for k in range(first if number == low else 0, rules.steps):
            if memory.work > rules.patience and memory.work > 0.0:
                return Status.PAUSED.value, number, k, finished, recorded
            block = Block(
                (call.after if k & 1 else call.before)[number], (call.before if k & 1 else call.after)[number],
                call.memory.scratch,
                call.scenes.scene_params[number if call.scenes.scene_params.shape[0] > 1 else 0], number * width,
                min(width, count - number * width),
            )  # fmt: skip
            if k > 0 and skip_remaining_steps(call, block, k):
                break
            ended, lane, recorded = move(scene, params, address, block, k, recorded)
            if ended == Status.FULL or ended == Status.PAUSED or ended == Status.UNCOMPILED:
                return ended.value, number, k, finished, recorded
            memory.lane = 0
            waiting, ends = keep_waiting(block), 0
            if ended == Status.DONE and call.results.rewards.shape[0]:
                ended, lane, ends = reward(call, block, k, waiting)
            if ended != Status.DONE:
                return ended.value, block.first + lane, k, finished, recorded
            memory.work += block.size
            finished += close_block(rules, block, call.results, waiting > 0, ends != 0, k + 1)
            record(address, block, k)
        finished += count_decisions(call, number)
        bad = finish_block(call, number)
        if bad >= 0:
            return Status.BAD_OBSERVATION.value, number * width + bad, rules.steps, finished, recorded
    return Status.DONE.value, -1, rules.steps, finished, recorded


@inlined
def move(
    scene: SceneNumbers, params: StepParameters, address: Any, block: Block, k: int, recorded: int
) -> tuple[Status, int, int]:
    """Step a block: the rows in free flight together, then the others one by one.

    ``scene`` and ``params`` are those of the first row. Returns how it ended, the lane that failed, and the number of
    impacts in the log.
    """
    call = arguments_at(address)
    memory, bad = call.memory.workspaces[0], set_torques(address, block, k)
    if bad >= 0:
        return Status.BAD_TORQUE if call.rules.controls == CONTROL_ACTIONS else Status.BAD_ACTION, bad, recorded
    if memory.lane == 0:
        memory.glided = 1 if fly_block(scene, params, call.scenes, block, memory) else 0
    return step_lanes(scene, params, address, block, k, recorded)


@inlined
def reward(call: Arguments, block: Block, k: int, waiting: int) -> tuple[Status, int, int]:
    """Reward a step of a block, of which ``waiting`` episodes were over before.

    Returns how it ended, the lane whose reward is unusable, and the number of episodes that the task ends.
    """
    results, scratch, unscored, skipped = call.results, call.memory.scratch, block.before[OVER], waiting
    if call.rules.continue_after_done:
        unscored, skipped = scratch[UNSCORED], mark_unscored(block, results.terminations)
    rewards = results.rewards[min(k, results.rewards.shape[0] - 1)]
    ends = block_scorer(call.rules.score)(
        call.scenes.values, block.after, scratch, unscored, skipped, block.first, k, rewards, results.terminations,
        results.reports,
    )  # fmt: skip
    if ends < 0:
        return Status.BAD_REWARD, first_unusable(block, rewards), 0
    for lane in range(block.size if results.returns.shape[0] else 0):
        row = block.first + lane
        results.returns[row] = rewards[row] + (results.returns[row] if k else -0.0)  # -0.0 stays -0.0
    return Status.DONE, -1, ends


def set_torques(address: Any, block: Block, k: int) -> int:
    """Fill in the torques of a step, 0 under a drive; return the lane of a control that is unusable, or -1.

    That is one that is NaN or infinite, or an action whose torque is NaN. Those of episodes that are over are not
    checked.
    """
    call = arguments_at(address)
    torque, limit, controls = block.scratch[APPLIED], block.scene_params[LIMIT], call.controls
    if not controls.shape[0]:
        torque[:] = 0.0
        return -1
    if call.rules.controls == CONTROL_ACTIONS:
        return block_actor(call.rules.act)(
            call.scenes.values, block.before, block.scratch, controls, block.first, block.size, call.rules.dt
        )
    step_controls = controls[k // (call.rules.steps // controls.shape[0])]
    here, usable = step_controls[block.first : block.first + block.size], 0
    if call.rules.controls == CONTROL_SHARES:
        for lane in range(block.size):
            torque[lane] = max(-1.0, min(1.0, here[lane])) * limit[lane]
    else:
        copy_numbers(block.size, here, torque)
    for lane in range(block.size):
        usable += 1 if abs(here[lane]) < math.inf else 0
    return -1 if usable == block.size else first_unusable(block, step_controls)


def first_unusable(block: Block, numbers: Array) -> int:
    """The first lane of a block whose episode goes on and whose number, of (N,), is NaN or infinite; or -1."""
    for lane in range(block.size):
        if not abs(numbers[block.first + lane]) < math.inf and block.before[OVER, lane] == 0.0:
            return lane
    return -1


def fly_block(scene: SceneNumbers, params: StepParameters, scenes: Scenes, block: Block, memory: Workspace) -> bool:
    """Move the rows of a block that are in free flight; return whether it did. A block of one row is not moved.

    ``scene`` and ``params`` are those of the first row, and of all rows if they share a scene.
    """
    if block.before.shape[1] == 1:
        return False
    constant = params.drive_kind == CONSTANT
    if scenes.values.shape[0] > 1:
        for lane in range(block.size):
            constant = constant or scenes.drive_kinds[block.first + lane] == CONSTANT
    elif params.drive_kind == CHIRP and params.per_radian == 0.0:
        # Not with loss: a single step then takes whole turns off the angles, which rounds differently.
        return glide_under_chirp(scene, params, block, memory)
    if constant:
        glide_block(params.dt, block)
    return constant


def step_lanes(
    scene: SceneNumbers, params: StepParameters, address: Any, block: Block, k: int, recorded: int
) -> tuple[Status, int, int]:
    """Step the rows of a block from ``memory.lane`` on, except those that glided and stay off the walls.

    Returns:
        How it ended, the lane that failed, and the number of impacts in the log. PAUSED sets ``memory.lane``.
    """
    before, after, scratch, already = block.before, block.after, block.scratch, recorded
    call = arguments_at(address)
    scenes, memory, log, nonsmooth = call.scenes, call.memory.workspaces[0], call.memory.log, call.results.nonsmooth
    varied, first, left = scenes.values.shape[0] > 1, memory.lane, scratch[LEFT]
    mark_left(params, scenes, block, memory.glided != 0)
    for lane in range(first, block.size):
        if left[lane] == 0.0:
            continue
        time = before[TIME, lane]
        if time + params.dt == time or time + params.dt > LATEST_TIME:
            return Status.TOO_LATE, lane, recorded
        row = block.first + lane
        kind = scenes.drive_kinds[row] if varied else params.drive_kind
        if memory.work > call.rules.patience and lane > first:
            memory.lane = lane
            return Status.PAUSED, lane, recorded
        row_scene, row_params = scene, params
        if varied:
            row_scene = make_numbers(scenes.values[row])
            row_params = make_parameters(row_scene, params.dt, kind)
        pieces = Pieces(scenes.table, 0, 0)
        if scenes.begins.shape[0] and kind != CONSTANT and kind != CHIRP:
            begin = scenes.begins[row if scenes.begins.shape[0] > 1 else 0] + k
            pieces = Pieces(scenes.table, scenes.ends[begin], scenes.ends[begin + 1])
        room = log[recorded:]
        ended, scratch[TORQUE, lane] = step(
            row_scene, row_params, before[:, lane], after[:, lane], time, scratch[APPLIED, lane], pieces, memory, room
        )  # fmt: skip
        if ended != Status.DONE:
            return ended, lane, already if ended == Status.UNCOMPILED else recorded
        if log.shape[0]:
            if memory.hits > room.shape[0]:
                return Status.FULL, lane, already
            recorded += memory.hits
        if nonsmooth.shape[0]:
            nonsmooth[row, k] = memory.nonsmooth != 0
        scratch[HITS, lane], scratch[IMPULSE_SUM, lane] = memory.hits, memory.impulse
        memory.work += effort(memory)
    return Status.DONE, -1, recorded


def mark_left(params: StepParameters, scenes: Scenes, block: Block, glided: bool) -> None:
    """Mark the rows that are left to :func:`step_lanes`, those whose time ends among them."""
    over, time, near, left = block.before[OVER], block.before[TIME], block.scratch[NEAR], block.scratch[LEFT]
    for lane in range(block.size):
        end = time[lane] + params.dt
        on_time = (end != time[lane]) & (end <= LATEST_TIME)
        left[lane] = 0.0 if (over[lane] != 0.0) | (on_time & glided & (near[lane] == 0.0)) else 1.0
    for lane in range(block.size if glided and scenes.values.shape[0] > 1 else 0):
        if scenes.drive_kinds[block.first + lane] != CONSTANT and over[lane] == 0.0:
            left[lane] = 1.0


def skip_remaining_steps(call: Arguments, block: Block, k: int) -> bool:
    """Whether all rows of a block have stopped before step ``k``; then copies them to where the last step would."""
    if call.rules.continue_after_done:
        return False
    for lane in range(block.size):
        if block.before[OVER, lane] == 0.0:
            return False
    for column in range(HEIGHT if (call.rules.steps - k) & 1 else 0):
        copy_numbers(block.size, block.before[column], block.after[column])
    return True


def count_decisions(call: Arguments, number: int) -> int:
    """Count a decision of each row that stepped; truncate episodes with enough of them, and return their number."""
    rules, results, width = call.rules, call.results, call.before.shape[2]
    if rules.decisions == math.inf:
        return 0
    rows, first, ended = (call.after if rules.steps & 1 else call.before)[number], number * width, 0
    for lane in range(min(width, results.terminations.shape[0] - first)):
        over = rows[OVER, lane] == 1.0
        if over and not (results.terminations[first + lane] or results.truncations[first + lane]):
            continue  # it waited
        rows[DECISIONS, lane] += 1.0
        if rows[DECISIONS, lane] >= rules.decisions:
            results.truncations[first + lane] = True
            rows[OVER, lane] = 1.0
            ended += 0 if over else 1
    return ended


def finish_block(call: Arguments, number: int) -> int:
    """After the last step: let rows go on that an impact has stopped, and observe; return a lane with a NaN, or -1."""
    width = call.before.shape[2]
    rows, first = (call.after if call.rules.steps & 1 else call.before)[number], number * width
    size = min(width, call.results.terminations.shape[0] - first)
    for lane in range(size if call.rules.max_contact_steps > 0 else 0):
        if rows[OVER, lane] == STOPPED:
            rows[OVER, lane] = 0.0
    if not call.results.observations.shape[0]:
        return -1
    return block_observer(call.rules.observe)(
        call.scenes.values, rows, size, call.memory.scratch, first, call.results.observations
    )


def keep_waiting(block: Block) -> int:
    """Copy the states of episodes that are over; return their number."""
    over, waiting = block.before[OVER], 0
    for lane in range(block.size):
        waiting += 1 if over[lane] != 0.0 else 0
    for lane in range(block.size if waiting else 0):
        if over[lane] != 0.0:
            copy_numbers(12, block.before[:, lane], block.after[:, lane])
    return waiting


def mark_unscored(block: Block, terminations: Flags) -> int:
    """Mark the rows that earn nothing: episodes that are over, or that the task has ended. Return their number."""
    over, unscored, count = block.before[OVER], block.scratch[UNSCORED], 0
    for lane in range(block.size):
        unscored[lane] = 1.0 if over[lane] != 0.0 or terminations[block.first + lane] else 0.0
        count += 1 if unscored[lane] != 0.0 else 0
    return count


def close_block(rules: Rules, block: Block, results: Results, waiting: bool, ends: bool, made: int) -> int:
    """Advance times and step counts, and end episodes; return the number of episodes that ended.

    ``waiting``: whether some episodes were over before the step; those stay as they are. ``ends``: whether the task
    ended some. ``made``: steps of this call, with this one.
    """
    before, after, first, count = block.before, block.after, block.first, block.size
    terminations, truncations = results.terminations[first : first + count], results.truncations[first : first + count]
    time, steps, over = before[TIME], before[STEPS], before[OVER]
    new_time, new_steps, new_over = after[TIME], after[STEPS], after[OVER]
    ended = 0
    for k in range(count):
        new_time[k] = time[k] + rules.dt
    for k in range(count):
        new_steps[k] = steps[k] + 1.0
    copy_numbers(count if rules.decisions < math.inf else 0, before[DECISIONS], after[DECISIONS])
    for k in range(count):
        new_over[k] = 1.0 if new_steps[k] >= rules.longest else 0.0
    for k in range(count):
        truncations[k] |= new_over[k] != 0.0 and over[k] == 0.0
    for k in range(count if ends and not rules.continue_after_done else 0):
        new_over[k] = 1.0 if terminations[k] else new_over[k]
    for k in range(count):
        ended += 1 if new_over[k] != 0.0 else 0
    if rules.max_contact_steps > 0:
        stop_rows(rules, block, made)
    if waiting:
        for k in range(count):
            if over[k] != 0.0:
                ended -= 1 if new_over[k] == 1.0 else 0
                new_time[k], new_steps[k], new_over[k] = time[k], steps[k], over[k]
    return ended


def stop_rows(rules: Rules, block: Block, made: int) -> None:
    """Stop the rows that an impact stops after ``made`` steps."""
    separated, hits, over = block.scratch[SEPARATED], block.scratch[HITS], block.after[OVER]
    for k in range(block.size):
        separated[k] = 1.0 if hits[k] == 0.0 or (made > 1 and separated[k] != 0.0) else 0.0
        if over[k] == 0.0 and ends_decision(made, separated[k] != 0.0, hits[k] > 0.0, rules.max_contact_steps):
            over[k] = STOPPED


def record(address: Any, block: Block, k: int) -> None:
    """Record what the caller wants of a step: states, energies, impacts, ends of episodes."""
    call = arguments_at(address)
    results, steps = call.results, call.rules.steps
    trajectories, energies, hits, lengths = results.trajectories, results.energies, results.hits, results.lengths
    if not trajectories.shape[0] + energies.shape[0] + hits.shape[0] + lengths.shape[0]:
        return
    values, index = call.scenes.values, (k + 1) % max(1, trajectories.shape[1])
    for lane in range(block.size):
        row = block.first + lane
        if trajectories.shape[0] and block.before[OVER, lane] == 0.0:
            copy_numbers(12, block.after[:, lane], trajectories[row, index])
        if energies.shape[0]:
            row_scene = scene_at(values, row)
            if k == 0:
                energies[row, 0] = energy_of(row_scene, block.before[:, lane])
            energies[row, k + 1] = energy_of(row_scene, block.after[:, lane])
        if hits.shape[0] and block.before[OVER, lane] == 0.0:
            hits[k, row], results.impulses[k, row] = int(block.scratch[HITS, lane]), block.scratch[IMPULSE_SUM, lane]
        if lengths.shape[0] and results.terminations[row] and lengths[row] == steps:
            lengths[row] = k + 1
