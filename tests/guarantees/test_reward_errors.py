"""A custom task that fails or cannot be compiled raises one clear error, and changes nothing."""

from __future__ import annotations

import functools
import math
from typing import Any

import numpy as np
import pytest

from jackbox_env import Drive, JackInBoxEnv, JackInBoxVectorEnv, Scene, Task, TaskError
from jackbox_env.model.states import OMEGA_JACK
from jackbox_env.simulators import CONTACT_MODELS

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
