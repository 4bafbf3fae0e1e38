"""Fits recover the scene of synthetic recordings, report unidentifiable fields, and refuse unusable recordings."""

from __future__ import annotations

import importlib
import sys
from collections.abc import Callable

import numpy as np
import pytest

from jackbox_env import Fit, Recording, Scene, fit, make_simulator, rollout
from jackbox_env.fits.least_squares import Chain, Rows
from jackbox_env.fits.shooting import Parameters, Shooting, Window, units
from jackbox_env.model.tasks import sample_start
from tests.states import Array

DT = 0.02
TRUE = Scene(jack_mass=12.0, restitution=0.85, drive=None)
START = Scene(jack_mass=9.0, drive=None)


def recorded(
    scene: Scene = TRUE, seed: int = 0, steps: int = 200, noise: float = 1e-3, torque: float = 3e4
) -> tuple[Array, Array, Array]:
    """States with noise, torques up to ``torque`` and times of impacts."""
    rng = np.random.default_rng(seed)
    torques = np.repeat(rng.uniform(-torque, torque, steps // 10), 10)
    simulator = make_simulator(scene, contact="exact")
    simulator.reset(sample_start(scene, rng))
    states, heard = [simulator.state], list[float]()
    for torque in torques.tolist():
        simulator.step(DT, torque)
        states.append(simulator.state)
        heard += [hit.time for hit in simulator.impacts]
    seen = np.array(states)
    return seen + noise * units(scene) * rng.standard_normal(seen.shape), torques, np.array(heard)


def holds(fitted: Fit, scene: Scene, wide: float = 2.0) -> bool:
    """Whether the truth is within intervals ``wide`` times as wide."""
    for name, (low, high) in fitted.intervals.items():
        middle, half = 0.5 * (low + high), 0.5 * wide * (high - low)
        if not abs(getattr(scene, name) - middle) <= half:
            return False
    return True


def test_mass_and_restitution_from_everything_seen_with_noise() -> None:
    states, torques, _ = recorded()
    fitted = fit(Recording(states, torques, DT), ("jack_mass", "restitution"), START)
    assert fitted.converged
    assert not fitted.unidentified
    assert holds(fitted, TRUE)
    assert fitted.scene.jack_mass == pytest.approx(12.0, rel=5e-3)
    assert fitted.scene.jack_inertia == fitted.scene.jack_mass  # follows: m l^2 with l = 1 m
    assert fitted.noise["x_jack"] == pytest.approx(6e-3, rel=0.2)
    assert 0.7 < np.sqrt(np.mean(fitted.residuals**2)) < 1.3
    assert abs(fitted.motions[0] - states)[:, 3].max() < 0.05


def test_a_jack_in_a_clamped_box_gives_restitution_and_an_unidentified_mass() -> None:
    true = Scene(box_mass=1e6, box_half_width=0.15, jack_arm=0.04, jack_mass=0.06, restitution=0.85, drive=None)
    states = rollout(true, 0.3 * np.eye(12)[5], np.zeros(120), 1.0 / 120.0)[0]
    seen = states + 5e-4 * np.random.default_rng(1).standard_normal(states.shape)
    seen[:, 6:] = np.nan
    start = true.changed(jack_mass=0.05, restitution=0.9)
    fitted = fit(Recording(seen, None, 1.0 / 120.0), ("jack_mass", "restitution"), start)
    assert fitted.intervals["jack_mass"] == (0.0, np.inf)
    assert fitted.unidentified == ("the recordings do not identify jack_mass",)
    low, high = fitted.intervals["restitution"]
    assert low < 0.85 < high < low + 0.01
    assert fitted.converged


@pytest.mark.parametrize(
    "wrong",
    [
        {"gravity": 1.01},
        pytest.param({"jack_arm": 1.02}, marks=pytest.mark.slow),
        pytest.param({"box_mass": 1.05}, marks=pytest.mark.slow),
    ],
)
def test_a_wrong_model_does_not_converge_to_wrong_intervals(
    wrong: dict[str, float], cases: Callable[[int], int]
) -> None:
    fields = ("jack_mass", "restitution")
    for seed in range(cases(4)):
        rng = np.random.default_rng(seed)
        scene = Scene(
            jack_mass=rng.uniform(4.0, 40.0), jack_arm=rng.uniform(0.8, 1.5), restitution=rng.uniform(0.75, 0.98),
            drive=None,
        )  # fmt: skip
        states, torques, _ = recorded(scene, seed)
        states[:, 6:] = np.nan
        states[np.arange(len(states)) % (1 + seed % 2) > 0] = np.nan
        right = scene.changed(**{name: getattr(scene, name) * rng.uniform(0.8, 1.0) for name in fields})
        start = right.changed(**{name: getattr(right, name) * factor for name, factor in wrong.items()})
        fitted = fit(Recording(states, torques, DT), fields, start)
        assert holds(fitted, scene, wide=2.0) or not fitted.converged
        if seed == 0:
            assert not fitted.converged
            assert any("that is not fitted" in problem for problem in fitted.problems)
            assert fit(Recording(states, torques, DT), fields, right).converged


def chained(rows: Rows, windows: int) -> Array:
    """The Jacobian of rows as one dense matrix: fields, then starts."""
    fields, count = rows.fields, len(rows.residuals)
    dense = np.zeros((count, fields + 12 * windows + 12))
    dense[:, :fields] = rows.jacobian[:, 24:]
    for row, window in enumerate(rows.window):
        dense[row, fields + 12 * window : fields + 12 * window + 24] = rows.jacobian[row, :24]
    return dense[:, :-12]


def linked_windows(rng: np.random.Generator, windows: int, fields: int) -> Rows:
    """Random rows of windows that are linked, but for every third."""
    parts = list[Rows]()
    for window in range(windows):
        jacobian = rng.standard_normal((60, 24 + fields)) * (0.05 if window % 4 else 1.0)
        jacobian[:, 12:24] = 0.0
        column = np.repeat([3, 4, 12], 20)
        if window % 3 and window < windows - 1:
            jacobian[:12] = 1e3 * rng.standard_normal((12, 24 + fields))
            jacobian[:12, 12:24] = -1e3 * np.eye(12)
            column[:12] = -1
        parts.append(Rows(rng.standard_normal(60), jacobian, column, np.full(60, window)))
    return Rows(*(np.concatenate(columns) for columns in zip(*parts, strict=True)))


def test_a_chain_equals_dense_least_squares() -> None:
    rng = np.random.default_rng(0)
    for windows, fields in ((1, 2), (9, 0), (9, 3)):
        rows = linked_windows(rng, windows, fields)
        dense, chain = chained(rows, windows), Chain(rows, windows)
        expected = -np.linalg.lstsq(dense, rows.residuals, rcond=None)[0]
        step, decrease = chain.step(0.0)
        np.testing.assert_allclose(step, expected, atol=1e-9 * abs(expected).max())
        left = float(((rows.residuals + dense @ expected) ** 2).sum())
        assert decrease == pytest.approx(float((rows.residuals**2).sum()) - left, rel=1e-9)
        if fields:
            inverse, information = np.linalg.inv(dense.T @ dense), chain.information()
            np.testing.assert_allclose(np.linalg.inv(information.T @ information), inverse[:fields, :fields], rtol=1e-6)


@pytest.mark.parametrize(("restitution", "noise", "rel"), [(0.85, 0.0, 1e-8), (1.0, 1e-3, 1e-2)])
def test_no_noise_and_restitution_1_converge(restitution: float, noise: float, rel: float) -> None:
    scene = TRUE.changed(restitution=restitution)
    states, torques, _ = recorded(scene, noise=noise)
    fitted = fit(Recording(states, torques, DT), ("jack_mass", "restitution"), START.changed(jack_mass=11.0))
    assert fitted.problems == ()
    assert fitted.scene.jack_mass == pytest.approx(12.0, rel=rel)
    assert fitted.scene.restitution == pytest.approx(restitution, rel=rel)
    assert fitted.intervals["restitution"][1] <= 1.0


def test_a_fit_that_excluded_most_steps_has_not_converged() -> None:
    states, torques, _ = recorded()
    states[60:, 3:5] += 0.3  # a camera that was pushed, and pushed again
    states[120:, 3:5] -= 0.5
    fitted = fit(Recording(states, np.where(np.arange(200) < 60, torques, -torques), DT), ("jack_mass",), START)
    assert fitted.left_out > 60
    assert any("that the scene does not explain" in problem for problem in fitted.problems)


def test_a_fit_that_takes_most_of_a_recording_for_rest_has_not_converged() -> None:
    states, torques, _ = recorded()
    states[:30] = np.nan  # a search from nothing ends at restitution 0, where all is rest
    fitted = fit(Recording(states, torques, DT), ("jack_mass", "restitution"), START.changed(restitution=0.9))
    assert not (fitted.converged and fitted.left_out > 100)


def test_without_scipy_a_sentence_names_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "jackbox_env.fits.outcome")
    monkeypatch.setitem(sys.modules, "scipy", None)
    with pytest.raises(ModuleNotFoundError, match="jackbox_env.fit needs scipy, the extra 'train'"):
        importlib.import_module("jackbox_env.fits.outcome")


def test_derivatives_of_residuals_equal_differences() -> None:
    states, torques, heard = recorded()
    recording = Recording(states, torques, DT, impacts=heard)
    parameters = Parameters(("jack_mass", "restitution", "gravity"), TRUE)
    windows = [Window(0, 0, 60, True, states[0]), Window(0, 60, 90, False, states[60])]
    shooting, noise = Shooting([recording], parameters, windows), 1e-3 * np.append(units(TRUE), 1.0)
    at = shooting.unknowns(parameters.of(TRUE))
    rows = shooting.rows(at, noise, 1e-2)
    assert rows is not None
    assert {-1, 12} <= {*rows.column.tolist()}  # links and heard impacts among them
    dense = chained(rows, 2)
    for column in range(len(at)):
        step = 1e-7 * np.eye(len(at))[column]
        more, less = (shooting.rows(at + sign * step, noise, 1e-2) for sign in (1.0, -1.0))
        assert more is not None
        assert less is not None
        difference = (more.residuals - less.residuals) / 2e-7
        np.testing.assert_allclose(dense[:, column], difference, atol=1e-5 * abs(difference).max() + 1e-6, rtol=1e-5)
