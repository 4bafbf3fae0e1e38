"""The commands of the package refuse files and options in one sentence, with status 2, and write nothing."""

from __future__ import annotations

import io
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jackbox_env.commands import fit, play, simulate
from tests.refusals.sentences import Refusal, assert_refused, command, refused, rows

pytest.importorskip("scipy")

SIMULATED = {"states.csv": "time [s],x_box [m]\n0,1\n0.1,1\n", "impacts.csv": "time [s],wall,foot\n0.05,0,0\n"}
NPZ = command(fit.main, "bad.npz")
FITTED = command(fit.main, "bad.csv", "--fields", "jack_mass")


def npz(arrays: dict[str, Any]) -> bytes:
    np.savez(file := io.BytesIO(), **arrays)
    return file.getvalue()


def fits(*words: str) -> Callable[[Any], None]:
    return command(fit.main, "states.csv", "--fields", "jack_mass", *words)


def simulates(words: str) -> Callable[[Any], None]:
    return command(simulate.main, "--no-plots", *words.split())


FITS = [
    refused(NPZ, "bad.npz: there must be an array state, got states", {"bad.npz": npz({"states": np.zeros((2, 12))})}),
    refused(
        NPZ,
        "bad.npz, state must have shape (n, 12), got (2, 11)",
        {"bad.npz": npz({"state": np.zeros((2, 11)), "time": np.arange(2.0)})},
    ),
    refused(
        NPZ,
        "bad.npz, row 1: column time [s] must be one of 'x_box', 'y_box', 'theta_box', 'x_jack', "
        "'y_jack', 'theta_jack', 'vx_box', 'vy_box', 'omega_box', 'vx_jack', 'vy_jack', 'omega_jack'",
        {"bad.npz": npz({"state": np.zeros((2, 12))})},
    ),
    refused(
        NPZ,
        "bad.npz, scene must be a JSON object, got '{'",
        {"bad.npz": npz({"state": np.zeros((2, 12)), "time": np.arange(2.0) / 9, "scene": np.array("{")})},
    ),
    refused(
        NPZ,
        "bad.npz: must be an npz file of jackbox simulate, got ...",
        {"bad.npz": npz({"state": np.array([None, {}], dtype=object)})},
    ),
    refused(NPZ, "bad.npz: must be an npz file of jackbox simulate, got ...", {"bad.npz": "nothing"}),
    refused(
        FITTED,
        "bad.csv: there must be a row of headers, time among them, ...; Recording.from_frame accepts what pandas reads",
        {"bad.csv": ""},
    ),
    refused(
        command(fit.main, "bad.csv", "--columns", "time=t,x_jack=x"),
        "bad.csv: there must be a row of headers, t among them, ...; save a spreadsheet as CSV in UTF-8; ...",
        {"bad.csv": "PK\3\4\nt,x\n0,1\n0.1,1\n"},
    ),
    refused(
        FITTED,
        "bad.csv, row 1: columns must have one of the 12 numbers of a state; --columns (in Python names=) maps other "
        "headers, got time, x_jac",
        {"bad.csv": "time,x_jac\n0,1\n1,1\n"},
    ),
    refused(
        FITTED,
        "bad.csv, row 1: column 'theta_box [mm]' must be in one of the units rad, deg, °, mrad, degrees, "
        "radians, rev, got 'mm'",
        {"bad.csv": "time,theta_box [mm]\n0,1\n"},
    ),
    refused(FITTED, "bad.csv, row 1: column 'x_box [m]' comes twice", {"bad.csv": "time,x_box,x_box [m]\n0,1,2\n"}),
    refused(FITTED, "bad.csv, row 2: there must be two rows of numbers at least", {"bad.csv": "time,x_box\n0,1\n"}),
    refused(FITTED, "bad.csv, row 1: there must be two rows of numbers at least", {"bad.csv": "time,x_box\n"}),
    refused(
        FITTED,
        "bad.csv, row 5, column x_box: must be a number or empty, got 'left'",
        {"bad.csv": "time,x_box\n0,1\n\n0.1,1\n0.2,left\n"},
    ),
    refused(
        FITTED,
        "bad.csv, row 3, column x_box: must be a number or empty, got 'inf'",
        {"bad.csv": "time,x_box\n0,1\n0.1,inf\n"},
    ),
    refused(
        FITTED,
        "bad.csv, row 3: must have 2 cells like row 1, with commas between and points in numbers, got 1",
        {"bad.csv": "time,x_box\n0,1\n0.1\n"},
    ),
    refused(FITTED, "bad.csv, row 3, column time: must be a number, got none", {"bad.csv": "time,x_box\n0,1\n,2\n"}),
    refused(
        FITTED,
        "bad.csv, row 5, column time: must increase evenly, to 5% of a step, by 0.1 s or a multiple where "
        "frames are missing, got 0.35 s",
        {"bad.csv": "time,x_box\n0,1\n0.1,1\n0.2,1\n0.55,1\n"},
    ),
    refused(
        FITTED,
        "bad.csv, row 3, column time: must increase up to 1e+10 s, got 0.1 s after 0.1 s",
        {"bad.csv": "time,x_box\n0.1,1\n0.1,1\n"},
    ),
    refused(
        FITTED,
        "bad.csv, row 3, column time: must increase up to 1e+10 s, got 0.2 s after 0.3 s",
        {"bad.csv": "time,x_box\n0.3,1\n0.2,1\n0.1,1\n"},
    ),
    refused(
        FITTED,
        "bad.csv, row 3, column time: must increase up to 1e+10 s, got 1.7e+308 s after 0 s",
        {"bad.csv": "time,x_box\n0,1\n1.7e308,1\n"},
    ),
    refused(
        FITTED,
        "bad.csv: dt must be a finite number at least 1e-09 and at most 1e+09, got 1e-300",
        {"bad.csv": "time,x_box\n0,1\n1e-300,1\n"},
    ),
    refused(
        FITTED,
        "bad.csv, column time: 88 frames are missing between 3 rows; give stretches as recordings of their own",
        {"bad.csv": "time,x_box\n0,1\n0.1,1\n9,1\n"},
    ),
    refused(
        FITTED,
        "bad.csv, column time: time runs to 6,012 s in steps of 16.7 s, which must be at most 0.55 s: ...",
        {"bad.csv": "time,x_box\n" + "".join(f"{16.7 * row:.1f},1\n" for row in range(361))},
    ),
    refused(
        FITTED,
        "bad.csv, the jack is up to 5,000 m from the centre of a box of half width 6 m: ...",
        {"bad.csv": "time,x_box,x_jack\n0,0,4800\n0.1,0,5000\n"},
    ),
    refused(
        FITTED,
        "bad.csv, column y_jack: y_jack changes by up to 800 m from row to row, in 0.1 s: ...",
        {"bad.csv": "time,y_jack\n0,0\n0.1,800\n"},
    ),
    refused(
        FITTED,
        "bad.csv, column theta_jack: theta_jack changes by up to 345 rad from row to row, in 0.1 s: degrees?",
        {"bad.csv": "time,theta_jack\n0,350\n0.1,5\n0.2,10\n0.3,15\n"},
    ),
    refused(
        FITTED,
        "bad.csv, row 3, column torque: must be a number, got none",
        {"bad.csv": "time,x_box,torque\n0,1,5\n0.1,1,\n0.2,1,5\n"},
    ),
    refused(
        FITTED,
        "bad.csv: states must have an observed number, got NaN only and no impacts",
        {"bad.csv": "time,x_box\n0,\n0.1,\n"},
    ),
    refused(fits("--noise", "loud"), "noise must be a number or a JSON object, got 'loud'", SIMULATED),
    refused(
        fits("--impacts", "impacts.csv", "impacts.csv"),
        "impacts must be 1 files, one for each recording, got 2",
        SIMULATED,
    ),
    refused(
        fits("--impacts", "states.csv"),
        "states.csv: must have times of impacts, got states with a column 'x_box [m]'",
        SIMULATED,
    ),
    refused(fits("--folder", "here"), "folder goes with --html, without which nothing is written", SIMULATED),
    refused(fits("--columns", "x_jack"), "columns must be like x_jack=ball_x,time=t_ms, ..., got 'x_jack'", SIMULATED),
    refused(fits("--columns", "x_jack=x,x_jack=y"), "columns must be like ..., each name once, got ...", SIMULATED),
    refused(
        fits("--columns", "x_jack=x,y_jack=x"), "states.csv, names must be of different headers, got ...", SIMULATED
    ),
    refused(
        fits("--columns", "x_jak=x_jack"),
        "names accepts only 'time', 'x_box', 'y_box', 'theta_box', 'x_jack', 'y_jack', 'theta_jack', 'vx_box', "
        "'vy_box', 'omega_box', 'vx_jack', 'vy_jack', 'omega_jack', 'torque', got 'x_jak' (did you mean 'x_jack'?)",
        SIMULATED,
    ),
    refused(
        fits("--columns", "x_jack=ball"),
        "states.csv, row 1: column 'ball', which is to be x_jack, must be one of 'time [s]', 'x_box [m]'",
        SIMULATED,
    ),
    refused(
        fits("--scene", '{"jack_mas": 4}'),
        "scene accepts only 'box_half_width', 'box_mass', 'box_inertia', 'jack_arm', 'jack_mass', "
        "'jack_inertia', 'gravity', 'restitution', 'torque_limit', 'drive', got 'jack_mas' (did you mean 'jack_mass'?)",
        SIMULATED,
    ),
    refused(
        fits("--html", "--folder", "out"),
        "out exists, and is never overwritten: choose another place",
        {"states.csv": "time,x_box\n0,1\n0.1,1\n", "out/a.b": ""},
    ),
    refused(
        command(fit.main, "a/states.csv", "b/states.csv"),
        "the recordings must be of one scene, got different ones in a/scene.json and b/scene.json",
        {
            "a/states.csv": "time,x_box\n0,1\n0.1,1\n",
            "a/scene.json": "{}",
            "b/states.csv": "time,x_box\n0,1\n0.1,1\n",
            "b/scene.json": '{"gravity": 1.62}',
        },
    ),
    refused(
        command(fit.main, "pushed.csv", "--torque", "none"),
        "pushed.csv: --torque none is for files without a column torque",
        {"pushed.csv": "time,x_box,torque\n0,0,0\n0.1,0,0\n"},
    ),
    refused(
        command(fit.main, "still.csv", "--torque-column", "linear"),
        "--torque-column goes with a column torque, which no file has",
        {"still.csv": "time,x_jack\n0,0\n0.1,0\n"},
    ),
    refused(
        command(fit.main, "unix.csv"),
        "unix.csv, column time: begins at 1700000000 s, and the scene's drive depends on the time: give the "
        "drive's times; --torque none if nothing turns the box",
        {"unix.csv": "time,x_jack\n1700000000.0,1\n1700000000.02,1\n"},
    ),
]
SIMULATIONS = [
    refused(simulates("--seconds nan"), "seconds must be a finite number above 0 and at most 1e+06, got nan"),
    refused(simulates("--state [1,2]"), "state must have shape (12,), got shape (2,)"),
    refused(
        simulates("--state [0,0,0,6.5,0,0,0,0,0,0,0,0]"), "state must have every foot at most 1 m outside, got 1.5 m"
    ),
    refused(
        simulates("--state " + "[" * 100_000),
        "state must be a JSON list, got "
        "'[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[[...",
    ),
    refused(
        command(play.main, "--out", "page.html"),
        "page.html exists, and is never overwritten: choose another place",
        {"page.html": ""},
    ),
    refused(simulates("--folder /dev/null/runs"), "/dev/null cannot be used: Not a directory"),
    refused(simulates("--folder /proc/runs"), "/proc cannot be used: No such file or directory"),
    refused(
        simulates('--scene {"gravity":-1}'), "gravity must be a finite number at least 0 and at most 1e+60, got -1"
    ),
    refused(simulates("--seconds 1e4 --html"), "html takes at most 20,000 steps, got seconds / dt = 500000"),
    refused(
        simulates('--state {"x":1}'),
        "state accepts only 'x_box', 'y_box', 'theta_box', 'x_jack', 'y_jack', 'theta_jack', 'vx_box', "
        "'vy_box', 'omega_box', 'vx_jack', 'vy_jack', 'omega_jack', got 'x'",
    ),
    refused(simulates('--state {"x_jack":"a"}'), "x_jack in state must be a finite number, got 'a'"),
    refused(simulates("--state x_jack=1"), "state must be a JSON object, got 'x_jack=1'"),
    refused(simulates("--film run.avi"), "a film must be a .gif or .mp4 file, got 'run.avi'"),
    refused(simulates("--seconds 1e6"), "duration / dt must be at most 10,000,000 steps, got 1e+06 / 0.02"),
    refused(simulates("--film run.gif --seconds 61"), "seconds of a film must be a finite number at most 60, got 61.0"),
    refused(
        simulates('--gravity 3 --scene {"gravity":2}'), "gravity must be chosen once, got 2 in --scene and 3 beside it"
    ),
    refused(simulates("--restitution 2"), "restitution must be a finite number at least 0 and at most 1, got 2.0"),
    refused(simulates("--folder out"), "out exists, and is never overwritten: choose another place", {"out/a.b": ""}),
    refused(
        simulates("--film run.gif"), "run.gif exists, and is never overwritten: choose another place", {"run.gif": ""}
    ),
]


@rows([*FITS, *SIMULATIONS])
def test_a_command_refuses_in_one_sentence_and_writes_nothing(row: Refusal) -> None:
    assert_refused(row)
