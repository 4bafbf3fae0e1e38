"""A jack that lies still, for a long time, in scenes with loss."""

from __future__ import annotations

import math

import numpy as np

from jackbox_env.mechanics import energy
from jackbox_env.scene import Scene
from jackbox_env.states import clearance
from tests.extremes.measures import started
from tests.extremes.page import FULL, Bound, Finding, extreme, within

SECONDS = 1000 if FULL else 10
FLAT = 6.0 - math.sqrt(0.5)  # of the jack's centre from a wall that carries two of its feet [m]


@extreme("restitution 0, 0.5 and 0.9: lies on a level, a tilted and a turning floor for 1000 s", timeout=600.0)
def test_a_jack_at_rest_stays_on_its_floor(contact: str) -> Finding:
    # A tilted and a turning floor let it slide into a corner, where two walls hold it.
    deepest = gained = 0.0
    for e in (0.0, 0.5, 0.9):
        for tilt, omega in ((0.0, 0.0), (0.3, 0.0), (0.0, 0.2)):
            gravity = 0.0 if omega else 9.81
            scene = Scene(restitution=e, gravity=gravity, drive=None, box_mass=1e9, box_inertia=36e9)
            state = np.zeros(12)
            state[2], state[5] = tilt, tilt + math.pi / 4.0
            state[3], state[4] = math.cos(tilt) + FLAT * math.sin(tilt), math.sin(tilt) - FLAT * math.cos(tilt)
            state[[8, 11]], state[9], state[10] = omega, -omega * state[4], omega * state[3]
            run = started(scene, contact, state)
            start = energy(scene, state)
            size = 4.0 * 9.81 * 12.0 + abs(start)  # a fall through the box
            for _ in range(SECONDS * 50):
                run.step(0.02, 0.0)
                deepest = max(deepest, -clearance(scene, run.state.tolist()))
                gained = max(gained, (energy(scene, run.state) - start) / size)
    return within(
        Bound("a foot in a wall", deepest, 1e-12 if contact == "exact" else 0.1, "m"),
        Bound("energy above that of the start, relative", gained, 1e-12 if contact == "exact" else 1e-4),
    )
