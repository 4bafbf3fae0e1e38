"""Derivatives of steps of the exact contact model: a tangent beside flight and law, in the order of a step's impacts.

A tangent holds, in each of its columns, how the state changes with one number, and below how the torque and the scene
change with that number, shape (ROWS, columns). Flight is linear in the state and in what acts. At an impact, with the
time t*, the gap g, the reset R (the impact law at fixed places) and the flow f before and after, a tangent d becomes

    d+ = (DR + (f+ - DR f-) Dg / (Dg f-)) d,

the saltation matrix (Aizerman and Gantmacher 1958; Kong et al. 2024, "Saltation Matrices", Proceedings of the IEEE). It
is applied as it is derived: to the moment of impact, dt* = -Dg d / (Dg f-), through the law there, and back.

Exactness: rounding of the states and of the impacts' times, over the impact's rate.
Fails: several contacts at one moment, an impact slower than 1e-6 v0 or so slow for how its gap bends that rounding
    decides, feet at rest, a foot that touches at an end of a step, a step whose impacts multiply errors by 1e10. No
    derivative exists there, or none can be told: it is NaN. Under a drive, P by the box's mass and inertia comes from
    differences of states: off by what rounding leaves of places and angles that are far from 0.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from jackbox_env.exact.contact import SLOW, frame_of, gradient, kick, rate_of
from jackbox_env.exact.rest import bend
from jackbox_env.exact.run import Counts, Flags
from jackbox_env.exact.step import (
    CONSTANT,
    CONSTANT_BESIDE_FORCES,
    FUNCTIONS,
    Plan,
    make_numbers,
    make_plan,
    start,
    touch_of,
)
from jackbox_env.exact.workspace import AT_IMPACT, DRIVEN_THERE, Workspace, Workspaces
from jackbox_env.scene import SceneNumbers
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

# Rows of a tangent below the state's 12: a torque added throughout the step, and numbers of the scene.
FIELDS = (
    "gravity", "box_mass", "box_inertia", "jack_mass", "jack_inertia", "jack_arm", "box_half_width", "restitution",
)  # fmt: skip
TORQUE = 12
GRAVITY, BOX_MASS, BOX_INERTIA, JACK_MASS, JACK_INERTIA, JACK_ARM, HALF_WIDTH, RESTITUTION = range(13, 21)
LATER = 21  # by how much later the last impact comes [s]
ROWS = 22
FIRST_FIELD = 13  # column

CLEAR, LEAVING, OUTSIDE, APPROACHING = range(4)  # how feet touch walls
_ROUNDING = 1e-2  # of the contact tolerance: what rounding leaves of a gap
_GRAZE = 1e-4  # share of a derivative that may be rounding
# Of a state's numbers; by those of the box's centre: the same, as both move alike.
GROWING = THETA_BOX, X_JACK, Y_JACK, THETA_JACK, OMEGA_BOX, VX_JACK, VY_JACK, OMEGA_JACK
_LARGEST = 1e10  # of a derivative in the scene's units: rounding, 1e-16 at first, has grown as much


def fly(scene: SceneNumbers, tangent: Array, s: float, drift: Array) -> None:
    """Take a tangent through a flight of ``s`` [s].

    ``drift`` is by how much the drive moves the box's centre and angle in that time, and their rates, shape (6,).
    """
    half, inertia, mass = 0.5 * s * s, scene.box_inertia, scene.box_mass
    for place in range(6):
        for column in range(tangent.shape[1]):
            tangent[place, column] += s * tangent[RATES + place, column]
    for column in range(tangent.shape[1]):
        torque, box_inertia = tangent[TORQUE, column], tangent[BOX_INERTIA, column]
        tangent[THETA_BOX, column] += (half * torque - drift[2] * box_inertia) / inertia
        tangent[OMEGA_BOX, column] += (s * torque - drift[5] * box_inertia) / inertia
        tangent[Y_JACK, column] -= half * tangent[GRAVITY, column]
        tangent[VY_JACK, column] -= s * tangent[GRAVITY, column]
        tangent[X_BOX, column] -= drift[0] / mass * tangent[BOX_MASS, column]
        tangent[Y_BOX, column] -= drift[1] / mass * tangent[BOX_MASS, column]
        tangent[VX_BOX, column] -= drift[3] / mass * tangent[BOX_MASS, column]
        tangent[VY_BOX, column] -= drift[4] / mass * tangent[BOX_MASS, column]


def accelerate(scene: SceneNumbers, hit: Array, rates: Array, s: float) -> None:
    """Change six rates by what ``s`` [s] of the accelerations at an impact, a row of a wide log, do."""
    rates[X_BOX] += hit[DRIVEN_THERE + 1] * s
    rates[Y_BOX] += hit[DRIVEN_THERE + 2] * s
    rates[THETA_BOX] += hit[DRIVEN_THERE] * s
    rates[Y_JACK] -= scene.gravity * s


def lateness(gap: float, rate: float) -> float:
    """By how much later a gap closes that is wider by ``gap`` [m] and changes at ``rate`` [m/s]: -dg / (Dg f-) [s]."""
    return -gap / rate


def locate(scene: SceneNumbers, hit: Array, memory: Workspace) -> float:
    """Write the state just before an impact, a row of a wide log, to ``memory.before``, and its gradient to the first.

    The search ends where the gap is within the tolerance. Returns by how much later it is 0 [s]: there the state is.
    """
    at, row = memory.before, memory.gradients[0]
    for place in range(12):
        at[place] = hit[AT_IMPACT + place]
    gap = gradient(scene, frame_of(at), int(hit[1]), int(hit[2]), row)
    later = lateness(gap, rate_of(at, row))
    for place in range(6):
        at[place] += at[RATES + place] * later
    accelerate(scene, hit, at[RATES:], later)
    gradient(scene, frame_of(at), int(hit[1]), int(hit[2]), row)
    return later


def saltate(scene: SceneNumbers, tangent: Array, hit: Array, memory: Workspace) -> None:
    """Take a tangent, and the state in ``memory.before``, through an impact that :func:`locate` has found."""
    at, row = memory.before, memory.gradients[0]
    frame, rate = frame_of(at), rate_of(at, row)
    nx, ny, box_arm, jack_arm = row[X_BOX], row[Y_BOX], row[THETA_BOX], row[THETA_JACK]
    depth = nx * frame.x + ny * frame.y
    extent = scene.box_half_width - depth  # of the foot from the jack's centre, along the normal
    vx, vy, omega, spin = at[VX_JACK] - at[VX_BOX], at[VY_JACK] - at[VY_BOX], at[OMEGA_BOX], at[OMEGA_JACK]
    yielding = 1.0 / scene.box_mass + 1.0 / scene.jack_mass
    yielding += box_arm * box_arm / scene.box_inertia + jack_arm * jack_arm / scene.jack_inertia
    back = 1.0 + scene.restitution
    push, after = -back * rate / yielding, memory.rates
    for place in range(6):
        after[place] = at[RATES + place]
    kick(scene, after, row, push)
    for c in range(tangent.shape[1]):
        d = tangent[:, c]
        wider = d[HALF_WIDTH] - extent / scene.jack_arm * d[JACK_ARM]
        closing = (
            nx * (d[X_BOX] - d[X_JACK])
            + ny * (d[Y_BOX] - d[Y_JACK])
            + box_arm * d[THETA_BOX]
            + jack_arm * d[THETA_JACK]
            + wider
        )
        later = d[LATER] = lateness(closing, rate)
        # To the moment of impact.
        for place in range(6):
            d[place] += at[RATES + place] * later
        accelerate(scene, hit, d[RATES:], later)
        # Through the law there.
        dx, dy, angle = d[X_JACK] - d[X_BOX], d[Y_JACK] - d[Y_BOX], d[THETA_BOX]
        turn_x, turn_y = -ny * angle, nx * angle  # of the normal
        lever = extent * (d[THETA_JACK] - angle) + jack_arm / scene.jack_arm * d[JACK_ARM]
        box_lever = -(nx * dy - ny * dx - depth * angle) - lever
        faster = (
            nx * (d[VX_BOX] - d[VX_JACK])
            + ny * (d[VY_BOX] - d[VY_JACK])
            + box_arm * d[OMEGA_BOX]
            + jack_arm * d[OMEGA_JACK]
        )
        faster += box_lever * omega + lever * spin - turn_x * vx - turn_y * vy
        box_mass, jack_mass = d[BOX_MASS] / scene.box_mass, d[JACK_MASS] / scene.jack_mass  # relative changes
        box_inertia, jack_inertia = d[BOX_INERTIA] / scene.box_inertia, d[JACK_INERTIA] / scene.jack_inertia
        softer = box_arm * (2.0 * box_lever - box_arm * box_inertia) / scene.box_inertia
        softer += jack_arm * (2.0 * lever - jack_arm * jack_inertia) / scene.jack_inertia
        softer -= box_mass / scene.box_mass + jack_mass / scene.jack_mass
        harder = -(back * faster + d[RESTITUTION] * rate + push * softer) / yielding
        d[VX_BOX] += (turn_x * push + nx * (harder - push * box_mass)) / scene.box_mass
        d[VY_BOX] += (turn_y * push + ny * (harder - push * box_mass)) / scene.box_mass
        d[OMEGA_BOX] += (box_lever * push + box_arm * (harder - push * box_inertia)) / scene.box_inertia
        d[VX_JACK] -= (turn_x * push + nx * (harder - push * jack_mass)) / scene.jack_mass
        d[VY_JACK] -= (turn_y * push + ny * (harder - push * jack_mass)) / scene.jack_mass
        d[OMEGA_JACK] += (lever * push + jack_arm * (harder - push * jack_inertia)) / scene.jack_inertia
        # And back, with the rates after it.
        for place in range(6):
            d[place] -= after[place] * later
        accelerate(scene, hit, d[RATES:], -later)
    for place in range(6):
        at[RATES + place] = after[place]


def drifted(plan: Plan, alpha: float, before: Array, after: Array, s: float, drift: Array) -> None:
    """Write what the drive has done to the box between two states, ``s`` [s] apart and without an impact between."""
    for place in range(6):
        drift[place] = 0.0
    if plan.kind == CONSTANT or plan.kind == CONSTANT_BESIDE_FORCES:
        drift[2], drift[5] = 0.5 * alpha * s * s, alpha * s
    else:
        drift[2] = after[THETA_BOX] - before[THETA_BOX] - before[OMEGA_BOX] * s
        drift[5] = after[OMEGA_BOX] - before[OMEGA_BOX]
    if plan.kind == FUNCTIONS or plan.kind == CONSTANT_BESIDE_FORCES:
        for place in range(2):
            drift[place] = after[place] - before[place] - before[RATES + place] * s
            drift[3 + place] = after[RATES + place] - before[RATES + place]


def step_tangent(
    scene: SceneNumbers, plan: Plan, torque: float, before: Array, after: Array, hits: Array, by_time: Array,
    tangent: Array, memory: Workspace,
) -> None:  # fmt: skip
    """Take a tangent through a step from one state to the next.

    ``hits`` are the step's rows of a wide log, ``by_time`` is for how much later each of them comes, shape (hits or 0,
    columns).
    """
    alpha, since, state, drift = torque / scene.box_inertia, 0.0, memory.state, memory.drift
    start(plan, before, memory)
    end = memory.after
    for place in range(6):
        end[place], end[RATES + place] = state[place] + (after[place] - before[place]), after[RATES + place]
    for number in range(hits.shape[0]):
        hit = hits[number]
        time = hit[0] + locate(scene, hit, memory)
        drifted(plan, alpha, state, memory.before, time - since, drift)
        fly(scene, tangent, time - since, drift)
        saltate(scene, tangent, hit, memory)
        for place in range(12):
            state[place] = memory.before[place]
        since = time
        for column in range(by_time.shape[1] if number < by_time.shape[0] else 0):
            by_time[number, column] = tangent[LATER, column]
    drifted(plan, alpha, state, end, plan.dt - since, drift)
    fly(scene, tangent, plan.dt - since, drift)


class Played(NamedTuple):
    """A rollout, as all of the functions below take it, in this order."""

    values: Array  # numbers of the scenes, shape (1 or N, numbers of a scene)
    kinds: Counts  # what turns the box in each of them
    dt: float  # [s]
    torques: Array  # [N m], shape (N, whole part of H)
    trajectories: Array  # (N, H + 1, 12)
    hits: Array  # rows of a wide log
    begins: Counts  # where those of each step begin, and past the last one's, shape (N H + 1,)
    smooth: Flags  # which steps have a derivative, shape (N, H)


RolloutData = tuple[Array, Counts, float, Array, Array, Array, Counts, Flags]


def rollout_of(given: RolloutData) -> Played:
    """The rollout of a tuple."""
    return Played(given[0], given[1], given[2], given[3], given[4], given[5], given[6], given[7])


def scene_of(played: Played, i: int) -> tuple[SceneNumbers, Plan]:
    """Scene and plan of a row."""
    own = i if played.values.shape[0] > 1 else 0
    scene = make_numbers(played.values[own])
    return scene, make_plan(scene, played.dt, played.kinds[own])


def torque_of(played: Played, k: int) -> int:
    """Number of the torque that is held in step ``k``."""
    return int(k // max(1, played.smooth.shape[1] // max(1, played.torques.shape[1])))


def rows_of(played: Played, i: int, k: int) -> tuple[int, int]:
    """The first of the log's rows of a step, and past the last."""
    number = i * played.smooth.shape[1] + k
    return played.begins[number], played.begins[number + 1]


def flies(played: Played, i: int, k: int) -> bool:
    """Whether a step has a derivative and no impact."""
    first, last = rows_of(played, i, k)
    return bool(played.smooth[i, k] and first == last)


def touching(scene: SceneNumbers, plan: Plan, state: Array, row: Array) -> int:
    """How feet touch walls: ``CLEAR``, or the worst of ``LEAVING``, ``OUTSIDE`` and leaving, ``APPROACHING``."""
    x, y = state[X_JACK] - state[X_BOX], state[Y_JACK] - state[Y_BOX]
    room = scene.box_half_width * (1.0 - 1e-12) - scene.jack_arm
    near = touch_of(plan, state).together
    if room > near and x * x + y * y < (room - near) * (room - near):
        return CLEAR
    frame, found = frame_of(state), CLEAR
    for wall in range(4):
        for foot in range(4):
            gap = gradient(scene, frame, wall, foot, row)
            if gap <= near:
                slow = rate_of(state, row) < SLOW * scene.speed_scale
                found = max(found, APPROACHING if slow else OUTSIDE if gap < -near else LEAVING)
    return found


def grazes(scene: SceneNumbers, plan: Plan, hit: Array, memory: Workspace) -> bool:
    """Whether an impact, a row of a wide log, is so slow for how its gap bends that rounding decides the derivative.

    Rounding moves the place of the impact, and so changes its rate by as much again as the gap's second derivative
    times the rounding over the rate.
    """
    at, row, free = memory.before, memory.gradients[0], memory.free
    locate(scene, hit, memory)
    frame, rate = frame_of(at), rate_of(at, row)
    for place in range(6):
        free[place] = 0.0
    accelerate(scene, hit, free, 1.0)
    bent = bend(scene, at, frame, row, 0.0)
    for place in range(6):
        bent += row[place] * free[place]
    return bool(abs(bent) * _ROUNDING * touch_of(plan, at).together > _GRAZE * rate * rate)


def mark_smooth(given: RolloutData, rough: Flags, tangent: Array, workspaces: Workspaces) -> None:
    """Fill in which steps have a derivative: not ``rough``, no foot that touches at an end, and not lost in rounding.

    Args:
        given: the rollout.
        rough: steps that have none, shape (N, H).
        tangent: to work in, shape (ROWS, len(GROWING)).
        workspaces: one, to work in.
    """
    played, memory, steps = rollout_of(given), workspaces[0], rough.shape[1]
    row, none = memory.gradients[0], played.torques[:0]
    for i in range(rough.shape[0]):
        scene, plan = scene_of(played, i)
        before = touching(scene, plan, played.trajectories[i, 0], row)
        for k in range(steps):
            after = touching(scene, plan, played.trajectories[i, k + 1], row)
            first, last = rows_of(played, i, k)
            at_ends = before == APPROACHING or after == APPROACHING
            if last > first:  # a foot that strikes as the step ends touches there; one that is outside strikes there
                at_ends |= before == OUTSIDE or after != CLEAR
            played.smooth[i, k] = not (rough[i, k] or at_ends)
            for hit in range(first, last if played.smooth[i, k] else first):
                if grazes(scene, plan, played.hits[hit], memory):
                    played.smooth[i, k] = False
            if played.smooth[i, k] and last > first:
                tangent[:] = 0.0
                for column in range(len(GROWING)):
                    tangent[GROWING[column], column] = 1.0
                propagate(played, scene, plan, i, k, none, tangent, memory)
                played.smooth[i, k] = largest_growth(scene, tangent) < _LARGEST
            before = after


def largest_growth(scene: SceneNumbers, tangent: Array) -> float:
    """Largest derivative by ``GROWING``, in units of L, v0 and v0 / L; NaN if one is."""
    largest = 0.0
    for row in range(12):
        for column in range(len(GROWING)):
            grown = abs(tangent[row, column]) * unit_of(scene, GROWING[column]) / unit_of(scene, row)
            largest = grown if not grown <= largest else largest
    return largest


def unit_of(scene: SceneNumbers, place: int) -> float:
    """The scene's unit of a number of the state: L, 1 rad, v0 or v0 / L."""
    length = scene.box_half_width if place % 3 != 2 else 1.0
    return length if place < RATES else length * scene.speed_scale / scene.box_half_width


def propagate(
    played: Played,
    scene: SceneNumbers,
    plan: Plan,
    i: int,
    k: int,
    by_time: Array,
    tangent: Array,
    memory: Workspace,
) -> None:
    """Take a tangent through a step; it is NaN if there is no derivative.

    ``by_time`` is for the impacts' times, shape (rows of the log or 0, columns).
    """
    if played.smooth[i, k]:
        before, after = played.trajectories[i, k], played.trajectories[i, k + 1]
        first, last = rows_of(played, i, k)
        torque = played.torques[i, torque_of(played, k)]
        own = by_time[first:last]
        step_tangent(scene, plan, torque, before, after, played.hits[first:last], own, tangent, memory)
    else:
        tangent[:] = math.nan


def fill_identity(tangent: Array, seeds: Array) -> None:
    """Fill in the tangent of no step at all: columns of the state, the torque, and the fields of ``seeds``.

    ``seeds`` are how each field moves the scene's numbers, shape (fields, 8).
    """
    tangent[:] = 0.0
    for place in range(FIRST_FIELD):
        tangent[place, place] = 1.0
    for column in range(seeds.shape[0]):
        for place in range(seeds.shape[1]):
            tangent[GRAVITY + place, FIRST_FIELD + column] = seeds[column, place]


def matrices(
    given: RolloutData, seeds: Array, span: tuple[int, int], results: tuple[Array, Array, Array, Array], tangent: Array,
    workspaces: Workspaces,
) -> None:  # fmt: skip
    """Fill in the derivatives of all steps of some rows; NaN where there is none.

    Args:
        given: the rollout.
        seeds: of :func:`fill_identity`, shape (1 or N, F, 8).
        span: first row, past the last.
        results: derivatives by state, (N, H, 12, 12), torque, (N, H, 12), and fields, (N, H, 12, F); of the times of
            impacts by all of these, (rows of the log, 13 + F).
        tangent: to work in, shape (ROWS, 13 + F).
        workspaces: one, to work in.
    """
    played = rollout_of(given)
    by_state, by_torque, by_field, by_time = results
    for i in range(span[0], span[1]):
        scene, plan = scene_of(played, i)
        stale = True  # whether the tangent is another than that of a flight under a constant torque
        for k in range(played.smooth.shape[1]):
            same = plan.kind == CONSTANT and flies(played, i, k)
            if stale or not same or by_field.shape[3] > 0:
                fill_identity(tangent, seeds[i if seeds.shape[0] > 1 else 0])
                propagate(played, scene, plan, i, k, by_time, tangent, workspaces[0])
                stale = not same
            for row in range(12):
                for column in range(12):
                    by_state[i, k, row, column] = tangent[row, column]
                by_torque[i, k, row] = tangent[row, TORQUE]
                for column in range(by_field.shape[3]):
                    by_field[i, k, row, column] = tangent[row, FIRST_FIELD + column]


def push_forward(
    given: RolloutData, moved: tuple[Array, Array, Array], span: tuple[int, int], results: Array, tangent: Array,
    workspaces: Workspaces,
) -> None:  # fmt: skip
    """Fill in how trajectories change, shape (N, H + 1, 12), with NaN after a step that has no derivative.

    Args:
        given: the rollout.
        moved: how first states, (N, 12), torques, as they are given, and the scenes' numbers, (N, 8), change.
        span: first row, past the last.
        results: to be filled in.
        tangent: to work in, shape (ROWS, 1).
        workspaces: one, to work in.
    """
    played = rollout_of(given)
    states, torques, numbers = moved
    for i in range(span[0], span[1]):
        scene, plan = scene_of(played, i)
        for place in range(12):
            tangent[place, 0] = results[i, 0, place] = states[i, place]
        for place in range(numbers.shape[1]):
            tangent[GRAVITY + place, 0] = numbers[i, place]
        for k in range(played.smooth.shape[1]):
            tangent[TORQUE, 0] = torques[i, torque_of(played, k)]
            propagate(played, scene, plan, i, k, results[i, :0], tangent, workspaces[0])
            for place in range(12):
                results[i, k + 1, place] = tangent[place, 0]


def pull_back(
    given: RolloutData, seeds: Array, span: tuple[int, int], weights: Array, results: tuple[Array, Array, Array],
    tangent: Array, workspaces: Workspaces,
) -> None:  # fmt: skip
    """Fill in how a sum of weights times states changes with first states, torques and fields.

    Args:
        given: the rollout.
        seeds: as in :func:`matrices`.
        span: first row, past the last.
        weights: shape (N, H + 1, 12).
        results: zeros, shapes (N, 12), of the torques as they are given, and (N, F); NaN by all that acts before or in
            a step that has no derivative.
        tangent: to work in, shape (ROWS, 13 + F).
        workspaces: one, to work in.
    """
    played, memory = rollout_of(given), workspaces[0]
    by_start, by_torque, by_field = results
    steps, drift = played.smooth.shape[1], memory.drift
    for i in range(span[0], span[1]):
        scene, plan = scene_of(played, i)
        seed, pulled = seeds[i if seeds.shape[0] > 1 else 0], by_start[i]
        for place in range(12):
            pulled[place] = weights[i, steps, place]
        for k in range(steps - 1, -1, -1):
            held, weight = torque_of(played, k), 0.0
            for place in range(12):
                weight += abs(pulled[place])
            if weight == 0.0:  # nothing has been asked of what comes after
                for place in range(12):
                    pulled[place] = weights[i, k, place]
                continue
            if flies(played, i, k):
                before, after = played.trajectories[i, k], played.trajectories[i, k + 1]
                drifted(plan, played.torques[i, held] / scene.box_inertia, before, after, plan.dt, drift)
                by_torque[i, held] += fly_back(scene, pulled, plan.dt, drift, seed, by_field[i])
            else:
                fill_identity(tangent, seed)
                propagate(played, scene, plan, i, k, by_torque[:0], tangent, memory)
                by_torque[i, held] += weighed(pulled, tangent, TORQUE)
                for column in range(seed.shape[0]):
                    by_field[i, column] += weighed(pulled, tangent, FIRST_FIELD + column)
                for column in range(12):
                    memory.before[column] = weighed(pulled, tangent, column)
                for column in range(12):
                    pulled[column] = memory.before[column]
            for place in range(12):
                pulled[place] += weights[i, k, place]


def weighed(weights: Array, tangent: Array, column: int) -> float:
    """Sum of the weights times the state's rows of one column."""
    total = 0.0
    for place in range(12):
        total += weights[place] * tangent[place, column]
    return total


def fly_back(scene: SceneNumbers, weights: Array, s: float, drift: Array, seed: Array, by_field: Array) -> float:
    """Take weights of the state after a flight to those of the state before it: :func:`fly`, transposed.

    Adds to ``by_field`` what the fields do in it; returns what the torque does.
    """
    half = 0.5 * s * s
    if seed.shape[0]:
        gravity = -half * weights[Y_JACK] - s * weights[VY_JACK]
        mass = (
            drift[0] * weights[X_BOX]
            + drift[1] * weights[Y_BOX]
            + drift[3] * weights[VX_BOX]
            + drift[4] * weights[VY_BOX]
        )
        inertia = drift[2] * weights[THETA_BOX] + drift[5] * weights[OMEGA_BOX]
        for column in range(seed.shape[0]):
            by_field[column] += gravity * seed[column, 0]
            by_field[column] -= mass / scene.box_mass * seed[column, BOX_MASS - GRAVITY]
            by_field[column] -= inertia / scene.box_inertia * seed[column, BOX_INERTIA - GRAVITY]
    torque = (half * weights[THETA_BOX] + s * weights[OMEGA_BOX]) / scene.box_inertia
    for place in range(6):
        weights[RATES + place] += s * weights[place]
    return float(torque)
