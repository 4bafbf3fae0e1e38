"""Distributes ranges of environments or rollouts over a pool of threads.

The threads are our own because an interruption can cut the Python code of ``threading`` and ``concurrent.futures`` and
leave a lock locked, so that the next step hangs (``tests/guarantees/test_interruptions.py``).
"""

from __future__ import annotations

import _thread
import os
import weakref
from collections import deque
from collections.abc import Callable
from itertools import repeat
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

from jackbox_env.exact.late import AGAIN, repaired
from jackbox_env.exact.workspace import Call, Status
from jackbox_env.model.states import Array
from jackbox_env.tools import checks as check

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
    first, finished = 0, 0
    logs: list[Array] = []  # faster than list[Array]()
    while True:
        ended, number, step, now, recorded = loop(calls[thread].address, low, high, first)
        finished += now
        if recorded:
            logs.append(calls[thread].memory.log[:recorded].copy())
        if ended in AGAIN:
            calls[thread] = repaired(calls[thread], ended)
        if not (ended == Status.PAUSED or ended in AGAIN) or halt.requested:
            return ended, number, step, finished, logs
        low, first = number, step  # it paused so that Python can handle an interruption


class _Job(Generic[R]):
    """Work on ranges that several threads share. It carries the queue of its call's reports."""

    def __init__(self, work: Callable[[int, int, int], R], total: int, size: int, halt: Halt) -> None:
        self._work, self._total, self._size, self._pieces = work, total, size, deque(range(0, total, size))
        self.halt = halt
        self.reports: SimpleQueue[dict[int, R] | BaseException] = SimpleQueue()

    def share(self, number: int) -> dict[int, R]:
        """Work on one range after the other; return the results by the ranges' starts."""
        results: dict[int, R] = {}
        while not self.halt.requested:
            try:
                low = self._pieces.popleft()
            except IndexError:
                break
            results[low] = self._work(number, low, min(low + self._size, self._total))
        return results

    def report(self, number: int) -> None:
        """Work likewise in another thread; the results, or the error, go to ``reports``."""
        try:
            self.reports.put(self.share(number))
        except BaseException as error:
            self.halt.requested = True
            self.reports.put(error)


class _Workers:
    """Threads that work on the jobs in a queue. They end with this object and do not keep a process alive.

    A queue's methods, and the starts and ends of threads here, are C, which an interruption cannot cut.
    """

    def __init__(self, count: int) -> None:
        self.process = os.getpid()  # threads do not survive a fork
        self.jobs: SimpleQueue[Any] = SimpleQueue()
        for _ in range(count):
            # Once this object is gone, its weak references are put into the queue; a worker that gets one ends.
            _thread.start_new_thread(_serve, (self.jobs, weakref.ref(self, self.jobs.put)))


def _serve(jobs: SimpleQueue[Any], _workers: weakref.ref[_Workers]) -> None:
    """Work on jobs, each a :class:`_Job` and this thread's number in it, until a dead reference is among them."""
    while not isinstance(assigned := jobs.get(), weakref.ref):
        job, number = assigned
        job.report(number)
        del assigned, job  # an idle thread keeps nothing alive


class Threads:
    """A few threads that work on ranges, one piece at a time; the calling thread works as well.

    A free thread works on the next piece, so a thread that wakes late costs half of its delay and not all of it.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._workers: _Workers | None = None

    def run(self, work: Callable[[int, int, int], R], total: int, grain: int = 1, halt: Halt | None = None) -> list[R]:
        """Call ``work(number, low, high)`` for ranges that make up ``total``, and return the results in their order.

        Simultaneous calls have different ``number``, below ``count``. A range has at least ``grain`` items.

        An error or an interruption sets ``halt``, which long work polls, and is raised once all threads have stopped.
        A second interruption ends this wait: a thread may then still write to the arrays that its work refers to.
        """
        if self.count == 1:
            return [work(0, 0, total)]
        job = _Job(work, total, max(1, grain, -(-total // (_PIECES * self.count))), halt or Halt())
        workers, self._workers = self._workers, None  # the workers of a call that fails end
        reports: list[dict[int, R] | BaseException] = []
        sent = 0
        try:
            if workers is None or workers.process != os.getpid():
                workers = _Workers(self.count - 1)
            for number in range(1, self.count):
                workers.jobs.put((job, number))
                sent = number
            results = job.share(0)
            _gather(job.reports, reports, sent)
        except BaseException:
            job.halt.requested, workers = True, None
            _gather(job.reports, reports, sent)
            raise
        for report in reports:
            if isinstance(report, BaseException):
                raise report
            results |= report
        self._workers = workers
        return [results[low] for low in sorted(results)]

    def __getstate__(self) -> dict[str, Any]:
        return {"count": self.count}

    def __setstate__(self, state: dict[str, Any]) -> None:
        self.__init__(state["count"])  # type: ignore[misc]


def _gather(queue: SimpleQueue[R], items: list[R], count: int) -> None:
    """Move items from a queue to a list until it has ``count``. An interruption in this one C call loses none."""
    items.extend(map(SimpleQueue.get, repeat(queue, count - len(items))))
