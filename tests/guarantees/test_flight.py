"""Flight is exact to rounding: against 60 digits and closed forms."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from jackbox_env.model.scene import Chirp, Scene
from jackbox_env.simulators import CONTACT_MODELS, make_simulator
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.closed_forms import chirp_motion
from tests.states import load

EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)


@pytest.mark.parametrize("record", load("exact_trajectories"), ids=lambda record: record["name"])
@pytest.mark.parametrize("kind", [*CONTACT_MODELS, "pymunk's engine"])
def test_flight_before_the_first_impact_equals_the_60_digit_reference(
    record: dict[str, Any], kind: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "pymunk's engine":
        monkeypatch.setattr(PymunkSimulator, "_may_touch", lambda *arguments: True)
    scene = Scene(gravity=record["gravity"], drive=Chirp() if record["drive"] == "chirp" else None)
    simulator = make_simulator(scene, kind.split("'")[0])
    simulator.reset(record["q"] + record["qdot"])
    checked = 0
    for step in range(250):
        held = scene.torque_limit * record["actions"][step] if record["drive"] == "held" else None
        simulator.step(0.02, held)
        if simulator.time >= record["impacts"][0]["time"]:
            break
        if step % 5 == 4:
            reference = record["states"][step // 5]
            assert reference["time"] == pytest.approx(simulator.time)
            np.testing.assert_allclose(simulator.state, reference["state"], rtol=0.0, atol=1e-12)
            checked += 1
    assert checked >= 3


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
