"""What the pymunk contact model asks of the engine's contacts: a record of their impulses, and enough iterations."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pymunk

from jackbox_env.mechanics import gap_jacobian
from jackbox_env.scene import Scene
from jackbox_env.simulators.base import Impact

_FIRST_FOOT = 4  # collision types: walls are 0..3, feet 4..7
_FEWEST_ITERATIONS = 64
_MOST_ITERATIONS = 100_000


class Recorder:
    """What the engine calls after it solved a contact, once per substep while the contact lasts.

    It knows nothing of the simulator, so that spaces are freed as soon as they are replaced. The engine prints and
    forgets what is raised in here, so it is kept for :meth:`check`.
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
        """Note the contact, and its impulse if there is one."""
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
    def wedged(self) -> bool:
        """Whether opposite walls pushed in one substep."""
        pushed = {(hit.time, hit.wall) for hit in self.impacts} if len(self.impacts) > 1 else ()
        return any((time, wall + 2) in pushed for time, wall in pushed)

    def check(self) -> None:
        """Raise what was raised while recording."""
        if self._failure is not None:
            raise self._failure


def iterations_for(scene: Scene) -> int:
    """Iterations after which the contact solver is at rounding level for every set of contacts that a jack can make.

    Sequential impulses are the Gauss-Seidel method for A = J M^-1 J^T: the error falls by the largest eigenvalue of
    -(D + L)^-1 L^T in modulus per iteration; those of dependent contacts are 1 and belong to impulses that cancel.

    Raises:
        ValueError: more than 100,000 are needed.
    """
    half, arm = scene.box_half_width, scene.jack_arm
    depth, turned = half - arm * math.sqrt(0.5), math.pi / 4.0  # of the centre where two feet at 45 degrees touch
    cases = [((depth, place, turned), [(0, 0), (0, 3)]) for place in (0.0, 0.5 * depth, depth)]
    cases.append(((depth, depth, turned), [(0, 0), (0, 3), (1, 0), (1, 1)]))
    if arm > half:  # wedged: feet on opposite walls, with little leverage where the arm is hardly longer
        cases.append(((0.0, 0.0, math.acos(half / arm)), [(0, 0), (1, 1), (2, 2)]))
    worst = 0.0
    for pose, contacts in cases:
        state = np.array([0.0, 0.0, 0.0, *pose, *[0.0] * 6])
        rows = np.array([gap_jacobian(scene, state, wall, foot) for wall, foot in contacts])
        rows /= np.sqrt(scene.mass_diagonal)
        matrix = rows @ rows.T
        lower = np.tril(matrix)
        factors = np.sort(np.abs(np.linalg.eigvals(-np.linalg.solve(lower, matrix - lower))))
        independent = min(len(contacts), 3)  # more contacts have rank 3, and the others' factor is 1
        worst = max(worst, float(factors[independent - 1]))
    needed = math.log(1e-16) / math.log(max(worst, 1e-16)) if worst < 1.0 else math.inf
    if not needed <= _MOST_ITERATIONS:
        raise ValueError(
            f"jack_inertia = {scene.jack_inertia:g} kg m^2, box_inertia = {scene.box_inertia:g} kg m^2 and jack_arm = "
            f"{arm / half:.7g} box_half_width couple the feet so strongly that contact='pymunk' needs {needed:,.0f} "
            f"iterations, at most {_MOST_ITERATIONS:,} are made"
        )
    return max(_FEWEST_ITERATIONS, math.ceil(needed))
