"""Unusable arguments of plans, derivatives, motions, recordings and fits are refused in one sentence."""

from __future__ import annotations

import math
from collections.abc import Callable
from functools import cache, partial
from operator import attrgetter
from pathlib import Path
from typing import Any

import numpy as np

from jackbox_env import Chirp, JackLostError, Recording, cheapest, fit, ilqr, linearize, simulate
from jackbox_env.fits.tables import read_arrays, read_table
from tests.measuring.test_fitting import START as LIGHT
from tests.measuring.test_fitting import recorded as noisy
from tests.measuring.test_tables import DAMAGED
from tests.refusals.sentences import START, Refusal, Subject, assert_refused, files, rows

ZEROS = np.zeros(12)

# -- plans and derivatives ---------------------------------------------------------------------------------------------

LINEAR = Subject(
    lambda: linearize(None, np.zeros((2, 12)), np.zeros(3), 0.02),
    shown=attrgetter("trajectories", "smooth", "A", "B", "P"),
)


def costing(returned: Any) -> Callable[[Any], object]:
    return lambda _: ilqr(None, START, [0.0], 0.02, cost=lambda states: returned, repeat=2)


PLANS = [
    Refusal(costing(1.0), TypeError, "cost must return costs, slopes and curvatures, got 1.0"),
    Refusal(costing(("a", 1.0, 1.0)), TypeError, "cost's costs must be numbers, got 'a'"),
    Refusal(
        costing((np.zeros(4), np.zeros(4), np.zeros(4))),
        ValueError,
        "cost's costs must be finite and have shape (2,), got ... of (4,)",
    ),
    Refusal(
        costing((np.full(2, math.nan), np.zeros((2, 12)), np.zeros((2, 12, 12)))),
        ValueError,
        "cost's costs must be finite and have shape (2,), got ... of (2,)",
    ),
    Refusal(
        lambda lin: lin.vjp(np.zeros((2, 3, 12))), ValueError, "g must have shape (2, 4, 12), got (2, 3, 12)", LINEAR
    ),
    Refusal(lambda lin: lin.jvp(dtorques=np.zeros(3)), ValueError, "dtorques must have shape (2, 3), got (3,)", LINEAR),
    Refusal(lambda lin: lin.vjp("up"), TypeError, "g must be numbers, got 'up'", LINEAR),
    Refusal(lambda lin: lin.impacts(2), ValueError, "row must be a whole number from 0 to 1, got 2", LINEAR),
    *(
        Refusal(lambda lin, name=name: getattr(lin, name).__setitem__(0, 0), ValueError, "...read-only", LINEAR)
        for name in ("trajectories", "smooth", "A", "B", "P")
    ),
    Refusal(
        lambda _: linearize(None, ZEROS, None, 0.02),
        TypeError,
        "steps must be a whole number from 0 to 10000000, got None",
    ),
    Refusal(
        lambda _: linearize(None, ZEROS, np.zeros(3), 0.02, steps=3),
        TypeError,
        "steps must be None if there are torques, got 3",
    ),
    Refusal(
        lambda _: linearize(None, ZEROS, None, 0.02, steps=3, repeat=2),
        ValueError,
        "repeat must be 1 if torques is None, got 2",
    ),
    Refusal(
        lambda _: linearize(None, np.zeros((4, 12)), None, 0.02, [0.0, 1.0], steps=25),
        ValueError,
        "time must be one number or 4, as many as rows, got [0.0, 1.0]",
    ),
]

# -- motions -----------------------------------------------------------------------------------------------------------

STATES = attrgetter("t", "states")
MOTION = cache(lambda: simulate(duration=0.25))
PYMUNKS = [
    Subject(partial(simulate, duration=4.0, fidelity=fidelity), shown=STATES) for fidelity in ("coarse", "balanced")
]
STEPS_ONLY = (
    "this motion has states at the ends of control steps only: between them and at impacts there are states with "
    "fidelity='exact'"
)
MOTIONS = [
    Refusal(
        lambda _: simulate(torque=lambda: 1.0),
        TypeError,
        "torque must be a function of the time, or of time and state, got <function <lambda>.<locals>...",
    ),
    Refusal(lambda _: simulate(torque=lambda t: 1.0 / 0.0), ZeroDivisionError, "...division by zero"),
    Refusal(
        lambda _: simulate(None, [0.0] * 11 + [1e9], 2.0),
        JackLostError,
        "the jack needs more than 1,000,000 gap evaluations in the dt = 0.02 s after t = 1 s; use a "
        "smaller time step or less torque",
    ),
    *(
        Refusal(call, ValueError, STEPS_ONLY, motion)
        for motion in PYMUNKS
        for call in (
            lambda motion: motion(0.1),
            lambda motion: motion.restart(0),
            lambda motion: motion.work(),
            lambda motion: motion.work(0.1),
        )
    ),
    Refusal(
        lambda _: MOTION().save("run.npz"),
        FileExistsError,
        "run.npz exists, and is never overwritten: choose another place",
        files({"run.npz": ""}),
    ),
    Refusal(
        lambda _: MOTION().save("run.xls"),
        ValueError,
        "the suffix of path must be one of '.npz', '.csv', '.mat', got '.xls'",
        files({}),
    ),
    *(
        Refusal(
            lambda _, suffix=suffix: MOTION().save(f"missing/run{suffix}"),
            FileNotFoundError,
            f"[Errno 2] No such file or directory: 'missing/run{suffix}'",
            files({}),
        )
        for suffix in (".npz", ".csv", ".mat")
    ),
    Refusal(
        lambda _: read_table(Path("huge.csv"), "torque"),
        ValueError,
        "huge.csv, row 2: field larger than field limit (131072)",
        files({"huge.csv": "time,torque\n0," + "1" * 200_000 + "\n"}),
    ),
    *(
        Refusal(
            lambda _, array=array: read_table(Path("bad.npz"), array),
            ValueError,
            "bad.npz: must be an npz file of jackbox simulate, got ...",
            files({"bad.npz": content}),
        )
        for content in DAMAGED.values()
        for array in ("state", "torque", "impact_time")
    ),
    Refusal(
        lambda _: read_arrays(Path("none.npz")),
        FileNotFoundError,
        "[Errno 2] No such file or directory: 'none.npz'",
        files({}),
    ),
]

# -- recordings --------------------------------------------------------------------------------------------------------


def framed(torque: str = "held", scene: Any = None, **change: Any) -> Callable[[Any], object]:
    arguments = {"columns": {"time": [0.0, 0.1], "x_jack": [0.0, 1.0]}, "scene": scene, "torque": torque, **change}
    return lambda _: Recording.from_frame(**arguments)


def recorded(**change: Any) -> Callable[[Any], object]:
    return lambda _: Recording(**{"states": np.zeros((4, 12)), "torques": np.zeros(3), "dt": 0.02, **change})


COLUMNS = [
    Refusal(framed(columns=[1.0]), TypeError, "columns must be a dict of columns or a DataFrame, got [1.0]"),
    Refusal(
        framed(columns={"time": [0.0, 1.0], "x_jack": [1.0]}),
        ValueError,
        "columns must have the same number of rows, got time 2, x_jack 1",
    ),
    Refusal(framed(columns={"time": ["a", "b"]}), TypeError, "column 'time' must be numbers, got ['a', 'b']"),
    Refusal(framed(columns={"time": [0.0, "b"]}), TypeError, "column 'time' must be numbers, got [0.0, 'b']"),
    Refusal(framed(columns={"time": [[0.0]]}), TypeError, "column 'time' must be numbers, got [[0.0]]"),
    Refusal(
        framed(columns={"time": [0.0], "x_jack": np.array(["2026-01-01"], "M8[s]")}),
        TypeError,
        "column 'x_jack' must be numbers, got array(['2026-01-01T00:00:00'], dtype='datetime64[s]')",
    ),
    Refusal(
        framed(columns={"time": [0.0, math.inf]}),
        ValueError,
        "row 1, column time: must be a finite number or NaN, got inf",
    ),
    Refusal(framed(columns={"x_jack": [0.0, 1.0]}), ValueError, "column time [s] must be one of 'x_jack'"),
    Refusal(
        framed(columns={"time": [0.0, 0.1], "ball": [0.0, 1.0]}),
        ValueError,
        "columns must have one of the 12 numbers of a state; --columns (in Python names=) maps other headers, got "
        "time, ball",
    ),
    Refusal(
        framed(columns={"time": [0.0, None], "x_jack": [0.0, 1.0]}),
        ValueError,
        "row 1, column time: must be a number, got none",
    ),
    Refusal(
        framed(columns={"time": [0.0, 0.1], "x_jack": [None, None]}),
        ValueError,
        "states must have an observed number, got NaN only and no impacts",
    ),
    Refusal(
        framed(torque="sampled", columns={"time": [0.0, 0.1, 0.2], "x_jack": [1.0] * 3, "torque": [1.0, None, 1.0]}),
        ValueError,
        "row 1, column torque: must be a number, got none",
    ),
    Refusal(
        framed(names={"x_jack": "ball"}),
        ValueError,
        "column 'ball', which is to be x_jack, must be one of 'time', 'x_jack'",
    ),
    Refusal(
        framed(columns={"time": [0.0, 0.1], "jack_x (px)": [0.0, 1.0]}, names={"x_jack": "jack_x"}),
        ValueError,
        "column 'jack_x (px)' must be in one of the units m, cm, mm, um, µm, meters, metres, micron, microns, got 'px'"
        "; --scale (in Python scale=) gives pixels per metre",
    ),
    Refusal(framed(scale=0.0), ValueError, "scale must be a finite number above 0, got 0.0"),
    *(  # whatever unit has this factor
        Refusal(framed(scale=scale), ValueError, "scale goes with columns in px, which no header has")
        for scale in (100.0, 1.0)
    ),
    Refusal(
        framed(columns={"time": [0.0, 0.1], "ball": [0.0, 1.0], "tau": [1.0, 1.0]}, names={"x_jack": "ball"}),
        ValueError,
        "column 'tau' is left out, and the scene's drive would turn the box: name it as that of torque, or leave the "
        "drive out (--torque none)",
    ),
    Refusal(
        framed(names={"weight": "ball"}),
        ValueError,
        "names accepts only 'time', 'x_box', 'y_box', 'theta_box', 'x_jack', 'y_jack', 'theta_jack', "
        "'vx_box', 'vy_box', 'omega_box', 'vx_jack', 'vy_jack', 'omega_jack', 'torque', got 'weight'",
    ),
    Refusal(framed(y_down=1), TypeError, "y_down must be True or False, got 1"),
    Refusal(framed(scene=3), TypeError, "scene must be a Scene, a dict of its fields or None, got 3"),
    Refusal(framed(impacts=[0.2, 0.1]), ValueError, "impacts must be times in order, got array([0.2, 0.1])"),
    Refusal(
        recorded(states=np.zeros((1, 12))), ValueError, "states must have shape (H + 1, 12) with H >= 1, got (1, 12)"
    ),
    Refusal(
        recorded(states=np.full((4, 12), np.inf)), ValueError, "states must be finite or NaN, got x_box = inf in row 0"
    ),
    Refusal(
        recorded(states=np.full((4, 12), np.nan)),
        ValueError,
        "states must have an observed number, got NaN only and no impacts",
    ),
    Refusal(recorded(states="up"), TypeError, "states must be numbers, got 'up'"),
    Refusal(recorded(torques=[1.0]), ValueError, "torques must have shape (3,), one for each step, got (1,)"),
    Refusal(
        recorded(torques=np.zeros((3, 0))), ValueError, "torques must have shape (3,), one for each step, got (3, 0)"
    ),
    Refusal(
        recorded(torques=np.zeros((3, 1, 1))),
        ValueError,
        "torques must have shape (3,), one for each step, got (3, 1, 1)",
    ),
    Refusal(recorded(torque="linear"), ValueError, "torques must have shape (4,), one for each state, got (3,)"),
    Refusal(recorded(torque="square"), ValueError, "torque must be one of 'held', 'sampled', 'linear', got 'square'"),
    Refusal(recorded(torques=[np.nan] * 3), ValueError, "torques must be finite, got nan"),
    Refusal(recorded(dt=0.0), ValueError, "dt must be a finite number at least 1e-09 and at most 1e+09, got 0.0"),
    Refusal(recorded(dt=1e-300), ValueError, "dt must be a finite number at least 1e-09 and at most 1e+09, got 1e-300"),
    Refusal(
        recorded(time=np.nan), ValueError, "time must be a finite number at least -1e+09 and at most 1e+09, got nan"
    ),
    Refusal(recorded(impacts=[0.2, 0.1]), ValueError, "impacts must be times in order, got [0.2, 0.1]"),
]

# -- fits and choices --------------------------------------------------------------------------------------------------

FEW = Recording(np.where(np.arange(20)[:, None] < 9, ZEROS, np.nan), np.zeros(19), 0.02)
WEIGHTLESS = {"gravity": 0.0, "drive": None}


def fitted(**change: Any) -> Callable[[Any], object]:
    recording = Recording(np.zeros((4, 12)), np.zeros(3), 0.02)
    return lambda _: fit(**{"recordings": recording, "fields": ("gravity",), **change})


FITS = [
    Refusal(
        lambda _: fit(Recording(noisy()[0], -noisy()[1], 0.02), ("jack_mass", "restitution"), LIGHT),
        ValueError,
        "no part of the recording agrees with the start scene: check that y points up (--y-down), units, sizes, "
        "masses, gravity and drive, a noise that you gave, or whether the jack moves",
    ),
    Refusal(
        lambda _: fit(Recording(noisy()[0], None, 0.02), ("jack_mass",), LIGHT.changed(drive=Chirp()), noise=1e-9),
        ValueError,
        "no part of the recording agrees with the start scene: check that y points up (--y-down), units, sizes, "
        "masses, gravity and drive, a noise that you gave, or whether the jack moves",
    ),
    Refusal(fitted(recordings=[]), TypeError, "recordings must be a Recording or several, got []"),
    Refusal(fitted(recordings=3), TypeError, "recordings must be a Recording or several, got 3"),
    Refusal(fitted(fields=()), ValueError, "fields must be different names, at least one, got ()"),
    Refusal(fitted(fields="gravity"), ValueError, "fields must be different names, at least one, got 'gravity'"),
    Refusal(
        fitted(fields=("weight",)),
        ValueError,
        "fields accepts only 'gravity', 'box_mass', 'box_inertia', 'jack_mass', 'jack_inertia', "
        "'jack_arm', 'box_half_width', 'restitution', got 'weight'",
    ),
    Refusal(fitted(start=3), TypeError, "scene must be a Scene, a dict of its fields or None, got 3"),
    Refusal(fitted(noise=0.0), ValueError, "noise of x_box must be a finite number at least 1e-12, got 0.0"),
    Refusal(
        fitted(noise={"x_jack": 5e-324}),
        ValueError,
        "noise of x_jack must be a finite number at least 1e-12, got 5e-324",
    ),
    Refusal(fitted(fields=None), ValueError, "fields must be different names, at least one, got None"),
    Refusal(
        fitted(fields=[["gravity"]]),
        ValueError,
        "fields accepts only 'gravity', 'box_mass', 'box_inertia', 'jack_mass', 'jack_inertia', "
        "'jack_arm', 'box_half_width', 'restitution', got ['gravity']",
    ),
    Refusal(
        fitted(fields=("gravity", "gravity")),
        ValueError,
        "fields must be different names, at least one, got ('gravity', 'gravity')",
    ),
    Refusal(
        fitted(noise={"x": 1.0}),
        ValueError,
        "noise accepts only 'x_box', 'y_box', 'theta_box', 'x_jack', 'y_jack', 'theta_jack', "
        "'vx_box', 'vy_box', 'omega_box', 'vx_jack', 'vy_jack', 'omega_jack', 'impacts', got 'x'",
    ),
    Refusal(
        fitted(),
        ValueError,
        "recordings must have at least 10 rows in which something was observed, or impacts that were heard, got 4",
    ),
    Refusal(
        fitted(recordings=[FEW]),
        ValueError,
        "recordings must have at least 10 rows in which something was observed, or impacts that were heard, got 9",
    ),
    Refusal(
        lambda _: cheapest([{}, {}, {"mass": 1}]),
        ValueError,
        "scene[2]: scene accepts only 'box_half_width', 'box_mass', 'box_inertia', 'jack_arm', "
        "'jack_mass', 'jack_inertia', 'gravity', 'restitution', 'torque_limit', 'drive', got 'mass' "
        "(did you mean 'box_mass'?)",
    ),
    Refusal(
        lambda _: cheapest(WEIGHTLESS, cases=2, steps=1),
        ValueError,
        "no foot reaches a wall within 1 steps of 0.02 s in any of 2 cases: pass more steps",
    ),
    Refusal(
        lambda _: cheapest(
            {"restitution": 0.5},
            first_impact_error=1e-9,
            cases=1,
            steps=60,
            contact="pymunk",
        ),
        ValueError,
        "no setting has the first impact within 1e-09 s and penetration within inf m; the finest, "
        "Setting(contact='pymunk', substeps=256), reaches ... s and ... m or more",
    ),
    Refusal(
        lambda _: cheapest([{}, {"jack_inertia": 1e-6}], cases=2, contact="pymunk"),
        ValueError,
        "jack_inertia = 1e-06 kg m^2, box_inertia = 14400 kg m^2 and jack_arm = 0.1666667 "
        "box_half_width couple the feet so strongly that contact='pymunk' needs more than "
        "100,000 iterations",
    ),
]


@rows([*PLANS, *MOTIONS, *COLUMNS, *FITS])
def test_unusable_values_are_refused_in_one_sentence(row: Refusal) -> None:
    assert_refused(row)
