"""Timing in interleaved rounds, and the machine in words; the studies that measure speed use it."""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path

from tqdm import tqdm

Timed = Callable[[], float]  # runs once and returns operations per second
Rates = dict[str, list[float]]  # operations per second in each round
PINNED = hasattr(os, "sched_setaffinity")


def repeat(
    block: Callable[[], int],
    seconds: float,
    prepare: Callable[[], None] | None = None,
    clock: Callable[[], float] = time.perf_counter,
) -> Timed:
    """Operations per second of ``block``, repeated until ``seconds`` [s] have passed.

    ``block`` returns how many operations it did. ``prepare`` runs before each block and is not timed, nor is reading
    the clock.
    """

    reading = min(-clock() + clock() for _ in range(1000))  # [s]

    def run() -> float:
        count, passed = 0, 0.0
        while passed <= seconds:
            if prepare is not None:
                prepare()
            began = clock()
            count += block()
            passed += clock() - began - reading
        return count / passed

    return run


def measure(timed: Mapping[str, Timed], rounds: int) -> Rates:
    """Rates of all, run in turn, ``rounds`` times after a warm-up; a terminal shows a progress bar."""
    rates: Rates = {name: [] for name in timed}
    with tqdm(total=(rounds + 1) * len(timed), unit="measurement", disable=None, leave=False) as bar:
        for number in range(rounds + 1):
            for name, run in timed.items():
                rate = run()
                if number:
                    rates[name].append(rate)
                bar.update()
    return rates


def ratios(rates: Mapping[str, Sequence[float]], one: str, other: str) -> list[float]:
    """One rate over another in each round."""
    return [a / b for a, b in zip(rates[one], rates[other], strict=True)]


# -- the machine -------------------------------------------------------------------------------------------------------


def on_cores(cores: Iterable[int]) -> None:
    """Pin all threads of this process, and those that they start later, to these cores, if the system can."""
    for thread in os.listdir("/proc/self/task") if PINNED else ():
        with contextlib.suppress(ProcessLookupError):  # a thread that has ended meanwhile
            os.sched_setaffinity(int(thread), cores)


def core_seconds() -> tuple[float, float]:
    """Core-seconds since the machine started: those of other processes, and all; zeros if unknown."""
    if not Path("/proc/stat").exists():
        return 0.0, 0.0
    ticks = [int(number) for number in Path("/proc/stat").read_text(encoding="utf-8").split("\n", 1)[0].split()[1:9]]
    idle = ticks[3] + ticks[4]  # and waiting for disks
    ours = sum(os.times()[:4])
    return (sum(ticks) - idle) / os.sysconf("SC_CLK_TCK") - ours, sum(ticks) / os.sysconf("SC_CLK_TCK")


def busy_since(before: tuple[float, float]) -> str:
    """The share of the machine's time that other processes used since ``before``, in words: it disturbs figures."""
    busy, total = core_seconds()
    share = (busy - before[0]) / max(total - before[1], 1e-9)
    return f"Other processes took {max(0.0, share):.0%} of the machine's time meanwhile." if total else ""


def measured_with(packages: Iterable[str]) -> str:
    """The machine, and the versions of these packages."""
    from agents.runs import machine, versions

    return f"{machine()}; " + ", ".join(f"{name} {version}" for name, version in versions(tuple(packages)).items())
