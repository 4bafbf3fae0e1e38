"""Impacts that lose energy, and feet at rest on walls, in the exact model."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env.complementarity import project
from jackbox_env.exact import rest, search
from jackbox_env.exact import step as course
from jackbox_env.mechanics import energy, gaps
from jackbox_env.scene import Drive, Scene
from jackbox_env.simulators import Impact
from jackbox_env.states import clearance
from tests.simulators.exact_runs import plain_step, simulator
from tests.states import load, lying

LOSS = {course["name"]: course for course in load("loss_trajectories")}
EVERY_LOSS = pytest.mark.parametrize("e", [0.0, 0.5, 1.0])
HEAVY: dict[str, Any] = {
    "box_mass": 1e9,
    "box_inertia": 36e9,
    "drive": None,
}  # so heavy that it gives way by 1e-8 at most


# -- impacts ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", LOSS)
def test_trajectories_with_loss_are_those_of_60_digits(name: str) -> None:
    known = LOSS[name]
    run = simulator(Scene(restitution=known["restitution"]), known["q"] + known["qdot"])
    dt, hits = known.get("control_dt", 0.02), list[Impact]()
    for number in range(round(known["T"] / dt)):
        held = known["actions"][number] * run.scene.torque_limit if known["drive"] == "held" else None
        run.step(dt, held)
        hits += run.impacts
    assert [(hit.wall, hit.foot) for hit in hits] == [(hit["wall"], hit["foot"]) for hit in known["impacts"]]
    errors = [abs(hit.time - other["time"]) for hit, other in zip(hits, known["impacts"], strict=True)]
    assert max(errors) < 1e-9
    assert max(errors[:3]) < 1e-11
    impulses = [hit.impulse for hit in hits]
    np.testing.assert_allclose(impulses, [hit["impulse"] for hit in known["impacts"]], rtol=1e-8)


@pytest.mark.parametrize("e", [0.3, 0.5, 0.9])
def test_each_bounce_of_a_dropped_jack_keeps_its_share_of_the_speed(e: float) -> None:
    scene = Scene(restitution=e, box_mass=1e15, box_inertia=36e15, drive=None)
    run, speed, hits = simulator(scene, np.zeros(12)), math.sqrt(2.0 * 9.81 * 5.0), list[Impact]()
    while len(hits) < 6:
        run.step(0.02, 0.0)
        hits += run.impacts
    for number, hit in enumerate(hits[:6]):
        assert hit.impulse == pytest.approx(4.0 * (1.0 + e) * e**number * speed, rel=1e-9)
    waits = np.diff([hit.time for hit in hits[:6]])
    np.testing.assert_allclose(waits, [2.0 * e ** (n + 1) * speed / 9.81 for n in range(5)], rtol=0.0, atol=1e-11)


# -- rest -------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("e", [0.0, 0.5])
def test_bounces_that_pile_up_end_in_rest(e: float) -> None:
    scene = Scene(restitution=e, drive=None)
    start = np.zeros(12)
    start[4], start[5] = -3.0, math.pi / 4.0
    run, previous, deepest = simulator(scene, start), math.inf, 0.0
    for _ in range(400):
        run.step(0.02, 0.0)
        now = energy(scene, run.state)
        assert now <= previous + 1e-13 * abs(previous)
        previous, deepest = now, min(deepest, clearance(scene, run.state.tolist()))
    assert deepest > -1e-12
    assert [hit[:3] for hit in run.impacts] == [(run.time, 3, 2), (run.time, 3, 3)]
    weight = 4.0 * 400.0 / 404.0 * 9.81 * 0.02
    assert sum(hit.impulse for hit in run.impacts) == pytest.approx(weight, rel=1e-12)


@EVERY_LOSS
def test_a_jack_slides_down_a_tilted_floor(e: float) -> None:
    tilt = 0.5  # [rad]
    run = simulator(Scene(restitution=e, **HEAVY), lying(tilt=tilt))
    for _ in range(50):
        run.step(0.02, 0.0)
        assert clearance(run.scene, run.state.tolist()) > -1e-14
    moved = run.state[3:5] - run.state[:2] - lying(tilt=tilt)[3:5]
    slid = -(moved[0] * math.cos(tilt) + moved[1] * math.sin(tilt))
    assert slid == pytest.approx(9.81 * math.sin(tilt) / 2.0, abs=1e-8)


@EVERY_LOSS
def test_a_weightless_jack_slides_outwards_along_a_turning_wall(e: float) -> None:
    omega = 1.5  # [rad/s]
    start = lying(0.7, omega)
    run = simulator(Scene(restitution=e, gravity=0.0, **HEAVY), start)
    for _ in range(50):
        run.step(0.02, 0.0)
    angle, offset = run.state[2], run.state[3:5] - run.state[:2]
    along = offset[0] * math.cos(angle) + offset[1] * math.sin(angle)
    assert along == pytest.approx(0.7 * math.cosh(omega), abs=1e-8)
    assert sorted((hit.wall, hit.foot) for hit in run.impacts) == [(3, 2), (3, 3)]


def test_a_wall_that_falls_faster_than_the_jack_lets_it_go() -> None:
    # From t = 0.013 s on the box falls at 3 g: the feet part from the floor at 2 g, not before.
    force = -3.0 * 9.81 * 1e9
    scene = Scene(restitution=0.5, **{**HEAVY, "drive": Drive(force_y=lambda t: force if t >= 0.013 else 0.0)})
    run = simulator(scene, lying())
    run.step(0.02)
    assert gaps(scene, run.state)[3, 2:4] == pytest.approx([9.81 * 0.007**2] * 2, rel=1e-8)
    assert sum(hit.impulse for hit in run.impacts) == pytest.approx(4.0 * 9.81 * 0.013, rel=1e-8)


def test_a_torque_that_turns_the_floor_away_lets_one_foot_go_and_presses_the_other() -> None:
    scene = Scene(restitution=0.0, drive=None)
    run = simulator(scene, lying(along=2.0))
    run.step(0.02, -6e4)
    after = gaps(scene, run.state)[3, 2:4]
    assert after.max() > 1e-4
    assert after.min() > -1e-13


# -- any number -------------------------------------------------------------------------------------------------------


# -- negative controls ------------------------------------------------------------------------------------------------


def test_without_rest_a_step_never_ends(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(restitution=0.5, drive=None)
    assert plain_step(scene, lying(), 1e-3, 0.0)[0] == 0
    monkeypatch.setattr(course, "settle", lambda *arguments: 0)
    for module in (search, rest):
        monkeypatch.setattr(module, "MOST_WORK", 2000)
    assert plain_step(scene, lying(), 1e-3, 0.0)[0] != 0


def test_a_wall_that_held_on_would_carry_the_jack_along(monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(restitution=0.0, drive=None)
    start = lying(along=2.0)
    freed = plain_step(scene, start, 0.02, -6e4)[1]
    monkeypatch.setattr(rest, "release_time", lambda *arguments: math.inf)
    monkeypatch.setattr(rest, "active_set", lambda work, count: (0, 1, -1) if project(work, 2, 0, 1, -1) else None)
    assert (
        gaps(scene, freed)[3, 2:4].max()
        > 1e-4
        > np.abs(gaps(scene, plain_step(scene, start, 0.02, -6e4)[1])[3, 2:4]).max()
    )
