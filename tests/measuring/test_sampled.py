"""Torques that were measured with the states, and change linearly between them."""

from __future__ import annotations

import math
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from jackbox_env import Recording, Scene, rollout
from jackbox_env.model.states import RATES, STATE_NAMES, Array

pytest.importorskip("scipy")
from jackbox_env.commands import fit as command

RATE, PARTS = 30, 16  # frames a second; constant torques for each
TRUE, START = Scene(jack_mass=4.6, restitution=0.9, drive=None), Scene(drive=None)


def measured(seconds: float = 4.0) -> tuple[Array, Array]:
    """States that a camera sees, and a motor's torques with them: linear from one to the next."""
    rng, steps = np.random.default_rng(3), round(seconds * RATE)
    times = np.arange(steps + 1) / RATE
    samples = 4e4 * np.sin(2.0 * math.pi * 0.8 * times) + 2e4 * np.sin(2.0 * math.pi * 0.3 * times + 1.0)
    middles = (np.arange(steps * PARTS) + 0.5) / (RATE * PARTS)
    torques = np.interp(middles, times, samples)
    states = rollout(TRUE, [0.0] * 5 + [0.3] + [0.0] * 6, torques, dt=1.0 / (RATE * PARTS))[0][::PARTS]
    states[:, RATES:] = np.nan
    states[:, :RATES] += np.array([5e-3, 5e-3, 1e-3] * 2) * rng.standard_normal((steps + 1, RATES))
    return states, samples


def test_samples_become_constant_torques_and_others_stay() -> None:
    states, torques = np.zeros((5, 12)), [0.0, 0.0, 12.0, 12.0, 24.0]
    recording = Recording(states, torques, 0.1, torque="sampled")
    np.testing.assert_allclose(np.asarray(recording.torques), [-1.0, 6.0, 12.0, 17.0])
    assert Recording(states[:2], torques[1:3], 0.1, torque="sampled").torques == [6.0]
    np.testing.assert_array_equal(np.asarray(Recording(states, torques[1:], 0.1).torques), torques[1:])
    with pytest.raises(ValueError, match=r"torques must have shape \(5,\), one for each state, got \(4,\)"):
        Recording(states, torques[1:], 0.1, torque="sampled")
    with pytest.raises(ValueError, match="torque must be one of 'held', 'sampled', got 'linear'"):
        Recording(states, torques[1:], 0.1, torque="linear")


def test_samples_go_on_linearly_at_dropped_frames() -> None:
    columns = {"time": [0.0, 0.1, 0.3, 0.4], "x_jack": [1.0] * 4, "torque": [3.0, 4.0, 6.0, 7.0]}
    recording = Recording.from_frame(columns, START, torque="sampled")
    np.testing.assert_allclose(np.asarray(recording.torques), [3.5, 4.5, 5.5, 6.5])
    with pytest.raises(ValueError, match="row 3, column torque: must be a number, got none"):
        Recording.from_frame({**columns, "torque": [3.0, 4.0, 6.0, None]}, START, torque="sampled")


def test_a_linear_torque_gives_the_mass_and_a_note_names_the_samples(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    states, samples = measured()
    monkeypatch.chdir(tmp_path)
    rows = np.column_stack([np.arange(len(states)) / RATE, states[:, :RATES], samples])
    header = ",".join(["time", *STATE_NAMES[:RATES], "torque"])
    np.savetxt("motor.csv", rows, delimiter=",", header=header)
    for options, converged in ([], False), (["--torque-column", "sampled"], True):
        monkeypatch.setattr(sys, "argv", ["jackbox fit", "motor.csv", *options])
        command.main()
        out, err = capsys.readouterr()
        assert ("Converged: the search ended" in out) == converged
        low, high = map(float, re.findall(r"jack_mass +[\d.]+ +([\d.einf+-]+) to ([\d.einf+-]+)", out)[0])
        assert (low < 4.6 < high < low + 0.2) == converged
        assert ("The torques fit better as samples: --torque-column sampled.\n" in err) != converged
