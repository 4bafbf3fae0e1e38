"""Threads end with their owner, with an interruption and with the process."""

from __future__ import annotations

import copy
import gc
import os
import signal
import subprocess
import sys
import threading
import time
import weakref
from pathlib import Path

import pytest
from numba.core.compiler_lock import global_compiler_lock

from jackbox_env import JackInBoxVectorEnv
from jackbox_env.batches import threads
from jackbox_env.batches.threads import Threads
from tests.batches.waiting import until

TASKS = Path("/proc/self/task")


@pytest.mark.skipif(not TASKS.exists(), reason="the system does not say how many threads there are")
def test_threads_end_with_their_owner_and_with_an_interruption() -> None:
    def count() -> int:
        return len(os.listdir(TASKS))

    def work(number: int, low: int, high: int) -> int:
        time.sleep(0.001)
        return number

    def interrupted(number: int, low: int, high: int) -> int:
        if number == 0:
            raise KeyboardInterrupt
        return work(number, low, high)

    gc.collect()
    before, owner, kept = count(), Threads(9), []
    for _ in range(20):
        assert max(owner.run(work, 100)) > 0
        assert count() == before + 8
        with pytest.raises(KeyboardInterrupt) as raised:
            owner.run(interrupted, 100)
        kept.append(raised)  # its traceback holds frames and their variables
        until(lambda: count() == before)
    owner.run(work, 100)
    copied = copy.deepcopy(owner)
    kept.clear()
    del owner, raised
    gc.collect()
    until(lambda: count() == before)
    assert copied.run(work, 100)
    del copied
    until(lambda: count() == before)


def test_an_idle_thread_holds_no_memory_of_its_last_job() -> None:
    class Kept:
        pass

    owner, kept = Threads(3), Kept()
    gone = weakref.ref(kept)
    owner.run(lambda number, low, high, kept=kept: (kept, time.sleep(0.001)), 100)  # type: ignore[misc, func-returns-value]
    del kept
    gc.collect()
    until(lambda: gone() is None)


def test_a_fork_forgets_threads_that_it_does_not_have() -> None:
    gate, owner = threading.Event(), Threads(2)

    def shared(number: int, low: int, high: int) -> int:
        gate.set() if number else gate.wait(20.0)  # the calling thread leaves pieces to the other one
        return number

    def late(number: int, low: int, high: int) -> None:
        if number == 0:
            until(lambda: threads._AT_WORK)
            process = os.fork()
            if process == 0:
                # In the child no thread is at work, so it waits for none and starts threads of its own.
                owner_works = Threads(2).run(shared, 50)
                os._exit(0 if not threads._AT_WORK and 1 in owner_works else 1)
            assert os.waitstatus_to_exitcode(os.waitpid(process, 0)[1]) == 0
            gate.set()
        gate.wait(20.0)

    owner.run(late, 2)


def test_a_fork_makes_environments_although_a_thread_that_it_does_not_have_compiles() -> None:
    JackInBoxVectorEnv(2, contact="exact").close()
    compiles, gate = threading.Event(), threading.Event()

    def compiling() -> None:
        with global_compiler_lock:
            compiles.set()
            gate.wait(60.0)

    thread = threading.Thread(target=compiling)
    thread.start()
    compiles.wait()
    process = os.fork()
    if process == 0:
        signal.alarm(10)  # ends the child if it waits for the lock
        try:
            JackInBoxVectorEnv(2, contact="exact").close()
            os._exit(0)
        finally:
            os._exit(1)
    status = os.waitpid(process, 0)[1]
    gate.set()
    thread.join()
    assert os.waitstatus_to_exitcode(status) == 0


WEARY = """
import signal, sys
import numpy as np
from jackbox_env import JackInBoxVectorEnv
env = JackInBoxVectorEnv(8000, contact="exact", num_threads=4)
env.reset(seed=0)
env.step(None)
if sys.argv[1] == "busy":
    states = env.states
    states[5000:] = 0.0
    states[5000:, 9] = 1e6  # from wall to wall: a step of each takes milliseconds
    env.set_states(states, 0.0)

    def interrupt(*_):
        signal.setitimer(signal.ITIMER_REAL, 0.002)
        raise KeyboardInterrupt

    from jackbox_env.batches import threads
    for _ in range(50):  # until an interruption strikes while a thread is at work, which a busy machine may delay
        signal.signal(signal.SIGALRM, interrupt)
        signal.setitimer(signal.ITIMER_REAL, 0.3)
        try:
            env.step(None)
        except KeyboardInterrupt:
            pass
        finally:
            signal.signal(signal.SIGALRM, signal.SIG_IGN)
        if threads._AT_WORK:
            break
    assert threads._AT_WORK
"""


@pytest.mark.parametrize("how", ["idle", "busy"])
def test_a_process_ends_whatever_its_threads_are_at(how: str) -> None:
    ran = subprocess.run([sys.executable, "-c", WEARY, how], capture_output=True, text=True, timeout=100, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
