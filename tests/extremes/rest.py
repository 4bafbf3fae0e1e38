"""A jack that comes to rest and lies still, for a long time, in scenes with loss."""

from __future__ import annotations

import math

import numpy as np

from jackbox_env.mechanics import energy, gaps
from jackbox_env.scene import Scene
from jackbox_env.states import clearance
from tests.extremes.measures import started
from tests.extremes.page import FULL, Bound, Finding, part, within
from tests.states import lying

SECONDS = 1000 if FULL else 10
loss = part("Loss")


@loss("restitution 0, 0.5 and 0.9: lies on a level, a tilted and a turning floor for 1000 s", timeout=600.0)
def a_jack_at_rest_stays_on_its_floor(contact: str) -> Finding:
    # A tilted and a turning floor let it slide into a corner, where two walls hold it.
    deepest = gained = 0.0
    for e in (0.0, 0.5, 0.9):
        for tilt, omega in ((0.0, 0.0), (0.3, 0.0), (0.0, 0.2)):
            gravity = 0.0 if omega else 9.81
            scene = Scene(restitution=e, gravity=gravity, drive=None, box_mass=1e9, box_inertia=36e9)
            state = lying(1.0, omega, tilt)
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


@loss("restitution 0 and 0.5: comes to rest")
def a_jack_that_loses_energy_comes_to_rest(contact: str) -> Finding:
    speed = moved = lifted = above = put_back = 0.0
    for restitution in (0.0, 0.5):
        scene = Scene(restitution=restitution, drive=None, box_mass=1e12, box_inertia=1e14)
        start = np.zeros(12)
        start[5] = 0.2
        simulator = started(scene, contact, start)
        energies, resting = [energy(scene, start)], []
        for number in range(1200):
            simulator.step(0.02, 0.0)
            energies.append(energy(scene, simulator.state))
            if number >= 1100:
                resting.append(simulator.state)
        states = np.array(resting)
        above = max(above, max(energies) - energies[0])
        put_back = max(put_back, float(np.diff(energies).max()))
        speed = max(speed, float(np.abs(states[:, [9, 10]]).max()))
        moved = max(moved, float(np.ptp(states[:, [3, 4, 5]], axis=0).max()))
        lifted = max(lifted, float(np.abs(np.sort(gaps(scene, states[-1])[3])[:2]).max()))
    # An impact at 9.9 m/s ends up to v h deep in the floor; the jack is then lifted out, against its weight.
    deep = math.sqrt(2.0 * 9.81 * 5.0) * 0.005
    return within(
        Bound("speed after 22 s (g h of a synchronised contact)", speed, 9.81 * 0.005, "m/s"),
        Bound("jitter over 2 s", moved, 1e-3, "m or rad"),
        Bound("two feet off the floor", lifted, 1e-4, "m"),
        Bound("energy above that of the start", above, 1e-9, "J"),
        Bound("energy that lifting a foot out of the floor adds in a step (m g v h)", put_back, 4.0 * 9.81 * deep, "J"),
    )
