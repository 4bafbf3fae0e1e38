"""Flight under a chirp is exact to rounding: against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from jackbox_env.model.scene import Chirp, Scene
from jackbox_env.simulators import CONTACT_MODELS, make_simulator
from tests.closed_forms import chirp_motion

EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


@EVERY_MODEL
@pytest.mark.parametrize(
    ("chirp", "time", "dt"),
    [
        (Chirp(), 0.0, 0.02),
        (Chirp(), 7.3, 0.02),
        (Chirp(), 9.0, 1.0),
        (Chirp(rate=-2.0, start_frequency=3.0), 1.49, 0.02),  # the frequency passes through zero
        (Chirp(rate=0.0), 123.1, 0.3),  # a sine
        (Chirp(), -50.0, 0.02),
        (Chirp(), 1e6, 0.02),
        (Chirp(start_frequency=-2.0), 0.3, 0.02),
        (Chirp(amplitude=-3e4, rate=40.0), 0.7, 0.02),
    ],
    ids=str,
)
def test_any_chirp_at_any_time_turns_the_box_by_its_closed_integrals(
    chirp: Chirp, time: float, dt: float, contact: str
) -> None:
    simulator = make_simulator(Scene(gravity=0.0, drive=chirp), contact)
    simulator.reset(np.zeros(12), time)
    simulator.step(dt)
    spun, turned = chirp_motion(chirp, 14400.0, time, dt)
    assert simulator.state[8] == pytest.approx(spun, rel=1e-13, abs=1e-13)
    assert simulator.state[2] == pytest.approx(turned, rel=1e-13, abs=1e-15)
    assert simulator.torque == pytest.approx(14400.0 * spun / dt, abs=1e-7)
