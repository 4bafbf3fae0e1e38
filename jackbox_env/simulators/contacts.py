"""For the pymunk contact model: records the impulses of the engine's contacts, and computes the iterations it needs."""

from __future__ import annotations

import math
from typing import Any

import pymunk

from jackbox_env.exact.geometry import quarter
from jackbox_env.model.scene import Scene
from jackbox_env.simulators.base import Impact

_FIRST_FOOT = 4  # collision types: walls are 0..3, feet 4..7
_FEWEST_ITERATIONS = 64
_MOST_ITERATIONS = 100_000
_ROUNDING = 1e-16


class ContactRecorder:
    """A record of the impulses in a step.

    The engine calls it after it solved a contact, once per substep while the contact lasts. It does not refer to the
    simulator, so that spaces are freed as soon as they are replaced. The engine prints and drops an error raised in
    here, so the error is stored for :meth:`check`.
    """

    def __init__(self) -> None:
        self.start(0.0)

    def start(self, time: float) -> None:
        """Forget everything; the step starts at ``time`` [s]."""
        self.time = time
        self.substep = 0
        self.last_contact = -1  # the last substep in which a contact was alive
        self.impacts: list[Impact] = []
        self._failure: BaseException | None = None

    def __call__(self, arbiter: pymunk.Arbiter, space: pymunk.Space, _data: Any) -> None:
        """Record the contact, and its impulse if there is one."""
        try:
            self.last_contact = self.substep
            impulse = math.hypot(*arbiter.total_impulse)
            if impulse > 0.0:
                wall, foot = sorted(shape.collision_type for shape in arbiter.shapes)
                time = self.time + (self.substep + 1) * space.current_time_step
                self.impacts.append(Impact(time, wall, foot - _FIRST_FOOT, impulse))
        except BaseException as failure:
            self._failure = failure

    @property
    def strained(self) -> bool:
        """Whether several feet were struck in one substep, so that the solver may have stopped short."""
        return len({hit.time for hit in self.impacts}) < len(self.impacts)

    def check(self) -> None:
        """Raise what was raised while recording."""
        if self._failure is not None:
            raise self._failure


def iterations_for(scene: Scene) -> int:
    """Iterations after which the contact solver is at rounding level for contacts that a jack makes without overlap.

    Feet that a coarse substep drives deep into walls may need more: :attr:`ContactRecorder.strained`.

    Sequential impulses are the Gauss-Seidel method for A = J M^-1 J^T: the error falls by the largest eigenvalue of
    -(D + L)^-1 L^T in modulus per iteration; those of dependent contacts are 1 and belong to impulses that cancel.
    Everything is computed in closed form, so that every machine returns the same number.

    Raises:
        ValueError: more than 100,000 are needed.
    """
    half, arm = scene.box_half_width, scene.jack_arm
    diagonal = math.sqrt(0.5)  # cosine and sine of 45 degrees
    depth = half - arm * diagonal  # of the centre where two feet at 45 degrees touch
    cases = [(depth, sideways, diagonal, [(0, 0), (0, 3)]) for sideways in (0.0, 0.5 * depth, depth)]
    cases.append((depth, depth, diagonal, [(0, 0), (0, 3), (1, 0), (1, 1)]))
    if arm > half:  # wedged: feet on opposite walls, with little leverage where the arm is hardly longer
        cases.append((0.0, 0.0, half / arm, [(0, 0), (1, 1), (2, 2)]))
    needed = max(_iterations(_convergence(_coupling(scene, *case))) for case in cases)
    if needed > _MOST_ITERATIONS:
        raise ValueError(
            f"jack_inertia = {scene.jack_inertia:g} kg m^2, box_inertia = {scene.box_inertia:g} kg m^2 and jack_arm = "
            f"{arm / half:.7g} box_half_width couple the feet so strongly that contact='pymunk' needs more than "
            f"{_MOST_ITERATIONS:,} iterations"
        )
    return max(_FEWEST_ITERATIONS, needed)


def _coupling(scene: Scene, x: float, y: float, cosine: float, contacts: list[tuple[int, int]]) -> list[list[float]]:
    """A = J M^-1 J^T of contacts (wall, foot), with the box at angle 0.

    Args:
        scene: the scene.
        x: of the jack's centre in the box [m].
        y: likewise.
        cosine: of the jack's angle, which is between 0 and 90 degrees.
        contacts: the closed ones.
    """
    sine = math.sqrt((1.0 - cosine) * (1.0 + cosine))
    rows = []
    for wall, foot in contacts:
        nx, ny = quarter(1.0, 0.0, wall)
        ox, oy = quarter(scene.jack_arm * cosine, scene.jack_arm * sine, foot)
        rows.append((nx, ny, ny * (x + ox) - nx * (y + oy), ny * ox - nx * oy))
    centres = 1.0 / scene.box_mass + 1.0 / scene.jack_mass
    return [
        [
            (a[0] * b[0] + a[1] * b[1]) * centres
            + a[2] * b[2] / scene.box_inertia
            + a[3] * b[3] / scene.jack_inertia
            for b in rows
        ]
        for a in rows
    ]  # fmt: skip


def _convergence(matrix: list[list[float]]) -> float:
    """Largest modulus of an eigenvalue of G = -(D + L)^-1 L^T, leaving out a fourth contact's, which is 1.

    The first column of G is zero. Without it two contacts leave one eigenvalue, three leave a matrix of two by two, and
    four one of three by three, of which one eigenvalue is 1.
    """
    size = len(matrix)
    g = [[0.0] * size for _ in range(size)]
    for column in range(1, size):
        for i in range(size):
            value = -matrix[i][column] if column > i else 0.0
            for j in range(i):
                value -= matrix[i][j] * g[j][column]
            g[i][column] = value / matrix[i][i]
    if size == 2:
        return abs(g[1][1])
    if size == 3:
        total, product = g[1][1] + g[2][2], g[1][1] * g[2][2] - g[1][2] * g[2][1]
    else:
        total = g[1][1] + g[2][2] + g[3][3] - 1.0
        product = (
            g[1][1] * (g[2][2] * g[3][3] - g[2][3] * g[3][2])
            - g[1][2] * (g[2][1] * g[3][3] - g[2][3] * g[3][1])
            + g[1][3] * (g[2][1] * g[3][2] - g[2][2] * g[3][1])
        )
    within = 0.25 * total * total - product
    return 0.5 * abs(total) + math.sqrt(within) if within >= 0.0 else math.sqrt(product)


def _iterations(factor: float) -> int:
    """The fewest iterations that reduce an error to rounding if each multiplies it by ``factor``, or too many."""
    count, error = 0, 1.0
    while not error <= _ROUNDING and count <= _MOST_ITERATIONS:  # too many for a NaN
        count, error = count + 1, error * factor
    return count
