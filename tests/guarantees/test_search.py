"""The search for impacts is guaranteed: the bound, and the impacts that a search without it misses."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
import pytest

from jackbox_env.exact import bounds
from jackbox_env.exact import flight as motion
from jackbox_env.exact import search as kernel
from jackbox_env.exact.workspace import Status, new_workspaces
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import clearance
from scripts.studies.speed import measured
from tests.simulators.exact_runs import plain_step, simulator
from tests.states import WEIGHTLESS, inside

MISSED: dict[str, tuple[Scene, list[float], float]] = {
    # Foot 0 turns at 10 rad/s on an arm of 1 m around a centre 5 m from the wall: it points at it after 10 ms.
    "a foot swings 1 nm through": (WEIGHTLESS, [0, 0, 0, 5.0 + 1e-9, 0, -0.1, 0, 0, 0, 0, 0, 10.0], 0.02),
    "fast spin, whole turns in a step": (WEIGHTLESS, [0, 0, 0, 5.2, 0, 0.785, 0, 0, 0, 0, 0, 100.0 * math.pi], 0.02),
    "the box's corner sweeps past": (WEIGHTLESS, [0, 0, -0.02, 5.001, 0, -0.02, 0, 0, 2.0, 0, 0, 2.0], 0.02),
    "a bounce on the ceiling within a long step": (Scene(drive=None), [0, 0, 0, 0, 4.9, 0, 0, 0, 0, 0, 1.5, 0], 0.3),
}


@pytest.mark.parametrize("name", MISSED)
def test_impacts_that_sampling_at_the_steps_end_misses_are_located(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    scene, state, dt = MISSED[name]
    ended, after, impacts = plain_step(scene, state, dt, 0.0)
    assert ended == Status.DONE
    assert impacts
    run = simulator(scene, state)  # and compiled it finds the same
    run.step(dt, 0.0)
    np.testing.assert_array_equal(run.state, after)
    # Without impacts, small steps show the foot outside: the impact is real.
    with monkeypatch.context() as without:
        without.setattr(kernel, "walls_in_reach", lambda *_: 0)
        times = impacts[0][0] + np.linspace(0.0, 0.1 * dt, 2001)[1:]
        lows = [clearance(scene, plain_step(scene, state, float(time), 0.0)[1].tolist()) for time in times]
    assert min(lows) < -1e-13
    monkeypatch.setattr(kernel, "first_of_all", measured.first_of_all)
    assert len(plain_step(scene, state, dt, 0.0)[2]) < len(impacts)


def test_the_bounds_hold_over_the_whole_flight() -> None:
    # Of the distance of the centres, and of the second derivative of every gap; half of it would not do.
    rng = np.random.default_rng(5)
    broken, tightest = 0, math.inf
    for number in range(400):
        scene = Scene(jack_arm=rng.uniform(0.1, 8.0), gravity=rng.choice([0.0, 9.81]))
        state = inside(scene, rng, speed=rng.choice([1.0, 5.0]))
        n, w = scene.numbers, new_workspaces()[0]
        alpha, duration = rng.uniform(-50.0, 50.0), rng.choice([0.02, 0.2, 1.0])
        if number % 2:  # thrown up and back again: its ends show nothing of the path between
            state[6:9], state[10] = 0.0, 0.5 * scene.gravity * duration
        flight = motion.flight_of(n, state, motion.constant_piece(duration, alpha), 0.0)
        bound = bounds.bounds_of(n, flight, duration, abs(alpha), 0.0)
        times, step = np.linspace(0.0, duration, 41, retstep=True)
        for time in times.tolist():
            frame = motion.view_at(flight, w, time).frame
            distance = math.hypot(frame.x, frame.y)
            far = bounds.reach_of(n, flight, duration, 0.0)
            assert distance <= far
            tightest = min(tightest, far - distance)
        for wall, foot in rng.integers(0, 4, (4, 2)).tolist():
            gaps = [motion.gap_at(n, flight, w, wall, foot, time)[0] for time in times.tolist()]
            bent = np.abs(np.diff(gaps, 2)).max() / step**2
            assert bent <= bound.centre_curvature + bound.foot_curvature + 1e-13 / step**2
            broken += bent > 0.5 * (bound.centre_curvature + bound.foot_curvature)
    assert broken > 100
    assert tightest < 0.5  # no wild exaggeration


def fast_flights(count: int, deep: bool = False) -> Iterator[tuple[Scene, motion.Flight, motion.Piece, float]]:
    """Flights in boxes that turn by half a radian to ten within the time: scene, flight, piece and time.

    If ``deep``, the box is small and feet may be in walls at first, up to 1 m, as other contact models leave them.
    """
    rng = np.random.default_rng(7)
    for _ in range(count):
        scene = Scene(jack_arm=rng.choice([0.1, 1.0, 5.5]), gravity=rng.choice([0.0, 9.81, 100.0]), drive=None)
        if deep:
            scene = scene.changed(box_half_width=0.5, jack_arm=0.1)
        duration, alpha = 10.0 ** rng.uniform(-3.0, -1.0), rng.uniform(-100.0, 100.0)
        state = inside(scene, rng, speed=rng.uniform(0.1, 4.0) / duration)
        if deep:
            state[3:5] += rng.uniform(-0.9, 0.9, 2)
            state[9:11] *= 0.2
        state[8] = rng.choice([-1.0, 1.0]) * rng.uniform(0.5, 10.0) / duration
        piece = motion.constant_piece(duration, alpha)
        yield scene, motion.flight_of(scene.numbers, state, piece, 0.0), piece, duration


@pytest.mark.parametrize("deep", [False, True])
def test_the_bounds_of_a_fast_box_hold_until_the_first_impact(deep: bool) -> None:
    tightest, quiet = math.inf, 0
    for scene, flight, piece, duration in fast_flights(150, deep):
        n, work = scene.numbers, new_workspaces()[0]
        until = kernel.first_impact(n, work, flight, piece, duration, 1e-13, 1e-13).time
        if until == 0.0:
            continue
        outermost = scene.box_half_width - min(
            motion.gap_at(n, flight, work, wall, foot, 0.0)[0] for wall in range(4) for foot in range(4)
        )
        curvature = bounds.curvature_to_impact(n, flight, duration, piece.max_angular_acceleration, 0.0, outermost)
        away, back = bounds.inside(n, flight, duration, 0.0)
        for wall, foot in ((0, 0), (1, 3), (2, 1)):
            h = until / 60.0
            times = h * np.arange(61)
            gaps = np.array([motion.gap_at(n, flight, work, wall, foot, time)[0] for time in times.tolist()])
            free = (away < times) & (times < back)
            assert (gaps[free] > 0.0).all()
            quiet += free.sum()
            bent = np.abs(np.diff(gaps, 2)) / h**2
            assert bent.max() <= curvature + 1e-12 * scene.box_half_width / h**2
            tightest = min(tightest, curvature / bent.max())
    assert tightest < 2.0
    assert quiet > (0 if deep else 500)
