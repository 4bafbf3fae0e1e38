"""Environments in free flight, moved many at a time: one coordinate per loop is what the compiler makes wide.

The law is that of ``exact.step``: under a held torque that of ``glide``, under the chirp that of
``flight.evolve``. Sums have the same order, so every environment gets the bits that it would get alone.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.exact.bounds import bend_of, farthest, stays_off
from jackbox_env.exact.drives import DEGREE, TURN, chirp_piece, chirp_pieces, horner
from jackbox_env.exact.flight import fallen, moved, on_axes, stays_clear, turned
from jackbox_env.exact.search import STEEPEST
from jackbox_env.exact.step import Plan
from jackbox_env.exact.trigonometry import LARGEST, cos_sin_within
from jackbox_env.exact.workspace import (
    AHEAD,
    APART,
    ASIDE,
    AT_MOST,
    BEND,
    HIT,
    IMPULSE_SUM,
    LANE,
    LANE_COSINE,
    LANE_OMEGA,
    LANE_SINE,
    NEAR,
    OFF,
    PULL,
    TORQUE,
    TURNING,
    Workspace,
)
from jackbox_env.scene import SceneNumbers, chirp_turns
from jackbox_env.states import (
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
)

Array = NDArray[np.float64]

WIDTH = 16
TIME, STEPS, OVER = 12, 13, 14  # [s], steps in the episode, 1 where it has ended
WIDEST = 128  # environments in a block
# Rows of a block's scenes: what environments that are moved together need of their scenes.
LIMIT, INERTIA, FALL, CLEAR, ROOM, ORDINARY = range(6)  # [N m], [kg m^2], speed gained in a step [m/s], as in Plan,
# distance of the centres at which the jack's feet reach a wall [m], see ``ordinary``
SCENE_LANES = 6
_ORDINARY = 1e9  # over L or v0: below it float64 resolves places and speeds


class Block(NamedTuple):
    """Environments that are stepped together."""

    before: Array  # (16, width)
    after: Array  # (16, width), where they go
    lanes: Array  # (LANES, width), memory to work in
    scenes: Array  # (SCENE_LANES, width)
    first: int  # number of its first environment
    size: int  # number of its environments


def glide_block(dt: float, block: Block) -> None:
    """Fly all lanes of a block for ``dt`` [s], many at a time, and mark those where a foot may touch a wall.

    The law is that of ``exact.step.glide``.
    """
    before, after, lanes, count = block.before, block.after, block.lanes, block.size
    inertia, fall, torque = block.scenes[INERTIA], block.scenes[FALL], lanes[TORQUE]
    alpha, hits, impulses = lanes[TURNING], lanes[HIT], lanes[IMPULSE_SUM]
    for k in range(count):
        alpha[k] = torque[k] / inertia[k]
    for k in range(count):
        torque[k] = inertia[k] * alpha[k]
        hits[k] = impulses[k] = 0.0
    mark_near(dt, block)
    for place in (X_BOX, Y_BOX, X_JACK, THETA_JACK):
        here, rate, there = before[place], before[RATES + place], after[place]
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
    for place in (VX_BOX, VY_BOX, VX_JACK, OMEGA_JACK):
        here, there = before[place], after[place]
        for k in range(count):
            there[k] = here[k]


def mark_near(dt: float, block: Block) -> None:
    """Mark the lanes where a foot may touch a wall within ``dt`` [s], or where float64 runs out of places.

    Looked at first is how far the jack is from the box's centre, then how far from each wall, as ``bounds.py`` has it.
    The box's angular acceleration [rad/s^2] is what ``lanes[TURNING]`` holds, at most.
    """
    before, lanes, count = block.before, block.lanes, block.size
    fall, clear, alpha, near = block.scenes[FALL], block.scenes[CLEAR], lanes[TURNING], lanes[NEAR]
    x, y, vx, vy = lanes[0], lanes[1], lanes[2], lanes[3]
    for place in range(2):
        own, other, difference = before[place], before[X_JACK + place], lanes[place]
        rate, other_rate, rates = before[RATES + place], before[VX_JACK + place], lanes[2 + place]
        for k in range(count):
            difference[k] = other[k] - own[k]
        for k in range(count):
            rates[k] = other_rate[k] - rate[k]
    for k in range(count):
        free = stays_clear(x[k], y[k], vx[k], vy[k], fall[k], dt, clear[k]) & (abs(alpha[k]) < STEEPEST)
        near[k] = 0.0 if free else 1.0
    look_at_walls(dt, block)


def look_at_walls(dt: float, block: Block) -> None:
    """Take the mark off lanes whose feet stay off every wall: what ``bounds.walls_in_reach`` finds, many at a time.

    The marked lanes are first brought together at the front of the memory, which never writes where it still reads.
    """
    before, lanes, near, scenes = block.before, block.lanes, block.lanes[NEAR], block.scenes
    x, y, vx, vy, alpha = lanes[0], lanes[1], lanes[2], lanes[3], lanes[AT_MOST]
    cosine, sine, omega = lanes[LANE_COSINE], lanes[LANE_SINE], lanes[LANE_OMEGA]
    ahead, aside = lanes[AHEAD], lanes[ASIDE]
    bend, lane, room, pull, off = lanes[BEND], lanes[LANE], lanes[APART], lanes[PULL], lanes[OFF]
    count = 0
    for k in range(block.size):
        lane[count] = k
        count += 1 if near[k] != 0.0 else 0
    for j in range(count):
        k = int(lane[j])
        x[j], y[j], vx[j], vy[j] = x[k], y[k], vx[k], vy[k]
        cosine[j], omega[j], alpha[j] = before[THETA_BOX, k], before[OMEGA_BOX, k], abs(lanes[TURNING, k])
        room[j], pull[j] = scenes[ROOM, k], scenes[FALL, k] / dt
        off[j] = 1.0 if is_ordinary(before[:, k], scenes[ORDINARY, k]) and alpha[j] < STEEPEST else 0.0
    for j in range(count):
        cosine[j], sine[j] = cos_sin_within(cosine[j])
    for j in range(count):
        far = farthest(x[j], y[j], vx[j], vy[j], pull[j], 0.0, dt)
        bend[j] = bend_of(vx[j], vy[j], omega[j], far, pull[j], alpha[j], dt)
    for j in range(count):
        ahead[j], aside[j] = on_axes(cosine[j], sine[j], x[j], y[j])
    for j in range(count):
        x[j] = on_axes(cosine[j], sine[j], vx[j], vy[j])[0] + omega[j] * aside[j]
    for j in range(count):
        y[j] = on_axes(cosine[j], sine[j], vx[j], vy[j])[1] - omega[j] * ahead[j]
    for place, rate in ((ahead, x), (aside, y)):
        for j in range(count):
            reach = 0.5 * bend[j] * dt * dt
            ahead_off = stays_off(room[j] - place[j], rate[j], dt, reach)
            behind_off = stays_off(room[j] + place[j], -rate[j], dt, reach)
            off[j] = off[j] if ahead_off & behind_off else 0.0
    for j in range(count):
        if off[j] != 0.0:
            near[int(lane[j])] = 0.0


def is_ordinary(state: Array, most: float) -> bool:
    """Whether all 12 numbers are below ``most``, and the angles in one reduction's reach."""
    largest = 0.0
    for place in range(12):
        largest = max(largest, abs(state[place]))
    return bool((largest < most) & (max(abs(state[THETA_BOX]), abs(state[THETA_JACK])) < LARGEST))


def ordinary(scene: SceneNumbers) -> float:
    """Places [m], angles [rad] and rates [m/s, rad/s] below which float64 certainly resolves what matters here."""
    return _ORDINARY * min(1.0, min(scene.box_half_width, scene.speed_scale))


def glide_under_chirp(scene: SceneNumbers, plan: Plan, block: Block, memory: Workspace) -> bool:
    """Fly the lanes that are at the time of the first one under the chirp, and mark all others.

    The chirp's integrals are worked out once for all of them. Returns False, with nothing done, where that is not
    possible.
    """
    before, lanes, count, dt = block.before, block.lanes, block.size, plan.dt
    first = 0
    while first < count and before[OVER, first] != 0.0:
        first += 1
    if first == count:
        return False
    time = before[TIME, first]
    pieces = chirp_pieces(scene, time, dt)
    if pieces == 0:
        return False
    mark_under_chirp(scene, plan, block, time)
    enter_frames(block)
    turns = chirp_turns(scene.chirp_start_frequency, scene.chirp_rate, time)
    frequency = scene.chirp_start_frequency + scene.chirp_rate * time
    length, impulse = dt / pieces, 0.0
    for number in range(pieces):
        chirp_piece(scene, turns, frequency, number * length, length, memory)
        angle = horner(memory.powers[3 * TURN + 2], DEGREE + 2, 1.0)
        rate = horner(memory.powers[3 * TURN + 1], DEGREE + 1, 1.0)
        impulse += rate
        drift(block, scene.gravity, length, angle, rate)
    torque, hits, impulses = lanes[TORQUE], lanes[HIT], lanes[IMPULSE_SUM]
    mean = scene.box_inertia * impulse / dt
    for k in range(count):
        torque[k] = mean
        hits[k] = impulses[k] = 0.0
    leave_frames(block)
    return True


def enter_frames(block: Block) -> None:
    """Copy the states to ``after``, each in a frame at its box's centre, the jack's centre to the first two lanes."""
    before, after, count = block.before, block.after, block.size
    x, y = block.lanes[0], block.lanes[1]
    for k in range(count):
        after[X_BOX, k] = after[Y_BOX, k] = 0.0
    for k in range(count):
        x[k] = before[X_JACK, k] - before[X_BOX, k]
        y[k] = before[Y_JACK, k] - before[Y_BOX, k]
    for place in (THETA_BOX, THETA_JACK, VX_BOX, VY_BOX, OMEGA_BOX, VX_JACK, VY_JACK, OMEGA_JACK):
        here, there = before[place], after[place]
        for k in range(count):
            there[k] = here[k]


def leave_frames(block: Block) -> None:
    """Move the states in ``after`` back to the world: see ``step.finish``."""
    before, after, lanes, count = block.before, block.after, block.lanes, block.size
    x, y = lanes[0], lanes[1]
    for k in range(count):
        x[k] = before[X_JACK, k] + (x[k] - (before[X_JACK, k] - before[X_BOX, k]))
        y[k] = before[Y_JACK, k] + (y[k] - (before[Y_JACK, k] - before[Y_BOX, k]))
    for place in (0, 1):
        here, there, jack = before[place], after[place], lanes[place]
        for k in range(count):
            there[k] = here[k] + there[k]
        there = after[X_JACK + place]
        for k in range(count):
            there[k] = jack[k]


def mark_under_chirp(scene: SceneNumbers, plan: Plan, block: Block, time: float) -> None:
    """Mark the lanes that are at another time, near a wall, or where float64 runs out of places."""
    before, near, alpha = block.before, block.lanes[NEAR], block.lanes[TURNING]
    steepest = abs(scene.chirp_amplitude) / scene.box_inertia * (1.0 + 1e-9)
    for k in range(block.size):
        alpha[k] = steepest
    mark_near(plan.dt, block)
    most = ordinary(scene)
    for k in range(block.size):
        near[k] = near[k] if before[TIME, k] == time else 1.0
    for place in range(12):
        here = before[place]
        for k in range(block.size):
            near[k] = near[k] if abs(here[k]) < most else 1.0


def drift(block: Block, gravity: float, length: float, angle: float, rate: float) -> None:
    """Fly all lanes for ``length`` [s], in which the chirp adds to the box's angle and rate: see ``flight.evolve``."""
    after, lanes, count = block.after, block.lanes, block.size
    for place in (0, 1):
        there, speed = after[place], after[RATES + place]
        for k in range(count):
            there[k] += speed[k] * length
    box_angle, omega = after[THETA_BOX], after[OMEGA_BOX]
    for k in range(count):
        box_angle[k] += omega[k] * length + angle
    for k in range(count):
        omega[k] += rate
    x, y, vx, vy = lanes[0], lanes[1], after[VX_JACK], after[VY_JACK]
    for k in range(count):
        x[k] += vx[k] * length
    for k in range(count):
        y[k] += (vy[k] - 0.5 * gravity * length) * length
    for k in range(count):
        vy[k] -= gravity * length
    jack_angle, spin = after[THETA_JACK], after[OMEGA_JACK]
    for k in range(count):
        jack_angle[k] += spin[k] * length
