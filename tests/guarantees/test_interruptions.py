"""Interruptions at any moment: a call is done, or not, or the next step refuses; nothing hangs, no thread writes later.

``JACKBOX_INTERRUPTIONS=10000`` (``make interruptions``) strikes so often at random moments.
"""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from functools import partial
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jackbox_env import JackInBoxVectorEnv, Scene, make_simulator, rollout
from jackbox_env.batches import exact, threads
from jackbox_env.compiled import compiler, glide, loop
from jackbox_env.compiled.compiler import PACKAGE
from jackbox_env.compiled.rollouts import roll
from jackbox_env.compiled.status import Status
from jackbox_env.planning import rollouts
from tests.states import lying

INTERRUPTIONS = os.environ.get("JACKBOX_INTERRUPTIONS", "150")
TOUCHING = [0.0, 0.0, 0.0, 4.9, 0.0, 0.1, 0.0, 0.0, 0.0, 8.0, 0.0, 1.0]
TASKS = Path("/proc/self/task")


def until(condition: Callable[[], object], seconds: float = 20.0) -> None:
    """Wait for what another thread does."""
    latest = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < latest
        time.sleep(0.002)


def interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


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
    sys._getframe().f_trace_opcodes = True  # without it Python 3.12 sends no instructions of the first call
    sys.settrace(trace)
    try:
        call()
    except KeyboardInterrupt:
        return True
    finally:
        sys.settrace(before)
    return False


def same(found: Any, expected: Any) -> bool:
    """Whether two answers agree in every bit; an episode's time on the clock is not compared."""
    if isinstance(expected, dict):
        names = [name for name in expected if name != "t"]
        return set(found) == set(expected) and all(same(found[name], expected[name]) for name in names)
    if isinstance(expected, list | tuple) or (isinstance(expected, np.ndarray) and expected.dtype == object):
        return len(found) == len(expected) and all(map(same, found, expected))
    if isinstance(expected, np.ndarray):
        return bool(found.dtype == expected.dtype and found.tobytes() == expected.tobytes())
    return bool(found == expected)


def told(env: Any) -> list[Any]:
    """What environments, or a simulator, show."""
    if not hasattr(env, "num_envs"):
        return [env.state, env.time, env.torque, env.impacts]
    vector = getattr(env, "vector_env", env)
    scenes = [repr(scene) for scene in vector.scenes] if vector.num_envs < 10 else []
    return [vector.states, vector.times, vector.observations, scenes, getattr(env, "reset_infos", None)]


def refuses(env: Any) -> bool:
    """Whether the interruption struck while results were put in place, and the next step says so."""
    with pytest.raises((RuntimeError, ValueError), match="reset|shape") as refused:
        env.step(np.zeros((env.num_envs + 1, 1)))  # a step that is not refused comes to look at the actions
    return refused.type is RuntimeError


def step(env: Any, seed: int) -> Any:
    if not hasattr(env, "num_envs"):
        env.step(0.02)
        shown = told(env)
        env.reset(TOUCHING)  # again
        return shown
    return env.step(np.random.default_rng(seed).uniform(-1.0, 1.0, (env.num_envs, 1)))


def start(env: Any, seed: int) -> Any:
    return env.reset(seed=seed) if isinstance(env, JackInBoxVectorEnv) else (env.seed(seed), env.reset())


def start_some(env: Any, seed: int) -> Any:
    return env.reset(seed=seed, options={"reset_mask": np.arange(env.num_envs) != 1, "time": 0.25})


def change(env: Any, seed: int) -> Any:
    return env.reset(options={"scene": {"jack_mass": 1.0 + seed % 7}, "reset_mask": np.arange(env.num_envs) == 1})


def put(env: Any, seed: int) -> None:
    env.set_states(np.eye(12)[9] * np.linspace(-5.0, seed % 5, env.num_envs)[:, None], 0.5)


def staggered(make: Callable[[], Any]) -> tuple[Any, Any]:
    """An environment and its twin. Their episodes end one after another, so every step restarts one."""
    pair = make(), make()
    for env in pair:
        vector = getattr(env, "vector_env", env)
        start(env, 0)
        for number in range(vector.num_envs - 1):
            vector.step(np.zeros(vector.num_envs))
            vector.reset(options={"reset_mask": np.arange(vector.num_envs) == number})
        env._changes = vector.changes  # those of sb3 refuse after steps that they have not made
    return pair


def assert_all_or_nothing(pair: tuple[Any, Any], call: Callable[[Any, int], Any], stride: int) -> int:
    """Interrupt a call at every ``stride``-th instruction in turn; return how often the environments refused then.

    They are reset where they refuse. The next step tells what is not shown.
    """
    env, twin = pair
    refused = 0
    for at in itertools.count(1, stride):
        before = told(env)
        interrupted = struck(lambda at=at: call(env, at), at)  # type: ignore[misc]
        call(twin, at)
        if interrupted and hasattr(env, "num_envs") and refuses(env):
            refused += 1
            start(env, at), start(twin, at)
        elif interrupted and same(told(env), before):
            call(env, at)
        assert same(told(env), told(twin)), f"interrupted before instruction {at}"
        assert same(step(env, at), step(twin, at)), f"after an interruption before instruction {at}"
        if not interrupted:
            assert at > 100
            return refused
    raise AssertionError


def batch(contact: str = "exact", **settings: Any) -> Callable[[], Any]:
    # Two threads have work in blocks of one environment each, where a single block is a piece.
    given = {"num_envs": 3, "num_threads": 2, "max_episode_steps": 2, "with_infos": True, **settings}
    return lambda: JackInBoxVectorEnv(contact=contact, **given)


def sb3(count: int = 2) -> Any:
    pytest.importorskip("stable_baselines3")
    from jackbox_env.sb3 import make_sb3_vec_env

    return make_sb3_vec_env(count, contact="exact", max_episode_steps=2, with_infos=True)


DRAWN = {"gravity": (1.0, 9.0)}
CALLS: dict[str, tuple[Callable[[], Any], Callable[[Any, int], Any], int]] = {
    "step": (batch(), step, 2),
    "step, restarts at once": (batch(autoreset_mode="SAME_STEP"), step, 5),
    "step, scenes drawn": (batch(randomize=DRAWN), step, 7),
    "set_states": (batch(), put, 5),
    "reset of some": (batch(), start_some, 5),
    "reset, another scene": (batch(randomize=DRAWN), change, 17),
    "sb3 step": (sb3, step, 13),
    "sb3 reset": (sb3, start, 11),
    "step, pymunk": (batch("pymunk", randomize=DRAWN), step, 101),
    "set_states, pymunk": (batch("pymunk"), put, 29),
    "reset, pymunk": (batch("pymunk"), start_some, 53),
}


@pytest.mark.parametrize("name", CALLS)
def test_an_interruption_before_any_instruction_leaves_all_or_nothing_done(
    name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exact, "_GRAIN", 1)  # so that two threads share even few environments
    make, call, stride = CALLS[name]
    assert assert_all_or_nothing(staggered(make), call, stride) > 0


@pytest.mark.parametrize(("contact", "stride"), [("exact", 3), ("pymunk", 13)])
def test_an_interrupted_step_of_a_simulator_is_done_or_not(contact: str, stride: int) -> None:
    pair = make_simulator(Scene(), contact), make_simulator(Scene(), contact)
    for simulator in pair:
        simulator.reset(TOUCHING)
    assert_all_or_nothing(pair, lambda simulator, _: simulator.step(0.02, 1e4), stride)


@pytest.mark.parametrize("contact", ["exact", "pymunk"])
def test_a_batch_left_half_stepped_would_be_seen(contact: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Environments that do not refuse.
    pair = staggered(batch(contact))
    monkeypatch.setattr(JackInBoxVectorEnv, "_mend", lambda self, chosen=None: None)
    with pytest.raises(AssertionError, match="interrupt"):
        assert_all_or_nothing(pair, step, 1 if contact == "exact" else 47)


# -- at chosen moments ------------------------------------------------------------------------------------------------


def test_an_interruption_of_a_long_step_is_heard_soon(monkeypatch: pytest.MonkeyPatch) -> None:
    # Jacks that lie still cost most. Compiled code hears nothing: it has to come back after a part of the step.
    count = 300 * glide.WIDEST
    env = JackInBoxVectorEnv(count, contact="exact", scene=Scene(restitution=0.5, drive=None), num_threads=1)
    env.reset(seed=0)
    states = np.tile(lying(), (count, 1))
    states[:, 3] = np.linspace(-4.0, 4.0, count)
    env.set_states(states, 0.0)
    step_blocks, ends = compiler.compiled(loop.step_blocks), list[int]()

    def interrupted(*given: Any) -> Any:
        ends.append(step_blocks(*given)[0])
        raise KeyboardInterrupt  # as Ctrl-C while it worked

    monkeypatch.setattr(exact, "compiled", lambda _: interrupted)
    with pytest.raises(KeyboardInterrupt):
        env.step(np.zeros(count))
    assert ends == [Status.PAUSED]
    assert same([env.states, env.times], [states, np.zeros(count)])


def test_threads_give_up_long_work_where_it_pauses(monkeypatch: pytest.MonkeyPatch) -> None:
    env = JackInBoxVectorEnv(640, contact="exact", num_threads=2)
    env.reset(seed=0)
    main, compiled = threading.get_ident(), compiler.compiled

    def endless(*_: Any) -> tuple[int, int, int]:
        if threading.get_ident() == main:
            until(lambda: threads._AT_WORK)
            raise KeyboardInterrupt
        time.sleep(0.001)
        return Status.PAUSED.value, 0, 0

    for module in (exact, rollouts):
        monkeypatch.setattr(
            module, "compiled", lambda function: endless if function in (loop.step_blocks, roll) else compiled(function)
        )
    calls = (
        lambda: env.step(None),
        lambda: rollout(None, np.zeros((1000, 12)), np.zeros((1000, 5)), 0.02, num_threads=2),
    )
    for call in calls:
        with pytest.raises(KeyboardInterrupt):
            call()
        assert not threads._AT_WORK


def test_a_thread_left_at_work_changes_no_later_step(monkeypatch: pytest.MonkeyPatch) -> None:
    env, twin = (JackInBoxVectorEnv(640, contact="exact", num_threads=number) for number in (4, 1))
    for one in (env, twin):
        one.reset(seed=0)
        step(one, 0)
    before = told(env)
    main, begun, gate = threading.get_ident(), threading.Event(), threading.Event()
    step_blocks = compiler.compiled(loop.step_blocks)

    def late(*given: Any) -> Any:
        if threading.get_ident() == main:
            assert begun.wait(20.0)
            raise KeyboardInterrupt
        begun.set()
        gate.wait(20.0)
        return step_blocks(*given)

    with monkeypatch.context() as patch:
        patch.setattr(exact, "compiled", lambda _: late)
        patch.setattr(threads, "time", SimpleNamespace(sleep=interrupt))  # again, while it waits for threads at work
        with pytest.raises(KeyboardInterrupt):
            step(env, 1)
    assert same(told(env), before)
    assert same(step(env, 2), step(twin, 2))
    gate.set()
    until(lambda: not threads._AT_WORK)
    assert same(told(env), told(twin))
    assert same(step(env, 3), step(twin, 3))


# -- threads end ------------------------------------------------------------------------------------------------------


@pytest.mark.skipif(not TASKS.exists(), reason="the system does not say how many threads there are")
def test_threads_end_with_an_interruption_and_with_their_owner() -> None:
    begun, done = list[int](), list[int]()

    def interrupted(number: int, low: int, high: int) -> None:
        if number == 0:
            until(lambda: len(begun) >= 3)
            raise KeyboardInterrupt
        begun.append(low)
        time.sleep(0.02)
        done.append(low)

    before, owner = len(os.listdir(TASKS)), threads.Threads(4)
    with pytest.raises(KeyboardInterrupt):
        owner.run(interrupted, 1000)
    assert sorted(begun) == sorted(done)  # nobody works on
    until(lambda: len(os.listdir(TASKS)) <= before)  # threads of other tests may end as well
    owner.run(lambda number, low, high: time.sleep(0.001), 100)
    del owner
    until(lambda: len(os.listdir(TASKS)) <= before)


ENDS = """
import time
from types import SimpleNamespace
from jackbox_env.batches import threads

def interrupt(*_):
    raise KeyboardInterrupt

def work(number, low, high):
    if number == 0:
        while len(threads._AT_WORK) < 2:
            time.sleep(0.001)
        raise KeyboardInterrupt
    time.sleep(0.3 if number == 1 else 1000.0)
    print("worked to its end", flush=True)

threads.time = SimpleNamespace(sleep=interrupt)
try:
    threads.Threads(3).run(work, 30)
except KeyboardInterrupt:
    threads.time = time
"""


def test_a_process_waits_a_little_for_threads_that_are_left_at_work_and_ends() -> None:
    ran = subprocess.run([sys.executable, "-c", ENDS], capture_output=True, text=True, timeout=60, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    assert "worked to its end" in ran.stdout


def test_a_fork_works_on_without_its_parents_threads() -> None:
    env = JackInBoxVectorEnv(64, contact="exact", num_threads=2)
    env.reset(seed=0)
    env.step(None)
    at_work: Any = object(), 1
    threads._AT_WORK.add(at_work)
    process = os.fork()
    if process == 0:
        signal.alarm(20)  # ends the child if it waits for a thread
        env.step(None)
        os._exit(int(env.times[0] != 0.04 or bool(threads._AT_WORK)))
    threads._AT_WORK.discard(at_work)
    assert os.waitpid(process, 0)[1] == 0


# -- at random moments ------------------------------------------------------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["steps", "sb3", "rollouts"])
def test_interruptions_at_random_moments_do_no_harm(kind: str) -> None:
    # Its own process: it needs the timer, and a hang must have an end.
    command = [sys.executable, "-m", __name__, kind, INTERRUPTIONS]
    ran = subprocess.run(command, capture_output=True, text=True, timeout=100 + 0.2 * int(INTERRUPTIONS), check=False)
    print(ran.stdout)  # pytest -s shows how often what happened
    assert (ran.returncode, ran.stderr) == (0, "")


def _strike(_: int, frame: FrameType | None) -> None:
    """Interrupt a call of :func:`_exposed`, if it has begun and not ended."""
    while frame is not None and frame.f_code is not _exposed.__code__:
        frame = frame.f_back
    if frame is not None:
        raise KeyboardInterrupt


def _exposed(call: Callable[[], Any]) -> Any:
    return call()


def torment(kind: str, number: int, count: int = 4000) -> dict[str, int]:
    """Interrupt steps or rollouts by a timer; return how often they were done, undone, refused or not reached."""
    kinds: dict[str, Callable[[], Any]] = {"steps": batch(num_envs=count), "sb3": partial(sb3, count // 8)}
    states, torques = np.zeros((count, 12)), np.random.default_rng(0).uniform(-9e4, 9e4, (count, 30))
    states[:, 9] = np.linspace(-9.0, 9.0, count)
    rng, happened, (env, twin) = (
        np.random.default_rng(1),
        Counter[str](),
        [kinds[kind]() if kind in kinds else None for _ in range(2)],
    )

    def call(one: Any, seed: int) -> Any:
        return step(one, seed) if one is not None else rollout(None, states, torques, 0.02, num_threads=2)

    for one in (env, twin) if env is not None else ():
        start(one, 0)
    expected = call(env, 0), call(twin, 0)
    began = time.perf_counter()
    call(env, 1), call(twin, 1)
    typical = 0.5 * (time.perf_counter() - began)
    signal.signal(signal.SIGALRM, _strike)
    while sum(happened.values()) - happened["missed"] < number:
        seed = int(rng.integers(2**32))
        before = None if env is None else told(env)
        try:
            signal.setitimer(signal.ITIMER_REAL, rng.uniform(1e-6, 1.2 * typical))
            outcome = (_exposed(lambda: call(env, seed)), "missed")  # noqa: B023
        except KeyboardInterrupt:
            outcome = (None, "done")
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        found, word = outcome
        if env is None:
            assert same(call(env, 0), expected[1])
            word = "undone" if word == "done" else word
        else:
            wanted = call(twin, seed)
            if word == "done" and refuses(env):
                start(env, seed), start(twin, seed)
                word = "refused"
            elif word == "done" and same(told(env), before):
                found, word = call(env, seed), "undone"
            assert found is None or same(found, wanted)
            assert same(told(env), told(twin))
            assert same(call(env, seed + 1), call(twin, seed + 1))
        happened[word] += 1
    return happened


if __name__ == "__main__":
    before = len(os.listdir(TASKS)) if TASKS.exists() else 0
    print(sys.argv[1], dict(torment(sys.argv[1], int(sys.argv[2]))))
    until(lambda: not threads._AT_WORK)
