"""Derivatives of whole rollouts of the exact contact model: the tangents of its steps, chained.

:func:`mark_smooth` decides which steps have a derivative. :func:`matrices` fills in the derivatives of each step,
and :func:`pull_back` chains them against the order of time. ``tangents.py`` has the law of one step.
:mod:`jackbox_env.planning.linearization` calls all of it, for ``jackbox_env.linearize``.
"""

from __future__ import annotations

import math
from typing import NamedTuple

from jackbox_env.exact.constrained import bias_acceleration
from jackbox_env.exact.contact import SLOW
from jackbox_env.exact.geometry import frame_of, gradient, rate_of
from jackbox_env.exact.step import CONSTANT, StepParameters, make_parameters, tolerances_of
from jackbox_env.exact.tangents import FIRST_FIELD, GRAVITY, TORQUE, accelerate, drifted, fly_back, locate, step_tangent
from jackbox_env.exact.workspace import Workspace, Workspaces, scene_at
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    RATES,
    THETA_BOX,
    THETA_JACK,
    VX_JACK,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
    Array,
    Counts,
    Flags,
    add_numbers,
    copy_numbers,
)

CLEAR, LEAVING, OUTSIDE, APPROACHING = range(4)  # how feet touch walls
_ROUNDING = 1e-2  # of the contact tolerance: rounding of a gap
_GRAZE = 1e-4  # share of a derivative that may be rounding
# Of a state's numbers; by those of the box's centre: the same, as both move alike.
GROWING = THETA_BOX, X_JACK, Y_JACK, THETA_JACK, OMEGA_BOX, VX_JACK, VY_JACK, OMEGA_JACK
_LARGEST = 1e10  # of a derivative in the scene's units: rounding, 1e-16 at first, has grown as much


class Played(NamedTuple):
    """A rollout of N rows and H steps."""

    values: Array  # numbers of the scenes, shape (1 or N, numbers of a scene)
    drive_kinds: Counts  # what turns the box in each of them
    dt: float  # [s]
    torques: Array  # [N m], shape (N, H / repeat)
    trajectories: Array  # (N, H + 1, 12)
    hits: Array  # rows of a wide log
    begins: Counts  # first row of each step in the log, and past the last row, shape (N H + 1,)
    smooth: Flags  # which steps have a derivative, shape (N, H)


def scene_of(played: Played, i: int) -> tuple[SceneNumbers, StepParameters]:
    """The scene of a row, and the parameters of its steps."""
    scene = scene_at(played.values, i)
    return scene, make_parameters(scene, played.dt, played.drive_kinds[i if played.values.shape[0] > 1 else 0])


def torque_index(played: Played, k: int) -> int:
    """Index of the torque in step ``k``."""
    return int(k // max(1, played.smooth.shape[1] // max(1, played.torques.shape[1])))


def rows_of(played: Played, i: int, k: int) -> tuple[int, int]:
    """The first row of a step in the log, and past the last."""
    number = i * played.smooth.shape[1] + k
    return played.begins[number], played.begins[number + 1]


def flies(played: Played, i: int, k: int) -> bool:
    """Whether a step has a derivative and no impact."""
    first, last = rows_of(played, i, k)
    return bool(played.smooth[i, k] and first == last)


def touching(scene: SceneNumbers, params: StepParameters, state: Array, row: Array) -> int:
    """How feet touch walls: ``CLEAR``, or the worst of ``LEAVING``, ``OUTSIDE`` and leaving, ``APPROACHING``."""
    x, y = state[X_JACK] - state[X_BOX], state[Y_JACK] - state[Y_BOX]
    room = scene.box_half_width * (1.0 - 1e-12) - scene.jack_arm
    resolution = tolerances_of(params, state).resolution
    if room > resolution and x * x + y * y < (room - resolution) * (room - resolution):
        return CLEAR
    frame, worst = frame_of(state), CLEAR
    for wall in range(4):
        for foot in range(4):
            gap = gradient(scene, frame, wall, foot, row)
            if gap <= resolution:
                slow = rate_of(state, row) < SLOW * scene.speed_scale
                worst = max(worst, APPROACHING if slow else OUTSIDE if gap < -resolution else LEAVING)
    return worst


def grazes(scene: SceneNumbers, params: StepParameters, hit: Array, memory: Workspace) -> bool:
    """Whether an impact, a row of a wide log, is so slow for its gap's curvature that rounding decides the derivative.

    Rounding shifts the impact, and so changes its rate by the gap's second derivative times the rounding over the rate.
    """
    at, row, free = memory.before, memory.contacts.gradients[0], memory.held.free
    locate(scene, hit, memory)
    frame, rate = frame_of(at), rate_of(at, row)
    free[:] = 0.0
    accelerate(scene, hit, free, 1.0)
    bent = bias_acceleration(scene, at, frame, row, 0.0)
    for index in range(6):
        bent += row[index] * free[index]
    return bool(abs(bent) * _ROUNDING * tolerances_of(params, at).resolution > _GRAZE * rate * rate)


def mark_smooth(played: Played, nonsmooth: Flags, tangent: Array, workspaces: Workspaces) -> None:
    """Fill in which steps have a derivative.

    A step has none if it is ``nonsmooth``, if a foot touches a wall at an end, or if rounding hides the derivative.

    Args:
        played: the rollout.
        nonsmooth: steps that have none, shape (N, H).
        tangent: scratch, shape (ROWS, len(GROWING)).
        workspaces: one, scratch.
    """
    memory, steps = workspaces[0], nonsmooth.shape[1]
    row, none = memory.contacts.gradients[0], played.torques[:0]
    for i in range(nonsmooth.shape[0]):
        scene, params = scene_of(played, i)
        before = touching(scene, params, played.trajectories[i, 0], row)
        for k in range(steps):
            after = touching(scene, params, played.trajectories[i, k + 1], row)
            first, last = rows_of(played, i, k)
            at_ends = before == APPROACHING or after == APPROACHING
            if last > first:  # a foot that strikes as the step ends touches there; one that is outside strikes there
                at_ends |= before == OUTSIDE or after != CLEAR
            played.smooth[i, k] = not (nonsmooth[i, k] or at_ends)
            for hit in range(first, last if played.smooth[i, k] else first):
                if grazes(scene, params, played.hits[hit], memory):
                    played.smooth[i, k] = False
            if played.smooth[i, k] and last > first:
                tangent[:] = 0.0
                for column in range(len(GROWING)):
                    tangent[GROWING[column], column] = 1.0
                propagate(played, scene, params, i, k, none, tangent, memory)
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


def unit_of(scene: SceneNumbers, index: int) -> float:
    """The scene's unit of a number of the state: L, 1 rad, v0 or v0 / L."""
    length = scene.box_half_width if index % 3 != 2 else 1.0
    return length if index < RATES else length * scene.speed_scale / scene.box_half_width


def propagate(
    played: Played,
    scene: SceneNumbers,
    params: StepParameters,
    i: int,
    k: int,
    by_time: Array,
    tangent: Array,
    memory: Workspace,
) -> None:
    """Propagate a tangent through a step; it becomes NaN if there is no derivative.

    ``by_time`` is filled with the time shifts of impacts, shape (rows of the log or 0, columns).
    """
    if played.smooth[i, k]:
        before, after = played.trajectories[i, k], played.trajectories[i, k + 1]
        first, last = rows_of(played, i, k)
        torque = played.torques[i, torque_index(played, k)]
        step_tangent(
            scene, params, torque, before, after, played.hits[first:last], by_time[first:last], tangent, memory
        )
    else:
        tangent[:] = math.nan


def fill_identity(tangent: Array, seeds: Array) -> None:
    """Fill in the identity: columns of the state, the torque, and the fields of ``seeds``.

    ``seeds`` are the derivatives of the scene's numbers by each field, shape (fields, 8).
    """
    tangent[:] = 0.0
    for index in range(FIRST_FIELD):
        tangent[index, index] = 1.0
    for column in range(seeds.shape[0]):
        copy_numbers(seeds.shape[1], seeds[column], tangent[GRAVITY:, FIRST_FIELD + column])


def matrices(
    played: Played, seeds: Array, span: tuple[int, int], results: tuple[Array, Array, Array, Array], tangent: Array,
    workspaces: Workspaces,
) -> None:  # fmt: skip
    """Fill in the derivatives of all steps of some rows; NaN where there is none.

    Args:
        played: the rollout.
        seeds: of :func:`fill_identity`, shape (1 or N, F, 8).
        span: first row, past the last.
        results: derivatives by state, (N, H, 12, 12), torque, (N, H, 12), and fields, (N, H, 12, F); of the times of
            impacts by all of these, (rows of the log, 13 + F).
        tangent: scratch, shape (ROWS, 13 + F).
        workspaces: one, scratch.
    """
    by_state, by_torque, by_field, by_time = results
    for i in range(span[0], span[1]):
        scene, params = scene_of(played, i)
        stale = True  # whether the tangent is not that of a flight under a constant torque
        for k in range(played.smooth.shape[1]):
            same = params.drive_kind == CONSTANT and flies(played, i, k)
            if stale or not same or by_field.shape[3] > 0:
                fill_identity(tangent, seeds[i if seeds.shape[0] > 1 else 0])
                propagate(played, scene, params, i, k, by_time, tangent, workspaces[0])
                stale = not same
            for row in range(12):
                copy_numbers(12, tangent[row], by_state[i, k, row])
                by_torque[i, k, row] = tangent[row, TORQUE]
                copy_numbers(by_field.shape[3], tangent[row, FIRST_FIELD:], by_field[i, k, row])


def pull_back(
    played: Played, seeds: Array, span: tuple[int, int], weights: Array, results: tuple[Array, Array, Array],
    tangent: Array, workspaces: Workspaces,
) -> None:  # fmt: skip
    """Fill in the derivatives of a sum of weights times states by first states, torques and fields.

    Args:
        played: the rollout.
        seeds: as in :func:`matrices`.
        span: first row, past the last.
        weights: shape (N, H + 1, 12).
        results: zeros, shapes (N, 12), (N, H / repeat) and (N, F); NaN by what acts before or in a step without a
            derivative.
        tangent: scratch, shape (ROWS, 13 + F).
        workspaces: one, scratch.
    """
    memory, (by_start, by_torque, by_field) = workspaces[0], results
    steps, drift = played.smooth.shape[1], memory.drift
    for i in range(span[0], span[1]):
        scene, params = scene_of(played, i)
        seed, pulled = seeds[i if seeds.shape[0] > 1 else 0], by_start[i]
        copy_numbers(12, weights[i, steps], pulled)
        for k in range(steps - 1, -1, -1):
            knot, weight = torque_index(played, k), 0.0
            for index in range(12):
                weight += abs(pulled[index])
            if weight == 0.0:  # later states have no weight
                copy_numbers(12, weights[i, k], pulled)
                continue
            if flies(played, i, k):
                before, after = played.trajectories[i, k], played.trajectories[i, k + 1]
                drifted(params, played.torques[i, knot] / scene.box_inertia, before, after, params.dt, drift)
                by_torque[i, knot] += fly_back(scene, pulled, params.dt, drift, seed, by_field[i])
            else:
                fill_identity(tangent, seed)
                propagate(played, scene, params, i, k, by_torque[:0], tangent, memory)
                by_torque[i, knot] += vjp_column(pulled, tangent, TORQUE)
                for column in range(seed.shape[0]):
                    by_field[i, column] += vjp_column(pulled, tangent, FIRST_FIELD + column)
                for column in range(12):
                    memory.before[column] = vjp_column(pulled, tangent, column)
                copy_numbers(12, memory.before, pulled)
            add_numbers(12, pulled, 1.0, weights[i, k])


def vjp_column(weights: Array, tangent: Array, column: int) -> float:
    """Scalar product of the weights and the state's rows of one column."""
    total = 0.0
    for index in range(12):
        total += weights[index] * tangent[index, column]
    return total
