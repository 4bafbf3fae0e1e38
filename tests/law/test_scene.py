"""Scene, Chirp and Drive: what they accept, what they derive, and the chirp's averages against 40 digits."""

from __future__ import annotations

import dataclasses
import math
import pickle
from typing import Any

import mpmath as mp
import numpy as np
import pytest

from jackbox_env.env import JackInBoxEnv
from jackbox_env.planning import rollout
from jackbox_env.scene import Chirp, Drive, Scene
from jackbox_env.vector_env import JackInBoxVectorEnv


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


def test_numbers_are_kept_as_python_floats() -> None:
    scene = Scene(
        box_half_width=np.float32(3.0),  # type: ignore[arg-type]
        box_mass=2,
        jack_mass=np.int64(5),  # type: ignore[arg-type]
        drive=Chirp(rate=np.float64(1.0)),
    )
    for part in dataclasses.fields(scene):
        if part.name != "drive":
            assert type(getattr(scene, part.name)) is float, part.name
    assert type(scene.drive.rate) is float  # type: ignore[union-attr]
    assert scene.box_inertia == 18.0
    assert Scene(box_inertia=7).box_inertia == 7.0


def test_scenes_are_frozen_equal_by_value_and_picklable() -> None:
    scene = Scene(gravity=0.0)
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.gravity = 1.0  # type: ignore[misc]
    assert scene == Scene(gravity=0.0) == pickle.loads(pickle.dumps(scene))
    assert hash(scene) == hash(Scene(gravity=0.0))


def test_scenes_come_from_dicts() -> None:
    assert Scene.of(None) == Scene()
    assert Scene.of({"gravity": 1.62, "drive": {"rate": 0.0}}) == Scene(gravity=1.62, drive=Chirp(rate=0.0))
    assert Scene.of(dataclasses.asdict(Scene(jack_arm=2.0))) == Scene(jack_arm=2.0)
    with pytest.raises(ValueError, match="scene takes only 'box_half_width', .*, got 'mass'"):
        Scene.of({"mass": 3.0})
    with pytest.raises(ValueError, match="drive takes only 'amplitude', 'start_frequency', 'rate', got 'gain'"):
        Scene.of({"drive": {"gain": 3.0}})
    with pytest.raises(TypeError, match="scene must be a Scene, a dict of its fields or None, got 3"):
        Scene.of(3)  # type: ignore[arg-type]


LENGTHS_AND_MASSES = ["box_half_width", "box_mass", "box_inertia", "jack_arm", "jack_mass", "jack_inertia"]


@pytest.mark.parametrize("name", [*LENGTHS_AND_MASSES, "torque_limit"])
@pytest.mark.parametrize("bad", [0.0, -1.0, math.nan, math.inf, 5e-324, 1e61, "1", True, [1.0], 10**400])
def test_impossible_quantities_are_refused(name: str, bad: Any) -> None:
    with pytest.raises((TypeError, ValueError), match=f"{name} must be a finite number at least 1e-60 and at most 1e"):
        Scene(**{name: bad})


@pytest.mark.parametrize(
    ("field", "bad", "sentence"),
    [
        ("gravity", -9.81, "gravity must be a finite number at least 0 and at most 1e[+]60, got -9.81"),
        ("restitution", 1.01, "restitution must be a finite number at least 0 and at most 1, got 1.01"),
        ("restitution", -0.1, "restitution must be a finite number at least 0 and at most 1, got -0.1"),
        ("jack_arm", 8.5, r"jack_arm must be below sqrt\(2\) \* box_half_width = 8.48528 m to fit, got 8.5 m"),
        ("drive", 3.0, "drive must be a Chirp, a Drive, a dict of Chirp's fields or None, got 3.0"),
        ("drive", Chirp, "drive must be a Chirp"),
    ],
)
def test_other_fields_out_of_range_are_refused(field: str, bad: Any, sentence: str) -> None:
    with pytest.raises((TypeError, ValueError), match=sentence):
        Scene(**{field: bad})


def test_an_arm_that_fits_only_at_some_angles_is_a_scene() -> None:
    assert Scene(jack_arm=8.48).jack_arm == 8.48


@pytest.mark.parametrize("name", ["amplitude", "start_frequency", "rate"])
@pytest.mark.parametrize("bad", [math.nan, math.inf, "1", None, 1e61])
def test_impossible_chirps_are_refused(name: str, bad: Any) -> None:
    with pytest.raises((TypeError, ValueError), match=f"{name} must be a finite number at least -1e.* at most 1e"):
        Chirp(**{name: bad})


def test_drives_take_functions_only() -> None:
    with pytest.raises(TypeError, match="force_x must be a function of the time in s or None, got 3"):
        Drive(force_x=3)  # type: ignore[arg-type]
    assert Drive().torque_means(0.0, 1.0) == (0.0, 0.0)
    assert Drive().force_means == ()


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


@pytest.mark.parametrize("chirp", CHIRPS, ids=repr)
@pytest.mark.parametrize(
    ("time", "duration"), [(0.0, 0.005), (3.0, 0.02), (9.5, 0.1), (1e3, 0.0005), (-4.0, 0.02), (1e6, 1e-6)]
)
def test_the_chirps_means_under_triangles(chirp: Chirp, time: float, duration: float) -> None:
    with mp.workdps(40):
        start, length = mp.mpf(time), mp.mpf(duration)
        turns = duration * (abs(chirp.start_frequency) + abs(chirp.rate) * (abs(time) + duration))
        pieces = mp.linspace(0, length, 2 + int(2 * turns))
        falling = mp.quad(lambda s: 2 * (length - s) / length**2 * exact_torque(chirp, start + s), pieces)
        rising = mp.quad(lambda s: 2 * s / length**2 * exact_torque(chirp, start + s), pieces)
    found = chirp.torque_means(time, duration)
    tolerance = 2e-13 * abs(chirp.amplitude)  # late times too, where the interval's middle is rounded
    np.testing.assert_allclose(found, [float(falling), float(rising)], rtol=0.0, atol=tolerance)


def test_a_chirp_too_fast_to_follow_is_refused() -> None:
    with pytest.raises(ValueError, match=r"the chirp turns 9e\+05 times in the 1 s after t = 1e\+06 s, at most 83333"):
        Chirp().torque_means(1e6, 1.0)
    Chirp().torque_means(1e6, 1e-4)


def test_drive_means_are_exact_for_polynomials() -> None:
    # f = 1 + s^3 on [0, 2] from t = 1 (s = t - 1): int (2 - s) f = 2 + 8/5, int s f = 2 + 32/5, times 2 / T^2 = 1/2.
    seen: list[float] = []

    def cubic(time: float) -> float:
        seen.append(time)
        return 1.0 + (time - 1.0) ** 3

    assert Drive(torque=cubic).torque_means(1.0, 2.0) == pytest.approx((1.8, 4.2))
    assert all(type(time) is float for time in seen)


def test_a_drive_that_answers_nan_is_refused() -> None:
    with pytest.raises(ValueError, match=r"force_y\(.* s\) must be a finite number, got nan"):
        Drive(force_y=lambda t: math.nan).force_means[1](0.0, 0.1)


@pytest.mark.parametrize("name", ["state", "torques"])
def test_masked_numbers_are_refused(name: str) -> None:
    state, torques = np.array([0.0] * 5 + [0.7] + [0.0] * 6), np.zeros((1, 3))
    whole = {"state": np.ma.array(state, mask=False), "torques": np.ma.array(torques, mask=False)}
    rollout(None, whole["state"], whole["torques"], 0.02)
    whole[name][..., 1] = np.ma.masked
    with pytest.raises(ValueError, match=f"{name}.* must hold .*, none of them masked, got masked_array"):
        rollout(None, whole["state"], whole["torques"], 0.02)


def test_masked_actions_masks_and_times_are_refused() -> None:
    hidden = np.ma.array([0.5], mask=[True], dtype=np.float32)
    single, several = JackInBoxEnv(), JackInBoxVectorEnv(2, contact="exact")
    several.reset(seed=0)
    single.reset(seed=0)
    before = several.states
    for call in (
        lambda: single.step(hidden),
        lambda: single.reset(options={"state": np.ma.array(np.zeros(12), mask=[True] + [False] * 11)}),
        lambda: several.step([hidden, [0.5]]),  # type: ignore[arg-type]
        lambda: several.set_states(before, 0.0, np.ma.array([True, True], mask=[True, False])),
    ):
        with pytest.raises((TypeError, ValueError), match="masked"):
            call()
    np.testing.assert_array_equal(several.states, before)
    assert single.step(np.ma.array([0.5], dtype=np.float32))[4]["torque"] == 45000.0
