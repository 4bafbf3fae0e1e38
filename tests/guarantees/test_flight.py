"""Flight under a chirp is exact to rounding: against closed forms."""

from __future__ import annotations

import numpy as np
import pytest
from flint import arb, ctx

from jackbox_env.model.scene import Chirp, Scene
from jackbox_env.simulators import CONTACT_MODELS, make_simulator
from tests.proof import chirp_turn

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
        (Chirp(), 1e6, 0.02),  # how well 18,000 turns cancel
        (Chirp(), 1e6, 1.3e-5),  # the phase, by 12 turns
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
    with ctx.workprec(256):
        turned, spun = map(float, chirp_turn(chirp, arb(14400.0), arb(time), arb(0)).gain(arb(dt)))
    assert simulator.state[8] == pytest.approx(spun, rel=1e-13, abs=1e-14)
    assert simulator.state[2] == pytest.approx(turned, rel=1e-13, abs=1e-15)
    assert simulator.torque == pytest.approx(14400.0 * spun / dt, abs=1e-7)
