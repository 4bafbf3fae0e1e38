"""The drive of the exact model: chirps, functions, held torques."""

from __future__ import annotations

import numpy as np
import pytest

from jackbox_env.model.scene import Chirp, Drive, Scene
from tests.simulators.exact_runs import simulator


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
