"""A custom task that fails or cannot be compiled raises one clear error, and changes nothing."""

from __future__ import annotations

import functools
import math
from typing import Any

import numba
import numpy as np
import pytest
from gymnasium.spaces import Box

from jackbox_env import (
    Action,
    Drive,
    JackInBoxEnv,
    JackInBoxVectorEnv,
    Observation,
    Scene,
    Task,
    TaskError,
    rollout,
)
from jackbox_env.model.states import OMEGA_BOX, OMEGA_JACK
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.simulators import CONTACT_MODELS
from tests.batches.several import assert_same
from tests.environment.test_nouns import present

EVERY_MODEL = pytest.mark.parametrize("contact", CONTACT_MODELS)
MAKERS: list[Any] = [JackInBoxEnv, functools.partial(JackInBoxVectorEnv, 2)]


@EVERY_MODEL
@pytest.mark.parametrize("make", MAKERS)
def test_an_error_in_the_function_comes_back_and_leaves_all_as_it_was(contact: str, make: Any) -> None:
    def strict(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
        if torque > 0.0:
            raise ValueError("no push to the left, please")
        return (1.0,)

    env = make(contact=contact, task=Task(("strict",), strict))
    env.reset(seed=0)
    push, names = np.ones(env.action_space.shape), ("state", "time") if make is JackInBoxEnv else ("states", "times")
    before = [getattr(env, name) for name in names]
    with pytest.raises(ValueError, match="no push to the left"):
        env.step(push)
    for value, name in zip(before, names, strict=True):
        np.testing.assert_array_equal(getattr(env, name), value)
    assert np.all(env.step(-push)[1] == 1.0)


@EVERY_MODEL
@pytest.mark.parametrize("divided", [lambda by: 1.0 / by, lambda by: 1.0 // by, lambda by: 1 // int(by)])
def test_a_division_by_zero_is_an_error_in_every_model(contact: str, divided: Any) -> None:
    task = Task(("part",), lambda scene, state, torque, impulse: (float(divided(torque + 1.0)),))
    for make in MAKERS:
        env = make(contact=contact, task=task)
        env.reset(seed=0)
        with pytest.raises(ZeroDivisionError):
            env.step(np.full(env.action_space.shape, -1.0 / Scene().torque_limit))


TABLE, GRID, PAIR = np.array([1.0, 2.0, 4.0]), np.arange(6.0).reshape(2, 3), (8.0, 9.0)
BOTH, EVERY_SECOND, LONG = (TABLE, TABLE[:2]), np.arange(8.0)[::2], np.arange(200_000.0)
READS: dict[str, Any] = {
    "an array": lambda k: TABLE[k],
    "rows": lambda k: GRID[k, 1],
    "columns": lambda k: GRID[1, k],
    "a row of them": lambda k: GRID[k][2],
    "a column of them": lambda k: GRID.T[k, 0],
    "a part": lambda k: TABLE[1:][k],
    "every second": lambda k: EVERY_SECOND[k],
    "1.6 MB": lambda k: LONG[99_999 * k],
    "a default": lambda k, table=TABLE: table[k],
    "a tuple": lambda k: PAIR[k],
    "arrays in a tuple": lambda k: BOTH[1][k],
    "bytes": lambda k: b"abc"[k],
    "numba's": numba.njit(lambda k: TABLE[k]),
}


@pytest.mark.parametrize("read", READS)
def test_an_index_counts_from_either_end_and_past_it_is_an_error(read: str) -> None:
    number_at = READS[read]
    plain = getattr(number_at, "py_func", number_at)
    env = JackInBoxEnv(
        contact="exact", task=Task(("read",), lambda scene, state, torque, impulse: 1.0 * number_at(round(torque)))
    )
    env.reset(seed=0)
    wrong = 0
    for k in range(-5, 6):
        try:
            expected = plain(k)
        except IndexError:
            wrong += 1
            with pytest.raises(IndexError, match="out of"):
                env.step(k / Scene().torque_limit)
        else:
            assert env.step(k / Scene().torque_limit)[1] == expected
    assert 3 <= wrong <= 7


def past(rate: float) -> Any:
    return TABLE[0 if rate <= 0.0 else 3]


FAILING: dict[str, dict[str, Any]] = {
    "reward": {"task": Task(("r",), lambda scene, state, torque, impulse: past(torque))},
    "end": {"task": Task(("r",), lambda scene, state, torque, impulse: 1.0, over=lambda *_: past(_[2]) < 0.0)},
    "observation": {"observation": Observation(("o",), 0, 9, lambda scene, state, time: (past(state.omega_box),))},
    "action": {"action": Action(Box(-1, 1, (1,)), lambda scene, state, action, time, dt: past(action[0]) * action[0])},
}


@EVERY_MODEL
@pytest.mark.parametrize("kind", FAILING)
def test_an_index_past_the_end_is_an_error_on_every_path_and_changes_nothing(contact: str, kind: str) -> None:
    settings: dict[str, Any] = {**FAILING[kind], "contact": contact, "action_repeat": 2}
    threaded, stable = JackInBoxVectorEnv(300, num_threads=2, **settings), make_sb3_vec_env(2, **settings)
    for env in (*(make(**settings) for make in MAKERS), threaded, stable):
        inner: Any = getattr(env, "vector_env", env)
        env.reset()
        last = np.zeros(inner.action_space.shape)
        last[-1] = 1.0
        resets = [lambda inner=inner: inner.reset(options={"state": 0.1 * np.eye(12)[OMEGA_BOX]})]
        for call in (functools.partial(env.step, last), *(resets if kind == "observation" else ())):
            before = present(inner)
            with pytest.raises(IndexError, match="out of"):
                call()
            assert_same(present(inner), before)
        env.step(-last)
    if contact == "exact" and "task" in settings:
        with pytest.raises(IndexError, match="out of"):
            rollout(None, np.zeros(12), [0.0, 1.0], 0.02, rewards=settings["task"])


def writing(scene: Any, state: Any, torque: float, impulse: float, table: Any = TABLE) -> tuple[float, float]:
    table[0] += 1.0
    return 1.0, 1.0


FLOATS, NUMBERS = "a tuple of 2 floats, one for each term, got", "a tuple of 2 numbers, one for each term, got"


@pytest.mark.parametrize(
    ("contact", "values", "message"),
    [
        ("exact", lambda scene, state, torque, impulse: (1.0,), FLOATS),
        ("exact", lambda scene, state, torque, impulse: 1.0, FLOATS),
        ("exact", lambda scene, state, torque, impulse: (1, 2.0), FLOATS),
        ("exact", lambda scene, state, torque, impulse: (1j, 2j), FLOATS),
        ("exact", lambda scene, state, torque, impulse: (scene.nothing, 1.0), "cannot be compiled.*'nothing'"),
        ("exact", lambda scene, state, torque, impulse: (nowhere, 1.0), "cannot be compiled.*'nowhere'"),  # type: ignore[name-defined]  # noqa: F821
        ("exact", lambda scene, state, torque, impulse: (np.sum(state * 2.0), 1.0), r"cannot be compiled.*mul\(State"),
        ("exact", lambda scene, state, torque, impulse: [state[0], 1.0], "cannot be compiled.*use single numbers"),
        ("exact", writing, "cannot be compiled.*setitem.readonly array"),
        ("exact", lambda scene, state, torque, impulse: (GRID.flat[1], 1.0), "cannot be compiled.*flat is not checked"),
        ("exact", lambda scene, state, torque: (1.0, 1.0), "cannot be compiled.*too many positional arguments"),
        ("pymunk", lambda scene, state, torque, impulse: 1.0, NUMBERS),
        ("pymunk", lambda scene, state, torque, impulse: (1.0,), NUMBERS),
        ("pymunk", lambda scene, state, torque, impulse: (1j, 2j), NUMBERS),
        ("pymunk", lambda scene, state, torque, impulse: [1.0, 2.0], NUMBERS),
    ],
)
def test_an_unfit_task_is_refused_at_once_in_one_sentence(contact: str, values: Any, message: str) -> None:
    for make in MAKERS:
        with pytest.raises(TypeError, match=message) as caught:
            make(contact=contact, task=Task(("a", "b"), values))
        assert "\n" not in str(caught.value)


WITHOUT_TORQUE: dict[str, Any] = {
    "division": lambda scene, state, torque, impulse: (1.0 / torque,),
    "logarithm": lambda scene, state, torque, impulse: (math.log(torque),),
    "overflow": lambda scene, state, torque, impulse: (math.exp(1e3 - torque),),
    "infinite": lambda scene, state, torque, impulse: (math.inf if torque == 0.0 else 1.0,),
}


@EVERY_MODEL
@pytest.mark.parametrize("case", WITHOUT_TORQUE)
def test_arithmetic_that_fails_before_the_first_step_is_no_verdict(case: str, contact: str) -> None:
    values = WITHOUT_TORQUE[case]
    for make in MAKERS:
        env = make(contact=contact, task=Task(("part",), values))
        env.reset(seed=0)
        (expected,) = values(None, None, Scene().torque_limit, 0.0)
        np.testing.assert_allclose(env.step(np.ones(env.action_space.shape))[1], expected)
        seen = env.observation if make is JackInBoxEnv else env.observations
        assert np.isfinite(seen).all()


def test_a_reset_that_finds_an_unfit_task_changes_nothing() -> None:
    task = Task(("a",), lambda scene, state, torque, impulse: (0.0,) * (1 if abs(state[3]) <= 1.0 else 2))
    env, right = JackInBoxEnv(task=task), 2.0 * (np.arange(12) == 3)
    env.reset(seed=0)
    before = env.state
    with pytest.raises(TypeError, match="must return a tuple of 1 numbers"):
        env.reset(options={"state": right})
    np.testing.assert_array_equal(env.state, before)


@pytest.mark.parametrize("num_threads", [1, 2])
def test_the_earliest_error_of_several_steps_is_raised_whatever_the_threads(num_threads: int) -> None:
    def late(time: float) -> float:
        if time > 0.3:
            raise OSError("late")
        return 0.0

    def early(scene: Any, state: Any, torque: float, impulse: float) -> float:
        return math.inf if state.theta_jack > 0.5 else 1.0

    scenes = [{"drive": Drive(force_x=late)}, {}]
    made: Any = {"contact": "exact", "num_threads": num_threads, "scene": scenes}
    envs = JackInBoxVectorEnv(2, task=Task(("r",), early), action_repeat=40, **made)
    envs.reset(seed=0)
    spinning = np.zeros((2, 12))
    spinning[1, OMEGA_JACK] = 10.0
    envs.set_states(spinning, 0.0)
    with pytest.raises(TaskError, match="'r' is inf, in environment 1"):
        envs.step([0.0, 0.0])
    np.testing.assert_array_equal(envs.states, spinning)


def test_a_drive_that_fails_once_is_named() -> None:
    failed = list[float]()

    def flaky(time: float) -> float:
        if time > 0.05 and not failed:
            failed.append(time)
            raise OSError("no sensor")
        return 1e4

    scene = {"drive": Drive(torque=flaky)}
    envs = JackInBoxVectorEnv(2, contact="exact", torque="chirp", scene=scene, action_repeat=10)
    envs.reset(seed=0)
    with pytest.raises(RuntimeError, match="the drive of environment 0 failed at t = 0.04 s, but not when"):
        envs.step(None)
