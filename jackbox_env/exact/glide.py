"""Rows in free flight, moved many at a time; ``run.py`` calls it before it steps the others one by one.

Each loop is over one coordinate of all rows, which the compiler vectorizes. Rows with a foot that may touch a wall are
marked for ``step.py``. The law of motion is that of ``flight.free_flight`` under a constant torque and of
``flight.evolve`` under the chirp. Sums have the same order there, so every row gets the bits that it would get alone.
"""

from __future__ import annotations

from typing import NamedTuple

from jackbox_env.exact.bounds import centre_curvature_of, clearance_of_all, farthest, foot_curvature_of
from jackbox_env.exact.flight import DEGREE, TURN, chirp_piece, chirp_pieces, fallen, horner, moved, stays_clear, turned
from jackbox_env.exact.geometry import ONE_REDUCTION, cos_sin_within, on_axes
from jackbox_env.exact.search import STEEPEST
from jackbox_env.exact.step import CONSTANT, StepParameters, make_parameters
from jackbox_env.exact.workspace import (
    AHEAD,
    ALPHA_BOUND,
    APPLIED,
    ASIDE,
    CLEAR,
    CLEARANCE,
    FALL,
    HITS,
    IMPULSE_SUM,
    INERTIA,
    JACK_ARM,
    LANE_ARM,
    LANE_COSINE,
    LANE_CURVATURE,
    LANE_INDEX,
    LANE_OMEGA,
    LANE_PULL,
    LANE_ROOM,
    LANE_SINE,
    LANE_SPIN,
    LIMIT,
    NEAR,
    ORDINARY,
    ORDINARY_LANE,
    OVER,
    RELATIVE_COSINE,
    RELATIVE_SINE,
    ROOM,
    TIME,
    TORQUE,
    TURNING,
    Workspace,
    scene_at,
)
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    RATES,
    THETA_BOX,
    THETA_JACK,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
    Counts,
    add_numbers,
    copy_numbers,
)

_DRIFT_COST = 0.005  # gap evaluations that take as long as one row's flight through a piece
_ORDINARY = 1e9  # over L or v0: below it float64 resolves positions and speeds


class Block(NamedTuple):
    """Rows that are stepped together."""

    before: Array  # (16, width)
    after: Array  # (16, width), written by the step
    scratch: Array  # (SCRATCH, width)
    scene_params: Array  # (SCENE_PARAMS, width)
    first: int  # index of the first row among all
    size: int  # number of rows


def glide_block(dt: float, block: Block) -> None:
    """Fly all rows of a block for ``dt`` [s] under constant torques, and mark those where a foot may touch a wall.

    The law is that of ``flight.free_flight``.
    """
    before, after, scratch, count = block.before, block.after, block.scratch, block.size
    inertia, fall, applied, torque = (
        block.scene_params[INERTIA],
        block.scene_params[FALL],
        scratch[APPLIED],
        scratch[TORQUE],
    )
    alpha, hits, impulses = scratch[TURNING], scratch[HITS], scratch[IMPULSE_SUM]
    for k in range(count):
        alpha[k] = applied[k] / inertia[k]
    for k in range(count):
        torque[k] = inertia[k] * alpha[k]
        hits[k] = impulses[k] = 0.0
    mark_near(dt, block)
    for index in (X_BOX, Y_BOX, X_JACK, THETA_JACK):
        here, rate, there = before[index], before[RATES + index], after[index]
        for k in range(count):
            there[k] = moved(here[k], rate[k], dt)
    angle, omega, new_angle, new_omega = before[THETA_BOX], before[OMEGA_BOX], after[THETA_BOX], after[OMEGA_BOX]
    for k in range(count):
        new_angle[k] = turned(angle[k], omega[k], alpha[k], dt)
    for k in range(count):
        new_omega[k] = omega[k] + alpha[k] * dt
    height, climb, new_height, new_climb = before[Y_JACK], before[VY_JACK], after[Y_JACK], after[VY_JACK]
    for k in range(count):
        new_height[k] = fallen(height[k], climb[k], fall[k], dt)
    for k in range(count):
        new_climb[k] = climb[k] - fall[k]
    for index in (VX_BOX, VY_BOX, VX_JACK, OMEGA_JACK):
        copy_numbers(count, before[index], after[index])


def mark_near(dt: float, block: Block) -> None:
    """Mark the rows where a foot may touch a wall within ``dt`` [s], or where float64 does not resolve the motion.

    The test is first by the jack's distance from the box's centre, then by that from each wall, as in ``search.py``.
    ``scratch[TURNING]`` bounds the box's angular acceleration [rad/s^2].
    """
    before, scratch, count = block.before, block.scratch, block.size
    fall, clear, alpha, near = block.scene_params[FALL], block.scene_params[CLEAR], scratch[TURNING], scratch[NEAR]
    x, y, vx, vy = scratch[0], scratch[1], scratch[2], scratch[3]
    for axis in range(2):
        box, jack, difference = before[axis], before[X_JACK + axis], scratch[axis]
        box_rate, jack_rate, rates = before[RATES + axis], before[VX_JACK + axis], scratch[2 + axis]
        for k in range(count):
            difference[k] = jack[k] - box[k]
        for k in range(count):
            rates[k] = jack_rate[k] - box_rate[k]
    for k in range(count):
        free = stays_clear(x[k], y[k], vx[k], vy[k], fall[k], dt, clear[k]) & (abs(alpha[k]) < STEEPEST)
        near[k] = 0.0 if free else 1.0
    clear_marks(dt, block)


def clear_marks(dt: float, block: Block) -> None:
    """Remove the mark of rows whose feet stay off every wall, by ``search.clearance_of_all``, many rows at a time.

    The marked rows are first gathered at the front; a gathered row never overwrites one still to be read.
    """
    before, scratch, near, scenes = block.before, block.scratch, block.scratch[NEAR], block.scene_params
    x, y, vx, vy, alpha = scratch[0], scratch[1], scratch[2], scratch[3], scratch[ALPHA_BOUND]
    cosine, sine, omega = scratch[LANE_COSINE], scratch[LANE_SINE], scratch[LANE_OMEGA]
    relative_cosine, relative_sine, spin = scratch[RELATIVE_COSINE], scratch[RELATIVE_SINE], scratch[LANE_SPIN]
    ahead, aside, arm, room = scratch[AHEAD], scratch[ASIDE], scratch[LANE_ARM], scratch[LANE_ROOM]
    curvature, lane, pull = scratch[LANE_CURVATURE], scratch[LANE_INDEX], scratch[LANE_PULL]
    ordinary_lane, clearance = scratch[ORDINARY_LANE], scratch[CLEARANCE]
    count = 0
    for k in range(block.size):
        lane[count] = k
        count += 1 if near[k] != 0.0 else 0
    for j in range(count):
        k = int(lane[j])
        x[j], y[j], vx[j], vy[j] = x[k], y[k], vx[k], vy[k]
        # The angles, which their cosines replace below.
        cosine[j], relative_cosine[j] = before[THETA_BOX, k], before[THETA_JACK, k] - before[THETA_BOX, k]
        omega[j], spin[j] = before[OMEGA_BOX, k], before[OMEGA_JACK, k] - before[OMEGA_BOX, k]
        alpha[j], pull[j] = abs(scratch[TURNING, k]), scenes[FALL, k] / dt
        room[j], arm[j] = scenes[ROOM, k], scenes[JACK_ARM, k]
        ordinary_lane[j] = 1.0 if is_ordinary(before[:, k], scenes[ORDINARY, k]) and alpha[j] < STEEPEST else 0.0
    for j in range(count):
        cosine[j], sine[j] = cos_sin_within(cosine[j])
    for j in range(count):
        relative_cosine[j], relative_sine[j] = cos_sin_within(relative_cosine[j])
    for j in range(count):
        far = farthest(x[j], y[j], vx[j], vy[j], pull[j], 0.0, dt)
        curvature[j] = centre_curvature_of(vx[j], vy[j], omega[j], far, pull[j], alpha[j], dt)
    for j in range(count):
        ahead[j], aside[j] = on_axes(cosine[j], sine[j], x[j], y[j])
    ahead_rate, aside_rate = x, y  # in the same memory, as positions along x and y are no longer needed
    for j in range(count):
        ahead_rate[j] = on_axes(cosine[j], sine[j], vx[j], vy[j])[0] + omega[j] * aside[j]
    for j in range(count):
        aside_rate[j] = on_axes(cosine[j], sine[j], vx[j], vy[j])[1] - omega[j] * ahead[j]
    for j in range(count):
        foot_curvature = foot_curvature_of(arm[j], abs(spin[j]) + alpha[j] * dt, alpha[j])
        clearance[j] = clearance_of_all(
            room[j], arm[j], ahead[j], aside[j], ahead_rate[j], aside_rate[j], relative_cosine[j], relative_sine[j],
            spin[j], curvature[j], foot_curvature, dt,
        )  # fmt: skip
    for j in range(count):
        near[int(lane[j])] = 0.0 if clearance[j] > 0.0 and ordinary_lane[j] != 0.0 else 1.0


def is_ordinary(state: Array, most: float) -> bool:
    """Whether all 12 numbers are below ``most``, and the angles below the limit of ``cos_sin_within``."""
    largest = 0.0
    for index in range(12):
        largest = max(largest, abs(state[index]))
    return bool((largest < most) & (max(abs(state[THETA_BOX]), abs(state[THETA_JACK])) < ONE_REDUCTION))


def ordinary(scene: SceneNumbers) -> float:
    """Bound of positions [m], angles [rad] and velocities [m/s, rad/s] that float64 resolves well enough here."""
    return _ORDINARY * min(1.0, min(scene.box_half_width, scene.speed_scale))


def glide_under_chirp(scene: SceneNumbers, params: StepParameters, block: Block, memory: Workspace) -> bool:
    """Fly the rows at the time of the first one for a step under the chirp, and mark all others.

    The chirp is integrated once for all of them. Returns False, with nothing done, if all episodes are over or the
    chirp turns too often.
    """
    before, scratch, count, dt = block.before, block.scratch, block.size, params.dt
    first = 0
    while first < count and before[OVER, first] != 0.0:
        first += 1
    if first == count:
        return False
    time = before[TIME, first]
    pieces = chirp_pieces(scene, time, dt)
    if pieces == 0:
        return False
    mark_under_chirp(scene, params, block, time)
    enter_frames(block)
    length, impulse = dt / pieces, 0.0
    memory.work += pieces * (1.0 + _DRIFT_COST * count)
    for number in range(pieces):
        chirp_piece(scene, time, number * length, length, memory)
        angle = horner(memory.powers[3 * TURN + 2], DEGREE + 2, 1.0)
        rate = horner(memory.powers[3 * TURN + 1], DEGREE + 1, 1.0)
        impulse += rate
        drift(block, scene.gravity, length, angle, rate)
    torque, hits, impulses = scratch[TORQUE], scratch[HITS], scratch[IMPULSE_SUM]
    mean = scene.box_inertia * impulse / dt
    for k in range(count):
        torque[k] = mean
        hits[k] = impulses[k] = 0.0
    leave_frames(block)
    return True


def enter_frames(block: Block) -> None:
    """Copy the states to ``after``, in frames at the boxes' centres; the jacks' centres go to two rows of scratch."""
    before, after, count = block.before, block.after, block.size
    x, y = block.scratch[0], block.scratch[1]
    for k in range(count):
        after[X_BOX, k] = after[Y_BOX, k] = 0.0
    for k in range(count):
        x[k] = before[X_JACK, k] - before[X_BOX, k]
        y[k] = before[Y_JACK, k] - before[Y_BOX, k]
    for index in (THETA_BOX, THETA_JACK, VX_BOX, VY_BOX, OMEGA_BOX, VX_JACK, VY_JACK, OMEGA_JACK):
        copy_numbers(count, before[index], after[index])


def leave_frames(block: Block) -> None:
    """Move the states in ``after`` back to the world: see ``step.leave_frame``."""
    before, after, scratch, count = block.before, block.after, block.scratch, block.size
    x, y = scratch[0], scratch[1]
    for k in range(count):
        x[k] = before[X_JACK, k] + (x[k] - (before[X_JACK, k] - before[X_BOX, k]))
        y[k] = before[Y_JACK, k] + (y[k] - (before[Y_JACK, k] - before[Y_BOX, k]))
    for axis in (0, 1):
        add_numbers(count, after[axis], 1.0, before[axis])
        copy_numbers(count, scratch[axis], after[X_JACK + axis])


def mark_under_chirp(scene: SceneNumbers, params: StepParameters, block: Block, time: float) -> None:
    """Mark the rows at another time, near a wall, or where float64 does not resolve the motion."""
    before, near, alpha = block.before, block.scratch[NEAR], block.scratch[TURNING]
    steepest = abs(scene.chirp_amplitude) / scene.box_inertia * (1.0 + 1e-9)
    for k in range(block.size):
        alpha[k] = steepest
    mark_near(params.dt, block)
    most = ordinary(scene)
    for k in range(block.size):
        near[k] = near[k] if before[TIME, k] == time else 1.0
    for index in range(12):
        here = before[index]
        for k in range(block.size):
            near[k] = near[k] if abs(here[k]) < most else 1.0


def drift(block: Block, gravity: float, length: float, angle: float, rate: float) -> None:
    """Fly all rows for ``length`` [s]; the chirp adds ``angle`` and ``rate`` to the box: see ``flight.evolve``."""
    after, scratch, count = block.after, block.scratch, block.size
    for axis in (0, 1):
        add_numbers(count, after[axis], length, after[RATES + axis])
    box_angle, omega = after[THETA_BOX], after[OMEGA_BOX]
    for k in range(count):
        box_angle[k] += omega[k] * length + angle
    for k in range(count):
        omega[k] += rate
    x, y, vx, vy = scratch[0], scratch[1], after[VX_JACK], after[VY_JACK]
    add_numbers(count, x, length, vx)
    for k in range(count):
        y[k] += (vy[k] - 0.5 * gravity * length) * length
    for k in range(count):
        vy[k] -= gravity * length
    add_numbers(count, after[THETA_JACK], length, after[OMEGA_JACK])


def write_scene_params(values: Array, dt: float, scene_params: Array, numbers: Counts) -> None:
    """Write the numbers of scenes that rows moved together need, see ``workspace.SCENE_PARAMS``.

    Args:
        values: the scenes' numbers, a row for each of ``numbers`` or one for all.
        dt: control step [s].
        scene_params: shape (blocks, SCENE_PARAMS, width), to be written.
        numbers: of the environments.
    """
    for i in range(numbers.shape[0]):
        scene = scene_at(values, i)
        lane = scene_params[numbers[i] // scene_params.shape[2], :, numbers[i] % scene_params.shape[2]]
        lane[LIMIT], lane[INERTIA], lane[FALL] = scene.torque_limit, scene.box_inertia, scene.gravity * dt
        lane[CLEAR] = make_parameters(scene, dt, CONSTANT).clear
        lane[ROOM], lane[ORDINARY] = scene.box_half_width * (1.0 - 1e-12) - scene.jack_arm, ordinary(scene)
        lane[JACK_ARM] = scene.jack_arm
