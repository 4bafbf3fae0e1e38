"""The drive of the exact model: chirps, functions, held torques."""

from __future__ import annotations

import math
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from jackbox_env.planning.rollouts import rollout
from jackbox_env.scene import Chirp, Drive, Scene
from jackbox_env.simulators import exact, functions
from jackbox_env.states import clearance
from jackbox_env.vector_env import JackInBoxVectorEnv
from tests.closed_forms import chirp_motion_by_fresnel
from tests.simulators.exact_runs import simulator
from tests.states import inside


@pytest.mark.parametrize(
    ("chirp", "time", "dt"),
    [
        (Chirp(), 0.0, 0.02),
        (Chirp(), 9.0, 1.0),
        (Chirp(rate=-2.0, start_frequency=3.0), 1.49, 0.02),  # the frequency passes through zero
        (Chirp(), -50.0, 0.02),
        (Chirp(), 1e4, 0.02),
        (Chirp(), 1e6, 0.02),
    ],
    ids=str,
)
def test_any_chirp_at_any_time_moves_the_box_by_its_fresnel_integrals(chirp: Chirp, time: float, dt: float) -> None:
    run = simulator(Scene(gravity=0.0, drive=chirp), np.zeros(12), time)
    run.step(dt)
    if chirp.rate < 0.0:  # the same torque
        chirp = Chirp(-chirp.amplitude, -chirp.start_frequency, -chirp.rate)
    spun, turned = chirp_motion_by_fresnel(chirp, 14400.0, time, dt)
    assert run.state[8] == pytest.approx(spun, abs=1e-13, rel=1e-13)
    assert run.state[2] == pytest.approx(turned, abs=1e-15, rel=1e-13)
    assert run.torque == pytest.approx(14400.0 * spun / dt, abs=1e-7)


def test_a_chirp_of_one_frequency_is_a_sine() -> None:
    time, dt, turning = 123.1, 0.3, mp.pi
    run = simulator(Scene(gravity=0.0, drive=Chirp(start_frequency=0.5, rate=0.0)), np.zeros(12), time)
    run.step(dt)
    start, end = turning * mp.mpf(time), turning * (mp.mpf(time) + mp.mpf(dt))
    spun = 6.25 / turning * (mp.cos(start) - mp.cos(end))
    turned = 6.25 / turning * (mp.cos(start) * dt - (mp.sin(end) - mp.sin(start)) / turning)
    np.testing.assert_allclose(run.state[[8, 2]], [float(spun), float(turned)], rtol=1e-12)


def test_a_chirp_that_turns_too_often_is_refused() -> None:
    run = simulator(Scene(), np.zeros(12), 1e8)
    with pytest.raises(ValueError, match=r"the chirp turns 1.8e\+06 times in the 0.02 s after .* at most 83333"):
        run.step(0.02)
    run.step(0.02, torque=0.0)


@pytest.mark.parametrize(
    ("chirp", "gravity", "dt", "steps", "error"),
    [(Chirp(), 9.81, 0.02, 140, 1e-9), (Chirp(amplitude=2e4), 0.0, 0.7, 8, 1e-13)],
    ids=["five impacts", "long steps"],
)
def test_functions_drive_as_the_chirp_does(chirp: Chirp, gravity: float, dt: float, steps: int, error: float) -> None:
    drives = chirp, Drive(torque=chirp.torque)
    one, other = (simulator(Scene(gravity=gravity, drive=drive), np.zeros(12)) for drive in drives)
    for _ in range(steps):
        one.step(dt)
        other.step(dt)
        assert [hit[1:3] for hit in one.impacts] == [hit[1:3] for hit in other.impacts]
        assert one.torque == pytest.approx(other.torque, rel=1e-9, abs=1e-6)
    np.testing.assert_allclose(one.state, other.state, rtol=0.0, atol=error)


@pytest.mark.parametrize(
    ("torque", "dt", "times"),
    [
        (lambda t: 9e4 * math.sin(2.0 * math.pi * t), 0.02, [81.48, 1e6, 1e8]),
        (lambda t: 9e4 * math.sin(2.0 * math.pi * t), 1e-4, [0.5, 100.0]),
        (Chirp().torque, 0.02, [24.28, 1000.0]),
        (lambda t: np.float32(9e4 * math.sin(t)), 0.02, [0.0, 3.14]),
    ],
    ids=["1 Hz", "small steps", "chirp", "float32"],
)
def test_the_rounding_of_a_function_is_not_interpolated(torque: Any, dt: float, times: list[float]) -> None:
    # Near a zero the rounding of t * omega is large against the function's values in the step.
    for time in times:
        run = simulator(Scene(gravity=0.0, drive=Drive(torque=torque)), np.zeros(12), time)
        run.step(dt)
        mean = mp.quad(lambda s, time=time: float(torque(float(time + s))), [0, dt / 2, dt]) / dt
        assert run.torque == pytest.approx(float(mean), abs=0.1 + 9e4 * 100.0 * math.ulp(time))


def test_jumps_of_a_drive_are_located() -> None:
    # A square wave of 9e4 N m: 6.25 rad/s^2 for 0.25 s, then back: omega is a triangle, theta grows by 0.390625 rad.
    run = simulator(Scene(gravity=0.0, drive=Drive(torque=lambda t: 9e4 if t % 0.5 < 0.25 else -9e4)), np.zeros(12))
    for _ in range(50):
        run.step(0.03)
    assert run.state[8] == pytest.approx(0.0, abs=1e-11)
    assert run.state[2] == pytest.approx(3.0 * 6.25 * 0.25**2, abs=1e-11)


def test_a_drive_of_noise_is_refused() -> None:
    rng = np.random.default_rng(0)
    run = simulator(Scene(drive=Drive(torque=lambda t: rng.uniform(-1.0, 1.0))), np.zeros(12))
    before = run.state
    with pytest.raises(ValueError, match="drive must be smooth but for some jumps: over the 0.02 s after t = 0 s"):
        run.step(0.02)
    np.testing.assert_array_equal(run.state, before)


def test_a_drive_of_zeros_changes_nothing() -> None:
    start = inside(Scene(), np.random.default_rng(6))
    runs = [simulator(Scene(drive=drive), start) for drive in (None, Drive(force_x=lambda t: 0.0))]
    for _ in range(100):
        for run in runs:
            run.step(0.02)
    np.testing.assert_allclose(runs[0].state, runs[1].state, atol=1e-9)


def test_a_held_torque_costs_no_more_where_it_replaces_a_function(monkeypatch: pytest.MonkeyPatch) -> None:
    # Where no side force acts there is nothing to interpolate: the step is, bit for bit, that of a scene without drive.
    function, none = Scene(drive=Drive(torque=lambda t: 1e4 * math.sin(t))), Scene(drive=None)
    rng, asked = np.random.default_rng(7), list[float]()
    start, torques = inside(none, rng), rng.integers(-64, 65, 100) / 64.0 * 9e4

    def interpolate(drive: Drive, time: float, dt: float) -> Any:
        asked.append(time)
        return functions.function_pieces(drive, time, dt)

    monkeypatch.setattr(exact, "function_pieces", interpolate)
    run, batch = simulator(function, start), JackInBoxVectorEnv(1, contact="exact", scene=function)
    batch.reset(options={"state": start})
    for torque in torques.tolist():
        run.step(0.02, torque)
        batch.step(np.array([torque / 9e4]))
    expected = rollout(none, start, torques, 0.02)
    np.testing.assert_array_equal(rollout(function, start, torques, 0.02), expected)
    for states in ([run.state], batch.states):
        np.testing.assert_array_equal(states, expected[:, -1])
    assert asked == []
    run.step(0.02)
    batch.step(None)
    assert asked == pytest.approx([2.0, 2.0])


def test_impacts_under_side_forces_keep_momentum() -> None:
    force = 3e4
    scene = Scene(gravity=0.0, drive=Drive(force_x=lambda t: force * math.cos(9.0 * t), force_y=lambda t: -1e3))
    run = simulator(scene, np.zeros(12))
    hits = 0
    for _ in range(300):
        run.step(0.02, torque=2e4)
        hits += len(run.impacts)
        assert clearance(scene, run.state.tolist()) > -1e-9
    assert hits > 3
    momentum = 400.0 * run.state[6:8] + 4.0 * run.state[9:11]
    np.testing.assert_allclose(momentum, [force / 9.0 * math.sin(54.0), -6e3], atol=1e-8)
