"""Work on ranges of environments, spread over threads that live as long as their owner."""

from __future__ import annotations

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor, wait
from threading import Lock
from typing import Any, TypeVar

from jackbox_env import _validation as check

R = TypeVar("R")

_PIECES = 2  # for each thread
_MOST = 256  # threads: a slip of the pen must not ask the system for a million


def thread_count(given: int | None, ranges: int) -> int:
    """The number of threads: as ``given``, or as many as this process may use, but no more than ``ranges`` or 256.

    Raises:
        TypeError, ValueError: ``given`` is no whole number of at least 1.
    """
    if given is None:
        affinity = getattr(os, "sched_getaffinity", None)
        wanted = len(affinity(0)) if affinity else os.cpu_count() or 1
    else:
        wanted = check.whole("num_threads", given, at_least=1)
    return max(1, min(wanted, ranges, _MOST))


class Threads:
    """A few threads that share out ranges, a piece at a time; the calling thread works as well.

    Whoever is ready takes the next piece: a thread that wakes late costs half of its delay and not all of it.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: ThreadPoolExecutor | None = None
        self._process = os.getpid()

    def run(self, work: Callable[[int, int, int], R], total: int, grain: int = 1) -> list[R]:
        """Call ``work(number, low, high)`` for ranges that make up ``total``; return what it returns in their order.

        ``number``, below ``count``, is different for calls at the same time. A range has ``grain`` items at least.
        """
        if self.count == 1:
            return [work(0, 0, total)]
        if self._pool is None or self._process != os.getpid():  # threads do not survive a fork
            self._pool, self._process = ThreadPoolExecutor(self.count - 1, "jackbox"), os.getpid()
        size = max(1, grain, -(-total // (_PIECES * self.count)))
        pieces, turn, results = iter(range(0, total, size)), Lock(), dict[int, R]()

        def share(number: int) -> None:
            while True:
                with turn:
                    low = next(pieces, None)
                if low is None or failed:
                    return
                results[low] = work(number, low, min(low + size, total))

        failed: list[bool] = []
        waiting = [self._pool.submit(share, number) for number in range(1, self.count)]
        try:
            share(0)
            for future in waiting:
                future.result()
        except BaseException:
            failed.append(True)
            raise
        finally:
            wait(waiting)  # nobody works on after an error or an interruption
        return [results[low] for low in sorted(results)]

    def __getstate__(self) -> dict[str, Any]:
        return {"count": self.count}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__init__(kept["count"])  # type: ignore[misc]
