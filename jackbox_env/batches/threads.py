"""Work on ranges of environments, spread over threads that live as long as their owner.

An interruption (a KeyboardInterrupt, or what else a signal handler raises) may strike the calling thread between any
two of its instructions. So the calling thread takes no lock that it could leave locked: it starts threads, hands over
jobs and waits for their ends by single calls of C code. A thread that an interruption leaves at work knows the job that
it was given and nothing of later ones. No thread keeps a process from ending.
"""

from __future__ import annotations

import _thread
import atexit
import os
import time
import weakref
from collections import deque
from collections.abc import Callable
from queue import SimpleQueue
from typing import Any, Generic, TypeVar

from jackbox_env import _validation as check

R = TypeVar("R")

_PIECES = 2  # for each thread
_MOST = 256  # threads: a typo must not ask the system for a million
_LAST_WAIT = 1.0  # [s] for threads at work when the process ends

# Jobs with the number of the thread that is at them. Threads enter themselves, the calling thread only looks.
_AT_WORK: set[tuple[_Job[Any], int]] = set()
if hasattr(os, "register_at_fork"):
    os.register_at_fork(after_in_child=_AT_WORK.clear)  # threads do not survive a fork


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


class Halt:
    """Asks the threads at a job to stop early: its result is no longer wanted."""

    asked = False


class Threads:
    """A few threads that share out ranges, a piece at a time; the calling thread works as well.

    A thread that is ready takes the next piece: a thread that wakes late costs half of its delay and not all of it.
    """

    def __init__(self, count: int) -> None:
        self.count = count
        self._pool: _Pool | None = None

    def run(self, work: Callable[[int, int, int], R], total: int, grain: int = 1, halt: Halt | None = None) -> list[R]:
        """Call ``work(number, low, high)`` for ranges that make up ``total``; return what it returns in their order.

        ``number``, below ``count``, is different for calls at the same time. A range has ``grain`` items at least.

        An error or an interruption sets ``halt``, which long work looks at, and is raised when all threads have
        stopped. A second interruption ends this wait: a thread may then still be at the range that it has begun.
        """
        if self.count == 1:
            return [work(0, 0, total)]
        size = max(1, grain, -(-total // (_PIECES * self.count)))
        job = _Job(work, total, size, halt or Halt())
        try:
            queue = self._queue()
            for number in range(1, self.count):
                queue.put((job, number))
            job.share(0)
            for _ in range(1, self.count):
                failure = job.ends.get()
                if failure is not None:
                    raise failure
        except BaseException:
            job.halt.asked = True
            self._pool = None  # its threads end as soon as they have nothing to do
            while any((job, number) in _AT_WORK for number in range(1, self.count)):
                time.sleep(0.0005)
            raise
        return [job.results[low] for low in sorted(job.results)]

    def _queue(self) -> SimpleQueue[Any]:
        """Where the threads take their jobs from; they are started where there are none."""
        if self._pool is None or self._pool.process != os.getpid():
            self._pool = _Pool(self.count - 1)
        return self._pool.queue

    def __getstate__(self) -> dict[str, Any]:
        return {"count": self.count}

    def __setstate__(self, kept: dict[str, Any]) -> None:
        self.__init__(kept["count"])  # type: ignore[misc]


class _Pool:
    """Threads that take jobs from a queue until this object is gone.

    ``threading.Thread.start`` waits for a lock of its own, which an interruption could leave locked; the bare call does
    not. Nor does any Python run when the threads are told to end: the weak reference puts itself into the queue.
    """

    def __init__(self, count: int) -> None:
        self.process = os.getpid()
        self.queue: SimpleQueue[Any] = SimpleQueue()
        gone = weakref.ref(self, self.queue.put)  # the threads keep it
        for _ in range(count):
            _thread.start_new_thread(_serve, (self.queue, gone))


def _serve(queue: SimpleQueue[Any], gone: object) -> None:
    """What a thread of a pool does: take one job after the other until the pool is gone."""
    while (given := queue.get()) is not gone:
        job, number = given
        _AT_WORK.add(given)
        job.serve(number)
        _AT_WORK.discard(given)
        del given, job  # an idle thread holds no job's memory
    queue.put(gone)  # for the next thread


class _Job(Generic[R]):
    """The work of one call, and what comes of it."""

    def __init__(self, work: Callable[[int, int, int], R], total: int, size: int, halt: Halt) -> None:
        self.halt = halt
        self.results: dict[int, R] = {}  # of each piece, by its first item
        self.ends: SimpleQueue[BaseException | None] = SimpleQueue()  # of each thread, with what it failed by
        self._work, self._total, self._size = work, total, size
        self._pieces = deque(range(0, total, size))

    def share(self, number: int) -> None:
        """Work on pieces until there are no more."""
        while not self.halt.asked:
            try:
                low = self._pieces.popleft()
            except IndexError:
                return
            self.results[low] = self._work(number, low, min(low + self._size, self._total))

    def serve(self, number: int) -> None:
        """Do the share of a thread; what it raises is for the calling thread."""
        try:
            self.share(number)
        except BaseException as failure:
            self.halt.asked = True
            self.ends.put(failure)
        else:
            self.ends.put(None)


@atexit.register
def _let_end() -> None:
    """Wait a little for threads that an interruption left at work: the code that they run goes with the interpreter."""
    for job, _ in list(_AT_WORK):
        job.halt.asked = True
    latest = time.monotonic() + _LAST_WAIT
    while _AT_WORK and time.monotonic() < latest:
        time.sleep(0.001)
