"""The drive of the exact model: chirps, functions, held torques."""

from __future__ import annotations

import math

import numpy as np
import pytest

from jackbox_env.envs.vector import JackInBoxVectorEnv
from jackbox_env.model.scene import Chirp, Drive, Scene
from jackbox_env.planning.rollouts import rollout
from jackbox_env.simulators import exact
from tests.simulators.exact_runs import simulator
from tests.states import inside


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


def test_a_held_torque_replaces_a_function_as_if_there_were_none(monkeypatch: pytest.MonkeyPatch) -> None:
    # Without side forces there is nothing to interpolate: the bits are those of a scene without drive.
    function, none = Scene(drive=Drive(torque=lambda t: 1e4 * math.sin(t))), Scene(drive=None)
    rng = np.random.default_rng(7)
    start, torques = inside(none, rng), rng.integers(-64, 65, 100) / 64.0 * 9e4
    monkeypatch.setattr(exact, "function_pieces", lambda *_: pytest.fail("the function is interpolated"))
    run, batch = simulator(function, start), JackInBoxVectorEnv(1, contact="exact", scene=function)
    batch.reset(options={"state": start})
    for torque in torques.tolist():
        run.step(0.02, torque)
        batch.step(np.array([torque / 9e4]))
    expected = rollout(none, start, torques, 0.02)
    np.testing.assert_array_equal(rollout(function, start, torques, 0.02), expected)
    for states in ([run.state], batch.states):
        np.testing.assert_array_equal(states, expected[:, -1])
