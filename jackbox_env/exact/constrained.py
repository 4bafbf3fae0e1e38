"""The motion of box and jack while walls hold feet: power series in time. ``rest.advance_held`` calls it.

A held foot's gap is a constraint of the Lagrangian motion

    M qddot = f + J^T lambda,    J qddot + Jdot qdot = 0.

It is written on the box's axes. (X, Y) is the jack's centre, psi its angle relative to the box, omega and alpha are the
box's angular velocity and acceleration, n is a wall's normal, l E and l D are a foot's extent along n and across it:

    X'' = 2 omega Y' + omega^2 X + alpha Y + gravity and side force - (1/m_b + 1/m_j) sum n_x lambda,
    Y'' = -2 omega X' + omega^2 Y - alpha X + gravity and side force - (1/m_b + 1/m_j) sum n_y lambda,
    J_b alpha = torque + sum a lambda,    J_j (psi'' + alpha) = sum b lambda,    a = -n^perp . (X, Y) - b,    b = l D,
    gap'' = -n . (X'', Y'') + b psi'' + l E psi'^2 = 0.

Method: these are sums and products, and cosines that obey c' = -s psi', so each power of time follows from those before
it (Taylor's method; Jorba and Zou 2005, Experimental Mathematics 14, 99). Powers are of u = s / T in [0, 1] over a
stretch of T [s], velocities are per unit of u. Walls do not move the common centre of mass.
Order: 12 in the accelerations; a stretch is halved until its last powers are rounding.
Cost: some 2 microseconds a stretch, which is a whole control step unless something turns fast.
"""

from __future__ import annotations

import math

from jackbox_env.exact.flight import (
    DEGREE,
    PUSH_X,
    PUSH_Y,
    RECIPROCALS,
    TURN,
    Flight,
    Piece,
    excursion,
    held_view,
    horner,
)
from jackbox_env.exact.geometry import Frame, View, cos_sin, on_axes, quarter
from jackbox_env.exact.workspace import (
    ALPHA,
    BOX_COSINE,
    BOX_LEVER,
    BOX_SINE,
    COSINE,
    DRIVEN,
    EXTENT,
    FORCE,
    JACK_ALPHA,
    JACK_LEVER,
    OMEGA,
    OMEGA_SQUARED,
    POSITION_X,
    POSITION_Y,
    PSI,
    PUSHED_X,
    PUSHED_Y,
    RATE_X,
    RATE_Y,
    SINE,
    SPIN,
    SPIN_SQUARED,
    TURNED,
    HeldFeet,
    Workspace,
)
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
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
    copy_numbers,
)

_RESOLVED = 1e-15  # last powers of the velocities, over a speed


def product(series: Array, one: int, other: int, k: int, first: int = 0) -> float:
    """Power k of the product of two series, of the first one from its power ``first`` on."""
    total = 0.0
    for j in range(first, k + 1):
        total += series[one, j] * series[other, k - j]
    return total


def drive_series(memory: Workspace, piece: Piece, since: float, length: float) -> None:
    """Fill in the accelerations of the box by the drive, from ``since`` [s] after the piece's start on."""
    series = memory.held.series
    series[DRIVEN : PUSHED_Y + 1] = 0.0
    series[DRIVEN, 0] = piece.alpha * length * length
    if piece.curved:
        shift(memory, TURN, DRIVEN, piece, since, length)
    if piece.pushed:
        shift(memory, PUSH_X, PUSHED_X, piece, since, length)
        shift(memory, PUSH_Y, PUSHED_Y, piece, since, length)


def shift(memory: Workspace, axis: int, row: int, piece: Piece, since: float, length: float) -> None:
    """Write a piece's polynomial acceleration as powers of the time since another moment (Horner's scheme)."""
    series = memory.held.series
    start, share = 2.0 * since / piece.length - 1.0, 2.0 * length / piece.length
    copy_numbers(DEGREE + 1, memory.powers[3 * axis], series[row])
    for i in range(DEGREE):
        for j in range(DEGREE - 1, i - 1, -1):
            series[row, j] += start * series[row, j + 1]
    scale = length * length
    for k in range(DEGREE + 1):
        series[row, k] *= scale
        scale *= share


def begin(series: Array, view: View, angle: float, omega: float, psi: float, length: float) -> None:
    """Fill in the lowest powers."""
    frame = view.frame
    series[POSITION_X, 0], series[POSITION_Y, 0] = frame.x, frame.y
    series[PSI, 0], series[TURNED, 0] = psi, 0.0
    series[RATE_X, 0], series[RATE_Y, 0] = frame.vx * length, frame.vy * length
    series[SPIN, 0], series[OMEGA, 0] = view.spin * length, omega * length
    for index in range(4):
        series[POSITION_X + index, 1] = series[RATE_X + index, 0]
    series[COSINE, 0], series[SINE, 0] = view.cosine, view.sine
    series[BOX_COSINE, 0], series[BOX_SINE, 0] = cos_sin(angle)


def expand(scene: SceneNumbers, memory: Workspace, length: float, pushed: bool) -> None:
    """Fill in all powers, from the lowest and the drive's, for a stretch of ``length`` [s].

    The inverse of J M^-1 J^T at its start is in ``held.inverse``.
    """
    series = memory.held.series
    count, gravity = memory.held.holding, scene.gravity * length * length
    pliancy = 1.0 / scene.box_mass + 1.0 / scene.jack_mass
    for k in range(DEGREE + 1):
        series[OMEGA_SQUARED, k] = product(series, OMEGA, OMEGA, k)
        series[SPIN_SQUARED, k] = product(series, SPIN, SPIN, k)
        x = (
            2.0 * product(series, OMEGA, RATE_Y, k) + product(series, OMEGA_SQUARED, POSITION_X, k)
            - gravity * series[BOX_SINE, k]
        )  # fmt: skip
        y = (
            -2.0 * product(series, OMEGA, RATE_X, k) + product(series, OMEGA_SQUARED, POSITION_Y, k)
            - gravity * series[BOX_COSINE, k]
        )  # fmt: skip
        if pushed:
            x -= product(series, BOX_COSINE, PUSHED_X, k) + product(series, BOX_SINE, PUSHED_Y, k)
            y -= product(series, BOX_COSINE, PUSHED_Y, k) - product(series, BOX_SINE, PUSHED_X, k)
        solve_forces(scene, memory, count, k, x, y)
        for contact in range(count):
            n_x, n_y = quarter(1.0, 0.0, memory.contacts.pairs[contact] // 4)
            x -= pliancy * n_x * series[FORCE + contact, k]
            y -= pliancy * n_y * series[FORCE + contact, k]
        share, later = RECIPROCALS[k], RECIPROCALS[k + 1]
        series[RATE_X, k + 1] = share * (x + product(series, ALPHA, POSITION_Y, k))
        series[RATE_Y, k + 1] = share * (y - product(series, ALPHA, POSITION_X, k))
        series[SPIN, k + 1] = share * (series[JACK_ALPHA, k] - series[ALPHA, k])
        for index in range(3):
            series[POSITION_X + index, k + 2] = later * series[RATE_X + index, k + 1]
        turn(series, k)
        series[COSINE, k + 1] = -share * product(series, SINE, SPIN, k)
        series[SINE, k + 1] = share * product(series, COSINE, SPIN, k)


def solve_forces(scene: SceneNumbers, memory: Workspace, count: int, k: int, x: float, y: float) -> None:
    """Fill in power k of the forces at held feet, and of the resulting angular accelerations.

    ``x`` and ``y`` are power k of the relative acceleration without forces and without alpha.
    """
    held = memory.held
    series = held.series
    box = jack = 0.0
    for contact in range(count):
        write_levers(scene, memory, contact, k)
        box += product(series, BOX_LEVER + contact, FORCE + contact, k, 1)
        jack += product(series, JACK_LEVER + contact, FORCE + contact, k, 1)
    series[ALPHA, k] = series[DRIVEN, k] + box / scene.box_inertia
    series[JACK_ALPHA, k] = jack / scene.jack_inertia
    for contact in range(count):
        n_x, n_y = quarter(1.0, 0.0, memory.contacts.pairs[contact] // 4)
        held.rhs[contact] = (
            n_x * x + n_y * y - product(series, EXTENT + contact, SPIN_SQUARED, k)
            - (product(series, BOX_LEVER + contact, ALPHA, k) + product(series, JACK_LEVER + contact, JACK_ALPHA, k))
        )  # fmt: skip
    solve(scene, held, count, k)


def write_levers(scene: SceneNumbers, memory: Workspace, contact: int, k: int) -> None:
    """Fill in power k of a held foot's levers and extent."""
    series = memory.held.series
    wall, foot = memory.contacts.pairs[contact] // 4, memory.contacts.pairs[contact] % 4
    along, across = quarter(series[COSINE, k], series[SINE, k], foot - wall)
    _, aside = quarter(series[POSITION_X, k], -series[POSITION_Y, k], wall)  # -n^perp . (X, Y)
    series[EXTENT + contact, k], series[JACK_LEVER + contact, k] = scene.jack_arm * along, scene.jack_arm * across
    series[BOX_LEVER + contact, k] = aside - series[JACK_LEVER + contact, k]


def invert(memory: Workspace, count: int) -> None:
    """Fill in (J M^-1 J^T)^-1 = R^-1 R^-T, from R = triangle times lengths of the contacts."""
    contacts, held = memory.contacts, memory.held
    for a in range(count):
        for b in range(a + 1):
            held.column[b] = 1.0 if a == b else 0.0
        for b in range(a, -1, -1):  # column a of R^-1
            for c in range(b + 1, a + 1):
                held.column[b] -= contacts.triangle[b, c] * contacts.lengths[c] * held.column[c]
            held.column[b] /= contacts.triangle[b, b] * contacts.lengths[b]
        for b in range(a + 1):
            for c in range(a + 1):
                before = held.inverse[b, c] if b < a and c < a else 0.0
                held.inverse[b, c] = before + held.column[b] * held.column[c]


def solve(scene: SceneNumbers, held: HeldFeet, count: int, k: int) -> None:
    """Solve power k of J qddot, in ``rhs``, for the forces; add their part of the angular accelerations."""
    series = held.series
    box, jack = 0.0, 0.0
    for contact in range(count):
        force = 0.0
        for other in range(count):
            force += held.inverse[contact, other] * held.rhs[other]
        series[FORCE + contact, k] = force
        box += series[BOX_LEVER + contact, 0] * force
        jack += series[JACK_LEVER + contact, 0] * force
    series[ALPHA, k] += box / scene.box_inertia
    series[JACK_ALPHA, k] += jack / scene.jack_inertia


def expand_rigid(scene: SceneNumbers, memory: Workspace, length: float, pushed: bool) -> None:
    """:func:`expand` for three held feet: the jack cannot move in the box and turns with it.

    Only the box's angle changes: that of a rigid body on which the weight of the jack has a lever.
    """
    held = memory.held
    series = held.series
    gravity, x0, y0 = scene.gravity * length * length, series[POSITION_X, 0], series[POSITION_Y, 0]
    for row in (POSITION_X, POSITION_Y, PSI, RATE_X, RATE_Y, SPIN):
        for k in range(0 if row >= RATE_X else 1, DEGREE + 3):
            series[row, k] = 0.0
    for contact in range(3):
        write_levers(scene, memory, contact, 0)
    for k in range(DEGREE + 1):
        squared = product(series, OMEGA, OMEGA, k)
        x, y = squared * x0 - gravity * series[BOX_SINE, k], squared * y0 - gravity * series[BOX_COSINE, k]
        if pushed:
            x -= product(series, BOX_COSINE, PUSHED_X, k) + product(series, BOX_SINE, PUSHED_Y, k)
            y -= product(series, BOX_COSINE, PUSHED_Y, k) - product(series, BOX_SINE, PUSHED_X, k)
        series[ALPHA, k], series[JACK_ALPHA, k] = series[DRIVEN, k], 0.0
        for contact in range(3):
            n_x, n_y = quarter(1.0, 0.0, memory.contacts.pairs[contact] // 4)
            held.rhs[contact] = n_x * x + n_y * y - series[BOX_LEVER + contact, 0] * series[DRIVEN, k]
        solve(scene, held, 3, k)
        turn(series, k)


def turn(series: Array, k: int) -> None:
    """Fill in the next powers of the box's rotation, from power k of its angular acceleration."""
    share = RECIPROCALS[k]
    series[OMEGA, k + 1] = share * series[ALPHA, k]
    series[TURNED, k + 2] = RECIPROCALS[k + 1] * series[OMEGA, k + 1]
    series[BOX_COSINE, k + 1] = -share * product(series, BOX_SINE, OMEGA, k)
    series[BOX_SINE, k + 1] = share * product(series, BOX_COSINE, OMEGA, k)


def stretch(scene: SceneNumbers, memory: Workspace, piece: Piece, since: float, view: View) -> float:
    """Expand the motion with held feet from ``since`` [s] after the piece's start; return how long it holds [s].

    It holds to the end of the piece, or as long as its last powers are rounding; 0 if no time is so short.
    """
    held = memory.held
    state, length = memory.state, piece.length - since
    frame = view.frame
    speed = scene.speed_scale + abs(frame.vx) + abs(frame.vy)
    speed += scene.box_half_width * abs(state[OMEGA_BOX]) + scene.jack_arm * abs(view.spin)
    turning = abs(state[OMEGA_BOX]) + abs(view.spin) + math.sqrt(piece.max_angular_acceleration)
    turning += math.sqrt((scene.gravity + piece.max_acceleration) / scene.jack_arm)
    if turning * length > 1.0:
        length = 1.0 / turning
    drive_series(memory, piece, since, length)
    begin(held.series, view, state[THETA_BOX], state[OMEGA_BOX], state[THETA_JACK] - state[THETA_BOX], length)
    invert(memory, held.holding)
    if held.holding == 3:
        expand_rigid(scene, memory, length, piece.pushed)
    else:
        expand(scene, memory, length, piece.pushed)
    memory.evaluations += DEGREE + 1.0
    while not resolved(scene, held.series, speed * length):
        length *= 0.5
        halve(held.series)
        if not since + length > since:
            return 0.0
    return length


def resolved(scene: SceneNumbers, series: Array, way: float) -> bool:
    """Whether the last two powers of the velocities are below the rounding of a ``way`` [m]."""
    tail = 0.0
    for k in (DEGREE, DEGREE + 1):
        tail = max(tail, abs(series[RATE_X, k]) + abs(series[RATE_Y, k]))
        tail = max(tail, scene.box_half_width * abs(series[OMEGA, k]) + scene.jack_arm * abs(series[SPIN, k]))
    return bool(tail <= _RESOLVED * way)


def halve(series: Array) -> None:
    """Halve the stretch: scale the powers and velocities, which are per stretch."""
    share = 1.0
    for k in range(DEGREE + 3):
        for index in range(4):
            series[POSITION_X + index, k] *= share
            series[RATE_X + index, k] *= 0.5 * share
        for index in range(3):
            series[FORCE + index, k] *= 0.25 * share
        share *= 0.5


def curvature_while_held(scene: SceneNumbers, series: Array, length: float) -> float:
    """Bound of a gap's second derivative over a stretch of ``length`` [s], from the powers [m/s^2]."""
    x, y, spin, max_angular_acceleration = 0.0, 0.0, abs(series[SPIN, 0]), 0.0
    for k in range(1, DEGREE + 2):
        x += k * abs(series[RATE_X, k])
        y += k * abs(series[RATE_Y, k])
        spin += abs(series[SPIN, k])
        max_angular_acceleration += k * abs(series[SPIN, k])
    bound = max(x, y) + scene.jack_arm * (spin * spin + max_angular_acceleration)
    return float(bound * (1.0 + 1e-12) / (length * length))


def carry(scene: SceneNumbers, memory: Workspace, flight: Flight, free: Flight, s: float) -> None:
    """Move the state ``s`` [s] along a stretch with held feet; ``free`` is the flight without them, for the drive.

    The common centre of mass moves under gravity and side forces alone, and the powers place box and jack about it.
    """
    series = memory.held.series
    state, u = memory.state, s / flight.half
    mass = scene.box_mass + scene.jack_mass
    share = scene.jack_mass / mass  # of the way between the centres, from the box's to the common one
    turned, omega = horner(series[TURNED], DEGREE + 2, u), horner(series[OMEGA], DEGREE + 1, u) / flight.half
    state[THETA_BOX] += turned
    state[THETA_JACK] += turned + (horner(series[PSI], DEGREE + 2, u) - series[PSI, 0])
    view = held_view(flight, memory.held, s)
    cosine, sine = cos_sin(state[THETA_BOX])
    x, y = on_axes(cosine, -sine, view.frame.x, view.frame.y)
    vx, vy = view.frame.vx - omega * view.frame.y, view.frame.vy + omega * view.frame.x
    vx, vy = on_axes(cosine, -sine, vx, vy)
    fallen, falling = -0.5 * share * scene.gravity * s * s, -share * scene.gravity * s
    drifted = drifting = 0.0
    if free.pushed:
        way, rate = excursion(memory, PUSH_X, free, s)
        drifted, drifting = (1.0 - share) * way, (1.0 - share) * rate
        way, rate = excursion(memory, PUSH_Y, free, s)
        fallen, falling = fallen + (1.0 - share) * way, falling + (1.0 - share) * rate
    common_x = state[VX_BOX] + share * (state[VX_JACK] - state[VX_BOX])
    common_y = state[VY_BOX] + share * (state[VY_JACK] - state[VY_BOX])
    state[X_BOX] += (common_x * s + drifted) - share * (x - (state[X_JACK] - state[X_BOX]))
    state[Y_BOX] += (common_y * s + fallen) - share * (y - (state[Y_JACK] - state[Y_BOX]))
    state[X_JACK], state[Y_JACK] = state[X_BOX] + x, state[Y_BOX] + y
    state[VX_BOX], state[VY_BOX] = common_x + drifting - share * vx, common_y + falling - share * vy
    state[VX_JACK], state[VY_JACK] = state[VX_BOX] + vx, state[VY_BOX] + vy
    state[OMEGA_BOX], state[OMEGA_JACK] = omega, omega + view.spin


def bias_acceleration(scene: SceneNumbers, state: Array, frame: Frame, row: Array, gap: float) -> float:
    """Jdot qdot of a gap with the gradient ``row``: its second derivative at qddot = 0 [m/s^2]."""
    nx, ny = row[X_BOX], row[Y_BOX]
    vx, vy = state[VX_JACK] - state[VX_BOX], state[VY_JACK] - state[VY_BOX]
    omega, spin = state[OMEGA_BOX], state[OMEGA_JACK] - state[OMEGA_BOX]
    depth, sideways = nx * frame.x + ny * frame.y, nx * vy - ny * vx  # n . r and n^perp . v
    along = scene.box_half_width - depth - gap  # of the foot from the jack's centre, on n
    return float(-2.0 * omega * sideways + omega * omega * depth + spin * spin * along)


def accelerations(scene: SceneNumbers, memory: Workspace, piece: Piece, since: float) -> None:
    """Fill in the accelerations of box and jack by gravity and the drive, ``since`` [s] after the piece's start."""
    u = 2.0 * since / piece.length - 1.0
    free = memory.held.free
    free[X_BOX] = free[Y_BOX] = free[X_JACK] = free[THETA_JACK] = 0.0
    free[THETA_BOX], free[Y_JACK] = piece.alpha, -scene.gravity
    if piece.curved:
        free[THETA_BOX] = horner(memory.powers[3 * TURN], DEGREE, u)
    if piece.pushed:
        free[X_BOX] = horner(memory.powers[3 * PUSH_X], DEGREE, u)
        free[Y_BOX] = horner(memory.powers[3 * PUSH_Y], DEGREE, u)
