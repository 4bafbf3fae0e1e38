"""Energy and momentum over whole runs, and feet inside the box, in every contact model.

A weaker tolerance is granted to a model by name, with the reason.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jackbox_env.mechanics import energy
from jackbox_env.model.scene import Chirp, Scene
from jackbox_env.model.states import clearance
from jackbox_env.simulators import CONTACT_MODELS, make_simulator

EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


@EVERY_MODEL
@pytest.mark.parametrize("drive", ["chirp", "held", "limit", "none"])
def test_momentum_and_centre_of_mass_follow_the_exact_laws_and_feet_stay_inside(drive: str, contact: str) -> None:
    scene = Scene(drive=Chirp() if drive == "chirp" else None)
    rng = np.random.default_rng(8)
    simulator = make_simulator(scene, contact)
    start = np.zeros(12)
    start[[3, 5]] = 0.5, 0.3
    simulator.reset(start)
    impacts = 0
    deepest = 1.0 if contact == "pymunk" else 1e-9  # the depth at which a substep may end, and rounding
    for _ in range(500):
        simulator.step(0.02, {"held": rng.uniform(-9e4, 9e4), "limit": 9e4}.get(drive))
        assert clearance(scene, simulator.state.tolist()) >= -deepest
        impacts += len(simulator.impacts)
    assert simulator.state[8] > 50.0 or drive != "limit"
    state, total = simulator.state, scene.box_mass + scene.jack_mass
    assert impacts > 5
    momentum = scene.box_mass * state[6:8] + scene.jack_mass * state[9:11]
    # Each contact in the last substep of a step shifts the synchronised velocity by at most g h / 2 = 0.0245 m/s.
    assert momentum[0] == pytest.approx(0.0, abs=1e-9)
    assert momentum[1] == pytest.approx(-scene.jack_mass * scene.gravity * simulator.time, abs=1e-9)
    centre = (scene.box_mass * state[0:2] + scene.jack_mass * state[3:5]) / total
    np.testing.assert_allclose(centre, [0.5 * 4.0 / 404.0, -4.0 / 404.0 * 9.81 * 10.0**2 / 2.0], atol=1e-9)


@pytest.mark.parametrize(
    "settings", [{"substeps": 1}, {"substeps": 4}, {"substeps": 64}, {"contact": "exact"}], ids=str
)
def test_energy_gained_is_the_work_of_the_torque(settings: dict[str, Any]) -> None:
    # A held torque's work is torque times the box's turn. In pymunk half-step velocities make the scheme symmetric in
    # time, so even impacts resolved late keep the balance to rounding.
    for seed in range(6):
        rng = np.random.default_rng(seed)
        simulator = make_simulator(Scene(), **settings)
        start = np.zeros(12)
        start[3:6] = rng.uniform(-1.0, 1.0, 3)
        simulator.reset(start)
        work = largest = 0.0
        impacts = 0
        for _ in range(300):
            torque, before = rng.uniform(-9e4, 9e4), simulator.state[2]
            simulator.step(0.02, torque)
            work += torque * (simulator.state[2] - before)
            largest = max(largest, abs(work))
            impacts += len(simulator.impacts)
        gained = energy(simulator.scene, simulator.state) - energy(simulator.scene, start)
        assert impacts > 3
        assert largest > 100.0
        assert gained == pytest.approx(work, abs=1e-11 * largest + 1e-9)
