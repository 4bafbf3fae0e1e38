"""Derivatives of one step of the exact contact model: :func:`step_tangent` follows its flights and impacts.

``derivatives.py`` calls it for the steps of a rollout, after ``run.py`` has recorded their impacts.
A tangent has the shape (ROWS, columns): each column is the derivative of the state by one number, and below of the
torque and the scene's parameters by that number. Flight is linear in the state and in the accelerations. At an impact,
with the time t*, the gap g, the reset R (the impact law at a fixed pose) and the flow f before and after, a tangent d
becomes

    d+ = (DR + (f+ - DR f-) Dg / (Dg f-)) d,

the saltation matrix (Aizerman and Gantmakher 1958; Kong et al. 2024, "Saltation Matrices", Proceedings of the IEEE). It
is applied as it is derived: to the moment of impact, dt* = -Dg d / (Dg f-), through the law there, and back.

Exactness: rounding of the states and of the impacts' times, over the impact's rate.
Fails: several contacts at one moment, an impact slower than 1e-6 v0 or so slow for its gap's curvature that rounding
    decides, feet at rest, a foot that touches at an end of a step, a step whose impacts multiply errors by 1e10. There
    no derivative exists, or rounding hides it: it is NaN. Under a drive, derivatives with respect to the box's mass and
    inertia come from differences of states, with the rounding of positions and angles that are far from 0.
"""

from __future__ import annotations

from jackbox_env.exact.contact import inverse_mass, kick
from jackbox_env.exact.geometry import Frame, frame_of, gradient, rate_of
from jackbox_env.exact.step import CONSTANT, CONSTANT_BESIDE_FORCES, FUNCTIONS, StepParameters, enter_frame
from jackbox_env.exact.workspace import AT_IMPACT, DRIVEN_THERE, Workspace
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
    add_numbers,
    copy_numbers,
)

# Rows of a tangent below the state's 12: a torque added throughout the step, and the scene's parameters.
FIELDS = (
    "gravity", "box_mass", "box_inertia", "jack_mass", "jack_inertia", "jack_arm", "box_half_width", "restitution",
)  # fmt: skip
TORQUE = 12
GRAVITY, BOX_MASS, BOX_INERTIA, JACK_MASS, JACK_INERTIA, JACK_ARM, HALF_WIDTH, RESTITUTION = range(13, 21)
IMPACT_TIME_SHIFT = 21  # of the last impact, positive if it comes later [s]
ROWS = 22
FIRST_FIELD = 13  # column


def fly_tangent(scene: SceneNumbers, tangent: Array, s: float, drift: Array) -> None:
    """Propagate a tangent through a flight of ``s`` [s].

    ``drift`` is the change of the box's centre and angle by the drive in that time, and of their rates, shape (6,).
    """
    half, inertia, mass = 0.5 * s * s, scene.box_inertia, scene.box_mass
    for index in range(6):
        for column in range(tangent.shape[1]):
            tangent[index, column] += s * tangent[RATES + index, column]
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


def fly_back(scene: SceneNumbers, weights: Array, s: float, drift: Array, seed: Array, by_field: Array) -> float:
    """Pull weights of the state after a flight back to the state before it: :func:`fly_tangent`, transposed.

    Adds the derivatives by the fields to ``by_field``; returns that by the torque.
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
    add_numbers(6, weights[RATES:], s, weights)
    return float(torque)


def accelerate(scene: SceneNumbers, hit: Array, rates: Array, s: float) -> None:
    """Change the six velocities ``rates`` by ``s`` [s] of the accelerations at an impact, a row of a wide log."""
    rates[X_BOX] += hit[DRIVEN_THERE + 1] * s
    rates[Y_BOX] += hit[DRIVEN_THERE + 2] * s
    rates[THETA_BOX] += hit[DRIVEN_THERE] * s
    rates[Y_JACK] -= scene.gravity * s


def impact_time_shift(gap: float, rate: float) -> float:
    """Time shift of an impact whose gap is wider by ``gap`` [m] and changes at ``rate`` [m/s]: -dg / (Dg f-) [s]."""
    return -gap / rate


def locate(scene: SceneNumbers, hit: Array, memory: Workspace) -> float:
    """Write the state at an impact, a row of a wide log, to ``memory.before``, and the gap's gradient to the first row.

    The search ends with a gap within the tolerance. Returns the time from there until the gap is 0 [s]; the state is
    that of then.
    """
    at, row = memory.before, memory.contacts.gradients[0]
    copy_numbers(12, hit[AT_IMPACT:], at)
    gap = gradient(scene, frame_of(at), int(hit[1]), int(hit[2]), row)
    shift = impact_time_shift(gap, rate_of(at, row))
    add_numbers(6, at, shift, at[RATES:])
    accelerate(scene, hit, at[RATES:], shift)
    gradient(scene, frame_of(at), int(hit[1]), int(hit[2]), row)
    return shift


def saltate(scene: SceneNumbers, tangent: Array, hit: Array, memory: Workspace) -> None:
    """Propagate a tangent, and the state in ``memory.before``, through an impact that :func:`locate` has located."""
    at, row = memory.before, memory.contacts.gradients[0]
    frame, rate, inverse_effective_mass = frame_of(at), rate_of(at, row), inverse_mass(scene, row)
    extent = scene.box_half_width - (row[X_BOX] * frame.x + row[Y_BOX] * frame.y)  # of the foot along the normal
    impulse, after = -(1.0 + scene.restitution) * rate / inverse_effective_mass, memory.contacts.rates
    copy_numbers(6, at[RATES:], after)
    kick(scene, after, row, impulse)
    for column in range(tangent.shape[1]):
        d = tangent[:, column]
        wider = d[HALF_WIDTH] - extent / scene.jack_arm * d[JACK_ARM]
        shift = d[IMPACT_TIME_SHIFT] = impact_time_shift(gap_change(d, row) + wider, rate)
        # To the moment of impact, through the law there, and back with the velocities after it.
        add_numbers(6, d, shift, at[RATES:])
        accelerate(scene, hit, d[RATES:], shift)
        change_rates(scene, at, row, frame, rate, impulse, inverse_effective_mass, d)
        add_numbers(6, d, -shift, after)
        accelerate(scene, hit, d[RATES:], -shift)
    copy_numbers(6, after, at[RATES:])


def gap_change(d: Array, row: Array) -> float:
    """The change of a gap with the gradient J in ``row`` by the coordinates of a tangent's column: J d."""
    return float(
        row[X_BOX] * (d[X_BOX] - d[X_JACK])
        + row[Y_BOX] * (d[Y_BOX] - d[Y_JACK])
        + row[THETA_BOX] * d[THETA_BOX]
        + row[THETA_JACK] * d[THETA_JACK]
    )


def change_rates(
    scene: SceneNumbers,
    at: Array,
    row: Array,
    frame: Frame,
    rate: float,
    impulse: float,
    inverse_effective_mass: float,
    d: Array,
) -> None:
    """Propagate a column of a tangent through the impact law at a fixed moment: change its velocities.

    Args:
        scene: the scene.
        at: state before the impact.
        row: the gap's gradient J.
        frame: of that state.
        rate: of the gap [m/s].
        impulse: of the impact [N s].
        inverse_effective_mass: J M^-1 J^T.
        d: the column, already at the moment of impact.
    """
    nx, ny, box_arm, jack_arm = row[X_BOX], row[Y_BOX], row[THETA_BOX], row[THETA_JACK]
    depth = nx * frame.x + ny * frame.y
    extent = scene.box_half_width - depth  # of the foot from the jack's centre, along the normal
    vx, vy = at[VX_JACK] - at[VX_BOX], at[VY_JACK] - at[VY_BOX]
    dx, dy, angle = d[X_JACK] - d[X_BOX], d[Y_JACK] - d[Y_BOX], d[THETA_BOX]
    turn_x, turn_y = -ny * angle, nx * angle  # of the normal
    lever = extent * (d[THETA_JACK] - angle) + jack_arm / scene.jack_arm * d[JACK_ARM]
    box_lever = -(nx * dy - ny * dx - depth * angle) - lever
    d_gap_rate = rate_of(d, row)
    d_gap_rate += box_lever * at[OMEGA_BOX] + lever * at[OMEGA_JACK] - turn_x * vx - turn_y * vy
    box_mass, jack_mass = d[BOX_MASS] / scene.box_mass, d[JACK_MASS] / scene.jack_mass  # relative changes
    box_inertia, jack_inertia = d[BOX_INERTIA] / scene.box_inertia, d[JACK_INERTIA] / scene.jack_inertia
    d_inverse_mass = (
        box_arm * (2.0 * box_lever - box_arm * box_inertia) / scene.box_inertia
        + jack_arm * (2.0 * lever - jack_arm * jack_inertia) / scene.jack_inertia
        - (box_mass / scene.box_mass + jack_mass / scene.jack_mass)
    )
    d_impulse = (
        -((1.0 + scene.restitution) * d_gap_rate + d[RESTITUTION] * rate + impulse * d_inverse_mass)
        / inverse_effective_mass
    )
    d[VX_BOX] += (turn_x * impulse + nx * (d_impulse - impulse * box_mass)) / scene.box_mass
    d[VY_BOX] += (turn_y * impulse + ny * (d_impulse - impulse * box_mass)) / scene.box_mass
    d[OMEGA_BOX] += (box_lever * impulse + box_arm * (d_impulse - impulse * box_inertia)) / scene.box_inertia
    d[VX_JACK] -= (turn_x * impulse + nx * (d_impulse - impulse * jack_mass)) / scene.jack_mass
    d[VY_JACK] -= (turn_y * impulse + ny * (d_impulse - impulse * jack_mass)) / scene.jack_mass
    d[OMEGA_JACK] += (lever * impulse + jack_arm * (d_impulse - impulse * jack_inertia)) / scene.jack_inertia


def drifted(params: StepParameters, alpha: float, before: Array, after: Array, s: float, drift: Array) -> None:
    """Write the change of the box by the drive between two states, ``s`` [s] apart without an impact in between."""
    drift[:] = 0.0
    if params.drive_kind == CONSTANT or params.drive_kind == CONSTANT_BESIDE_FORCES:
        drift[2], drift[5] = 0.5 * alpha * s * s, alpha * s
    else:
        drift[2] = after[THETA_BOX] - before[THETA_BOX] - before[OMEGA_BOX] * s
        drift[5] = after[OMEGA_BOX] - before[OMEGA_BOX]
    if params.drive_kind == FUNCTIONS or params.drive_kind == CONSTANT_BESIDE_FORCES:
        for index in range(2):
            drift[index] = after[index] - before[index] - before[RATES + index] * s
            drift[3 + index] = after[RATES + index] - before[RATES + index]


def step_tangent(
    scene: SceneNumbers, params: StepParameters, torque: float, before: Array, after: Array, hits: Array,
    by_time: Array, tangent: Array, memory: Workspace,
) -> None:  # fmt: skip
    """Propagate a tangent through a step from one state to the next.

    ``hits`` are the step's rows of a wide log. ``by_time`` is filled with the time shift of each, shape (hits or 0,
    columns).
    """
    alpha, since, state, drift = torque / scene.box_inertia, 0.0, memory.state, memory.drift
    enter_frame(params, before, memory)
    end = memory.after
    for index in range(6):
        end[index], end[RATES + index] = state[index] + (after[index] - before[index]), after[RATES + index]
    for number in range(hits.shape[0]):
        hit = hits[number]
        time = hit[0] + locate(scene, hit, memory)
        drifted(params, alpha, state, memory.before, time - since, drift)
        fly_tangent(scene, tangent, time - since, drift)
        saltate(scene, tangent, hit, memory)
        copy_numbers(12, memory.before, state)
        since = time
        for column in range(by_time.shape[1] if number < by_time.shape[0] else 0):
            by_time[number, column] = tangent[IMPACT_TIME_SHIFT, column]
    drifted(params, alpha, state, end, params.dt - since, drift)
    fly_tangent(scene, tangent, params.dt - since, drift)
