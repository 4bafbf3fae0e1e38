"""Recordings from columns as cameras write them: names, units, y downwards, wrapped angles, dropped frames."""

from __future__ import annotations

import math
from datetime import UTC, datetime
from typing import Any

import numpy as np
import pytest

from jackbox_env import Chirp, Recording, Scene
from jackbox_env.fits.tables import UNITS

STILL = Scene(drive=None)


class Frame:
    """What DataFrames of pandas and polars have in common: ``columns`` and ``frame[name]``."""

    def __init__(self, columns: dict[str, Any]) -> None:
        self.columns, self._columns = list(columns), columns

    def __getitem__(self, name: str) -> Any:
        return self._columns[name]


def observed(recording: Recording, name: str) -> list[float]:
    """A column of a recording's states."""
    values: list[float] = recording.states[:, list(UNITS).index(name) - 1].tolist()
    return values


@pytest.mark.parametrize("kind", [dict, Frame, "fields"])
def test_dicts_frames_and_named_fields_are_read(kind: Any) -> None:
    columns = {"time": [0.0, 0.1, 0.2], "x_jack": [1.0, np.nan, 2.0]}
    table: Any = np.array(list(zip(*columns.values(), strict=True)), dtype=[(name, float) for name in columns])
    recording = Recording.from_frame(table if kind == "fields" else kind(columns), STILL)
    np.testing.assert_array_equal(observed(recording, "x_jack"), [1.0, np.nan, 2.0])
    assert (recording.dt, recording.time, recording.torques, recording.notes) == (0.1, 0.0, None, ())


def test_units_are_converted() -> None:
    converted = {
        "time [ms]": ("time", 1e-3), "x_box [cm]": ("x_box", 1e-2), "x_jack [mm]": ("x_jack", 1e-3),
        "theta_box[deg]": ("theta_box", math.pi / 180.0), "theta_jack [°]": ("theta_jack", math.pi / 180.0),
        "vx_box [mm/s]": ("vx_box", 1e-3), "omega_box [rpm]": ("omega_box", math.pi / 30.0),
        "omega_jack [deg/s]": ("omega_jack", math.pi / 180.0), "torque [N mm]": ("torque", 1e-3),
    }  # fmt: skip
    recording = Recording.from_frame({header: [2.0, 3.0, 4.0] for header in converted}, STILL)
    assert [recording.dt, recording.time] == pytest.approx([1e-3, 2e-3])
    assert recording.torques is not None
    np.testing.assert_allclose(recording.torques, np.array([2e-3, 3e-3]))
    for name, factor in converted.values():
        if name not in ("time", "torque"):
            np.testing.assert_allclose(observed(recording, name), factor * np.array([2.0, 3.0, 4.0]))


def test_names_may_have_units_and_leave_other_columns_out() -> None:
    columns = {"t": [0.0, 20.0], ("dlc", "ball [mm]"): [5.0, 6.0], "x_box": [1.0, 1.0], "quality": [0.9, 0.8]}
    recording = Recording.from_frame(columns, STILL, names={"time": "t [ms]", "x_jack": "dlc ball"})
    assert recording.dt == pytest.approx(0.02)
    np.testing.assert_allclose(observed(recording, "x_jack"), [5e-3, 6e-3])
    assert observed(recording, "x_box") == [1.0, 1.0]
    assert recording.notes == ("left out, because no name stands for them: quality",)
    other = {"time": [0.0, 0.1], "x_jack": [1.0, 1.0], 7: [2.0, 2.0]}
    recording = Recording.from_frame(other, STILL, names={"x_jack": 7})  # type: ignore[dict-item]
    assert observed(recording, "x_jack") == [2.0, 2.0]
    assert recording.notes == (
        "left out, because no name stands for them: x_jack", "read in SI units, because no unit was found: 7",
    )  # fmt: skip


def test_only_columns_of_torques_cannot_be_left_out_where_the_drive_acts() -> None:
    columns = {"time": [0.0, 0.1], "ball": [1.0, 1.0]}
    for header in ("momentum_x", "marker x in m", "position m", "wavelength nm"):
        Recording.from_frame({**columns, header: [2.0, 2.0]}, names={"x_jack": "ball"})
    for header in ("box_tau", "Drehmoment", "motor (N.m)", "load [N·m]", "M_Nm", "M [N mm]", "motor (kN m)"):
        with pytest.raises(ValueError, match="is left out, and the scene's drive"):
            Recording.from_frame({**columns, header: [2.0, 2.0]}, names={"x_jack": "ball"})


def test_y_down_turns_y_and_angles_over_but_no_torque() -> None:
    names = list(UNITS)[1:-1]
    columns = {"time": [0.0, 0.1], "torque": [7.0, 7.0], **{name: [0.5, 0.5] for name in names}}
    recording = Recording.from_frame(columns, STILL, y_down=True)
    turned = {name for name in names if observed(recording, name)[0] == -0.5}
    assert turned == {f"{kind}_{body}" for kind in ("y", "theta", "vy", "omega") for body in ("box", "jack")}
    assert recording.torques is not None
    assert recording.torques.tolist() == [7.0]


def test_angles_that_wrap_are_unwrapped_and_others_are_not() -> None:
    angles = np.linspace(0.0, 20.0, 100)
    wrapped = (angles + 1.0) % (2.0 * math.pi) - 1.0
    wrapped[40] = np.nan
    times = 0.02 * np.arange(100)
    recording = Recording.from_frame({"time": times, "theta_box": angles, "theta_jack": wrapped}, STILL)
    np.testing.assert_array_equal(observed(recording, "theta_box"), angles)
    np.testing.assert_allclose(np.delete(observed(recording, "theta_jack"), 40), np.delete(angles, 40), atol=1e-12)
    assert recording.notes == ("theta_jack wraps: 3 jumps of a turn were taken out",)
    fast = {"time": [0.0, 0.5, 1.0, 1.5], "theta_jack": [0.0, 4.0, 8.0, 12.0]}
    assert observed(Recording.from_frame(fast, STILL), "theta_jack") == [0.0, 4.0, 8.0, 12.0]


@pytest.mark.parametrize("digits", [3, 4])
def test_rounded_times_are_even_and_dropped_frames_are_left_open(digits: int) -> None:
    frames = np.delete(np.arange(600), [7, 30, 31, 500])
    times = np.round(3.0 + frames / 60.0, digits)
    columns = {"time": times, "x_jack": 1e-3 * frames, "torque": frames // 10}
    recording = Recording.from_frame(columns, STILL)
    assert recording.dt == pytest.approx(1.0 / 60.0, rel=1e-5)
    assert recording.time == pytest.approx(3.0, abs=2e-4)
    assert np.flatnonzero(np.isnan(observed(recording, "x_jack"))).tolist() == [7, 30, 31, 500]
    assert recording.notes == ("4 of 600 frames are missing, and left open",)
    assert recording.torques is not None
    assert recording.torques[[29, 30, 31, 32]].tolist() == [2.0, 2.0, 2.0, 3.0]  # that of the row before goes on


def test_a_drive_is_recognised_in_a_file_with_dropped_frames() -> None:
    times = np.delete(0.02 * np.arange(50), [10, 11])
    torques = [0.5 * sum(Chirp().torque_means(time, 0.02)) for time in times.tolist()]
    columns = {"time": times, "x_jack": 0.0 * times, "torque": torques}
    assert Recording.from_frame(columns).torques is None
    assert Recording.from_frame(columns, {"drive": None}).torques is not None


def test_a_drive_does_not_begin_at_the_time_of_day() -> None:
    times = 51_785.1 + 0.02 * np.arange(5)
    columns = {"time": times, "x_jack": np.zeros(5)}
    with pytest.raises(ValueError, match="begins at 51785.1 s, and the scene's drive depends on the time"):
        Recording.from_frame(columns)
    assert Recording.from_frame(columns, STILL).time == times[0]
    assert Recording.from_frame({**columns, "torque": np.zeros(5)}).time == times[0]


MOMENTS = np.array(["2026-01-05T10:00:00.0", "2026-01-05T10:00:00.1", "2026-01-05T10:00:00.2"], "M8[ms]")


@pytest.mark.parametrize(
    ("times", "from_first"),
    [
        (MOMENTS, True),
        (MOMENTS.astype("M8[us]"), True),
        ([datetime(2026, 1, 5, 10, 0, 0, 100_000 * n, UTC) for n in range(3)], True),
        (MOMENTS - MOMENTS[0], False),
        ((MOMENTS - MOMENTS[0]).astype("m8[ns]"), False),
    ],
    ids=str,
)
@pytest.mark.parametrize("header", ["time", "time [ms]"])
def test_moments_and_durations_are_times(header: str, times: Any, from_first: bool) -> None:
    recording = Recording.from_frame({header: times, "x_jack": [1.0, 2.0, 3.0]}, STILL)
    assert recording.dt == pytest.approx(0.1, rel=1e-5)
    assert recording.notes == ("times count from the first row, at 1767607200 s",) * from_first


def test_zeros_of_a_jack_that_is_elsewhere_are_lost_frames() -> None:
    x, y = [0.0, 0.2, 0.0, 0.4, 0.0], [0.0, 0.1, 0.0, 0.1, 0.3]
    recording = Recording.from_frame({"time": 0.1 * np.arange(5), "x_jack": x, "y_jack": y}, STILL)
    np.testing.assert_array_equal(observed(recording, "x_jack"), [0.0, 0.2, math.nan, 0.4, 0.0])
    assert recording.notes == ("x_jack and y_jack are 0 in 1 rows, as of lost frames, which are left open",)


def test_masked_values_were_not_observed() -> None:
    seen = np.ma.array([1.0, 2.0, 3.0], mask=[False, True, False])
    recording = Recording.from_frame({"time": [0.0, 0.1, 0.2], "x_jack": seen}, STILL)
    np.testing.assert_array_equal(recording.states[:, 3], [1.0, math.nan, 3.0])


def test_impacts_of_another_clock_are_refused() -> None:
    columns = {"time": [0.0, 0.1], "x_jack": [1.0, 1.0]}
    assert Recording.from_frame(columns, STILL, impacts=[0.05, 7.0]).impacts is not None
    within = "impacts must be within the recording, from 0 to 0.1 s, got 1700 s first: another clock?"
    with pytest.raises(ValueError, match=within):
        Recording.from_frame(columns, STILL, impacts=[1700.0, 1700.1])
