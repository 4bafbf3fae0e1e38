"""Derivatives through impacts against 60 digits, differences and closed forms, and steps without a derivative."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import Linearization, Scene, linearize, rollout
from jackbox_env.exact import derivatives, tangents
from jackbox_env.jit.compiler import compiled, compiled_with
from tests.batches.several import assert_same
from tests.fingerprints import DRIVES
from tests.simulators.exact_runs import simulator
from tests.states import Array, at, inside, load, lying

FIELDS = tangents.FIELDS
CASES = load("derivatives")


def product(lin: Linearization, row: int = 0) -> tuple[Array, Array, Array]:
    """Derivatives of the last state of a row by the first, by each torque and by the fields."""
    by_start, by_fields, by_torques = np.eye(12), np.zeros((12, lin.P.shape[3])), np.zeros((12, 0))
    for a, b, p in zip(lin.A[row], lin.B[row], lin.P[row], strict=True):
        by_start, by_fields, by_torques = a @ by_start, a @ by_fields + p, np.column_stack([a @ by_torques, b])
    return by_start, by_torques, by_fields


def off(actual: Array, expected: Array) -> float:
    """Largest error, relative to the largest entry."""
    return float(abs(actual - expected).max() / max(abs(expected).max(), 1e-300))


# -- against references ------------------------------------------------------------------------------------------------


def linearized(case: dict[str, Any]) -> Linearization:
    fields = [name for name in FIELDS if name in case["by_field"]]
    scene = Scene(**case["scene"], drive=None)
    return linearize(scene, case["start"], case["torques"], case["control_dt"], fields=fields)


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{len(case['impacts'])} impacts")
def test_products_of_steps_equal_the_60_digit_reference(case: dict[str, Any]) -> None:
    lin = linearized(case)
    by_start, by_torques, by_fields = product(lin)
    expected = np.array(case["by_start"]).T
    tolerance = 5e-14 * max(1.0, abs(expected).max())
    assert lin.smooth.all()
    assert off(by_start, expected) <= tolerance
    for number, column in case["by_torque"].items():
        assert off(by_torques[:, int(number)], np.array(column)) <= tolerance
    for column, name in zip(by_fields.T, case["by_field"], strict=True):
        assert name in FIELDS
        assert off(column, np.array(case["by_field"][name])) <= tolerance


def test_without_the_shift_of_the_impacts_time_the_reference_is_missed(monkeypatch: pytest.MonkeyPatch) -> None:
    def never(closing: float, rate: float) -> float:
        return 0.0

    def without(function: Any) -> Any:
        replaced = {"impact_time_shift": never} if function is derivatives.matrices else {}
        return compiled_with(function, **replaced) if replaced else compiled(function)

    monkeypatch.setattr("jackbox_env.planning.linearization.compiled", without)
    for case in CASES:
        if case["impacts"]:
            assert off(product(linearized(case))[0], np.array(case["by_start"]).T) > 0.01


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{len(case['impacts'])} impacts")
def test_products_forward_and_backward_agree(case: dict[str, Any]) -> None:
    lin, rng = linearized(case), np.random.default_rng(0)
    g = rng.standard_normal(lin.trajectories.shape)
    for one in range(3):  # one kind of change after the other, as their scales differ
        changes = [
            rng.standard_normal(shape) * (one == kind)
            for kind, shape in enumerate([(1, 12), (1, lin.B.shape[1]), (1, lin.P.shape[3])])
        ]
        forward = (g * lin.jvp(*changes)).sum()
        backward = sum((gradient * change).sum() for gradient, change in zip(lin.vjp(g), changes, strict=True))
        size = (abs(g) * abs(lin.jvp(*changes))).sum()
        assert abs(forward - backward) <= 1e-12 * size
    by_start, _, _ = lin.vjp(np.eye(12)[3] * (np.arange(lin.trajectories.shape[1]) == lin.B.shape[1])[:, None][None])
    np.testing.assert_allclose(by_start[0], product(lin)[0][3], rtol=1e-11, atol=1e-13 * abs(by_start).max())


# -- closed forms ------------------------------------------------------------------------------------------------------


def upright(height: float, fall: float = 0.0) -> Array:
    """A jack upright over the middle of the floor, its foot at a height [m], falling at a rate [m/s]."""
    return at(y_jack=height - 5.0, vy_jack=-fall)


def test_the_time_of_an_impact_in_closed_form() -> None:
    # A foot at a height z over the floor that falls at w hits at t = (sqrt(w^2 + 2 g z) - w) / g.
    scene, state, g = Scene(drive=None), upright(0.2, 1.0), 9.81
    lin = linearize([scene] * 2, [upright(3.0), state], np.zeros((2, 20)), 0.02, fields=("gravity",))
    hit = math.sqrt(1.0 + 2.0 * g * 0.2)  # rate of the impact
    (step, *_), (since, *_), (by, *_) = lin.impacts(1)
    assert len(lin.impacts(0)[0]) == 0
    assert step * 0.02 + since == pytest.approx((hit - 1.0) / g, rel=1e-12)
    # By height, and by the rate upwards, of what moves freely from the step's start on: dt = dz / hit.
    z, w = 0.2 - step * 0.02 - 0.5 * g * (step * 0.02) ** 2, 1.0 + g * step * 0.02
    assert by[4] == pytest.approx(1.0 / hit, rel=1e-12)
    assert by[10] == pytest.approx(since / hit, rel=1e-12)
    assert by[13] == pytest.approx(-0.5 * since**2 / hit, rel=1e-12)
    assert since == pytest.approx((math.sqrt(w * w + 2.0 * g * z) - w) / g, rel=1e-10)


# -- where there is none -----------------------------------------------------------------------------------------------

OUTSIDE, SLOW, AT_ONCE = upright(-1e-6, -1.0), upright(1e-14, 1e-6), upright(0.0, 1.0)
FLAT = np.array([*lying()[:10], -3.0, 0.0]) + np.eye(12)[4] * 0.02  # falls on two feet at once
GRAZE = np.array([0, 0, 0, 5 + 5e-14, 0, -0.3, 0, 0, 0, 0, 0.3, 300.0])  # the foot passes the wall at 1e-4 m/s
ROUGH = {
    "a foot on a wall that leaves at a rate of rounding": (Scene(gravity=0.0, drive=None), upright(0.0, -1e-12), 0.02),
    "a foot outside that turns round": (Scene(drive=None), upright(-1e-10, -3e-5), 1e-5),
    "a graze": (Scene(gravity=0.0, drive=None), GRAZE, 2e-3),
    "two feet at one moment": (Scene(drive=None), FLAT, 0.02),
    "a slow impact": (Scene(gravity=0.0, drive=None), SLOW, 0.02),
    "an impact at the start": (Scene(drive=None), AT_ONCE, 0.02),
    "a foot outside that approaches": (Scene(drive=None), upright(-1e-6, 1.0), 0.02),
    "rest": (Scene(restitution=0.5, drive=None), lying(), 0.02),
    "a pile of bounces that ends in rest": (Scene(restitution=0.5, drive=None), upright(0.01, 0.0), 0.5),
    "an impact at the end": (Scene(gravity=0.0, drive=None), upright(0.25, 1.0), 0.25),
    "more than 300 impacts": (Scene(gravity=500.0, drive=None), upright(0.01), 2.0),
}  # fmt: skip
SMOOTH = {
    "a foot that leaves": (Scene(drive=None), upright(0.0, -1.0), 0.02),
    "a foot outside that leaves": (Scene(drive=None), OUTSIDE, 0.02),
    "flight": (Scene(drive=None), upright(1.0), 0.02),
}


@pytest.mark.parametrize("case", [*ROUGH, *SMOOTH])
def test_a_step_without_a_derivative_is_marked_and_nan(case: str) -> None:
    scene, state, dt = (ROUGH | SMOOTH)[case]
    lin = linearize(scene, state, np.zeros((1, 1)), dt, fields=("gravity",))
    assert lin.smooth[0, 0] == (case in SMOOTH)
    for one in (lin.A, lin.B, lin.P, *lin.vjp(np.ones((1, 2, 12))), lin.jvp(np.ones((1, 12)))[:, 1]):
        assert (np.isfinite(one) if case in SMOOTH else np.isnan(one)).all()


def test_nan_reaches_products_through_the_step_and_no_others() -> None:
    states = np.array([upright(1.0), FLAT + np.eye(12)[4] * 0.3])
    lin = linearize(Scene(drive=None), states, np.zeros((2, 20)), 0.02, fields=("gravity",))
    (rough,) = np.flatnonzero(~lin.smooth[1])
    forward, (by_start, by_torque, by_field) = lin.jvp(np.ones((2, 12))), lin.vjp(np.ones((2, 21, 12)))
    for values, first, last in (
        (forward, rough + 1, 21), (by_start, 0, 12), (by_field, 0, 1), (by_torque, 0, rough + 1),
    ):  # fmt: skip
        wrong: Any = np.isnan(values).reshape(*values.shape[:2], -1).any(axis=2)
        assert not wrong[0].any()
        np.testing.assert_array_equal(wrong[1], [first <= number < last for number in range(values.shape[1])])
    weights = np.ones((2, 21, 12))
    weights[:, rough + 1 :] = 0.0  # of the states after that step
    by_start, by_torque, _ = lin.vjp(weights)
    assert np.isfinite(by_start).all()
    assert (by_torque[1] != 0.0).tolist() == [number < rough for number in range(20)]


# -- the rollout's rows ------------------------------------------------------------------------------------------------


def test_rows_are_single_ones_and_those_of_rollout_whatever_the_threads_and_their_times() -> None:
    rng = np.random.default_rng(1)
    scenes = [Scene(drive=drive, restitution=e) for drive in DRIVES.values() for e in (1.0, 0.7)]
    states, times = np.array([inside(one, rng) for one in scenes]), [0.3, 1.3] * 5
    torques = rng.uniform(-9e4, 9e4, (len(scenes), 12))
    for rows, held in ((scenes, torques), ([scenes[1]] * 10, None)):
        options: dict[str, Any] = {"dt": 0.02, "fields": FIELDS, "steps": None if held is not None else 25}
        made = [linearize(rows, states, held, time=times, num_threads=n, **options) for n in (1, 3)]
        assert_same([*made[1]], [*made[0]])
        for row, (scene, state, time) in enumerate(zip(rows, states, times, strict=True)):
            alone = linearize(scene, state, None if held is None else held[row], time=time, **options)
            assert_same([one[0] for one in alone], [one[row] for one in made[0]])
            assert_same(alone.impacts(0), made[0].impacts(row))
            if held is not None:
                assert_same(alone.trajectories[0], rollout(scene, state, held[row], 0.02, time)[0])


@pytest.mark.parametrize("drive", ["chirp", "smooth functions"])
def test_drives_equal_differences(drive: str) -> None:
    scene, state, steps = Scene(drive=DRIVES[drive]), inside(Scene(), np.random.default_rng(3), 8.0), 25
    fields = ("box_mass", "box_half_width", "jack_arm", "gravity")
    lin = linearize(scene, state, None, 0.02, 0.1, fields=fields, steps=steps)
    by_start, _, by_fields = product(lin)
    assert abs(np.diff(lin.trajectories[0, :, 9])).max() > 0.1  # there are impacts

    def end(changed: Scene, start: Array) -> Array:
        run = simulator(changed, start, 0.1)
        for _ in range(steps):
            run.step(0.02)
        return run.state

    changes = [(scene, state + h, scene, state - h, 2e-7) for h in 1e-7 * np.eye(12)]
    for name in fields:
        more, less = (scene.changed(**{name: (1.0 + share) * getattr(scene, name)}) for share in (1e-7, -1e-7))
        changes.append((more, state, less, state, 2e-7 * getattr(scene, name)))
    for column, (more, high, less, low, width) in zip([*by_start.T, *by_fields.T], changes, strict=True):
        slope = (end(more, high) - end(less, low)) / width
        np.testing.assert_allclose(column, slope, atol=1e-5 * abs(column).max(), rtol=0.0)


def test_a_derived_inertia_follows_its_lengths_and_masses_and_a_set_one_stays() -> None:
    for settings in ({}, {"box_inertia": 14400.0}):
        scene = Scene(**settings, drive=None)
        lin = linearize(scene, upright(1.0), [3e4], 0.02, fields=("box_mass", "box_half_width"))
        follows = 0.0 if settings else -3e4 / 14400.0 * 0.02
        np.testing.assert_allclose(lin.P[0, 0, 8], [follows / 400.0, 2.0 * follows / 6.0], rtol=1e-12)


def test_rounding_hides_large_derivatives_however_few_the_impacts() -> None:
    # A jack much smaller than its box spins fast after an impact, so a few impacts multiply an error by 1e10.
    rng = np.random.default_rng(0)
    scene = Scene(box_half_width=1.0, jack_arm=0.01, jack_mass=1.0, jack_inertia=1e-5, drive=None)
    lin = linearize(scene, [inside(scene, rng, 10.0) for _ in range(2000)], np.zeros(1), 0.2)
    hits, smooth = np.array([len(lin.impacts(row)[0]) for row in range(2000)]), lin.smooth[:, 0]
    unit = np.array([1.0] * 6 + [scene.speed_scale] * 6)  # L is 1 m
    grown = abs(lin.A[smooth, 0] * unit / unit[:, None]).max(axis=(1, 2))
    assert 1e9 < grown.max() < 1e10
    assert (hits[~smooth] <= 4).sum() > 10


def test_later_changes_of_arrays_change_no_derivative() -> None:
    torques = np.full(3, 3e4)
    lin, twin = (linearize(Scene(drive=None), upright(1.0), torques, 0.02, fields=("box_mass",)) for _ in range(2))
    torques *= 2.0
    np.testing.assert_array_equal(lin.P, twin.P)
    assert lin.P[0, 0, 8, 0] == pytest.approx(-3e4 / 14400.0 * 0.02 / 400.0)
