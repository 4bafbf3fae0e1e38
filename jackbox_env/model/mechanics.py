"""The law of the jack in a box: state layout, gaps, impact maps and energy.

A state is 12 float64 numbers in SI units, positions q first, then their rates:

    [x_box, y_box, theta_box, x_jack, y_jack, theta_jack, vx_box, vy_box, omega_box, vx_jack, vy_jack, omega_jack]

Wall k = 0..3 has its outward normal n_k at the angle theta_box + k pi/2, foot i = 0..3 sits at o_i, at the angle
theta_jack + i pi/2 and l from the jack's centre. With r = p_jack - p_box and a^perp = (-a_y, a_x):

    gap_ki = L - n_k . (r + o_i)                                              >= 0 inside
    J_ki   = d gap_ki / d q = [n_k, -n_k^perp . (r + o_i), -n_k, -n_k . o_i^perp]

An impact is instantaneous and frictionless: momentum jumps along the gradient of the gap and, at restitution e = 1, the
Hamiltonian is kept (Brogliato, Nonsmooth Mechanics, 3rd ed. 2016, ch. 4; Glocker 2001, Set-Valued Force Laws, ch. 9):

    M (qdot+ - qdot-) = lambda J^T,    J qdot+ = -e J qdot-    =>    lambda = -(1 + e) J qdot- / (J M^-1 J^T)

No contact model calls the maps below; the models are checked against them. Their sums are written out and not left to
a linear algebra library, so equal cosines and sines give the same bits on every processor. The cosines and sines are
numpy's. Their last place may differ between processors; with glibc it does on processors without FMA and AVX2.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from types import SimpleNamespace

import numpy as np
from numpy.typing import ArrayLike

from jackbox_env.model.complementarity import mass_scale, nearest
from jackbox_env.model.scene import Scene, SceneNumbers
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
    Indices,
    Numbers,
    as_state,
    refuse_no_scene,
)
from jackbox_env.tools import checks as check

_QUARTERS = np.arange(4) * (math.pi / 2.0)


def _directions(angle: float | Array) -> Array:
    """Unit vectors at ``angle`` + k pi/2, shape (..., 4, 2), by numpy's cosine and sine."""
    turned = np.asarray(angle)[..., None] + _QUARTERS
    return np.stack([np.cos(turned), np.sin(turned)], axis=-1)


def gaps(scene: Scene, state: ArrayLike) -> Array:
    """The gap between each wall and each foot [m], shape (4 walls, 4 feet); negative outside.

    >>> gaps(Scene(), np.zeros(12))[0]  # wall 0 is at x = 6 m, the feet at x = 1, 0, -1 and 0 m
    array([5., 6., 7., 6.])

    Raises:
        TypeError, ValueError: the state is not 12 finite numbers.
    """
    refuse_no_scene(scene)
    q = as_state(state)
    jack = np.array([q[X_JACK] - q[X_BOX], q[Y_JACK] - q[Y_BOX]])
    feet = jack + scene.jack_arm * _directions(q[THETA_JACK])  # (4, 2) from the box's centre
    normals = _directions(q[THETA_BOX])
    return scene.box_half_width - (np.outer(normals[:, 0], feet[:, 0]) + np.outer(normals[:, 1], feet[:, 1]))


def gap_jacobian(scene: Scene, state: ArrayLike, wall: int, foot: int) -> Array:
    """The derivative of one gap with respect to the six positions, shape (6,), dimensionless and, by angles, in m.

    >>> gap_jacobian(Scene(), np.zeros(12), wall=0, foot=1).tolist()
    [1.0, 0.0, -1.0, -1.0, -0.0, 1.0]

    Raises:
        TypeError, ValueError: the state is not 12 finite numbers, scene is no Scene, or wall or foot is no whole number
            from 0 to 3.
    """
    refuse_no_scene(scene)
    q, (wall, foot) = as_state(state), _pair((wall, foot))
    jacobian: Array = contacts_of(scene, q[None], np.array([wall]), np.array([foot]))[1][0]
    return jacobian


def contacts_of(scene: Scene, states: Array, walls: Indices, feet: Indices) -> tuple[Array, Array]:
    """The gap [m] of one wall and one foot in each state, shape (n,), and its derivative, shape (n, 6).

    :func:`gaps` and :func:`gap_jacobian` for many states, without checks.

    >>> walls, feet = np.array([0, 1]), np.array([0, 0])
    >>> gap, derivative = contacts_of(Scene(), np.zeros((2, 12)), walls, feet)
    >>> gap
    array([5., 6.])

    Args:
        scene: the scene.
        states: shape (n, 12).
        walls: shape (n,), each from 0 to 3.
        feet: shape (n,), each from 0 to 3.
    """
    every, q = np.arange(len(states)), states.T
    nx, ny = _directions(q[THETA_BOX])[every, walls].T
    ox, oy = (scene.jack_arm * _directions(q[THETA_JACK])[every, feet]).T
    x, y = q[X_JACK] - q[X_BOX] + ox, q[Y_JACK] - q[Y_BOX] + oy  # of the foot, from the box's centre
    box_turns = ny * x - nx * y  # -n^perp . (r + o)
    jack_turns = nx * oy - ny * ox  # -n . o^perp
    jacobians = np.stack([nx, ny, box_turns, -nx, -ny, jack_turns], axis=1)
    return scene.box_half_width - (nx * x + ny * y), jacobians


def impact_map(scene: Scene, state: ArrayLike, wall: int, foot: int) -> tuple[Array, float]:
    """Apply the impact law of one foot on one wall: lambda = -(1 + e) J qdot- / (J M^-1 J^T).

    The gap need not be closed. A contact that separates (J qdot- >= 0) changes nothing.

    >>> state = [0, 0, 0, 5, 0, 0, 0, 0, 0, 1, 0, 0]  # foot 0 reaches wall 0 at 1 m/s
    >>> after, impulse = impact_map(Scene(), state, wall=0, foot=0)
    >>> after[6:].round(3), round(impulse, 3)
    (array([ 0.02,  0.  ,  0.  , -0.98,  0.  ,  0.  ]), 7.921)

    Returns:
        The state after, shape (12,), and the impulse lambda >= 0 [N s].

    Raises:
        TypeError, ValueError: the state is not 12 finite numbers, scene is no Scene, or wall or foot is no whole number
            from 0 to 3.
    """
    refuse_no_scene(scene)
    q, (wall, foot) = as_state(state), _pair((wall, foot))
    after, impulses = impact_maps(scene, q[None], np.array([wall]), np.array([foot]))
    return after[0], float(impulses[0])


def impact_maps(scene: Scene, states: Array, walls: Indices, feet: Indices) -> tuple[Array, Array]:
    """:func:`impact_map` for many states, without checks: the states after, (n, 12), and the impulses [N s], (n,).

    >>> states = np.zeros((2, 12))
    >>> states[:, 9] = 1.0, 2.0  # the jack flies at wall 0
    >>> impact_maps(Scene(), states, walls=np.array([0, 0]), feet=np.array([0, 0]))[1].round(2)
    array([ 7.92, 15.84])

    Args:
        scene: the scene.
        states: shape (n, 12).
        walls: shape (n,), each from 0 to 3.
        feet: shape (n,), each from 0 to 3.
    """
    _, jacobians = contacts_of(scene, states, walls, feet)
    kicks = jacobians / np.array(scene.mass_diagonal)  # change of qdot per impulse
    gap_rates = _dots(jacobians, states[:, RATES:])
    struck, after, impulses = gap_rates < 0.0, states.copy(), np.zeros(len(states))
    impulses[struck] = -(1.0 + scene.restitution) * gap_rates[struck] / _dots(jacobians, kicks)[struck]
    after[struck, RATES:] += (impulses[:, None] * kicks)[struck]
    return after, impulses


def simultaneous_impact_map(scene: Scene, state: ArrayLike, contacts: Sequence[tuple[int, int]]) -> tuple[Array, Array]:
    """Apply the impact law to several contacts at once: the simultaneous Newton law.

        0 <= lambda  _|_  J qdot+ + e J qdot- >= 0,    M (qdot+ - qdot-) = J^T lambda

    (Moreau 1988, "Unilateral contact and dry friction in finite freedom dynamics"; Glocker 2001.) All listed contacts
    enter, also separating ones; list the closed ones. The law is the optimality condition of a convex problem
    (:mod:`.complementarity`), so qdot+ is unique. The impulses need not be (a foot in a corner has four
    contacts of rank 3); the result is then one valid choice. Resolving the contacts one after the other conserves the
    energy too, but leads to other velocities. This project's convention is the simultaneous law.

    >>> state = [0, 0, 0, 0, -5.3, np.pi / 4, 0, 0, 0, 0, -1, 0]  # two feet fall onto the floor
    >>> after, impulses = simultaneous_impact_map(Scene(), state, [(3, 2), (3, 3)])
    >>> after[10].round(3).item(), impulses.round(2)
    (0.98, array([3.96, 3.96]))

    Args:
        scene: the scene.
        state: shape (12,).
        contacts: distinct pairs (wall, foot), each from 0 to 3.

    Returns:
        The state after, shape (12,), and the impulses [N s], shape (len(contacts),), in the order of ``contacts``.

    Raises:
        TypeError, ValueError: the state is not 12 finite numbers, or a contact is no pair of numbers 0..3 or repeated.
    """
    refuse_no_scene(scene)
    before = as_state(state)
    try:
        listed = list(contacts)
    except TypeError as error:
        raise TypeError(f"contacts must be a list of (wall, foot) pairs, got {check.shown(contacts)}") from error
    pairs = [_pair(contact) for contact in listed]
    if len(set(pairs)) < len(pairs):
        raise ValueError(f"contacts must be distinct (wall, foot) pairs, got {pairs}")
    if not pairs:
        return before, np.zeros(0)
    count, (walls, feet) = len(pairs), np.array(pairs).T
    _, jacobian = contacts_of(scene, np.tile(before, (count, 1)), walls, feet)  # (n, 6)
    listed_contacts = SimpleNamespace(
        gradients=jacobian, units=np.zeros((count, 6)), lengths=np.zeros(count), bias=np.zeros(count),
        rates=np.zeros(6), projected=np.zeros(6), multipliers=np.zeros(3), best=np.zeros(3), basis=np.zeros((3, 6)),
        triangle=np.zeros((3, 3)), goals=np.zeros(3),
    )  # fmt: skip
    mass_scale(scene.numbers, listed_contacts, count, before[RATES:])
    after, impulses, masses = before.copy(), np.zeros(count), np.array(scene.mass_diagonal)
    for row, number in enumerate(nearest(listed_contacts, count)):
        if number >= 0:
            impulses[number] = (1.0 + scene.restitution) * listed_contacts.best[row] / listed_contacts.lengths[number]
            after[RATES:] += jacobian[number] * impulses[number] / masses
    return after, impulses


def _pair(contact: tuple[int, int]) -> tuple[int, int]:
    try:
        wall, foot = contact
    except (TypeError, ValueError) as error:
        raise TypeError(f"a contact must be a pair (wall, foot), got {check.shown(contact)}") from error
    return check.whole("wall", wall, at_least=0, at_most=3), check.whole("foot", foot, at_least=0, at_most=3)


def _dots(a: Array, b: Array) -> Array:
    """Scalar product of each row of two arrays in the order written, shape (n,)."""
    total = np.zeros(len(a))
    for products in (a * b).T:
        total += products
    return total


def energy(scene: Scene, state: ArrayLike) -> float:
    """The kinetic energy plus m_j g y_jack [J]; a lift carries the box's weight.

    >>> energy(Scene(gravity=10.0), [0, 0, 0, 0, 2.5, 0, 0, 0, 0, 3, 0, 0])  # 4 kg, 2.5 m, 3 m/s
    118.0

    Raises:
        TypeError, ValueError: the state is not 12 finite numbers.
    """
    refuse_no_scene(scene)
    return energy_of(scene, as_state(state).tolist())


def energy_of(scene: Scene | SceneNumbers, state: Numbers) -> float:
    """:func:`energy` of 12 numbers, without checks."""
    box = twice_kinetic(scene.box_mass, scene.box_inertia, state[VX_BOX], state[VY_BOX], state[OMEGA_BOX])
    jack = twice_kinetic(scene.jack_mass, scene.jack_inertia, state[VX_JACK], state[VY_JACK], state[OMEGA_JACK])
    return 0.5 * (box + jack) + scene.jack_mass * scene.gravity * state[Y_JACK]


def twice_kinetic(mass: float, inertia: float, vx: float, vy: float, omega: float) -> float:
    """Twice a body's kinetic energy [J]."""
    return mass * (vx * vx + vy * vy) + inertia * omega * omega
