"""Interruptions at any moment: a call is done entirely or not at all, nothing hangs, no thread writes afterwards.

``JACKBOX_INTERRUPTIONS=10000`` interrupts so many calls of each kind at random moments instead of 150.
"""

from __future__ import annotations

import itertools
import os
import signal
import subprocess
import sys
import threading
import time
import timeit
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType, SimpleNamespace
from typing import Any

import numpy as np
import pytest

from jackbox_env import JackInBoxVectorEnv, Scene, make_simulator, rollout
from jackbox_env.batches import exact, threads
from jackbox_env.batches.single import SingleBatch
from jackbox_env.compiled import compiler, glide, loop
from jackbox_env.compiled.compiler import PACKAGE
from jackbox_env.compiled.rollouts import roll
from jackbox_env.compiled.status import Status
from jackbox_env.planning import rollouts
from tests.states import lying

ROOT = Path(__file__).parents[2]
TOUCHING = [0.0, 0.0, 0.0, 4.9, 0.0, 0.1, 0.0, 0.0, 0.0, 8.0, 0.0, 1.0]
TASKS = Path("/proc/self/task")
INTERRUPTIONS = int(os.environ.get("JACKBOX_INTERRUPTIONS", "150"))
Strike = Callable[[Callable[[], Any]], bool]  # makes a call and interrupts it; whether it did


def until(condition: Callable[[], object], seconds: float = 20.0) -> None:
    """Wait for what another thread does."""
    latest = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < latest
        time.sleep(0.002)


def interrupt(*_: Any) -> None:
    raise KeyboardInterrupt


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
    """What environments, or a simulator, show."""
    if not hasattr(env, "num_envs"):
        return [env.state, env.time, env.torque, env.impacts]
    vector = getattr(env, "vector_env", env)
    return [vector.states, vector.times, vector.observations, vector.scenes, getattr(env, "reset_infos", None)]


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
    return pair


def assert_done_or_not(pair: tuple[Any, Any], call: Callable[[Any, int], Any], seed: int, strike: Strike) -> bool:
    """Interrupt a call; the next step tells what is not shown. Return whether it was interrupted."""
    env, twin = pair
    before = told(env)
    interrupted = strike(lambda: call(env, seed))
    call(twin, seed)
    if interrupted and same(told(env), before):
        call(env, seed)
    assert same(told(env), told(twin)), f"interrupted at {seed}"
    assert same(step(env, seed), step(twin, seed)), f"after an interruption at {seed}"
    return interrupted


def assert_all_or_nothing(pair: tuple[Any, Any], call: Callable[[Any, int], Any], stride: int) -> None:
    """Interrupt a call at every ``stride``-th instruction in turn."""
    for at in itertools.count(1, stride):
        if not assert_done_or_not(pair, call, at, lambda made, at=at: struck(made, at)):  # type: ignore[misc]
            assert at > 100
            return


def batch(contact: str = "exact", **settings: Any) -> Callable[[], Any]:
    # Two threads have work in blocks of one environment each, where a single block is a piece.
    given = {"num_threads": 2, "max_episode_steps": 2, "with_infos": True, **settings}
    return lambda: JackInBoxVectorEnv(3, contact=contact, **given)


def sb3() -> Any:
    pytest.importorskip("stable_baselines3")
    from jackbox_env.sb3 import make_sb3_vec_env

    return make_sb3_vec_env(2, contact="exact", max_episode_steps=2, with_infos=True)


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
    assert_all_or_nothing(staggered(make), call, stride)


@pytest.mark.parametrize(("contact", "stride"), [("exact", 3), ("pymunk", 13)])
def test_an_interrupted_step_of_a_simulator_is_done_or_not(contact: str, stride: int) -> None:
    pair = make_simulator(Scene(), contact), make_simulator(Scene(), contact)
    for simulator in pair:
        simulator.reset(TOUCHING)
    assert_all_or_nothing(pair, lambda simulator, _: simulator.step(0.02, 1e4), stride)


def test_a_batch_left_half_stepped_would_be_seen(monkeypatch: pytest.MonkeyPatch) -> None:
    # Environments that are not put back where they were held.
    pair = staggered(batch("pymunk"))
    monkeypatch.setattr(SingleBatch, "_move_to", lambda self, held: None)
    with pytest.raises(AssertionError, match="interrupt"):
        assert_all_or_nothing(pair, step, 47)


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


class Timer:
    """Interrupts a call after a random time. Half of the calls are interrupted again and again until they end."""

    def __init__(self, typical: float) -> None:
        """An uninterrupted call takes ``typical`` [s]."""
        self._rng, self._typical, self._again = np.random.default_rng(0), typical, 0.0
        signal.signal(signal.SIGALRM, self._strike)

    def __call__(self, call: Callable[[], Any]) -> bool:
        first = self._rng.uniform(1e-6, 1.2 * self._typical)
        self._again = 10.0 ** self._rng.uniform(-6.0, -3.0) if self._rng.uniform() < 0.5 else 0.0
        try:
            signal.setitimer(signal.ITIMER_REAL, first)
            _exposed(call)
        except KeyboardInterrupt:
            return True
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0.0)
        return False

    def _strike(self, _: int, frame: FrameType | None) -> None:
        codes = []  # of the frames that were running; this method itself is not to be interrupted
        while frame is not None:
            codes.append(frame.f_code)
            frame = frame.f_back
        if _exposed.__code__ in codes and Timer._strike.__code__ not in codes:
            if self._again:
                signal.setitimer(signal.ITIMER_REAL, self._again)
            raise KeyboardInterrupt


def _exposed(call: Callable[[], Any]) -> None:
    call()


def many(number: int) -> Any:
    return JackInBoxVectorEnv(2000, contact="exact", num_threads=number, max_episode_steps=40, with_infos=True)


def many_of_sb3(number: int) -> Any:
    pytest.importorskip("stable_baselines3")
    from jackbox_env.sb3 import make_sb3_vec_env

    return make_sb3_vec_env(1000, contact="exact", num_threads=number, max_episode_steps=40)


def typical(call: Callable[[], Any]) -> float:
    """Median time of a call [s]."""
    return float(np.median([timeit.timeit(call, number=1) for _ in range(20)]))


def alarmed(test: Callable[..., None]) -> Callable[..., None]:
    """A slow test with its own alarm, whose hang ends the run with a traceback; each number of threads."""
    slow = pytest.mark.timeout(120 + INTERRUPTIONS, method="thread")(pytest.mark.slow(test))
    return pytest.mark.parametrize("number", [2, 8])(pytest.mark.usefixtures("threads_end")(slow))  # type: ignore[no-any-return]


@pytest.fixture
def threads_end() -> Iterator[None]:
    """No thread is left after the test."""
    tasks = _tasks()
    yield
    until(lambda: _tasks() <= tasks)


def _tasks() -> int:
    return len(os.listdir(TASKS)) if TASKS.exists() else 0


@alarmed
@pytest.mark.parametrize("make", [many, many_of_sb3])
def test_steps_interrupted_at_random_moments_are_done_or_not(
    make: Callable[[int], Any], number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exact, "_GRAIN", 1)
    pair = make(number), make(1)
    for env in pair:
        start(env, 0)
        for seed in range(40):  # episodes end at different times
            step(env, seed)
            getattr(env, "vector_env", env).reset(options={"reset_mask": np.arange(env.num_envs) % 40 == seed})
    timer = Timer(typical(lambda: step(pair[0], 0)))
    for _ in range(20):
        step(pair[1], 0)
    left, seeds = INTERRUPTIONS, itertools.count()
    while left:
        left -= assert_done_or_not(pair, step, next(seeds), timer)


@alarmed
def test_rollouts_interrupted_at_random_moments_harm_no_later_one(number: int) -> None:
    states, torques = np.zeros((8000, 12)), np.random.default_rng(0).uniform(-9e4, 9e4, (8000, 30))
    states[:, 9] = np.linspace(-9.0, 9.0, 8000)
    expected = rollout(None, states, torques, 0.02, num_threads=1)

    def play() -> Any:
        return rollout(None, states, torques, 0.02, num_threads=number)

    timer, left = Timer(typical(play)), INTERRUPTIONS
    while left:
        left -= timer(play)
        assert same(play(), expected)
