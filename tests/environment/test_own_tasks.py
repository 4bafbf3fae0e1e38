"""A task of the user's own: the same reward in Python and compiled, alone and in a batch, and what is refused."""

from __future__ import annotations

import math
from types import ModuleType
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

import jackbox_env
from jackbox_env import JackInBoxEnv, JackInBoxVectorEnv, Scene, Task
from jackbox_env.scene import SceneNumbers
from jackbox_env.scoring import CompiledScore, PlainScore
from jackbox_env.tasks import TASKS, reward_of

EVERY_MODEL = pytest.mark.parametrize("contact", ["exact", "pymunk"])
BONUS = 0.125
helpers = ModuleType("helpers")
exec("def halved(value):\n    return half(value)\n\ndef half(value):\n    return 0.5 * value\n", helpers.__dict__)


def squared(value: float) -> float:
    return value * value


def everything(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float, ...]:
    """Five terms that read all there is, through helpers of every kind."""
    height = (state[4] - state[1]) / scene.box_half_width
    return (
        height if height > 0.0 else -2.0 * height,
        squared(torque / scene.torque_limit) + BONUS,
        helpers.halved(impulse) / (scene.jack_mass * scene.speed_scale),
        math.sqrt(abs(state[11])) * scene.restitution,
        1.0 if scene.chirp_rate > 0.5 else 0.0,
    )


OWN = Task(("height", "effort", "knock", "turning", "chirping"), everything)


def expected(scene: Scene, info: dict[str, Any]) -> tuple[float, ...]:
    return everything(scene.numbers, info["state"].tolist(), info["torque"], info["impulse"])


@EVERY_MODEL
def test_the_reward_is_what_the_function_says(contact: str) -> None:
    env = gym.make("JackInBox-v0", task=OWN, contact=contact)
    env.reset(seed=0)
    rng = np.random.default_rng(0)
    knocks = 0
    for _ in range(300):
        _, reward, _, _, info = env.step(rng.uniform(-1.0, 1.0, 1).astype(np.float32))
        terms = expected(Scene(), info)
        assert [info[f"reward_{name}"] for name in OWN.terms] == list(terms)
        assert reward == reward_of(terms)
        knocks += info["impacts"]
    assert knocks > 0


@pytest.mark.parametrize("count", [1, 3, 300])
def test_a_batch_earns_what_single_environments_earn(count: int) -> None:
    scenes = [Scene(gravity=1.0 + i, jack_mass=4.0 + i) for i in range(count)]
    for several in (False, True):
        batch = JackInBoxVectorEnv(
            count, contact="exact", task=OWN, with_infos=True, scene=scenes if several else scenes[0]
        )
        batch.reset(seed=0)
        number = count - 1
        env = JackInBoxEnv(contact="exact", task=OWN, scene=scenes[number if several else 0])
        env.reset(seed=number)
        rng = np.random.default_rng(0)
        for _ in range(120):
            actions = rng.uniform(-1.0, 1.0, count)
            _, rewards, _, _, infos = batch.step(actions)
            _, reward, _, _, info = env.step(actions[number])
            assert rewards[number] == reward
            assert all(infos[f"reward_{name}"][number] == info[f"reward_{name}"] for name in OWN.terms)


@EVERY_MODEL
def test_closures_are_functions_too(contact: str) -> None:
    def make(weight: float) -> Task:
        def weighted(value: float) -> float:
            return weight * value

        return Task(("time_like",), lambda scene, state, torque, impulse: (weighted(state[4]),))

    rewards = []
    for weight in (1.0, 3.0):
        env = JackInBoxEnv(contact=contact, task=make(weight))
        env.reset(seed=0)
        rewards.append(env.step(0.0)[1])
    assert rewards[1] == 3.0 * rewards[0] != 0.0


@pytest.mark.parametrize("name", TASKS)
def test_every_task_pays_the_same_compiled(name: str) -> None:
    rng, scene = np.random.default_rng(0), Scene(gravity=3.0, jack_mass=2.0)
    plain, compiled = PlainScore(scene, TASKS[name]), CompiledScore(scene, TASKS[name])
    paid = []
    for _ in range(300):
        state = rng.normal(size=12) * 2.0
        torque, impulse = rng.normal() * 6e4, abs(rng.normal()) * 30.0
        seen, terms = plain(state, torque, impulse)
        others = compiled(state, torque, impulse)
        assert list(terms) == list(others[1])
        np.testing.assert_allclose(seen, others[0], rtol=1e-6)
        paid.append(terms)
    assert np.ptp(np.array(paid), axis=0).min() > 0.005


def test_every_number_of_the_scene_is_there_by_its_name() -> None:
    lines = ", ".join(f"scene.{name}" for name in SceneNumbers._fields)
    space: dict[str, Any] = {}
    exec(f"def numbers(scene, state, torque, impulse):\n    return ({lines},)", space)
    scene = Scene(gravity=2.5)
    for contact in ("exact", "pymunk"):
        env = JackInBoxEnv(contact=contact, scene=scene, task=Task(SceneNumbers._fields, space["numbers"]))
        env.reset(seed=0)
        info = env.step(0.0)[4]
        assert tuple(info[f"reward_{name}"] for name in SceneNumbers._fields) == scene.numbers


def test_terms_are_summed_in_their_order() -> None:
    task = Task(("a", "b", "c"), lambda scene, state, torque, impulse: (1e16, 1.0 + 0.0 * state[0], -1e16))
    single, batch = JackInBoxEnv(contact="exact", task=task), JackInBoxVectorEnv(2, contact="exact", task=task)
    single.reset(seed=0)
    batch.reset(seed=0)
    assert single.step(0.0)[1] == batch.step(None)[1][0] == (1e16 + 1.0) - 1e16 != math.fsum((1e16, 1.0, -1e16))


def test_an_error_in_the_function_comes_back_and_leaves_all_as_it_was() -> None:
    def strict(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
        if torque > 0.0:
            raise ValueError("no push to the left, please")
        return (1.0,)

    for contact in ("exact", "pymunk"):
        envs: list[Any] = [
            JackInBoxEnv(contact=contact, task=Task(("strict",), strict)),
            JackInBoxVectorEnv(3, contact=contact, task=Task(("strict",), strict)),
        ]
        for env in envs:
            env.reset(seed=0)
            push = np.ones(1) if isinstance(env, JackInBoxEnv) else np.ones(3)
            before, time = (env.state, env.time) if isinstance(env, JackInBoxEnv) else (env.states, env.times)
            with pytest.raises(ValueError, match="no push to the left"):
                env.step(push)
            after, later = (env.state, env.time) if isinstance(env, JackInBoxEnv) else (env.states, env.times)
            np.testing.assert_array_equal(after, before)
            np.testing.assert_array_equal(later, time)
            assert np.all(env.step(-push)[1] == 1.0)


# -- the state --------------------------------------------------------------------------------------------------------


def looped(state: Any) -> float:
    total = 0.0
    for place, value in enumerate(state):
        total += (place + 1.0) * value
    for place in range(len(state)):
        total -= state[place] * state[-1 - place]
    return total


def unpacked(state: Any) -> float:
    a, b, c, d, e, f, g, h, i, j, k, last = state
    return float(a - b + 2.0 * c - d + 3.0 * e - f + 4.0 * g - h + 5.0 * i - j + 6.0 * k - last)


def products(state: Any) -> float:
    total = 0.0
    for value, rate in zip(state[:6], state[6:]):  # noqa: B905
        total += value * rate
    return total


WAYS: dict[str, Any] = {
    "index": lambda state: state[-1] + 2.0 * state[-12] + state[11],
    "slice": lambda state: state[6:][3] + state[-3:][1] + len(state[::5]),
    "len": lambda state: float(len(state)),
    "max": lambda state: max(state) - min(state),
    "sum": lambda state: sum(state),
    "loop": looped,
    "unpack": unpacked,
    "products": products,
}


@pytest.mark.parametrize("way", WAYS)
def test_a_task_sees_the_same_twelve_numbers_everywhere(way: str) -> None:
    read = WAYS[way]
    task = Task(("read",), lambda scene, state, torque, impulse: (read(state),))
    batch = JackInBoxVectorEnv(3, contact="exact", task=task)
    batch.reset(seed=0)
    played: Any = jackbox_env.rollout(None, batch.states, np.full((3, 60), 4.5e4), 0.02, rewards=task)
    single, plain = JackInBoxEnv(contact="exact", task=task), JackInBoxEnv(task=task)
    single.reset(seed=2)
    plain.reset(seed=2)
    for earned in played.rewards.T:
        np.testing.assert_array_equal(batch.step(np.full(3, 0.5))[1], earned)
        for env in (single, plain):
            _, reward, _, _, info = env.step(0.5)
            assert reward == pytest.approx(read(info["state"].tolist()), rel=1e-14, abs=1e-13)
            assert reward == earned[2] or env is plain


@EVERY_MODEL
def test_a_task_that_writes_to_the_state_is_refused(contact: str) -> None:
    def pushing(scene: Any, state: Any, torque: float, impulse: float) -> tuple[float]:
        state[10] = 50.0
        return (1.0,)

    task = Task(("push",), pushing)
    for make in (JackInBoxEnv, JackInBoxVectorEnv):
        with pytest.raises(TypeError):
            make(contact=contact, task=task)
    if contact == "exact":
        with pytest.raises(TypeError):
            jackbox_env.rollout(None, np.zeros(12), np.zeros(3), 0.02, rewards=task)


@EVERY_MODEL
@pytest.mark.parametrize("divided", [lambda by: 1.0 / by, lambda by: 1.0 // by, lambda by: 1 // int(by)])
def test_a_division_by_zero_is_an_error_in_every_model(contact: str, divided: Any) -> None:
    task = Task(("part",), lambda scene, state, torque, impulse: (float(divided(torque + 1.0)),))
    for env in (JackInBoxEnv(contact=contact, task=task), JackInBoxVectorEnv(1, contact=contact, task=task)):
        env.reset(seed=0)
        with pytest.raises(ZeroDivisionError):
            env.step(np.full(1, -1.0 / Scene().torque_limit))


# -- refusals ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("values", "message"),
    [
        (lambda scene, state, torque, impulse: (1.0,), "a tuple of 2 floats, one for each term, got"),
        (lambda scene, state, torque, impulse: 1.0, "a tuple of 2 floats"),
        (lambda scene, state, torque, impulse: (1, 2.0), "a tuple of 2 floats"),
        (lambda scene, state, torque, impulse: (1j, 2j), "a tuple of 2 floats"),
        (lambda scene, state, torque, impulse: (scene.nothing, 1.0), "cannot be compiled.*'nothing'"),
        (lambda scene, state, torque, impulse: (nowhere, 1.0), "cannot be compiled.*'nowhere'"),  # type: ignore[name-defined]  # noqa: F821
        (lambda scene, state, torque, impulse: (np.sum(state * 2.0), 1.0), "cannot be compiled.*UniTuple"),
        (lambda scene, state, torque, impulse: [state[0], 1.0], "cannot be compiled.*use single numbers"),
        (lambda scene, state, torque: (1.0, 1.0), "cannot be compiled.*4 argument"),
    ],
)
def test_what_cannot_be_compiled_is_refused_at_once_in_one_sentence(values: Any, message: str) -> None:
    for make in (JackInBoxEnv, JackInBoxVectorEnv):
        with pytest.raises(TypeError, match=message) as caught:
            make(contact="exact", task=Task(("a", "b"), values))
        assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("task", "message"),
    [
        ("fly", "task must be one of 'juggle', 'spin', 'rattle', got 'fly'"),
        (3.0, "or a jackbox_env.Task, got 3.0"),
        (Task((), everything), "terms must be a tuple of different names"),
        (Task(("a", "a"), everything), "terms must be a tuple of different names"),
        (Task("height", everything), "terms must be a tuple of different names"),
        (Task(("a",), math.sin), "values must be a plain Python function"),
        (Task(("a",), lambda scene, state, torque, impulse: (1.0, 2.0)), "tuple of 1"),
    ],
)
@EVERY_MODEL
def test_unfit_tasks_are_refused(contact: str, task: Any, message: str) -> None:
    for make in (JackInBoxEnv, JackInBoxVectorEnv):
        with pytest.raises((TypeError, ValueError), match=message):
            make(contact=contact, task=task)
