"""Scene, Chirp and Drive: accepted values, derived values, and the chirp's averages against 40 digits."""

from __future__ import annotations

import dataclasses
import math
import pickle
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from jackbox_env.model.scene import Chirp, Drive, Scene


def test_defaults_are_the_documented_scene() -> None:
    scene = Scene()
    assert dataclasses.asdict(scene) == {
        "box_half_width": 6.0,
        "box_mass": 400.0,
        "box_inertia": 14400.0,  # m_b L^2
        "jack_arm": 1.0,
        "jack_mass": 4.0,
        "jack_inertia": 4.0,  # m_j l^2
        "gravity": 9.81,
        "restitution": 1.0,
        "torque_limit": 90000.0,
        "drive": {"amplitude": 90000.0, "start_frequency": 0.5, "rate": 0.9},
    }
    assert scene.mass_diagonal == (400.0, 400.0, 14400.0, 4.0, 4.0, 4.0)
    assert scene.speed_scale == pytest.approx(10.8499, abs=1e-4)  # a fall through 6 m


def test_numbers_become_python_floats_and_inertias_follow_unless_set() -> None:
    single: Any = np.float32(3.0)
    scene = Scene(box_half_width=single, box_mass=2, jack_mass=5, drive=Chirp(rate=np.float64(1.0)))
    assert {type(getattr(scene, part.name)) for part in dataclasses.fields(scene)} == {float, Chirp}
    assert type(scene.drive.rate) is float  # type: ignore[union-attr]
    assert (scene.box_inertia, Scene(box_inertia=7).box_inertia) == (18.0, 7.0)
    assert scene.changed(box_mass=4.0).box_inertia == 36.0
    assert Scene(box_inertia=7).changed(box_mass=4.0).box_inertia == 7.0
    assert Scene(jack_arm=8.48).jack_inertia == 4.0 * (8.48 * 8.48)  # fits only at some angles


def test_scenes_are_equal_by_value_picklable_and_come_from_dicts() -> None:
    scene = Scene(gravity=1.62, drive=Chirp(rate=0.0))
    assert scene == Scene.of({"gravity": 1.62, "drive": {"rate": 0.0}}) == pickle.loads(pickle.dumps(scene))
    assert hash(scene) == hash(Scene.of(dataclasses.asdict(scene)))
    assert Scene.of(None) == Scene() != scene


# -- the chirp against 40 digits --------------------------------------------------------------------------------------

CHIRPS = [
    Chirp(),
    Chirp(start_frequency=0.3, rate=0.0),
    Chirp(rate=-0.9),
    Chirp(start_frequency=-2.0),
    Chirp(amplitude=-3.0, rate=40.0),
]


def exact_torque(chirp: Chirp, time: Any) -> Any:
    turns = mp.mpf(chirp.start_frequency) * time + mp.mpf(chirp.rate) * time**2 / 2
    return mp.mpf(chirp.amplitude) * mp.sin(2 * mp.pi * turns)


@pytest.mark.parametrize("chirp", CHIRPS, ids=repr)
@pytest.mark.parametrize("time", [0.0, 0.3, 7.77, 1e3, 1e6, -12.5, 123456789.0])
def test_the_chirp_is_as_exact_as_its_time(chirp: Chirp, time: float) -> None:
    with mp.workdps(40):
        expected = float(exact_torque(chirp, mp.mpf(time)))
    assert chirp.torque(time) == pytest.approx(expected, abs=1e-13 * abs(chirp.amplitude) + 1e-13)


def test_an_unreduced_phase_would_lose_the_chirp_at_late_times() -> None:
    chirp = Chirp()
    naive = chirp.amplitude * math.sin(2.0 * math.pi * (0.5 * 1e6 + 0.9 * 1e6**2 / 2.0))
    with mp.workdps(40):
        assert abs(naive - float(exact_torque(chirp, mp.mpf(1e6)))) > 1e-6 * chirp.amplitude


def test_drive_means_are_exact_for_polynomials() -> None:
    # f = 1 + s^3 on [0, 2] from t = 1 (s = t - 1): int (2 - s) f = 2 + 8/5, int s f = 2 + 32/5, times 2 / T^2 = 1/2.
    seen: list[float] = []

    def cubic(time: float) -> float:
        seen.append(time)
        return 1.0 + (time - 1.0) ** 3

    assert Drive(torque=cubic).torque_means(1.0, 2.0) == pytest.approx((1.8, 4.2))
    assert Drive(force_y=cubic).force_means[1](1.0, 2.0) == pytest.approx((1.8, 4.2))
    assert (Drive().torque_means(0.0, 1.0), Drive().force_means) == ((0.0, 0.0), ())
    assert all(type(time) is float for time in seen)
