"""Distributes ranges of environments or rollouts over a pool of threads."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor, wait
from typing import Any, TypeVar

from jackbox_env import checks as check
from jackbox_env.exact.workspace import Call, Status
from jackbox_env.states import Array

R = TypeVar("R")

_PIECES = 2  # for each thread
_MOST = 256  # threads, so that a typo does not start a million


def thread_count(num_threads: int | None, ranges: int) -> int:
    """The number of threads: ``num_threads``, or as many as this process may use; at most ``ranges`` and 256.

    Raises:
        TypeError, ValueError: ``num_threads`` is not a whole number of at least 1.
    """
    if num_threads is None:
        affinity = getattr(os, "sched_getaffinity", None)
        wanted = len(affinity(0)) if affinity else os.cpu_count() or 1
    else:
        wanted = check.whole("num_threads", num_threads, at_least=1)
    return max(1, min(wanted, ranges, _MOST))


class Halt:
    """A request to the threads of a job to stop early: its result is no longer needed. Made faster than an Event."""

    requested = False


Ended = tuple[int, int, int, int, list[Array]]


def run_blocks(loop: Callable[..., Any], calls: list[Call], thread: int, low: int, high: int, halt: Halt) -> Ended:
    """Run blocks from ``low`` to ``high`` by the compiled ``loop``: to the end, to an error, or until a halt.

    Returns:
        How it ended, the row and the step that failed, the number of episodes that ended, and the recorded impacts.
    """
    first, finished, logs = 0, 0, list[Array]()
    while True:
        ended, number, step, now, recorded = loop(calls[thread].address, low, high, first)
        finished += now
        if recorded:
            logs.append(calls[thread].memory.log[:recorded].copy())
        if ended == Status.FULL:
            calls[thread] = calls[thread].with_room()
        if ended not in (Status.PAUSED, Status.FULL) or halt.requested:
            return ended, number, step, finished, logs
        low, first = number, step  # it paused so that Python can handle an interruption


class Threads:
    """A few threads that work on ranges, one piece at a time; the calling thread works as well.

    A free thread works on the next piece, so a thread that wakes late costs half of its delay and not all of it.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: tuple[int, ThreadPoolExecutor] | None = None  # with its process: threads do not survive a fork

    def run(self, work: Callable[[int, int, int], R], total: int, grain: int = 1, halt: Halt | None = None) -> list[R]:
        """Call ``work(number, low, high)`` for ranges that make up ``total``, and return the results in their order.

        Simultaneous calls have different ``number``, below ``count``. A range has at least ``grain`` items.

        An error or an interruption sets ``halt``, which long work polls, and is raised once all threads have stopped.
        A second interruption ends this wait: a thread may then still write to the arrays that its work refers to.
        """
        if self.count == 1:
            return [work(0, 0, total)]
        size = max(1, grain, -(-total // (_PIECES * self.count)))
        halt = halt or Halt()
        pieces, results, futures = deque(range(0, total, size)), dict[int, R](), list[Future[None]]()

        def share(number: int) -> None:
            while not halt.requested:
                try:
                    low = pieces.popleft()
                except IndexError:
                    return
                try:
                    results[low] = work(number, low, min(low + size, total))
                except BaseException:
                    halt.requested = True
                    raise

        try:
            pool = self._executor()
            for number in range(1, self.count):
                futures.append(pool.submit(share, number))
            share(0)
            for future in futures:
                future.result()
        except BaseException:
            halt.requested, self._pool = True, None
            wait(futures)
            raise
        return [results[low] for low in sorted(results)]

    def _executor(self) -> ThreadPoolExecutor:
        """The pool of this process."""
        if self._pool is None or self._pool[0] != os.getpid():
            self._pool = os.getpid(), ThreadPoolExecutor(self.count - 1)
        return self._pool[1]

    def __getstate__(self) -> dict[str, Any]:
        return {"count": self.count}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["count"])  # type: ignore[misc]
