"""Torques that were measured with the states, and change between them."""

from __future__ import annotations

import math
import re
from pathlib import Path

import numpy as np
import pytest

from jackbox_env import Recording, Scene, rollout
from jackbox_env.model.states import RATES, STATE_NAMES, Array

pytest.importorskip("scipy")
from tests.script import jackbox

RATE, PARTS = 30, 16  # frames a second; constant torques for each
TRUE, START = Scene(jack_mass=4.6, restitution=0.9, drive=None), Scene(drive=None)


def curve(times: Array) -> Array:
    """The torque of a motor [N m]."""
    return np.asarray(4e4 * np.sin(2.0 * math.pi * 0.8 * times) + 2e4 * np.sin(2.0 * math.pi * 0.3 * times + 1.0))


def measured(kind: str, seconds: float = 4.0) -> tuple[Array, Array]:
    """States that a camera sees, and a motor's torques with them: of the curve, or linear from one to the next."""
    rng, steps = np.random.default_rng(3), round(seconds * RATE)
    times = np.arange(steps + 1) / RATE
    middles = (np.arange(steps * PARTS) + 0.5) / (RATE * PARTS)
    torques = np.interp(middles, times, curve(times)) if kind == "linear" else curve(middles)
    states = rollout(TRUE, [0.0] * 5 + [0.3] + [0.0] * 6, torques, dt=1.0 / (RATE * PARTS))[0][::PARTS]
    states[:, RATES:] = np.nan
    states[:, :RATES] += np.array([5e-3, 5e-3, 1e-3] * 2) * rng.standard_normal((steps + 1, RATES))
    return states, curve(times)


def test_samples_become_means_of_quarters_and_others_stay() -> None:
    states, quarters, times = np.zeros((5, 12)), (np.arange(16) + 0.5).reshape(4, 4) / 4.0, np.arange(5.0)
    line, parabola = 8.0 * times + 3.0, times**2
    for kind in ("sampled", "linear"):
        torques = Recording(states, line, 0.1, torque=kind).torques
        np.testing.assert_allclose(np.asarray(torques), 8.0 * quarters + 3.0)
        two = Recording(states[:2], line[:2], 0.1, torque=kind).torques
        np.testing.assert_allclose(np.asarray(two), [[4.0, 6.0, 8.0, 10.0]])
    exact = quarters**2 + 1.0 / (12.0 * 4.0**2)  # the mean of a square
    inner = slice(1, 3)  # the slopes of the first and last sample are one-sided
    torques = np.asarray(Recording(states, parabola, 0.1, torque="sampled").torques)
    np.testing.assert_allclose(torques[inner], exact[inner])
    np.testing.assert_allclose(torques.mean(axis=1)[inner], exact.mean(axis=1)[inner])
    torques = np.asarray(Recording(states, parabola, 0.1, torque="linear").torques)
    np.testing.assert_allclose(torques[:, 0], parabola[:-1] + np.diff(parabola) / 8.0)
    for held in (line[1:], torques):  # a recording's own torques make another recording
        np.testing.assert_array_equal(np.asarray(Recording(states, held, 0.1).torques), held)


def test_samples_of_dropped_frames_are_on_the_curve() -> None:
    rows = np.delete(np.arange(30), [4, 11, 12, 20])
    columns = {"time": rows / RATE, "x_jack": np.ones(26), "torque": curve(rows / RATE)}
    for kind in ("sampled", "linear"):
        torques = Recording.from_frame(columns, START, torque=kind).torques
        whole = Recording(np.zeros((30, 12)), curve(np.arange(30) / RATE), 1.0 / RATE, torque=kind).torques
        np.testing.assert_allclose(np.asarray(torques), np.asarray(whole), atol=250.0)  # 3000 by a straight line


@pytest.mark.parametrize("kind", ["linear"])
def test_a_torque_that_changes_gives_the_mass_with_its_kind_alone(kind: str, tmp_path: Path) -> None:
    states, samples = measured(kind)
    rows = np.column_stack([np.arange(len(states)) / RATE, states[:, :RATES], samples])
    header = ",".join(["time", *STATE_NAMES[:RATES], "torque"])
    np.savetxt(tmp_path / "motor.csv", rows, delimiter=",", header=header)
    for options, converged in ([], False), (["--torque-column", kind], True):
        out = jackbox("fit", "motor.csv", *options, cwd=tmp_path).stdout
        assert ("Converged: the search ended" in out) == converged
        low, high = map(float, re.findall(r"jack_mass +[\d.]+ +([\d.einf+-]+) to ([\d.einf+-]+)", out)[0])
        assert (low < 4.6 < high < low + 0.2) == converged
