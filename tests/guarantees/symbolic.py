"""The impact law derived from first principles with sympy, sharing no formula with the package.

Frames in SE(3) give the position of every foot and the velocities of the bodies. From these follow the gap phi, the
Lagrangian, the momenta and the Hamiltonian. An impact then solves

    p(qdot+) - p(qdot-) = lambda (d phi / d q)^T,    H(qdot+) = H(qdot-),    lambda != 0.

Units: m, s, kg, rad.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from operator import attrgetter
from typing import Any

import numpy as np
import sympy as sp
from numpy.typing import NDArray

from jackbox_env.model.scene import Scene

Array = NDArray[np.float64]

HALF, ARM = sp.symbols("L l", positive=True)  # [m]
BOX_MASS, JACK_MASS = sp.symbols("m_b m_j", positive=True)  # [kg]
BOX_INERTIA, JACK_INERTIA = sp.symbols("J_b J_j", positive=True)  # [kg m^2] about z
GRAVITY = sp.Symbol("g", nonnegative=True)  # [m/s^2]
WALL_ANGLE, FOOT_ANGLE = sp.symbols("beta gamma", real=True)  # [rad] in the frame of the box, of the jack
Q = sp.Matrix(sp.symbols("x_b y_b theta_b x_j y_j theta_j", real=True))
RATES = sp.Matrix(sp.symbols("vx_b vy_b omega_b vx_j vy_j omega_j", real=True))
AFTER = sp.Matrix(sp.symbols("vx_b^+ vy_b^+ omega_b^+ vx_j^+ vy_j^+ omega_j^+", real=True))
IMPULSE = sp.Symbol("lambda", real=True)  # [N s]
SCENE = (HALF, ARM, BOX_MASS, BOX_INERTIA, JACK_MASS, JACK_INERTIA, GRAVITY)


def frame(angle: sp.Expr, x: sp.Expr, y: sp.Expr) -> sp.Matrix:
    """Homogeneous transform: turned about z by ``angle``, its origin at (x, y, 0)."""
    c, s = sp.cos(angle), sp.sin(angle)
    return sp.Matrix([[c, -s, 0, x], [s, c, 0, y], [0, 0, 1, 0], [0, 0, 0, 1]])


def inverse(g: sp.Matrix) -> sp.Matrix:
    """Inverse of a homogeneous transform: (R, p) -> (R^T, -R^T p)."""
    turned_back = g[:3, :3].T
    return turned_back.row_join(-turned_back * g[:3, 3]).col_join(sp.Matrix([[0, 0, 0, 1]]))


def time_derivative(expression: sp.Matrix) -> sp.Matrix:
    """Total derivative along qdot of something that depends on time through q alone."""
    return sum((sp.diff(expression, q) * rate for q, rate in zip(Q, RATES, strict=True)), 0 * expression)


def unhat(twist: sp.Matrix) -> sp.Matrix:
    """The six numbers (v, omega) of a 4x4 twist matrix."""
    return sp.Matrix([twist[0, 3], twist[1, 3], twist[2, 3], twist[2, 1], twist[0, 2], twist[1, 0]])


def body_kinetic_energy(g: sp.Matrix, mass: sp.Expr, inertia: sp.Expr) -> sp.Expr:
    """V^T I V / 2 with the body velocity V = unhat(g^-1 gdot) and a 6x6 inertia (a flat body: J/2, J/2, J)."""
    velocity = unhat(sp.simplify(inverse(g) * time_derivative(g)))
    matrix = sp.diag(mass, mass, mass, inertia / 2, inertia / 2, inertia)
    return sp.simplify((velocity.T * matrix * velocity)[0] / 2)


WORLD_BOX = frame(Q[2], Q[0], Q[1])
WORLD_JACK = frame(Q[5], Q[3], Q[4])


def world_foot(angle: sp.Expr) -> sp.Matrix:
    """Frame of a foot: turn by its angle on the jack, then go out along the arm."""
    return WORLD_JACK * frame(angle, 0, 0) * frame(0, ARM, 0)


def world_wall(angle: sp.Expr) -> sp.Matrix:
    """Frame in the middle of a wall: turn by its angle on the box, then go out; its x axis is the outward normal."""
    return WORLD_BOX * frame(angle, 0, 0) * frame(0, HALF, 0)


def four_feet_kinetic_energy() -> sp.Expr:
    """Kinetic energy of four point masses m_j / 4 at the feet."""
    total = sp.Integer(0)
    for foot in range(4):
        position = world_foot(foot * sp.pi / 2)[:3, 3]
        velocity = time_derivative(position)
        total += (velocity.T * velocity)[0] * JACK_MASS / 8
    return sp.simplify(total)


@dataclass(frozen=True)
class Evaluation:
    """Numbers at one state for one wall and foot: [m], 1 and m, [J], [m/s] and [rad/s], [N s]."""

    gap: float
    gradient: Array
    hamiltonian: float
    after: Array
    impulse: float


class Derivation:
    """Symbolic expressions, each derived at its first use, and their numbers for a scene and a state."""

    @cached_property
    def gap(self) -> sp.Expr:
        """phi(q) [m]: how far the foot is behind the wall, from its position in the wall's frame."""
        foot_in_wall = inverse(world_wall(WALL_ANGLE)) * world_foot(FOOT_ANGLE)
        return -foot_in_wall[0, 3]

    @cached_property
    def gradient(self) -> sp.Matrix:
        """d phi / d q, a row."""
        return sp.Matrix([self.gap]).jacobian(Q)

    @cached_property
    def lagrangian(self) -> sp.Expr:
        """Kinetic minus potential energy [J]; the lift is a potential that cancels the box's weight."""
        box = body_kinetic_energy(WORLD_BOX, BOX_MASS, BOX_INERTIA)
        jack = body_kinetic_energy(WORLD_JACK, JACK_MASS, JACK_INERTIA)
        weight = BOX_MASS * GRAVITY * WORLD_BOX[1, 3] + JACK_MASS * GRAVITY * WORLD_JACK[1, 3]
        lift = -BOX_MASS * GRAVITY * WORLD_BOX[1, 3]
        return box + jack - (weight + lift)

    @cached_property
    def momenta(self) -> sp.Matrix:
        """p = d Lagrangian / d qdot."""
        return sp.Matrix([self.lagrangian]).jacobian(RATES).T

    @cached_property
    def hamiltonian(self) -> sp.Expr:
        """H = p qdot - Lagrangian [J]."""
        return sp.expand((self.momenta.T * RATES)[0] - self.lagrangian)

    @cached_property
    def impact(self) -> tuple[sp.Matrix, sp.Expr]:
        """qdot+ and lambda in terms of qdot- and d phi / d q (here six free symbols: only their values matter)."""
        slope = sp.Matrix(sp.symbols("phi_1:7", real=True))
        at_after = dict(zip(RATES, AFTER, strict=True))
        jump = self.momenta.subs(at_after) - self.momenta - IMPULSE * slope
        (after,) = sp.solve([*jump], [*AFTER], dict=True)
        gained = sp.expand(self.hamiltonian.subs(at_after) - self.hamiltonian)
        (impulse,) = (root for root in sp.solve(gained.subs(after), IMPULSE) if root != 0)  # 0 is no impact at all
        back = dict(zip(slope, self.gradient, strict=True))
        return AFTER.subs(after).subs(IMPULSE, impulse).subs(back), impulse.subs(back)

    @cached_property
    def _numbers(self) -> Callable[..., list[Any]]:
        after, impulse = self.impact
        arguments = (SCENE, tuple(Q), tuple(RATES), WALL_ANGLE, FOOT_ANGLE)
        outputs = [self.gap, self.gradient, self.hamiltonian, after, impulse]
        function: Callable[..., list[Any]] = sp.lambdify(arguments, outputs, modules="numpy", cse=True)
        return function

    def evaluate(self, scene: Scene, state: Array, wall: int, foot: int) -> Evaluation:
        """All derived quantities at one state for one wall and foot."""
        names = "box_half_width jack_arm box_mass box_inertia jack_mass jack_inertia gravity"
        parameters, quarter = attrgetter(*names.split())(scene), np.pi / 2.0
        values = self._numbers(parameters, tuple(state[:6]), tuple(state[6:]), wall * quarter, foot * quarter)
        gap, gradient, hamiltonian, after, impulse = values
        return Evaluation(float(gap), np.ravel(gradient), float(hamiltonian), np.ravel(after), float(impulse))
