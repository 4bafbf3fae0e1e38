"""Files as trackers, loggers and spreadsheets write them: values and notes of each, or the sentence that refuses it."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest

from jackbox_env import Chirp, Drive, Recording, Scene
from jackbox_env.commands.fit import column_names, read_recording
from jackbox_env.model.states import STATE_NAMES

FILES = Path(__file__).parents[1] / "data" / "files"
STILL = Scene(drive=None)
X = {"x_jack": [0.5, -0.25, 0.125]}
XY, ANGLES = {**X, "y_jack": [1.0, 1.0, math.nan]}, {"theta_jack": [math.pi / 2, math.pi / 4, 0.0]}
TORQUES = [30.0, 1.0]
BALL = "time=t,x_jack=ball (left)"
NO_HEADERS = "there must be a row of headers, time among them, and rows of numbers below, got "


class Case(NamedTuple):
    """A file, and what it gives."""

    file: str
    torques: list[float] | None = None
    states: dict[str, list[float]] = X
    dt: float = 0.1
    notes: tuple[str, ...] = ()
    columns: str = ""  # of the command
    frames: int = 3
    refused: str = ""  # the sentence
    scene: Scene = STILL
    scale: float | None = None  # pixels per metre


def left_out(headers: str) -> str:
    return f"left out, because no name stands for them: {headers}"


def bare(headers: str) -> str:
    return f"read in SI units, because no unit was found: {headers}"


def above(row: int) -> str:
    return f"what is above the headers, in row {row}, was left out"


UNIX = "times count from the first row, at {:.10g} s"
COARSE = "column time: is rounded to {} s, too coarsely to know which frames are missing"
FALL: dict[str, Any] = {"frames": 20, "dt": 1 / 60}
DAYS = "column x_jack: x_jack changes by up to 0.01 m from row to row, in {} s: minutes, hours, days, "
LARGE = Scene(drive=None, box_half_width=2e3)  # of steps of a metre
ROUNDED: dict[str, Any] = {"frames": 60, "states": {}, "scene": LARGE}
CASES = [
    # Encodings and ends of lines.
    Case("comma.csv", TORQUES),
    Case("bom_crlf.csv", TORQUES),
    Case("old_mac.csv", TORQUES),
    Case("utf16.csv", TORQUES),
    Case("utf16_big_endian.csv", TORQUES),
    Case("utf16_no_mark.csv", refused="; save a spreadsheet as CSV in UTF-8; Recording.from_frame"),
    Case("cp1252.csv", states=ANGLES, notes=(left_out("Größe"),)),
    Case("sheet.csv", refused="; save a spreadsheet as CSV in UTF-8; Recording.from_frame"),
    # Delimiters and decimal commas.
    Case("tabs.txt", TORQUES),
    Case("semicolons.csv", TORQUES),
    Case("bars.csv", TORQUES),
    Case("spaces.dat"),
    Case("excel_sep.csv", TORQUES, notes=(above(2),)),
    Case("decimal_commas.csv", TORQUES),
    Case("decimal_commas_tabs.txt", TORQUES),
    Case("decimal_commas_quoted.csv"),
    Case(
        "decimal_commas_between_commas.csv",
        refused="row 2: must have 2 cells like row 1, with commas between and points in numbers, got 4",
    ),
    Case("decimal_commas_version.csv", notes=(left_out("version"),)),
    Case("thousands.csv", refused="commas must be in all decimal numbers or in none, and in no thousands, got '1,500'"),
    Case("points_and_commas.csv", refused="must be in all decimal numbers or in none, and in no thousands, got '-1,25"),
    Case("trailing.csv", TORQUES),
    Case("trailing_in_rows.csv"),
    Case("trailing_tabs.txt", states={**X, "y_jack": [1e-3, 2e-3, 3e-3]}, dt=1e-3, scene=LARGE),
    Case("cut.csv", refused="row 4: must have 2 cells like row 1, with commas between and points in numbers, got 1"),
    Case("cut_tabs.txt", refused="row 4: must have 2 cells like row 1, with tabs between and points in numbers, got 1"),
    # Rows before the numbers.
    Case("comments.csv", TORQUES, notes=(above(3),)),
    Case("savetxt.txt"),
    Case("savetxt_commas.csv"),
    Case("no_headers.csv", refused=NO_HEADERS),
    Case("preamble.csv", TORQUES, notes=(above(5),)),
    Case("labview.lvm", columns="time=X_Value", notes=(above(5), left_out("Comment"))),
    Case("labview_long.lvm", columns="time=X_Value", refused="must have 3 cells like row 9, with tabs between"),
    Case("optitrack.csv", columns="x_jack=X #2", notes=(above(7), left_out("Frame, X, Y, Y"), bare("X"))),
    Case(
        "optitrack.csv", columns="x_jack=Jack X", refused="must be one of 'Frame', 'Time (Seconds)', 'X #1', 'Y #1', "
    ),
    Case("vicon.csv", columns="x_jack=X #1", notes=(above(4), left_out("Frame, Y [mm], X [mm], Y [mm]"))),
    Case("trackmate.csv", columns="time=T,x_jack=X", notes=(above(2), left_out("Label, Quality [quality]"))),
    Case("row_names_tabs.txt", refused="row 2: must have 2 cells like row 1, with tabs between and points in numbers"),
    Case("r_write_table.txt", refused="row 2: must have 2 cells like row 1, with spaces between and points in numbers"),
    Case("markdown.md", refused="must be a number or empty, got ':-----'"),
    Case("second_run_longer.csv", refused="row 8, column time: must increase up to 1e+10 s, got 0 s after 0.4 s"),
    Case("two_runs.csv", refused="row 6, column time: must increase up to 1e+10 s, got 0 s after 0.2 s"),
    Case("units_row.csv", TORQUES),
    Case("units_row_bare.csv", TORQUES),
    Case("units_comment.csv", states=X | ANGLES),
    Case(
        "ros.csv",
        states=X | {"theta_jack": [1.5, 0.75, 0.0]},
        notes=(bare("/jack/pose/yaw"),),
        columns="time=/clock,x_jack=/jack/pose/x,theta_jack=/jack/pose/yaw",
    ),
    Case("tracker.txt", states=XY, columns="time=t,x_jack=x,y_jack=y", notes=(above(2), bare("x, y"))),
    Case("tracker_two.txt", columns="time=t,x_jack=x", refused="row 3: column 'x' comes twice; choose one as x #1"),
    Case("time_twice.csv", columns="time=t #2", notes=(left_out("t"),)),
    Case("tracker_two.txt", columns="time=t,x_jack=x #2", notes=(above(3), left_out("x, y, y"), bare("x"))),
    *(Case(file, refused=NO_HEADERS) for file in ("deeplabcut.csv", "page.csv", "lines.csv", "document.csv")),
    *(Case(file, refused=NO_HEADERS) for file in ("plotter.log", "monitor.log")),
    # Cells.
    Case(
        "missing.csv",
        states={
            **X,
            "y_jack": [math.nan, 1.0, math.nan],
            "theta_box": [math.nan, 1.0, math.nan],
            "theta_jack": [math.nan, 1.0, math.nan],
            "y_box": [math.nan, 1.0, math.nan],
            "x_box": [0.0, 0.0, math.nan],
        },
    ),
    Case(
        "missing_marks.csv",
        states={**X, **{name: [math.nan, 1.0, math.nan] for name in ("x_box", "y_box", "y_jack")}},
    ),
    Case("minus.csv"),
    Case("fortran.dat", refused="must be a number or empty, got '0.0D+00'"),
    Case("thousands_spaces.csv", refused="must be a number or empty, got '500"),
    Case("iso.csv", notes=(UNIX.format(1767607200),)),
    Case("underscore.csv", refused="row 3, column x_jack: must be a number or empty, got '1_0'"),
    Case("clock.csv", states={"x_jack": [0.5, -0.25]}, frames=2),
    Case("not_available_first.csv", states={"x_jack": [math.nan, -0.25, 0.125]}),
    Case("division_first.csv", states={"x_jack": [math.nan, -0.25, 0.125]}),
    Case(
        "folded_box.csv",
        states={"theta_box": [math.radians(80 + 4 * k) for k in range(20)]},
        notes=("theta_box wraps: 1 jumps of a quarter turn were taken out",),
        **FALL,
    ),
    Case(
        "folded_jack.csv",
        states={"theta_jack": [math.radians(25 * k - 10) for k in range(20)]},
        notes=("theta_jack wraps: 3 jumps of half a turn were taken out",),
        **FALL,
    ),
    Case(
        "folded_cross.csv",
        states={"theta_jack": [math.radians(25 * k - 10) for k in range(20)]},
        notes=("theta_jack wraps: 5 jumps of a quarter turn were taken out",),
        **FALL,
    ),
    # Columns that are left out.
    Case("left_out.csv", TORQUES, notes=(left_out("clock, note, note"),)),
    Case("alike.csv", TORQUES, notes=(left_out("clock, torque_limit, torque_measured"),)),
    Case("pandas_index.csv"),
    Case("frame.csv", notes=(left_out("frame"),)),
    Case("capitals.csv", TORQUES),
    # Units.
    Case(
        "exponents.csv",
        TORQUES,
        {
            "omega_jack": [math.pi, math.pi / 2, 0.0],
            "vx_jack": [0.5, -0.25, 0.125],
            "vy_jack": [0.5, -0.25, 0.125],
        },
    ),
    Case("pasco.csv", columns="time=Time (ms) Run #1,x_jack=Position (mm) Run #1"),
    Case("pasco.csv", columns="time=Time (ms) Run #1,x_jack=Position (mm) Run #1 [m]", refused="has another unit than"),
    Case("parentheses.csv", TORQUES, {**X, "omega_jack": [math.pi, math.pi / 2, 0.0]}),
    Case("slashes.csv", TORQUES),
    Case("greek_mu.csv"),
    Case("unknown_parentheses.csv", refused="column 'x_jack (furlongs)' must be in one of the units m, cm, mm, "),
    Case(
        "word_in_parentheses.csv",
        columns=BALL,
        refused="must be in one of the units m, cm, mm, um, µm, meters, metres, micron, microns, got 'left'",
    ),
    Case("word_in_parentheses.csv", columns=f"{BALL} [m]"),
    Case("vernier.csv", columns="time=Latest: Time,x_jack=Latest: Position"),
    Case("two_units.csv", columns="x_jack=x (mm)", notes=(left_out("x (px)"),)),
    Case("two_units.csv", columns="x_jack=x", refused="row 1: column 'x (px)' comes twice"),
    Case(
        "empty_unit.csv",
        refused="column 'x_jack []' must be in one of the units m, cm, mm, um, µm, meters, metres, micron, microns, g",
    ),
    Case("parentheses.csv", columns="x_jack=x_jack [cm]", refused="(mm)' has another unit than 'x_jack [cm]', chosen"),
    Case("parentheses.csv", TORQUES, columns="x_jack=x_jack [mm]"),
    Case(
        "ending_degrees.csv",
        columns="time=t,theta_box=box_angle_deg",
        states={"theta_box": ANGLES["theta_jack"]},
        notes=(left_out("ball_x_mm"),),
    ),
    Case("ending_degrees.csv", columns="time=t,x_jack=ball_x_mm", notes=(left_out("box_angle_deg"),)),
    Case(
        "ending_degrees.csv",
        columns="time=t,x_jack=ball_x_mm [cm]",
        states={"x_jack": [5.0, -2.5, 1.25]},
        notes=(left_out("box_angle_deg"),),
    ),
    Case("ending_ms.csv", columns="time=t_ms,x_jack=ball_x_cm"),
    Case("opensim.mot", refused="angles are in degrees; give the unit, as in theta_box [deg], and remove"),
    Case(
        "opensim_radians.mot",
        states={"theta_jack": [0.05 * k for k in range(20)]},
        columns="time=time",
        notes=(above(7),),
        **FALL,
    ),
    # Times in other units.
    Case("minutes.csv", scene=Scene(drive=None, box_half_width=0.15, jack_arm=0.04), refused=DAYS.format("0.000278")),
    Case("hours.csv", refused=DAYS.format("4.63e-06")),
    Case("days.csv", refused=DAYS.format("1.93e-07")),
    Case("minutes_unit.csv", states={}, **FALL),
    Case("serial_days.csv", refused=DAYS.format("1.93e-07")),
    Case(
        "milliseconds.csv", refused="column time: time runs to 200 s in steps of 100 s, which must be at most 0.55 s: "
    ),
    Case("midnight.csv", refused="row 3, column time: must increase up to 1e+10 s, got 0 s after 86399.9 s"),
    Case("timecode.csv", refused="row 2, column time: must be a number or empty, got '0:00:01:00'"),
    # Positions, angles and rates in other units.
    Case("pixels.csv", states=XY, scale=200.0, notes=(left_out("frame"),)),
    Case("pixels.csv", refused="got 'px'; --scale (in Python scale=) gives pixels per metre"),
    Case("millimetres.csv", refused="the jack is up to 500 m from the centre of a box of half width 6 m: are unit "),
    Case(
        "millimetres.csv",
        columns="x_box=x_box [mm],x_jack=x_jack [mm]",
        scale=200.0,
        refused="scale goes with columns in ",
    ),
    Case(
        "degrees.csv",
        refused="column theta_jack: theta_jack changes by up to 348 rad from row to row, in 0.0167 s: deg",
    ),
    Case("rates_in_degrees.csv", refused="column omega_jack: is often above 108.5 rad/s: degrees?"),
    # Unix times.
    Case("unix.csv", TORQUES, notes=(UNIX.format(1.7e9),)),
    Case("unix.csv", TORQUES, notes=(UNIX.format(1.7e9),), scene=Scene()),  # a chirp is replaced by the torques
    Case("unix.csv", scene=Scene(drive=Drive(force_x=math.sin)), refused="the scene's drive depends on the time"),
    Case("unix_no_torque.csv", notes=(UNIX.format(1.7e9),)),
    Case("unix_no_torque.csv", scene=Scene(drive=Chirp()), refused="--torque none if nothing turns the box"),
    # Times as they are rounded.
    Case("rounded_60fps_1ms.csv", dt=1 / 60, **ROUNDED),
    Case("rounded_240fps_1ms.csv", dt=1 / 240, **ROUNDED),
    Case("rounded_30fps_10ms.csv", dt=1 / 30, **ROUNDED),
    Case("truncated_30fps_10ms.csv", dt=1 / 30, **ROUNDED),
    Case("rounded_60fps_10ms.csv", dt=1 / 60, **ROUNDED),
    Case("rounded_60fps_10ms_dropped.csv", refused=COARSE.format(0.01), scene=LARGE),
    Case("rounded_240fps_1ms_dropped.csv", dt=1 / 240, notes=("4 of 60 frames are missing, and left open",), **ROUNDED),
    Case("rounded_100fps_10ms_dropped.csv", refused=COARSE.format(0.01), scene=LARGE),
    Case("rounded_90fps_10ms.csv", dt=1 / 90, **ROUNDED),
    Case("rounded_90fps_10ms_dropped.csv", refused=COARSE.format(0.01), scene=LARGE),
    Case("rounded_59.94fps_10ms_dropped.csv", refused=COARSE.format(0.01), scene=LARGE),
]


@pytest.mark.parametrize("case", CASES, ids=lambda case: f"{case.file} {case.columns}{' refused' * bool(case.refused)}")
def test_a_file_is_read_or_a_sentence_says_why_not(case: Case) -> None:
    def read() -> Recording:
        return read_recording(FILES / case.file, case.scene, names=column_names(case.columns), scale=case.scale)

    if case.refused:
        with pytest.raises(ValueError, match=r"^[^\n]*$") as refused:
            read()
        assert str(refused.value).startswith(str(FILES / case.file))
        assert case.refused in str(refused.value)
        return
    recording = read()
    assert recording.notes == case.notes
    assert len(recording.states) == case.frames
    assert recording.dt == pytest.approx(case.dt, rel=2e-3)
    assert (recording.torques if recording.torques is None else recording.torques.tolist()) == (
        case.torques and pytest.approx(case.torques)
    )
    for name, values in case.states.items():
        np.testing.assert_allclose(recording.states[:, STATE_NAMES.index(name)], values, atol=1e-12)


def test_each_file_is_tried() -> None:
    assert {case.file for case in CASES} == {path.name for path in FILES.iterdir()}
