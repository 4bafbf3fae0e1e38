"""A jack at rest in the exact contact model: in corners, in small boxes, and distinguished from one that rattles."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jackbox_env.exact import search as kernel
from jackbox_env.mechanics import energy
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import Array, clearance
from jackbox_env.simulators.exact import ExactSimulator
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
    for _ in range(2):
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


def test_a_wall_that_hardly_pushes_takes_little_work() -> None:
    # Three feet hold the jack in a heavy box that turns freely. The force at one is 0 to rounding all along.
    scene = Scene(restitution=0.5, gravity=0.0, drive=None, box_mass=1e9, box_inertia=36e9)
    simulator = ExactSimulator(scene)
    x, y, angle = 1.8663111704140243, -7.248884151870804, 81.93339792361094
    poses = [1.7145655509994085e-06, 3.3241596373226626e-07, 81.1479997602135, x, y, angle]
    omega = 0.19999999939967336
    rates = [-1.5647929887128605e-09, -6.930475574247976e-10, omega, 1.4497768909408617, 0.37326188935625176, omega]
    simulator.reset(np.array(poses + rates))
    simulator.step(0.02, torque=0.0)
    np.testing.assert_allclose(simulator.state[[8, 11]], omega, rtol=1e-9)
