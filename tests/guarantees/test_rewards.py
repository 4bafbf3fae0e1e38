"""A custom task is paid the same everywhere, changes no number, and is never mixed up with another task."""

from __future__ import annotations

import copy
import functools
import gc
import math
import sys
import weakref
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest
from gymnasium.spaces import Box
from gymnasium.vector import SyncVectorEnv

import jackbox_env
from jackbox_env import Action, JackInBoxEnv, JackInBoxVectorEnv, Observation, Task, rollout
from jackbox_env.exact import score
from jackbox_env.exact.threads import Threads
from jackbox_env.jit import compiler
from jackbox_env.model.states import total
from jackbox_env.model.tasks import TASKS
from jackbox_env.sb3 import make_sb3_vec_env
from jackbox_env.simulators import CONTACT_MODELS
from jackbox_env.simulators import users_functions as scoring
from tests.states import started

MAKERS: list[Any] = [JackInBoxEnv, functools.partial(JackInBoxVectorEnv, 2)]


# -- the same numbers everywhere ---------------------------------------------------------------------------------------


def looped(state: Any) -> float:
    total = 0.0
    for index, value in enumerate(state):
        total += (index + 1.0) * value
    for index in range(len(state)):
        total -= state[index] * state[-1 - index]
    return total


def unpacked(state: Any) -> float:
    a, b, c, d, e, f, g, h, i, j, k, last = state
    return float(a - b + 2.0 * c - d + 3.0 * e - f + 4.0 * g - h + 5.0 * i - j + 6.0 * k - last)


def task_terms(value: float) -> float:
    """A helper with the name of one in the compiled code."""
    return value * value


def read(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, ...]:
    """By index, slice, comparison and loop, and from every argument."""
    return (
        state[-1] + 2.0 * state[-12] + state[11],
        state[6:][3] + state[-3:][1] + len(state[::5]),
        max(state) - min(state),
        sum(state),
        looped(state),
        unpacked(state),
        task_terms(torque / scene.torque_limit) + math.sqrt(abs(state[11])) * scene.restitution,
        0.5 * impulse / (scene.jack_mass * scene.speed_scale),
        1.0 if scene.chirp_rate > 0.5 else 0.0,
        scene.box_half_width, scene.box_mass, scene.box_inertia, scene.jack_arm, scene.jack_inertia, scene.gravity,
        scene.chirp_amplitude, scene.chirp_start_frequency, scene.chirp_rate,
    )  # fmt: skip


def test_a_task_sees_the_same_numbers_everywhere() -> None:
    names = tuple(f"part_{number}" for number in range(18))
    task = Task(names, read)
    batch = started(JackInBoxVectorEnv(3, contact="exact", task=task), seed=0)
    played: Any = jackbox_env.rollout(None, batch.states, np.full((3, 150), 4.5e4), 0.02, rewards=task)
    single, plain = (started(JackInBoxEnv(contact=contact, task=task), seed=2) for contact in ("exact", "pymunk"))
    knocks = 0
    for earned in played.rewards.T:
        np.testing.assert_array_equal(batch.step(np.full(3, 0.5))[1], earned)
        for env in (single, plain):
            _, reward, _, _, info = env.step(0.5)
            terms = read(env.scene.numbers, info["state"].tolist(), info["torque"], info["impulse"])
            assert [info[f"reward_{name}"] for name in names] == pytest.approx(list(terms), rel=1e-14, abs=1e-13)
            assert reward == pytest.approx(total(terms), rel=1e-14, abs=1e-13)
            assert reward == earned[2] or env is plain
            knocks += info["impacts"]
    assert knocks > 0


def test_numbers_of_any_kind_are_terms_observations_and_torques_with_the_same_bits() -> None:
    named: dict[str, Any] = {}
    exec("def values(scene, state, torque, impulse): return float(torque < 1.0), 2, state[5] < 9.0, state[5]", named)
    task = Task(("a", "b", "c", "d"), named["values"])
    plain = Task(("a",), lambda scene, state, torque, impulse: 4.0 + state[5])
    assert paid_everywhere(task) == paid_everywhere(plain)
    assert paid_now(plain, "pymunk") == paid_now(task, "pymunk")
    assert paid_now(Task(("one",), lambda scene, state, torque, impulse: True)) == 1.0
    seen = Observation(("a", "b", "c"), -9.0, 9.0, lambda scene, state, time: (1, time < 9.0, state.y_jack))
    right = Action(Box(-1, 1, (1,)), lambda scene, state, action, time, dt: state.x_jack > -9.0)
    envs = [JackInBoxEnv(contact=contact, observation=seen, action=right) for contact in CONTACT_MODELS]
    np.testing.assert_array_equal(envs[0].reset(seed=0)[0], envs[1].reset(seed=0)[0])
    assert [env.step(0.0)[4]["torque"] for env in envs] == pytest.approx([90000.0] * 2)


def test_terms_are_summed_in_their_order() -> None:
    task = Task(("a", "b", "c"), lambda scene, state, torque, impulse: (1e16, 1.0 + 0.0 * state[0], -1e16))
    assert paid_everywhere(task) == (1e16 + 1.0) - 1e16 != math.fsum((1e16, 1.0, -1e16))


# -- nobody is paid another's ------------------------------------------------------------------------------------------


def paid_now(task: Task, contact: str = "exact") -> float:
    """The reward of a first step in a new environment."""
    env = started(JackInBoxEnv(contact=contact, task=task), seed=0)
    return env.step(0.0)[1]


def paid_everywhere(task: Task, contact: str = "exact") -> float:
    """The same reward, asserted equal in every kind of environment, and in a rollout."""
    made, reward = {"contact": contact, "task": task}, paid_now(task, contact)
    batch, stable = JackInBoxVectorEnv(2, **made), make_sb3_vec_env(2, **made)
    sync = SyncVectorEnv([functools.partial(JackInBoxEnv, **made)] * 2)
    stable.seed(0)
    stable.reset()
    for envs in (batch, sync):
        envs.reset(seed=0)
    states = batch.states
    assert reward == batch.step(np.zeros(2))[1][0] == sync.step(np.zeros((2, 1)))[1][0]
    assert np.float32(reward) == stable.step(np.zeros((2, 1)))[1][0]
    if contact == "exact":
        assert reward == paid_in_a_rollout(task, states)
    return reward


def paid_in_a_rollout(task: Task, states: Any) -> float:
    return float(rollout(None, states, np.zeros(1), 0.02, rewards=task).rewards[0, 0])


WEIGHT = 1.0
module: Any = ModuleType("module")
module.weight = 1e5


def helper(value: float) -> float:
    return 1000.0 * value


def test_a_task_is_read_once_for_all_environments_and_a_new_task_sees_every_change(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    long, pair, more = np.full(200_000, 10.0), (np.full(6, 100.0)[::2], 7), np.full(1, 10000.0)

    def reading(scene: Any, state: Any, torque: float, impulse: float, more: Any = more) -> Any:
        def inner(value: float) -> Any:
            return helper(value) + more[0]

        return (WEIGHT + long[0] + pair[0][0] + inner(1.0) + module.weight,)

    here, (alone, planned, plain) = sys.modules[__name__], (Task(["paid"], reading) for _ in range(3))
    assert paid_now(alone) == paid_in_a_rollout(planned, np.zeros(12)) == paid_everywhere(plain, "pymunk") == 111111.0
    changes: list[Callable[[], Any]] = [
        lambda: monkeypatch.setattr(here, "WEIGHT", 2.0), lambda: long.fill(20.0), lambda: pair[0].fill(200.0),
        lambda: monkeypatch.setattr(here, "helper", lambda value: 2000.0 * value),
        lambda: more.fill(20000.0), lambda: monkeypatch.setattr(module, "weight", 2e5),
    ]  # fmt: skip
    for number, change in enumerate(changes):
        change()
        assert paid_now(Task(("paid",), reading)) == float("111111"[: 5 - number] + "222222"[: number + 1])
    assert paid_everywhere(planned) == paid_everywhere(alone) == 111111.0
    assert paid_everywhere(plain, "pymunk") == 222222.0
    monkeypatch.setattr(compiler, "_jitted", lambda *_: pytest.fail("compiled again"))
    assert paid_everywhere(copy.deepcopy(alone)) == 111111.0


GAIN = np.array([0.25])
NOUNS: dict[str, Callable[[], Any]] = {
    "task": lambda: Task(("share",), lambda scene, state, torque, impulse: torque / scene.torque_limit),
    "observation": lambda: Observation(("gain",), 0.0, 1.0, lambda scene, state, time: (GAIN[0],)),
    "action": lambda: Action(Box(-1.0, 1.0, (1,)), lambda scene, state, action, time, dt: GAIN[0]),
}


def test_observations_and_actions_are_read_once_too() -> None:
    def shown(env: Any) -> set[float]:
        """All observations, and the torque over its limit."""
        first, (then, reward, *_) = env.reset(seed=0)[0], env.step(np.zeros(env.action_space.shape))
        now = env.observation if isinstance(env, JackInBoxEnv) else env.observations
        return {*map(float, np.ravel([first, then, now])), *np.ravel(reward)}

    GAIN[0] = 0.25
    made: dict[str, Any] = {"contact": "exact", **{name: noun() for name, noun in NOUNS.items()}}
    env = JackInBoxEnv(**made)
    GAIN[0] = 0.5
    assert [shown(one) for one in (env, JackInBoxVectorEnv(2, **made), JackInBoxEnv(**made))] == [{0.25}] * 3
    assert shown(JackInBoxEnv(contact="exact", **{name: noun() for name, noun in NOUNS.items()})) == {0.5}


def test_functions_that_differ_only_in_their_closure_or_a_default_are_paid_apart() -> None:
    def task(weight: Any) -> Task:
        def pair(scene: Any, state: Any, torque: float, impulse: float, by: Any = weight) -> tuple[float, float]:
            return math.copysign(1.0 + weight, weight), math.copysign(10.0 + by, by)

        return Task(("closed", "default"), pair)

    def first(pair: Any) -> Task:
        return Task(("paid",), lambda scene, state, torque, impulse, by=pair: (math.copysign(1.0, by[0]),))

    weights = {"0.0": 0.0, "-0.0": -0.0, "numpy's": np.float64(-0.0), "0": 0, "True": True, "2": 2}
    paid = {name: paid_now(task(weight)) for name, weight in weights.items()}
    assert paid == {"0.0": 11.0, "-0.0": -11.0, "numpy's": -11.0, "0": 11.0, "True": 13.0, "2": 15.0}
    assert [paid_now(first((zero, 2.0))) for zero in (0.0, -0.0)] == [1.0, -1.0]


def test_a_task_of_a_built_in_ones_name_is_paid_as_its_own_and_nothing_of_it_is_stored(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    @functools.wraps(TASKS["juggle"].values)
    def wrapped(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
        return (-900.0,)

    def named(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
        return (-5.0,)

    named.__name__, named.__qualname__, named.__module__ = "spin", "spin", "jackbox_env.model.tasks"
    before = [paid_everywhere(task) for task in TASKS.values()]
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path))
    assert [paid_everywhere(Task(("paid",), values)) for values in (wrapped, named)] == [-900.0, -5.0]
    assert not [*tmp_path.rglob("*.kept")]
    assert [paid_everywhere(task) for task in TASKS.values()] == before


def test_machine_code_is_freed_with_whatever_it_was_compiled_for() -> None:
    owners = {name: noun() for name, noun in NOUNS.items()}
    for make in MAKERS:
        env = started(make(contact="exact", **owners), seed=0)
        env.step(np.zeros(env.action_space.shape))
    entries: list[Any] = [entry for owner in owners.values() for entry in scoring._compiled[owner].entries.values()]
    engines = [made.library.codegen._engine._ee for entry in entries for made in entry.overloads.values()]
    alive = [weakref.ref(one) for one in (*owners.values(), *entries, *engines)]
    assert len(engines) > len(owners)
    del owners, entries, engines, env
    gc.collect()
    assert not [one() for one in alive if one()]


def test_a_thread_still_at_work_keeps_the_machine_code_that_it_calls(monkeypatch: pytest.MonkeyPatch) -> None:
    task = Task(("paid",), lambda scene, state, torque, impulse: (1.0,))
    batch, begun = started(JackInBoxVectorEnv(2, contact="exact", task=task), seed=0), list[Any]()

    def interrupted(threads: Threads, work: Any, *_: Any, **__: Any) -> None:
        begun.append(work)
        raise RuntimeError

    monkeypatch.setattr(Threads, "run", interrupted)
    with pytest.raises(RuntimeError):
        batch.step(np.zeros(2))
    called = weakref.ref(scoring._compiled[task].entries[score.score_block])
    del batch, task
    gc.collect()
    assert called() is not None
    begun.clear()
    gc.collect()
    assert called() is None
