"""Run trials in this process or on this machine's cores. A trial's process imports only this and the work's module."""

from __future__ import annotations

import os
import signal
import threading
import traceback
from collections.abc import Callable, Generator, Iterable
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from functools import partial
from multiprocessing import active_children, get_context, parent_process
from typing import Any, NamedTuple

from tqdm import tqdm

from jackbox_env.tools.reading import first_line

ONE_THREAD = dict.fromkeys(("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"), "1")


class Finished(NamedTuple):
    """A finished trial: a line of the log."""

    settings: dict[str, Any]
    result: dict[str, Any] | None = None  # None if it failed
    error: str | None = None  # why it failed, in one line
    details: str = ""  # where it failed: the traceback


Trials = Iterable[dict[str, Any]]
Work = Callable[[dict[str, Any]], dict[str, Any]]
Results = Generator[Finished, None, None]
Runner = Callable[[Trials, Work], Results]


def attempt(work: Work, settings: dict[str, Any]) -> Finished:
    """Run a trial in this process; an exception becomes its error."""
    try:
        return Finished(settings, work(settings))
    except Exception as error:
        return Finished(settings, None, first_line(error), traceback.format_exc())


def in_turn(trials: Trials, work: Work) -> Results:
    """Run trials in this process, one after the other."""
    return (attempt(work, settings) for settings in trials)


def on_cores(workers: int, trials: Trials, work: Work) -> Results:
    """Run trials in a number of processes of this machine, each in one thread.

    Each process has its own executor, so if it dies, only its trial fails. Closing the iterator ends the processes, and
    so does the end of this process, even by SIGKILL.
    """
    os.environ.update(ONE_THREAD)  # for the new processes; this one has loaded numpy already
    new, before = partial(ProcessPoolExecutor, 1, get_context("spawn"), _end_with_parent), active_children()
    waiting, idle = iter(trials), [new() for _ in range(workers)]
    running = dict[Future[Finished], tuple[dict[str, Any], ProcessPoolExecutor]]()
    try:
        while True:
            while idle and (settings := next(waiting, None)) is not None:
                pool = idle.pop()
                running[pool.submit(attempt, work, settings)] = settings, pool
            if not running:
                return
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                settings, pool = running.pop(future)
                try:
                    done = future.result()
                except Exception as error:  # its process has ended, or the work could not be sent
                    done, pool = Finished(settings, error=first_line(error)), new()
                idle.append(pool)
                yield done
    finally:
        for process in active_children():
            if process not in before:
                process.kill()
        for pool in (*idle, *(pool for _, pool in running.values())):
            pool.shutdown()


def _end_with_parent() -> None:
    """Make a worker end with its parent, however that ends, and not by Ctrl-C."""

    def end() -> None:
        parent_process().join()  # type: ignore[union-attr]
        os._exit(1)

    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent ends it; idle, it would print a traceback
    tqdm.set_lock(threading.RLock())  # one for many processes would outlive a worker that is killed
    threading.Thread(target=end, daemon=True).start()
