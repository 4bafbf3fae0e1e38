"""A custom task that fails or cannot be compiled raises one clear error, and changes nothing."""

from __future__ import annotations

import functools
import itertools
import math
from typing import Any

import numba
import numpy as np
import pytest
from gymnasium.spaces import Box

from jackbox_env import (
    Action,
    JackInBoxEnv,
    JackInBoxVectorEnv,
    Observation,
    Scene,
    Task,
    rollout,
)
from jackbox_env.model.states import OMEGA_BOX
from jackbox_env.sb3 import make_sb3_vec_env
from tests.batches.several import EVERY_MODEL, assert_same
from tests.states import started

MAKERS: list[Any] = [JackInBoxEnv, functools.partial(JackInBoxVectorEnv, 2)]


TABLE, GRID, PAIR = np.array([1.0, 2.0, 4.0]), np.arange(6.0).reshape(2, 3), (8.0, 9.0)
BOTH, EVERY_SECOND, LONG = (TABLE, TABLE[:2]), np.arange(8.0)[::2], np.arange(200_000.0)
READ_BY_NUMBA = numba.njit(lambda k: TABLE[k])


def read(kind: int, k: int, table: Any = TABLE) -> float:
    """A number at an index of 3 to 6 numbers of some kind."""
    if kind < 3:
        return float(TABLE[k] if kind == 0 else GRID[k, 1] if kind == 1 else GRID[1, k])
    if kind < 6:
        return float(GRID[k][2] if kind == 3 else GRID.T[k, 0] if kind == 4 else TABLE[1:][k])
    if kind < 9:
        return float(EVERY_SECOND[k] if kind == 6 else LONG[99_999 * k] if kind == 7 else table[k])
    return float(PAIR[k] if kind == 9 else BOTH[1][k] if kind == 10 else b"abc"[k] if kind == 11 else READ_BY_NUMBA(k))


def test_an_index_counts_from_either_end_and_past_it_is_an_error() -> None:
    task = Task(
        ("read",), lambda scene, state, torque, impulse: read((round(torque) + 8) // 16, (round(torque) + 8) % 16 - 8)
    )
    env = started(JackInBoxEnv(contact="exact", task=task), seed=0)
    wrong = [0] * 13
    for kind, k in itertools.product(range(13), range(-5, 6)):
        share = (16 * kind + k) / Scene().torque_limit
        try:
            expected = read(kind % 12, k)  # the last kind is the first, by numba
        except IndexError:
            wrong[kind] += 1
            with pytest.raises(IndexError, match="out of"):
                env.step(share)
        else:
            assert env.step(share)[1] == expected, (kind, k)
    assert all(3 <= number <= 7 for number in wrong), wrong


def present(env: Any) -> Any:
    if isinstance(env, JackInBoxVectorEnv):
        return env.states, env.times, [env.impacts(number) for number in range(env.num_envs)]
    return env.state, env.time, env.impacts


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


WITHOUT_TORQUE: dict[str, Any] = {
    "division": lambda scene, state, torque, impulse: (1.0 / torque,),
    "infinite": lambda scene, state, torque, impulse: (math.inf if torque == 0.0 else 1.0,),
}


@EVERY_MODEL
@pytest.mark.parametrize("case", WITHOUT_TORQUE)
def test_arithmetic_that_fails_before_the_first_step_is_no_verdict(case: str, contact: str) -> None:
    values = WITHOUT_TORQUE[case]
    for make in MAKERS:
        env = started(make(contact=contact, task=Task(("part",), values)), seed=0)
        (expected,) = values(None, None, Scene().torque_limit, 0.0)
        np.testing.assert_allclose(env.step(np.ones(env.action_space.shape))[1], expected)
        seen = env.observation if make is JackInBoxEnv else env.observations
        assert np.isfinite(seen).all()
