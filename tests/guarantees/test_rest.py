"""A jack at rest in the exact contact model: in corners, in small boxes, and distinguished from one that rattles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jackbox_env.exact import search as kernel
from jackbox_env.exact.rest import release_time
from jackbox_env.exact.workspace import FORCE, new_workspaces
from jackbox_env.mechanics import energy
from jackbox_env.scene import Scene
from jackbox_env.simulators.exact import ExactSimulator
from jackbox_env.states import Array, clearance
from tests.simulators.exact_runs import gaps_evaluated, plain_step


def in_a_corner(scene: Scene, speed: float, turning: float = 0.0) -> Array:
    """Two feet on the floor and two at the wall on the left, all but at rest in a box that turns [rad/s]."""
    depth = scene.box_half_width - scene.jack_arm * math.sqrt(0.5)
    state = np.array([0.0, 0.0, 0.0, -depth, -depth, math.pi / 4.0, *np.zeros(6)])
    state[9:] = speed * np.random.default_rng(1).standard_normal(3)
    state[[8, 11]] += turning
    state[9:11] += -turning * state[4], turning * state[3]
    return state


@pytest.mark.parametrize("turning", [0.0, 2.0])
@pytest.mark.parametrize("speed", [0.0, 1e-10, 1e-6])
@pytest.mark.parametrize(("half", "arm"), [(0.71, 0.67 * 0.71), (6.0, 1.0)])
def test_a_jack_all_but_at_rest_in_a_corner_is_followed(half: float, arm: float, speed: float, turning: float) -> None:
    scene = Scene(box_half_width=half, jack_arm=arm, drive=None)
    run = ExactSimulator(scene)
    start = in_a_corner(scene, speed, turning)
    run.reset(start)
    for _ in range(3):
        run.step(0.02, torque=0.0)
        assert gaps_evaluated(run) < 400_000
        assert clearance(scene, run.state.tolist()) > -2e-10 * min(1.0, half)
    assert energy(scene, run.state) == pytest.approx(energy(scene, start), rel=1e-12, abs=1e-12 * 4.0 * 9.81 * half)


@pytest.mark.parametrize("angle", [0.1, math.pi / 4.0])
def test_a_long_step_at_rest_under_ten_times_the_weight_is_followed(angle: float) -> None:
    scene = Scene(box_half_width=0.71, jack_arm=0.67 * 0.71, gravity=98.1, drive=None)
    state = np.zeros(12)
    state[4], state[5] = -(0.71 - scene.jack_arm * math.cos(angle)), angle
    run = ExactSimulator(scene)
    run.reset(state)
    run.step(0.2, torque=0.0)
    assert clearance(scene, run.state.tolist()) > -2e-10
    assert energy(scene, run.state) == pytest.approx(energy(scene, state), abs=1e-12 * 4.0 * 98.1)


def test_a_rattle_is_not_mistaken_for_rest(monkeypatch: pytest.MonkeyPatch) -> None:
    # Feet in all four corners with 1e-4 m of play: as many gaps evaluated as at rest, but impulses of m v.
    scene = Scene(gravity=0.0, drive=None, jack_arm=6.0 * math.sqrt(2.0) - 1e-4)
    state = np.zeros(12)
    state[[5, 9, 11]] = math.pi / 4.0, 10.0, 0.3
    monkeypatch.setattr(kernel, "_CHATTER_WORK", 1000)
    guarded = plain_step(scene, state, 0.005, 0.0)
    monkeypatch.setattr(kernel, "is_chattering", lambda n, w: False)
    without = plain_step(scene, state, 0.005, 0.0)
    assert np.array_equal(guarded[1], without[1])  # the same bits
    assert guarded[2] == without[2]
    monkeypatch.setattr(kernel, "is_chattering", lambda n, w: bool(w.evaluations > 1000))
    assert not np.array_equal(plain_step(scene, state, 0.005, 0.0)[1], without[1])


def test_the_resolution_of_rest_grows_with_impacts_not_with_work() -> None:
    touch = kernel.Touch(1e-13, 1e-13)
    for restitution, hits, resolution, sink in (
        (1.0, 0, 1e-13, 1e-13),
        (1.0, 16, 1e-13, 1.5e-13),
        (1.0, 32, 1e-13, 2e-13),
        (0.5, 0, 1e-13, 1e-13),
        (0.5, 256, 2e-13, 2e-13),
        (0.5, 100_000, 1e-10, 1e-10),
    ):
        scene, w = Scene(restitution=restitution).numbers, new_workspaces()[0]
        w.evaluations, w.hits = 900_000.0, hits
        limits = kernel.contact_resolution(scene, w, touch), kernel.widened(scene, w, 1e-13)
        assert limits == pytest.approx((resolution, sink), rel=1e-15, abs=0.0)


def test_chattering_is_much_work_for_little_impulse() -> None:
    scene, w = Scene(), new_workspaces()[0]
    light = 1e-4 * scene.jack_mass * scene.speed_scale  # [N s]
    for work, hits, impulse, chattering in (
        (kernel._CHATTER_WORK, 10_000, light, False),
        (kernel._CHATTER_WORK + 1, 10_000, light, True),
        (kernel._CHATTER_WORK + 1, 0, 0.0, True),  # a foot that creeps along a wall
        (kernel._CHATTER_WORK + 1, 10_000, 100.0 * light, False),
    ):
        w.evaluations, w.hits, w.impulse = work, hits, hits * impulse
        assert kernel.is_chattering(scene.numbers, w) is chattering


@pytest.mark.parametrize(
    ("powers", "moment"), [([1.0, -2.0], 0.5), ([1.0, 0.0, 0.0, -(0.9**-3)], 0.9), ([1.0, -3.0, 2.5], None)]
)
def test_a_held_foot_is_released_when_its_force_falls_to_zero(powers: list[float], moment: float | None) -> None:
    work, length = new_workspaces()[0], 0.02
    work.series[FORCE, : len(powers)] = powers
    time = release_time(work, 0, length, max(map(abs, powers)))
    assert time == (math.inf if moment is None else pytest.approx(moment * length, rel=1e-9))
