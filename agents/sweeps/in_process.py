"""Run many trials in this process; :mod:`agents.sweeps.on_ray` runs them on more cores and machines.

A trial is its settings, plain JSON. What runs it is a function from settings to a result, plain JSON too. A runner
gives trials to that function and yields them as they finish, whatever their order; it keeps nothing. A trial that
fails is yielded with its error and does not stop the others.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import time
import traceback
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple, Protocol

from agents.files import first_line
from agents.runs import machine

Work = Callable[[dict[str, Any]], Any]  # from settings to a result, both plain JSON
LOOK_AGAIN = 0.5  # [s] at most between two looks at what has finished


@dataclass(frozen=True)
class Trial:
    """One thing to run."""

    settings: dict[str, Any]
    """Plain JSON, from which the trial is run wherever that is."""

    @cached_property
    def key(self) -> str:
        """16 hexadecimal digits that name these settings, whatever the order of their keys."""
        return hashlib.sha256(json.dumps(self.settings, sort_keys=True).encode()).hexdigest()[:16]


class Finished(NamedTuple):
    """A trial that has ended."""

    trial: Trial
    result: Any  # what the work returned; None where it failed
    error: str | None  # why it failed, in one line
    details: str  # where it failed: the traceback, empty where it did not
    seconds: float  # that the work took [s]
    place: str  # machine and process
    processor: str  # the machine's


class Runner(Protocol):
    """Something that runs trials."""

    def run(self, trials: Iterable[Trial], work: Work, look: Callable[[], None]) -> Iterator[Finished]:
        """Yield the trials as they finish; call ``look`` every :data:`LOOK_AGAIN` s at least, if the runner can."""


def attempt(work: Work, trial: Trial) -> Finished:
    """Run a trial here and now; what it raises becomes its error."""
    began, result, error, details = time.perf_counter(), None, None, ""
    try:
        result = work(trial.settings)
    except Exception as raised:
        error, details = first_line(raised), traceback.format_exc()
    seconds = time.perf_counter() - began
    return Finished(trial, result, error, details, seconds, f"{platform.node()} {os.getpid()}", machine())


def nothing() -> None:
    """Look at nothing."""


class InTurn:
    """Runs trials in this process, one after the other."""

    def run(self, trials: Iterable[Trial], work: Work, look: Callable[[], None] = nothing) -> Iterator[Finished]:
        """See :class:`Runner`; ``look`` is called between trials."""
        for trial in trials:
            yield attempt(work, trial)
            look()
