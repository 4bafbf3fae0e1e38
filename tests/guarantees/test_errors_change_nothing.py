"""A call that raises leaves an environment or a batch as it was: states, the last step's impacts and torque, generators
and pictures.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jackbox_env import Drive, JackInBoxEnv, JackInBoxVectorEnv, Observation, Scene, Task, TaskError, make_simulator
from jackbox_env.model.tasks import sample_start
from tests.states import started

FALLING = np.array([0.0, 0, 0, 3.0, -4.9, 0, 0, 0, 0, 0, -10, 0])  # a foot strikes the floor within the first step
LOST, UNREWARDED = 1.0, 5e-15  # shares of the torque limit that raise
BAD = {"raise": False}  # whether starts and drives raise now
KINDS = ["exact", "pymunk", "exact batch", "pymunk batch", "rendered exact batch"]


def value(scene: Any, state: Any, torque: float, impulse: float) -> float:
    return math.nan if 0.4 < torque < 0.6 else state.y_jack


def start(scene: Scene, rng: Any) -> Any:
    drawn = sample_start(scene, rng)
    return np.zeros(3) if BAD["raise"] else drawn


def drive(time: float) -> float:
    if BAD["raise"]:
        raise ZeroDivisionError("from a drive")
    return 100.0


SCENE = Scene(torque_limit=1e14, drive=Drive(torque=drive))
TASK = Task(("height",), value, start=start)


def made(kind: str, steps: int = 10) -> Any:
    """One or two environments whose last step had an impact each."""
    contact = "exact" if "exact" in kind else "pymunk"
    shown = None if kind == "exact batch" else "rgb_array"
    settings: dict[str, Any] = {
        "contact": contact, "scene": SCENE, "task": TASK, "observation": "pixels-16x16x2", "render_mode": shown,
    }  # fmt: skip
    if "batch" not in kind:
        env = started(JackInBoxEnv(**settings, render_size=(64, 64)), seed=0, options={"state": FALLING})
        env.step(0.0)
        return env
    envs = started(
        JackInBoxVectorEnv(2, steps, "SAME_STEP", **settings, render_size=(64, 64)), seed=0, options={"state": FALLING}
    )
    envs.step(np.zeros(2))
    return envs


def shown(env: Any) -> list[Any]:
    """All that a user can read, and the generators."""
    if isinstance(env, JackInBoxEnv):
        torque, picture, generator = env._model.simulator.torque, env.render(), env.np_random.bit_generator.state
        assert picture is not None
        return [
            env.state.tobytes(),
            env.time,
            env.impacts,
            torque,
            env.observation.tobytes(),
            picture.tobytes(),
            generator,
        ]
    frames = [frame.tobytes() for frame in env.render()] if env.render_mode else []
    words = env._batch.draw(np.arange(2), placed=True).generators
    generators = words.tobytes() if isinstance(words, np.ndarray) else [one.bit_generator.state for one in words]
    impacts = [env.impacts(number) for number in range(2)]
    return [env.states.tobytes(), env.times.tobytes(), impacts, env.observations.tobytes(), frames, generators]


def actions(env: Any, first: float, second: float = 0.0) -> Any:
    return first if isinstance(env, JackInBoxEnv) else np.array([second, first])


def set_state(env: Any, state: Any) -> Any:
    return env.set_state(state) if isinstance(env, JackInBoxEnv) else env.set_states(state, 0.0)


CALLS: dict[str, Callable[[Any], Any]] = {
    "an action of NaN": lambda env: env.step(actions(env, math.nan)),
    "actions of a wrong shape": lambda env: env.step(np.zeros(7)),
    "a lost jack": lambda env: env.step(actions(env, LOST)),
    "a reward of NaN": lambda env: env.step(actions(env, UNREWARDED)),
    "a drive that raises": lambda env: env.step(None),
    "a state of a wrong shape": lambda env: set_state(env, np.zeros(3)),
    "a state far outside": lambda env: set_state(env, FALLING * 10.0),
    "a start that is refused": lambda env: env.reset(seed=7),
    "an option's state": lambda env: env.reset(seed=7, options={"state": np.zeros(3)}),
    "an option's scene": lambda env: env.reset(seed=7, options={"scene": {"gravity": -1.0}}),
    "an option's time": lambda env: env.reset(seed=7, options={"time": math.nan}),
}


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("name", CALLS)
def test_a_refused_call_changes_nothing(kind: str, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    env, twin = made(kind), made(kind)
    before = shown(env)
    assert env.impacts if isinstance(env, JackInBoxEnv) else all(map(env.impacts, range(2)))
    with monkeypatch.context() as patch:
        patch.setitem(BAD, "raise", True)
        with pytest.raises((TypeError, ValueError, RuntimeError, ZeroDivisionError)):
            CALLS[name](env)
    assert shown(env) == before
    for one in (env, twin):
        one.step(actions(one, 1e-10, 2e-10))
    assert shown(env) == shown(twin)


@pytest.mark.parametrize("kind", [kind for kind in KINDS if "batch" in kind])
def test_a_restart_that_is_refused_within_a_step_changes_nothing(kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    envs = made(kind, steps=2)
    before = shown(envs)
    with monkeypatch.context() as patch:
        patch.setitem(BAD, "raise", True)
        with pytest.raises(ValueError, match="start"):
            envs.step(np.zeros(2))  # the second step ends both episodes
    assert shown(envs) == before


@pytest.mark.parametrize("contact", ["exact", "pymunk"])
@pytest.mark.parametrize("call", [
    lambda one: one.step(0.02, math.nan), lambda one: one.step(-1.0), lambda one: one.step(0.02, 1e14),
    lambda one: one.step(0.02), lambda one: one.reset(np.zeros(3)), lambda one: one.reset(np.zeros(12), math.inf),
])  # fmt: skip
def test_a_refused_call_of_a_simulator_changes_nothing(
    contact: str, call: Callable[[Any], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    simulator = started(make_simulator(SCENE, contact), FALLING)
    simulator.step(0.02, 5.0)
    before = simulator.state.tobytes(), simulator.time, simulator.torque, simulator.impacts
    monkeypatch.setitem(BAD, "raise", True)
    with pytest.raises((ValueError, RuntimeError, ZeroDivisionError)):
        call(simulator)
    assert simulator.impacts
    assert (simulator.state.tobytes(), simulator.time, simulator.torque, simulator.impacts) == before


@pytest.mark.parametrize("contact", ["exact", "pymunk"])
def test_the_present_may_be_restored_after_several_steps(contact: str) -> None:
    simulator, twin = make_simulator(SCENE, contact), make_simulator(SCENE, contact)
    for one in (simulator, twin):
        one.reset(FALLING)
        one.step(0.02, 5.0)
    snapshot = simulator.snapshot()
    for _ in range(3):
        simulator.step(0.02, -1e5)
    simulator.restore(snapshot)
    for _ in range(3):
        assert (simulator.state.tobytes(), simulator.torque, simulator.impacts) == (
            twin.state.tobytes(), twin.torque, twin.impacts,
        )  # fmt: skip
        simulator.step(0.02, 1e5), twin.step(0.02, 1e5)


def test_a_refused_start_in_another_scene_changes_no_picture() -> None:
    def height(scene: Any, state: Any, time: float) -> Any:
        return (math.nan if scene.box_half_width == 9.0 else state.y_jack,)

    envs = started(JackInBoxVectorEnv(2, contact="pymunk", observation=Observation(("y",), -1.0, 1.0, height),
                              render_mode="rgb_array", render_size=(64, 64)), seed=0,
                   options={"state": FALLING})  # fmt: skip
    for _ in range(2):  # what is restored may be restored again
        before = shown(envs)
        with pytest.raises(TaskError):
            envs.reset(seed=1, options={"scene": [{"box_half_width": 12.0}, {"box_half_width": 9.0}]})
        assert shown(envs) == before
        envs.step(np.zeros(2))
