"""Flight is exact to rounding: against 60 digits and closed forms, and what a plain scheme would give."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pymunk
import pytest

from jackbox_env.scene import Chirp, Drive, Scene
from jackbox_env.simulators import CONTACT_MODELS, make_simulator
from jackbox_env.simulators.pymunk import PymunkSimulator
from tests.closed_forms import chirp_motion_by_fresnel
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
def test_side_forces_push_the_box_exactly(contact: str) -> None:
    # force_x = 4000 cos(2 t) N on 400 kg: vx = 5 sin 2t, x = 2.5 (1 - cos 2t); force_y held.
    scene = Scene(gravity=0.0, drive=Drive(force_x=lambda t: 4000.0 * math.cos(2.0 * t), force_y=lambda t: 400.0))
    simulator = make_simulator(scene, contact)
    simulator.reset(np.zeros(12))
    for _ in range(40):
        simulator.step(0.02, torque=None)
    x, vx = 2.5 * (1.0 - math.cos(1.6)), 5.0 * math.sin(1.6)
    np.testing.assert_allclose(simulator.state[[0, 1, 6, 7]], [x, 0.32, vx, 0.8], atol=1e-12)
    simulator.reset(np.zeros(12))
    simulator.step(0.02, torque=14400.0)  # replaces the drive's torque only
    assert simulator.state[8] == pytest.approx(0.02)
    assert simulator.state[6] == pytest.approx(5.0 * math.sin(0.04), abs=1e-12)
    assert simulator.torque == 14400.0


@EVERY_MODEL
@pytest.mark.parametrize("time", [0.0, 7.3])
def test_the_chirp_turns_the_box_by_fresnel_integrals(contact: str, time: float) -> None:
    scene = Scene(gravity=0.0)
    simulator = make_simulator(scene, contact)
    simulator.reset(np.zeros(12), time)
    simulator.step(0.02)
    assert isinstance(scene.drive, Chirp)
    spun, turned = chirp_motion_by_fresnel(scene.drive, scene.box_inertia, time, 0.02)
    assert simulator.state[[8, 2]] == pytest.approx([spun, turned], rel=1e-13, abs=1e-17)


def test_a_plain_start_and_a_sampled_drive_would_not_be_exact() -> None:
    # The same loop without half-step velocities is off by g h t / 2, and with the chirp sampled at each substep's
    # start the box's angle is off by thousandths of a radian after 1 s.
    h, steps = 0.005, 200
    space = pymunk.Space()
    box, jack = pymunk.Body(400.0, 14400.0), pymunk.Body(4.0, 4.0)
    space.add(box, jack)
    for step in range(steps):
        jack.force = (0.0, -4.0 * 9.81)
        box.torque = Chirp().torque(step * h)
        space.step(h)
    simulator = PymunkSimulator(Scene())
    simulator.reset(np.zeros(12))
    for _ in range(50):
        simulator.step(0.02)
    flight_error = jack.position.y + 0.5 * 9.81
    assert flight_error == pytest.approx(9.81 * h / 2.0, rel=1e-6)
    assert abs(box.angle - load("seed_scene")[0]["states"][9]["state"][2]) > 1e-3
    np.testing.assert_allclose(simulator.state, load("seed_scene")[0]["states"][9]["state"], atol=1e-12)
