"""Replays a step from its recorded impacts: flight in closed form, and the recorded impulses.

It reconstructs the poses at which a contact model resolved its contacts, and the work of the true torque up to there.
Exactness: that of the record; if the model applied impulses at other poses, the replay leaves its path.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from jackbox_env.model.mechanics import gap_jacobian
from jackbox_env.model.scene import Drive, Scene
from jackbox_env.model.states import OMEGA_BOX, RATES, VX_BOX, VY_BOX, Numbers, clearance
from jackbox_env.simulators.base import Impact
from jackbox_env.simulators.flight import after_flight


class Replay(NamedTuple):
    """The course of a step."""

    state: list[float]  # at its end, 12 numbers
    depth: float  # largest penetration of a foot at an impact [m]; -inf without impacts
    work: float  # of torque and side forces on the box [J]


def flown(scene: Scene, state: Sequence[float], time: float, duration: float, torque: float | None) -> list[float]:
    """The state after flight from ``time`` for ``duration`` [s] under a held torque [N m] or the drive (None)."""
    if duration <= 0.0:
        return list(state)
    drive = scene.drive or Drive()
    falling, rising = drive.torque_means(time, duration) if torque is None else (torque, torque)
    return after_flight(
        scene, list(state), duration, falling, rising, [means(time, duration) for means in drive.force_means]
    )


def replayed(
    scene: Scene, state: Sequence[float], time: float, impacts: Sequence[Impact], end: float, torque: float | None
) -> Replay:
    """Replay a step from ``time`` to ``end`` [s]; ``state`` is that before it."""
    now, depth, work = list(state), -math.inf, 0.0
    for impact in impacts:
        before = flown(scene, now, time, impact.time - time, torque)
        work += box_energy(scene, before) - box_energy(scene, now)  # in flight nothing else changes it
        time = max(time, impact.time)
        depth = max(depth, -clearance(scene, before))
        kick = impact.impulse * gap_jacobian(scene, before, impact.wall, impact.foot) / np.array(scene.mass_diagonal)
        now = before[:RATES] + (np.array(before[RATES:]) + kick).tolist()
    after = flown(scene, now, time, end - time, torque)
    return Replay(after, depth, work + box_energy(scene, after) - box_energy(scene, now))


def box_energy(scene: Scene, state: Numbers) -> float:
    """Kinetic energy of the box [J]."""
    vx, vy, omega = state[VX_BOX], state[VY_BOX], state[OMEGA_BOX]
    return 0.5 * (scene.box_mass * (vx * vx + vy * vy) + scene.box_inertia * omega * omega)
