"""A second thread in a simulator or a batch is refused, and changes nothing."""

from __future__ import annotations

import copy
import pickle
import threading
from _thread import get_ident
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from jackbox_env import Drive, JackInBoxEnv, JackInBoxVectorEnv, Scene, make_simulator
from jackbox_env.tools.one_thread import ThreadNote
from tests.states import started


class Torque:
    """A drive's function that can wait for the test, or raise."""

    def __init__(self) -> None:
        self.begun, self.goes_on = threading.Event(), threading.Event()
        self.waits = self.raises = False

    def __call__(self, time: float) -> float:
        if self.raises:
            raise KeyboardInterrupt
        if self.waits:
            self.begun.set()
            assert self.goes_on.wait(20.0)
        return 1000.0


def simulator(contact: str, scene: Scene) -> tuple[Any, Callable[[], Any], list[Callable[[], Any]]]:
    made = started(make_simulator(scene, contact), np.zeros(12))
    return made, lambda: made.step(0.02), [lambda: made.step(0.02), lambda: made.reset(np.zeros(12))]


def single(contact: str, scene: Scene) -> tuple[Any, Callable[[], Any], list[Callable[[], Any]]]:
    env = started(JackInBoxEnv(contact=contact, scene=scene), seed=0)
    return env, lambda: env.step(None), [lambda: env.step(None), env.reset, lambda: env.set_state(np.zeros(12))]


def batch(contact: str, scene: Scene) -> tuple[Any, Callable[[], Any], list[Callable[[], Any]]]:
    env = started(
        JackInBoxVectorEnv(2, contact=contact, scene=scene, render_mode="rgb_array" if contact == "pymunk" else None),
        seed=0,
    )
    refused: list[Callable[[], Any]] = [
        lambda: env.step(None), env.reset, lambda: env.set_states(np.zeros(12), 0.0), lambda: env.impacts(0),
        lambda: env.observations,
    ]  # fmt: skip
    return env, lambda: env.step(None), refused + [env.render] * (contact == "pymunk")


def states(of: Any) -> bytes:
    all_states: np.ndarray[Any, Any] = of.states if isinstance(of, JackInBoxVectorEnv) else of.state
    return all_states.tobytes()


def in_thread(work: Callable[[], Any]) -> threading.Thread:
    thread = threading.Thread(target=work, daemon=True)
    thread.start()
    return thread


@pytest.mark.parametrize("contact", ["exact", "pymunk"])
@pytest.mark.parametrize("kind", [simulator, single, batch])
def test_calls_by_a_second_thread_are_refused(kind: Any, contact: str) -> None:
    torque = Torque()
    made, step, calls = kind(contact, Scene(drive=Drive(torque=torque)))
    twin, step_twin, _ = kind(contact, Scene(drive=Drive(torque=lambda time: 1000.0)))
    torque.waits = True
    other = in_thread(step)
    assert torque.begun.wait(20.0)
    for call in calls:
        with pytest.raises(RuntimeError, match="one thread at a time"):
            call()
    torque.goes_on.set()
    other.join(20.0)
    step(), step_twin(), step_twin()
    assert states(made) == states(twin)


@pytest.mark.parametrize("kind", [simulator, single, batch])
def test_all_threads_may_go_on_after_an_interruption_and_copies_too(kind: Any) -> None:
    torque = Torque()
    made, step, _ = kind("exact", Scene(drive=Drive(torque=torque)))
    before = states(made)
    torque.raises = True
    with pytest.raises(KeyboardInterrupt):
        step()
    torque.raises = False
    assert states(made) == before
    note: ThreadNote = (made._model.simulator if isinstance(made, JackInBoxEnv) else made)._inside
    note[0] = get_ident()  # as if the interruption had cut the leaving too
    assert copy.copy(note) == copy.deepcopy(note) == pickle.loads(pickle.dumps(note)) == {}
    step()
    after = states(made)
    in_thread(step).join(20.0)
    assert states(made) != after
