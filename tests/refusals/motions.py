"""Rows of the table of refusals for ``simulate`` and the methods of a Motion."""

from __future__ import annotations

import math
from dataclasses import replace
from operator import attrgetter

import numpy as np

import jackbox_env
from jackbox_env.simulators.fidelity import FIDELITIES
from tests.refusals.kinds import array, choice, each, instance, out, real, whole, wrong
from tests.refusals.sentences import START, Subject
from tests.refusals.table import DT, ONE_SCENE, Kinds, Row, state

TORQUES = array([1.0, 2.0, 3.0, 4.0], scalar=True, none=True)
UNTIL = replace(
    instance("impact", "nothing", "function", "text", "empty_text", **each(out, {"zero": 0, "other": "impacts"})),
    accepted=(None, 2, np.int64(2), lambda state: state.y_jack),
).but(word=wrong(lambda state: "up", "'up'"), nan=out(lambda state: math.nan, "nan"))
SIMULATE: Kinds = {
    "scene": ONE_SCENE,
    "state": replace(
        state(1.0).but(nothing=None, dict=out({"something": 1}, "'something'")), accepted=(None, {"x_jack": 1})
    ),
    "duration": real(0.125, above=0.0).but(steps=out(1e9, "1e+09", "steps")),
    "torque": TORQUES.but(
        function=wrong(lambda time: "up", "'up'"), controller=out(lambda time, state: math.nan, "nan")
    ),
    "time": real(1.0, at_least=-1e9, at_most=1e9, ends=False),
    "dt": DT.but(tiny=out(1e-12, "1e-12", "steps")),
    "fidelity": choice("exact", FIDELITIES),
    "until": UNTIL,
}
TIMES = array([0.25, 0.5]).but(
    more=None, deeper=None, empty=None, scalar=None,
    early=out([-0.5], "-0.5"), late=out(np.array(4.0), "3", "4"), nan=out(math.nan, "nan"),
)  # fmt: skip


def motion() -> jackbox_env.Motion:
    return jackbox_env.simulate({"gravity": 1.5}, START, 3.0)


MADE = Subject(motion, shown=attrgetter("t", "states", "impacts"))
METHODS: dict[str, Kinds] = {
    "__call__": {"t": TIMES, "side": choice("before", ("before", "after"))},
    "energy": {"t": TIMES.but(nothing=None), "side": choice("before", ("before", "after"))},
    "work": {"t": TIMES.but(nothing=None)},
    "restart": {"k": whole(1, -2, 1)},
}
ROWS = [
    Row("simulate", lambda _: jackbox_env.simulate, SIMULATE),
    *(Row(f"Motion.{name}", attrgetter(name), arguments, MADE) for name, arguments in METHODS.items()),
]
