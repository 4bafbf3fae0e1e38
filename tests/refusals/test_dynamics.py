"""Motion that no contact model can follow is refused, and so are drives that cannot be integrated."""

from __future__ import annotations

import math
from functools import partial
from typing import Any

import numpy as np

from jackbox_env import Chirp, Drive, JackInBoxEnv, JackLostError, Scene, make_simulator, rollout
from jackbox_env.model.states import Array
from jackbox_env.simulators import CONTACT_MODELS
from tests.refusals.sentences import (
    START,
    Refusal,
    assert_refused,
    at,
    begun,
    of_both,
    put,
    reset,
    rows,
    second,
    several,
    simulator,
    stepped,
    with_foot,
)

# -- motion that cannot be followed ------------------------------------------------------------------------------------

CORNER, STRONG = {"x_jack": 5.2, "y_jack": 5.2, "theta_jack": math.pi / 4.0}, {"torque_limit": 1e60}
LOST = (
    "the jack{} moves too fast to be followed in the dt = 0.02 s after t = {:g} s, or is too far off; use a smaller "
    "time step, less speed or less torque"
)
MOVES = (
    "the jack would leave the box: after t = {:g} s a foot moves {} m in h = 7.81e-05 s, or ends so far outside, at "
    "most 1 m is followed; use more substeps, a smaller time step or less torque"
)
FAR = (
    "the jack would leave the box: it or the box moves 2e+88 m within dt = 0.02 s, at most 6e+09 m is followed; use a "
    "smaller time step or speed"
)
# Fields of the scene, the state, the action, and the sentence of pymunk.
RUNAWAYS: tuple[tuple[dict[str, Any], Array, float, str], ...] = (
    ({}, at(**CORNER, vx_jack=1e90), 0.0, FAR),
    ({}, at(**CORNER, vx_box=1e90), 0.0, FAR),
    ({}, at(**CORNER, omega_jack=1e90), 0.0, MOVES.format(1.0, "7.81e+85")),
    (STRONG, at(**CORNER), 1.0, MOVES.format(1.0, "3.54e+48")),
    (STRONG, at(theta_jack=math.pi / 4.0), 1.0, MOVES.format(1.0, "4.24e+47")),
)
CHIRP = (
    "the chirp turns {} times in the {:g} s after t = 1e+06 s, at most 83333 turns in one step or substep "
    "can be followed"
)
FLOATLESS: Any = {"gravity": 0.0, "drive": None}


MOTION = [
    *(
        Refusal(
            stepped(second(where, [action], [0.0])),
            JackLostError,
            LOST.format(where.replace(", in", " of"), 1.0) if contact == "exact" else pymunks,
            begun(
                one,
                reset(),
                partial(put, state=at(**CORNER)),
                stepped(second(where, [0.0], [0.0])),
                partial(put, state=second(where, state, at(**CORNER)), time=1.0),
            ),
        )
        for fields, state, action, pymunks in RUNAWAYS
        for contact in CONTACT_MODELS
        for one, where in of_both(contact, scene=Scene(**fields, drive=None))
    ),
    *(
        Refusal(
            lambda _, case=case: rollout(
                Scene(**case[0], drive=None), [at(), case[1]], [[0.0], [case[2] * 1e60]], 0.02
            ),
            JackLostError,
            LOST.format(" of states[1]", 0.0),
        )
        for case in RUNAWAYS
    ),
    *(
        Refusal(
            lambda run: run.step(1.0),
            ValueError,
            CHIRP.format(*turns),
            begun(simulator(contact), lambda run: run.reset(START, 1e6)),
        )
        for contact, turns in (("exact", ("9e+05", 1)), ("pymunk", ("2.25e+05", 0.25)))
    ),
    Refusal(
        lambda _: (Chirp().torque_means(1e6, 1e-4), Chirp().torque_means(1e6, 1.0)),
        ValueError,
        CHIRP.format("9e+05", 1),
    ),
    *(
        Refusal(
            lambda run, dt=dt: run.step(dt, 0.0),
            JackLostError,
            sentence,
            begun(simulator(contact), lambda run: run.reset(with_foot(-1e-3) + at(omega_jack=1e9), 1e6)),
        )
        for contact, dt, sentence in (
            (
                "exact",
                1e5,
                "the jack needs more than 1,000,000 gap evaluations in the dt = 100000 s after t = 1e+06 s; use a "
                "smaller time step or less torque",
            ),
            ("pymunk", 0.02, MOVES.format(1e6, "7.81e+04")),
        )
    ),
    *(
        Refusal(
            lambda run: run.step(0.02),
            JackLostError,
            "the jack moves too fast to be followed in the dt = 0.02 s after t = 0 s, or is too far off; "
            "use a smaller time step, less speed or less torque",
            begun(
                simulator("exact", **FLOATLESS),
                lambda run, far=far: run.reset(at(**({"x_jack": 5.2, "theta_jack": 0.785, "vx_jack": 10.0} | far))),
            ),
        )
        for far in ({"theta_box": 1e14}, {"theta_jack": 1e14}, {"vy_box": 1e14, "vy_jack": 1e14})
    ),
    Refusal(
        lambda run: run.step(0.02),
        JackLostError,
        "the jack would leave the box: after t = 0 s a foot moves 7.81 m in h = 7.81e-05 s, or ends "
        "so far outside, at most 1 m is followed; use more substeps, a smaller time step or less "
        "torque",
        begun(simulator("pymunk", drive=None), lambda run: run.reset(with_foot(-1.0) + at(vx_jack=1e5))),
    ),
    Refusal(
        lambda run: run.step(10.0),
        JackLostError,
        "in the step of dt = 10 s after t = 0 s the contacts gain or lose energy: substeps of h = "
        "0.0391 s are too long, or the jack is wedged between walls; use more of them, a smaller "
        "time step or contact='exact'",
        begun(simulator("pymunk"), lambda run: run.reset(np.zeros(12))),
    ),
    *(
        Refusal(
            lambda _, inertia=inertia: make_simulator(Scene(jack_inertia=inertia), "pymunk"),
            ValueError,
            f"jack_inertia = {inertia:g} kg m^2, box_inertia = 14400 kg m^2 and jack_arm = 0.1666667 box_half_width "
            "couple the feet so strongly that contact='pymunk' needs more than 100,000 iterations",
        )
        for inertia in (4e-6, 4e-9, 4e-16, 4e-25)
    ),
    Refusal(
        lambda _: JackInBoxEnv("pymunk", scene={"jack_arm": 6.0 + 6e-6}),
        ValueError,
        "jack_inertia = 144 kg m^2, box_inertia = 14400 kg m^2 and jack_arm = 1.000001 "
        "box_half_width couple the feet so strongly that contact='pymunk' needs more than "
        "100,000 iterations",
    ),
]

# -- drives ------------------------------------------------------------------------------------------------------------

ANSWERS: Any = []
ONCE: Any = []
FAILS: Any = {}
NOISE = np.random.default_rng(0)
FLAKY = Drive(torque=lambda time: FAILS[ONCE.pop()] if ONCE and time > 0.05 else 1e4)
HUGE: tuple[Any, ...] = (
    lambda t: 1.7e308 * math.cos(500.0 * t),
    lambda t: 1.7e308 if t < 1.013 else -1.7e308,
    lambda t: 1e300,
)
DRIVES = [
    *(
        Refusal(
            lambda run, answer=answer: (ANSWERS.append(answer), run.step(0.02)),
            error,
            sentence,
            begun(
                simulator(contact, drive=Drive(torque=lambda time: ANSWERS[-1])),
                lambda run: (ANSWERS.append(5.0), run.reset(START, 1.0), run.step(0.02)),
            ),
        )
        for answer, error, sentence in (
            (math.nan, ValueError, "torque(1.02... s) must be a finite number, got nan"),
            (math.inf, ValueError, "torque(1.02... s) must be a finite number, got inf"),
            ("much", TypeError, "torque(1.02... s) must be a finite number, got 'much'"),
        )
        for contact in CONTACT_MODELS
    ),
    Refusal(
        stepped(None),
        RuntimeError,
        "the drive of environment 0 failed at t = 0.04 s, but not when it was called again",
        begun(
            several(2, contact="exact", torque="chirp", action_repeat=10, scene={"drive": FLAKY}),
            reset(),
            lambda _: ONCE.append("no sensor"),
        ),
    ),
    Refusal(
        lambda run: run.step(0.02),
        ValueError,
        "drive must be smooth but for some jumps: over the 0.02 s after t = 1.25 s it wants more than 4096 pieces",
        simulator("exact", drive=Drive(torque=lambda t: NOISE.uniform(-1.0, 1.0))),
    ),
    *(
        Refusal(
            lambda run: run.step(0.02),
            JackLostError,
            LOST.format("", 1.0),
            begun(simulator("exact", drive=Drive(**{part: function})), lambda run: run.reset(START, 1.0)),
        )
        for part in ("torque", "force_x", "force_y")
        for function in HUGE
    ),
]


@rows([*MOTION, *DRIVES])
def test_motion_that_cannot_be_followed_is_refused_and_nothing_has_moved(row: Refusal) -> None:
    assert_refused(row)
