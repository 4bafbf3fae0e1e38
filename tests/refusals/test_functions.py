"""Functions of users that fail or return something else raise one clear error, and change nothing."""

from __future__ import annotations

import functools
import itertools
import math
from operator import attrgetter
from typing import Any

import gymnasium as gym
import numpy as np

from jackbox_env import Action, Drive, JackInBoxEnv, Observation, Pixels, Scene, Task, TaskError, rollout
from jackbox_env.simulators import CONTACT_MODELS
from tests.refusals.sentences import (
    MAKERS,
    OUTSIDE,
    Refusal,
    assert_refused,
    at,
    begun,
    of_both,
    reset,
    rows,
    second,
    several,
    single,
    stepped,
    with_foot,
)

# -- tasks -------------------------------------------------------------------------------------------------------------

# A foot strikes the floor within the first step; the box's place chooses what is paid then.
STRIKE = at(y_jack=-4.99, vy_jack=-5.0)
BAD = (
    "the reward must be finite, got nan: the term 'one' is nan",
    "the reward must be finite, got inf: the term 'two' is inf",
    "the reward must be finite, got inf: the term 'one' is 1e+308, 'two' is 1e+308",
)
PAID = Task(
    ("one", "two"),
    lambda scene, state, torque, impulse: (
        (0.0, 0.0)
        if impulse <= 0.0
        else (math.nan, 1.0)
        if state.x_box < 1.0
        else (1.0, math.inf)
        if state.x_box < 2.0
        else (1e308, 1e308)
    ),
)
FELL = Task(
    ("root",),
    lambda scene, state, torque, impulse: (math.nan if state.vy_jack < -5.0 and state.x_jack > 0.0 else 1.0,),
    lambda scene, state, torque, impulse: state.vy_jack < -4.9,
)
FLOATS = "the task's function <lambda> must return a tuple of 2 numbers, one for each term, got what numba calls ..."
VALUES = "a task's values must return a tuple of 2 numbers, one for each term, got {}"
NEEDS = "the task's function <lambda> cannot be compiled, as contact='exact' needs: ..."
TABLE = np.arange(3.0)


RUNS, DEEP = "; environments with fidelity='balanced' run it", "its functions call one another too deeply"


def halved(number: float) -> float:
    return number if number < 1.0 else halved(0.5 * number)


def one(*, number: float = 1.0) -> float:
    return number


def chain() -> Any:
    def after(last: Any) -> Any:
        return lambda scene, state, torque, impulse: last(scene, state, torque, impulse)

    return functools.reduce(lambda last, _: after(last), range(100), lambda *numbers: (1.0, 1.0))


def writing(scene: Any, state: Any, torque: float, impulse: float, table: Any = TABLE) -> tuple[float, float]:
    table[0] += 1.0
    return 1.0, 1.0


UNFIT: tuple[tuple[str, Any, str], ...] = (
    (
        "exact",
        lambda scene, state, torque, impulse: (TABLE.flat[1], 1.0),
        NEEDS + "an index of .flat is not checked; use the array's own indices...",
    ),
    ("exact", writing, NEEDS.replace("<lambda>", "writing") + "setitem(readonly array..."),
    ("exact", lambda scene, state, torque, impulse: (1.0,), FLOATS),
    ("exact", lambda scene, state, torque, impulse: 1.0, FLOATS),
    ("exact", lambda scene, state, torque, impulse: (halved(9.0), 1.0), NEEDS + "halved calls itself" + RUNS),
    ("exact", lambda scene, state, torque, impulse: (one(), 1.0), NEEDS + "one has arguments by keyword only" + RUNS),
    ("exact", chain(), NEEDS.replace("<lambda>", "...") + DEEP + RUNS),
    ("exact", lambda scene, state, torque, impulse: (1j, 2j), FLOATS),
    ("exact", lambda scene, state, torque, impulse: (scene.nothing, 1.0), NEEDS + "'nothing'..."),
    ("exact", lambda scene, state, torque, impulse: (nowhere, 1.0), NEEDS + "'nowhere'..."),  # type: ignore[name-defined]  # noqa: F821
    (
        "exact",
        lambda scene, state, torque, impulse: (np.sum(state * 2.0), 1.0),
        NEEDS + "mul(State...; write it without numpy, with single numbers and math",
    ),
    (
        "exact",
        lambda scene, state, torque, impulse: [state[0], 1.0],
        NEEDS + "it makes an array, a list or a dict; use single numbers",
    ),
    ("exact", lambda scene, state, torque: (1.0, 1.0), NEEDS + "too many positional arguments"),
    ("pymunk", lambda scene, state, torque, impulse: 1.0, VALUES.format("1.0")),
    ("pymunk", lambda scene, state, torque, impulse: (1.0,), VALUES.format("(1.0,)")),
    ("pymunk", lambda scene, state, torque, impulse: (1j, 2j), VALUES.format("(1j, 2j)")),
    ("pymunk", lambda scene, state, torque, impulse: [1.0, 2.0], VALUES.format("[1.0, 2.0]")),
)
MISDRAWN: Any = []
STARTS: Any = []
ANY_TASK: Any = Task


def drawn(rng: np.random.Generator) -> Any:
    return MISDRAWN.pop() if MISDRAWN else {"gravity": float(rng.uniform(1.0, 2.0))}


def failing(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
    """Fails under a torque to the left; the box's place chooses what else fails."""
    if torque > 0.0:
        raise ValueError("no push to the left, please")
    spot, by, height = int(state.x_box + 0.5), torque + 1.0, max(state.y_jack + 0.5, 0.0)
    if spot in (1, 2):
        return (1.0 / by if spot == 1 else 1.0 // by,)
    if spot in (3, 4):
        return (float(1 // int(by)) if spot == 3 else 1.0 / height,)
    return (1.0 if spot != 5 or height > 0.0 else math.nan,)


def pushing(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
    state[10] = 50.0
    return (1.0,)


FAILING = Task(("paid",), failing, start=lambda scene, rng: STARTS[-1])
RISING = np.linspace(3.0, 0.0, 100)[:, None] * at(vy_jack=1.0)
LATE_FAILURE = {"drive": Drive(force_x=lambda time: 0.0 * math.sqrt(0.3 - time))}
FALLEN = "the reward must be finite, got nan: the term 'paid' is nan, in "  # below -0.5 m
TASKS = [
    *(
        Refusal(
            lambda _, make=make, case=case: make(contact=case[0], task=Task(("a", "b"), case[1])), TypeError, case[2]
        )
        for case, make in zip(UNFIT, itertools.cycle(MAKERS), strict=False)
    ),
    *(
        Refusal(
            stepped(second(where, 0.0, 0.0)),
            TaskError,
            sentence + where,
            begun(one, reset(state=second(where, STRIKE + at(x_box=box, x_jack=box), at()))),
        )
        for contact in CONTACT_MODELS
        for one, where in of_both(contact, task=PAID)
        for box, sentence in enumerate(BAD)
    ),
    *(
        Refusal(
            lambda _, box=box: rollout(
                None, [at(), STRIKE + at(x_box=box, x_jack=box)], np.zeros(9), 0.02, rewards=PAID
            ),
            TaskError,
            sentence + ", in step 0 of states[1]",
        )
        for box, sentence in enumerate(BAD)
    ),
    *(  # environment 1 has ended in the first of these steps
        Refusal(
            lambda batch: batch.step(None),
            TaskError,
            "the reward must be finite, got nan: the term 'root' is nan, in environment 0",
            begun(
                several(2, contact=contact, task=FELL, autoreset_mode="SAME_STEP", action_repeat=8),
                reset(state=[at(x_jack=0.5, vy_jack=0.1), at(x_jack=-0.5)]),
                stepped(None, 3),
            ),
        )
        for contact in CONTACT_MODELS
    ),
    *(
        Refusal(
            lambda _, contact=contact: JackInBoxEnv(
                contact=contact,
                task=ANY_TASK(
                    ("a",), lambda scene, state, torque, impulse: (1.0,), lambda scene, state, torque, impulse: 1.0
                ),
            ),
            TypeError,
            sentence,
        )
        for contact, sentence in (
            ("exact", "the task's function ... must return True or False, got what numba calls ..."),
            ("pymunk", "a task's over must return True or False, got 1.0"),
        )
    ),
    *(
        Refusal(
            lambda env, drawn=drawn: (STARTS.append(drawn), env.reset(seed=4)),
            error,
            f"the task's start has drawn what is none: {sentence}",
            begun(one, reset(state=at(y_jack=0.4))),
        )
        for drawn, error, sentence in (
            (with_foot(4.0), ValueError, OUTSIDE.format(4)),
            ([1.0], ValueError, "state must have shape (12,), got shape (1,)"),
            ("here", TypeError, "state must be 12 numbers, got 'here'"),
        )
        for contact in CONTACT_MODELS
        for one, _ in of_both(contact, task=FAILING)
    ),
    *(
        Refusal(
            stepped(second(where, 1.0, 0.0)),
            ValueError,
            "no push to the left, please",
            begun(one, reset(state=at()), stepped(second(where, -1.0, -1.0))),
        )
        for contact in CONTACT_MODELS
        for one, where in of_both(contact, task=FAILING)
    ),
    *(
        Refusal(
            stepped(second(where, -1.0 / Scene().torque_limit, 0.0)),
            ZeroDivisionError,
            "...division...by zero",
            begun(one, reset(state=second(where, at(x_box=spot, x_jack=spot), at()))),
        )
        for contact in CONTACT_MODELS
        for one, where in of_both(contact, task=FAILING)
        for spot in (1, 2, 3)
    ),
    *(  # environment 0 fails later
        Refusal(
            stepped([0.0, 0.0]),
            TaskError,
            FALLEN + "environment 1",
            begun(
                several(
                    2, contact="exact", num_threads=threads, action_repeat=40, scene=[LATE_FAILURE, {}], task=FAILING
                ),
                reset(state=[at(), at(x_box=5.0, x_jack=5.0, vy_jack=-5.0)]),
            ),
        )
        for threads in (1, 2)
    ),
    *(
        Refusal(
            lambda _, spot=spot, threads=threads: rollout(
                {}, RISING + at(x_box=spot, x_jack=spot), np.zeros(80), 0.02, rewards=FAILING, num_threads=threads
            ),
            error,
            sentence,
        )
        for spot, error, sentence in (
            (4, ZeroDivisionError, "division by zero"),
            (5, TaskError, FALLEN + "step 29 of states[30]"),
        )
        for threads in (1, 2, 3)
    ),
    Refusal(
        lambda env: env.reset(options={"state": at(x_jack=2.0)}),
        TypeError,
        "a task's values must return a tuple of 1 numbers, one for each term, got (0.0, 0.0)",
        single(task=Task(("a",), lambda scene, state, torque, impulse: (0.0,) * (1 if abs(state[3]) <= 1.0 else 2))),
    ),
    *(
        Refusal(
            lambda _, make=make: make(task=Task(("push",), pushing)),
            TypeError,
            "'State' object does not support item assignment",
        )
        for make in MAKERS
    ),
    *(
        Refusal(
            lambda _, make=make: make(Task(("push",), pushing)),
            TypeError,
            "the task's function pushing cannot be compiled, as contact='exact' needs: ...setitem(State...",
        )
        for make in (
            *(lambda task, make=make: make(contact="exact", task=task) for make in MAKERS),
            lambda task: rollout(None, np.zeros(12), [0.0], 0.02, rewards=task),
        )
    ),
    *(
        Refusal(
            lambda env, misfit=misfit: (MISDRAWN.append(misfit), env.reset()),
            error,
            sentence,
            begun(one, lambda env: env.reset(seed=0), stepped(None)),
        )
        for misfit, error, sentence in (
            (
                {"jack_arm": 100.0},
                ValueError,
                "jack_arm must be below sqrt(2) * box_half_width = 8.48528 m to fit, got 100 m",
            ),
            ({"nothing": 1.0}, ValueError, "scene accepts only 'box_half_width', ..., 'drive', got 'nothing'"),
            (3.0, TypeError, "randomize must return a dict of the scene's fields, got 3.0"),
        )
        for contact in CONTACT_MODELS
        for one, _ in of_both(contact, randomize=drawn)
    ),
]

# -- observations and actions of a user --------------------------------------------------------------------------------

SMALL = {"box_half_width": 1.5}
FALLING = at(y_jack=0.45, vy_jack=24.0)  # it strikes the ceiling, and passes -0.2 m in the next step
HIGH = at(y_jack=0.4)
HIDES = "the observation must be numbers, got NaN for 'b'"
HIDDEN = Observation(
    ("a", "b"), -1, 1, lambda scene, state, time: (1.0, math.nan if state.y_jack < -0.2 or time > 5.0 else 0.5)
)
UNSTEADY = Action(
    gym.spaces.Discrete(2), lambda scene, state, action, time, dt: math.nan if state.y_jack < -0.2 else 0.1
)
ANY_OBSERVATION: Any = Observation
ANY_ACTION: Any = Action
PAIR = ANY_OBSERVATION(("a",), -1, 1, lambda scene, state, time: (1.0, 2.0))
WORD = ANY_OBSERVATION(("a",), -1, 1, lambda scene, state, time: "b")
WORDY = ANY_ACTION(gym.spaces.Discrete(2), lambda scene, state, action, time, dt: "c")
NOUNS = [
    *(
        Refusal(
            stepped(second(where, 1, 1)),
            TaskError,
            sentence + where,
            begun(one, reset(state=second(where, FALLING, HIGH)), stepped(second(where, 1, 1), steps)),
        )
        for noun, sentence, repeats in (
            ({"observation": HIDDEN, "action": "discrete"}, HIDES, ((1, 1), (2, 0))),
            ({"action": UNSTEADY}, "the action's torque must be a number, got nan", ((1, 2), (3, 0))),
        )
        for contact in CONTACT_MODELS
        for repeat, steps in repeats
        for one, where in of_both(contact, action_repeat=repeat, scene=SMALL, **noun)
    ),
    *(
        Refusal(
            reset(state=second(where, at(y_jack=-0.3), HIGH)),
            TaskError,
            HIDES + where,
            begun(one, reset(state=HIGH), stepped(second(where, 1, 1))),
        )
        for contact in CONTACT_MODELS
        for one, where in of_both(contact, scene=SMALL, observation=HIDDEN, action="discrete")
    ),
    *(
        Refusal(lambda _, make=make, noun=noun: make(**noun), TypeError, sentence)
        for noun, sentence in (
            (
                {"contact": "exact", "observation": PAIR},
                "the observation's function <lambda> must return a tuple of 1 numbers, one for each name, got what "
                "numba calls ...",
            ),
            (
                {"contact": "exact", "observation": WORD},
                "the observation's function <lambda> must return a tuple of 1 numbers, one for each name, got what "
                "numba calls ...",
            ),
            (
                {"contact": "exact", "action": WORDY},
                "the action's function <lambda> must return a number, got what numba calls ...",
            ),
            ({"observation": PAIR}, "an observation's values must return a tuple of 1 numbers, got (1.0, 2.0)"),
            ({"observation": WORD}, "an observation's values must return a tuple of 1 numbers, got 'b'"),
            ({"action": WORDY}, "an action's torque must return a number, got 'c'"),
        )
        for make in MAKERS
    ),
    *(
        Refusal(
            lambda envs, options=options: envs.reset(seed=9, options={"state": HIGH, **options}),
            TaskError,
            "the observation must be numbers, got NaN for 'b', in environment 2",
            begun(
                several(3, contact=contact, observation=HIDDEN, action="discrete"),
                reset(state=HIGH),
                stepped([1] * 3),
                *before,
            ),
        )
        for options, before in (
            ({"time": 6.0, "reset_mask": np.array([False, False, True])}, ()),
            (
                {"reset_mask": np.array([True, False, False])},
                (lambda envs: envs.set_states(envs.states, [0.02, 0.02, 6.0]),),
            ),
        )
        for contact in CONTACT_MODELS
    ),
    *(
        Refusal(
            lambda batch: batch.step(np.array([[0.5], [math.nan]])),
            ValueError,
            "action must be a finite number (clipped to [-1, 1]), got nan for environment 1",
            begun(
                several(2, contact=contact, observation=Pixels((24, 24), 2), action_repeat=2),
                reset(),
                stepped(np.ones((2, 1))),
            )._replace(shown=attrgetter("states", "observations")),
        )
        for contact in CONTACT_MODELS
    ),
]


@rows([*TASKS, *NOUNS])
def test_a_function_that_fails_is_named_and_changes_nothing(row: Refusal) -> None:
    assert_refused(row)
