"""Work on ranges of environments, spread over threads that live as long as their owner."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from typing import Any, TypeVar

from jackbox_env import _validation as check

R = TypeVar("R")


def thread_count(given: int | None, ranges: int) -> int:
    """The number of threads: as ``given``, or as many as this process may use, but no more than ``ranges``.

    Raises:
        TypeError, ValueError: ``given`` is no whole number of at least 1.
    """
    if given is None:
        affinity = getattr(os, "sched_getaffinity", None)
        wanted = len(affinity(0)) if affinity else os.cpu_count() or 1
    else:
        wanted = check.whole("num_threads", given, at_least=1)
    return max(1, min(wanted, ranges))


class Threads:
    """A few threads that share out ranges; the calling thread takes the first one itself."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: ThreadPoolExecutor | None = None
        self._process = os.getpid()

    def run(self, work: Callable[[int, int, int], R], total: int) -> list[R]:
        """Call ``work(number, low, high)`` for ``count`` ranges that make up ``total``; return what they return."""
        edges = [total * number // self.count for number in range(self.count + 1)]
        if self.count == 1:
            return [work(0, 0, total)]
        if self._pool is None or self._process != os.getpid():  # threads do not survive a fork
            self._pool, self._process = ThreadPoolExecutor(self.count - 1, "jackbox"), os.getpid()
        waiting = [self._pool.submit(work, number, edges[number], edges[number + 1]) for number in range(1, self.count)]
        try:
            first = work(0, edges[0], edges[1])
            return [first, *(future.result() for future in waiting)]
        finally:
            wait(waiting)  # nobody works on after an error or an interruption

    def __getstate__(self) -> dict[str, Any]:
        return {"count": self.count}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__init__(kept["count"])  # type: ignore[misc]
