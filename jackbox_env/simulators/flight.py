"""Flight between impacts in closed form, and a bound on how far it can bring a foot towards a wall.

Law: gravity pulls the jack with g, a lift carries the box, a torque turns the box; nothing else acts in flight.
Exactness: rounding, given the torque's averages over the step.
Fails: it ignores walls; call :func:`reach` first.
"""

from __future__ import annotations

import math
from collections.abc import Sequence

from jackbox_env.model.scene import Scene
from jackbox_env.model.states import (
    OMEGA_BOX,
    OMEGA_JACK,
    VX_BOX,
    VX_JACK,
    VY_BOX,
    VY_JACK,
    X_BOX,
    X_JACK,
    Y_BOX,
    Y_JACK,
)


def reach(scene: Scene, state: list[float], dt: float, torque_bound: float, force_bound: float) -> float:
    """Bound by how much any of the 16 gaps can shrink in flight within ``dt`` [m].

    |d gap / dt| = |n . (v_box - v_jack) - omega_box n^perp . r - (omega_jack - omega_box) n . o^perp|
                <= V + Omega D + l S
    with V, Omega, D, S upper bounds over the step of the relative speed, |omega_box|, |r|, |omega_jack - omega_box|.

    Args:
        scene: the scene.
        state: 12 numbers.
        dt: [s].
        torque_bound: upper bound of the torque on the box over the step [N m]; may be infinite.
        force_bound: upper bound of the side force on the box [N]; may be infinite.
    """
    spun_up = torque_bound * dt / scene.box_inertia
    speed = math.hypot(state[VX_JACK] - state[VX_BOX], state[VY_JACK] - state[VY_BOX])
    speed += (scene.gravity + force_bound / scene.box_mass) * dt
    distance = math.hypot(state[X_JACK] - state[X_BOX], state[Y_JACK] - state[Y_BOX]) + speed * dt
    spin = abs(state[OMEGA_JACK] - state[OMEGA_BOX]) + spun_up
    return dt * (speed + (abs(state[OMEGA_BOX]) + spun_up) * distance + scene.jack_arm * spin)


def after_flight(
    scene: Scene,
    state: list[float],
    dt: float,
    falling: float,
    rising: float,
    pushes: Sequence[tuple[float, float]] = (),
) -> list[float]:
    """Return the state after ``dt`` [s] of flight.

    ``falling`` and ``rising`` are the torque on the box over the step, averaged under a falling and under a rising
    triangle [N m]; for a held torque both are that torque. ``pushes`` are the same two averages of the side forces
    along x and y [N], or nothing where there are none.
    """
    x, y, angle, jack_x, jack_y, jack_angle, vx, vy, omega, jack_vx, jack_vy, jack_omega = state
    fall = scene.gravity * dt
    if pushes:
        (falling_x, rising_x), (falling_y, rising_y) = pushes
        pushed = 0.5 * dt / scene.box_mass
        x, y = x + pushed * falling_x * dt, y + pushed * falling_y * dt
        after = after_flight(scene, [x, y, *state[2:]], dt, falling, rising)
        after[VX_BOX] += pushed * (falling_x + rising_x)
        after[VY_BOX] += pushed * (falling_y + rising_y)
        return after
    return [
        x + vx * dt,
        y + vy * dt,
        angle + (omega + 0.5 * dt * falling / scene.box_inertia) * dt,
        jack_x + jack_vx * dt,
        jack_y + (jack_vy - 0.5 * fall) * dt,
        jack_angle + jack_omega * dt,
        vx,
        vy,
        omega + 0.5 * dt * (falling + rising) / scene.box_inertia,
        jack_vx,
        jack_vy - fall,
        jack_omega,
    ]
