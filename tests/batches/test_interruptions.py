"""Interruptions at any moment: a call is done entirely or not at all, nothing hangs, no thread writes afterwards."""

from __future__ import annotations

import itertools
import subprocess
import sys
import threading
import time
from collections.abc import Callable
from pathlib import Path
from queue import SimpleQueue
from types import FrameType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jackbox_env import JackInBoxVectorEnv, Scene, make_simulator, planning, rollout
from jackbox_env.batches import exact, threads
from jackbox_env.compiled import compiler, glide, loop
from jackbox_env.compiled.compiler import PACKAGE
from jackbox_env.compiled.rollouts import roll
from jackbox_env.compiled.status import Status
from scripts.studies.laws.interruptions import same
from tests.batches.waiting import until

ROOT = Path(__file__).parents[2]


# -- at every instruction ---------------------------------------------------------------------------------------------


def struck(call: Callable[[], Any], at: int) -> bool:
    """Make a call and raise KeyboardInterrupt before the ``at``-th instruction of this package; return whether it did.

    Python itself checks for signals at fewer instructions: never between the end of a ``with`` and the release of its
    lock. So the one lock on the way, the compiler's, is left out.
    """
    left = at

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        nonlocal left
        file = frame.f_code.co_filename
        if not file.startswith(str(PACKAGE)) or file == compiler.__file__:
            return None
        frame.f_trace_opcodes = True
        left -= event == "opcode"
        if left <= 0:
            raise KeyboardInterrupt
        return trace

    before = sys.gettrace()
    sys.settrace(trace)
    try:
        call()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


def told(env: Any) -> list[Any]:
    """Everything that determines the future."""
    vector = getattr(env, "vector_env", env)
    held = vector._batch.held
    if hasattr(held, "blocks"):
        held.settle()
        generators = held.generators.copy()
    else:
        generators = [generator.bit_generator.state for generator in held.generators]
    entered = held.book.entered and [*held.book.entered[:2], env.reset_infos]
    episodes = held.over, held.column(glide.STEPS) if hasattr(held, "column") else held.steps.copy()
    scenes = [repr(scene) for scene in vector.scenes]
    return [held.states, held.times, *episodes, generators, *held.book[:3], entered, vector.observations, scenes]


def staggered(make: Callable[[], Any]) -> tuple[Any, Any]:
    """An environment and its twin. Their episodes end one after another, so every step restarts one."""
    pair = make(), make()
    for env in pair:
        if not isinstance(env, JackInBoxVectorEnv):
            env.seed(0)
        env.reset()
        vector = getattr(env, "vector_env", env)
        vector.reset(seed=0)
        for number in range(vector.num_envs - 1):
            vector.step(np.zeros(vector.num_envs))
            vector.reset(options={"reset_mask": np.arange(vector.num_envs) == number})
    assert same(told(pair[0]), told(pair[1]))
    return pair


def step(env: Any, seed: int) -> Any:
    vector = getattr(env, "vector_env", env)
    return env.step(np.random.default_rng(seed).uniform(-1.0, 1.0, (vector.num_envs, 1)))


def put(env: Any, seed: int) -> None:
    states = np.zeros((env.num_envs, 12))
    states[:, 9] = np.random.default_rng(seed).uniform(-5.0, 5.0, env.num_envs)
    env.set_states(states, 0.5)


def start(env: Any, seed: int) -> Any:
    return env.reset(seed=seed) if isinstance(env, JackInBoxVectorEnv) else (env.seed(seed), env.reset())


def start_some(env: Any, seed: int) -> Any:
    env.reset(seed=seed, options={"reset_mask": np.array([True, False, True]), "time": 0.25})


def assert_all_or_nothing(pair: tuple[Any, Any], call: Callable[[Any, int], Any], stride: int) -> int:
    """Interrupt a call at every ``stride``-th instruction in turn; return how often it was done nevertheless."""
    env, twin = pair
    done = 0
    for at in itertools.count(1, stride):
        before = told(env)
        interrupted = struck(lambda at=at: call(env, at), at)  # type: ignore[misc]
        call(twin, at)
        now = told(env)
        if interrupted and same(now, before):
            call(env, at)
            now = told(env)
        else:
            done += 1
        assert same(now, told(twin)), f"interrupted before instruction {at}"
        assert same(step(env, at), step(twin, at)), f"after an interruption before instruction {at}"
        if not interrupted:
            assert at > 100
            return done
    raise AssertionError


def exact_of(mode: str) -> Callable[[], Any]:
    settings: Any = {"contact": "exact", "max_episode_steps": 2, "with_infos": True, "autoreset_mode": mode}
    # Blocks of one environment each; two threads find work for both where four blocks are one piece.
    return lambda: JackInBoxVectorEnv(3, num_threads=2, **settings)


def sb3_of(contact: str) -> Callable[[], Any]:
    def make() -> Any:
        pytest.importorskip("stable_baselines3")
        from jackbox_env.sb3 import make_sb3_vec_env

        return make_sb3_vec_env(2, contact=contact, max_episode_steps=2, with_infos=True)

    return make


def engine() -> Any:
    return JackInBoxVectorEnv(3, contact="pymunk", max_episode_steps=2, with_infos=True)


def drawn(contact: str, randomize: Any) -> Callable[[], Any]:
    return lambda: JackInBoxVectorEnv(2, contact=contact, max_episode_steps=2, randomize=randomize)


def choose(rng: np.random.Generator) -> dict[str, Any]:
    return {"gravity": float(rng.choice([1.0, 2.0, 3.0]))}


def change(env: Any, seed: int) -> Any:
    return env.reset(options={"scene": {"jack_mass": 1.0 + seed % 7}, "reset_mask": np.array([False, True])})


CALLS: dict[str, tuple[Callable[[], Any], Callable[[Any, int], Any], int]] = {
    "step": (exact_of("NEXT_STEP"), step, 1),
    "step, restarts at once": (exact_of("SAME_STEP"), step, 3),
    "set_states": (exact_of("NEXT_STEP"), put, 3),
    "reset": (exact_of("NEXT_STEP"), start, 3),
    "reset of some": (exact_of("NEXT_STEP"), start_some, 3),
    "step, scenes drawn": (drawn("exact", {"gravity": (1.0, 9.0)}), step, 5),
    "step, scenes chosen": (drawn("exact", choose), step, 17),
    "step, scenes drawn, pymunk": (drawn("pymunk", {"gravity": (1.0, 9.0)}), step, 101),
    "reset, another scene": (drawn("exact", {"gravity": (1.0, 9.0)}), change, 11),
    "sb3 step": (sb3_of("exact"), step, 7),
    "sb3 reset": (sb3_of("exact"), start, 7),
    "sb3 step, pymunk": (sb3_of("pymunk"), step, 53),
    "step, pymunk": (engine, step, 47),
    "set_states, pymunk": (engine, put, 29),
    "reset, pymunk": (engine, start, 53),
}


@pytest.mark.parametrize("name", CALLS)
def test_an_interruption_before_any_instruction_leaves_all_or_nothing_done(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exact, "_GRAIN", 1)  # so that two threads share even few environments
    make, call, stride = CALLS[name]
    done = assert_all_or_nothing(staggered(make), call, stride)
    assert done > (stride == 1)  # with stride 1 one interruption comes after the last assignment


@pytest.mark.parametrize(("contact", "stride"), [("exact", 1), ("pymunk", 13)])
def test_an_interrupted_step_of_a_simulator_is_done_or_not(contact: str, stride: int) -> None:
    simulator, twin = (make_simulator(Scene(), contact) for _ in range(2))
    touching = [0.0, 0.0, 0.0, 4.9, 0.0, 0.1, 0.0, 0.0, 0.0, 8.0, 0.0, 1.0]

    def told(one: Any) -> list[Any]:
        return [one.state, one.time, one.torque, one.impacts]

    for at in itertools.count(1, stride):
        for one in (simulator, twin):
            one.reset(touching)
        before = told(simulator)
        interrupted = struck(lambda: simulator.step(0.02, 1e4), at)
        twin.step(0.02, 1e4)
        if interrupted and same(told(simulator), before):
            simulator.step(0.02, 1e4)
        for _ in range(3):
            assert same(told(simulator), told(twin)), f"interrupted before instruction {at}"
            for one in (simulator, twin):
                one.step(0.02)
        if not interrupted:
            break
    assert at > 100


def test_an_error_between_step_and_restart_leaves_all_as_it_was(monkeypatch: pytest.MonkeyPatch) -> None:
    for make in (exact_of("NEXT_STEP"), exact_of("SAME_STEP"), engine):
        env, twin = staggered(make)
        before = told(env)

        def fail(*_: Any) -> None:
            raise MemoryError

        with monkeypatch.context() as patch:
            patch.setattr(env._batch, "restart", fail)
            for _ in range(2):
                with pytest.raises(MemoryError):
                    step(env, 0)
                assert same(told(env), before)
        assert same(step(env, 0), step(twin, 0))
        assert same(told(env), told(twin))


# -- at chosen moments ------------------------------------------------------------------------------------------------


def test_a_thread_left_at_work_never_writes_to_the_memory_of_a_later_step(monkeypatch: pytest.MonkeyPatch) -> None:
    env, twin = (JackInBoxVectorEnv(640, contact="exact", num_threads=number) for number in (4, 1))
    for one in (env, twin):
        one.reset(seed=0)
        step(one, 0)
    main, begun, gate, calling = threading.get_ident(), threading.Event(), threading.Event(), ["interrupted"]
    written: dict[str, set[int]] = {"interrupted": set(), "next": set()}
    kept = []  # so that no address is used twice
    compiled = compiler.compiled

    def watched(function: Any) -> Any:
        ready = compiled(function)  # here: an interruption above may have left the compiler's lock to this thread
        if function is not loop.step_blocks:
            return ready

        def late(*given: Any) -> Any:
            whose = calling[0]
            if threading.get_ident() != main and whose == "interrupted":
                begun.set()
                gate.wait(20.0)
            # Its destination, its results and its workspace.
            touched = (given[2][1], *given[5], *given[6])
            written[whose].update(id(array) for array in touched if array.size)
            kept.append(given)
            return ready(*given)

        return late

    class Queue:
        """Interrupts after the second job is put, when a thread is at work."""

        def __init__(self) -> None:
            self._queue: Any = SimpleQueue()
            self.get, self._puts = self._queue.get, 0

        def put(self, item: Any) -> None:
            self._queue.put(item)
            self._puts += 1
            if self._puts == 2 and item is not None:
                assert begun.wait(20.0)
                raise KeyboardInterrupt

    monkeypatch.setattr(exact, "compiled", watched)
    before = told(env)
    with monkeypatch.context() as patch:
        patch.setattr(threads, "SimpleQueue", Queue)
        patch.setattr(threads, "time", SimpleNamespace(sleep=interrupt))  # again, while it waits for threads at work
        env._batch._threads._pool = None  # type: ignore[attr-defined]
        with pytest.raises(KeyboardInterrupt):
            step(env, 1)
    assert same(told(env), before)
    calling[0] = "next"
    gate.set()
    assert same(step(env, 1), step(twin, 1))
    assert same(told(env), told(twin))
    until(lambda: not threads._AT_WORK)
    assert len(written["interrupted"]) > 4
    assert not written["interrupted"] & written["next"]
    assert same(told(env), told(twin))


def interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


def test_long_work_is_given_up_where_it_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    env = JackInBoxVectorEnv(640, contact="exact", num_threads=2)
    env.reset(seed=0)
    main, compiled = threading.get_ident(), compiler.compiled

    def endless(*given: Any) -> tuple[int, int, int]:
        if threading.get_ident() == main:
            until(lambda: threads._AT_WORK)
            raise KeyboardInterrupt
        time.sleep(0.001)
        return Status.PAUSED.value, 0, 0

    for module, wanted in ((exact, loop.step_blocks), (planning, roll)):
        monkeypatch.setattr(
            module, "compiled", lambda function, wanted=wanted: endless if function is wanted else compiled(function)
        )
    with pytest.raises(KeyboardInterrupt):
        env.step(None)
    assert not threads._AT_WORK
    with pytest.raises(KeyboardInterrupt):
        rollout(None, np.zeros((1000, 12)), np.zeros((1000, 5)), 0.02, num_threads=2)
    assert not threads._AT_WORK


# -- at random moments ------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_interruptions_at_random_moments_do_no_harm() -> None:
    # Its own process: it needs the timer, and a hang must have an end.
    command = [sys.executable, "scripts/studies/laws/interruptions.py", "--no-progress", "--interrupts", "150"]
    ran = subprocess.run(
        [*command, "--kinds", "steps", "rollouts"], cwd=ROOT, capture_output=True, text=True, timeout=250
    )
    lines = ran.stdout.splitlines()
    assert (ran.returncode, len(lines), ran.stderr) == (0, 4, "")
    assert all("wrong 0, threads left 0" in line for line in lines)
    refused = subprocess.run([*command[:3], "--interrupts", "0"], cwd=ROOT, capture_output=True, text=True, check=False)
    assert refused.returncode == 2
    assert "interrupts must be a whole number from 1" in refused.stderr
