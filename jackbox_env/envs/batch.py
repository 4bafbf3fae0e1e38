"""The common part of both batches of environments: how they change, and their results for the vector environment.

A step, a reset and ``set_states`` change a batch in three moves, so that an error or an interruption leaves all of it
as it was or all as the change leaves it:

- *prepare*: compute the environments after the change, in memory that is not in use. Only this may raise.
- *commit*: replace the present by them, in one assignment.
- *finish*: update all other memory to the present. The next call repeats this first, so a change that was interrupted
  after its commit is finished, and what *prepare* moved before an error is moved back.

The vector environment prepares and commits; what raises before that, such as drawing starts, changes nothing.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from numpy.typing import NDArray

from jackbox_env.model.action import Repeat
from jackbox_env.model.states import Array, Flags, Floats, Indices

Change = Mapping[str, Any]  # fields of a scene that change


@dataclass(slots=True)
class Outcome:
    """Results of a step, a decision of each environment: fresh arrays, which the batch never writes again."""

    observations: Floats  # (N, numbers)
    rewards: Array  # (N,)
    terminations: Flags  # (N,)
    truncations: Flags  # (N,)
    infos: dict[str, NDArray[Any]]  # numbers of each environment's step, (N,) or (N, 12): durations, others on request
    finished: int  # episodes that this step ends
    after: Any  # the environments after the step, for the batch's ``commit``

    @property
    def ended(self) -> Flags:
        """True for each episode that this step ends, shape (N,)."""
        return self.terminations | self.truncations


class Starts(NamedTuple):
    """Episodes that are drawn but not begun."""

    numbers: Indices  # (k,) of their environments
    generators: Any  # of these environments from their start on
    scenes: Any  # of these environments from their start on, in the batch's own form; None: unchanged
    states: Any = None  # (k, 12) in which they start, checked; None: drawn when they begin
    times: Array | None = None  # (k,) at which they start [s]; None: 0


class EpisodeLimits(NamedTuple):
    """The limits at which an episode is truncated; infinite: never."""

    steps: float  # control steps
    decisions: float  # counted only if it is finite

    @classmethod
    def of(cls, repeat: Repeat, decisions: float, steps: float) -> EpisodeLimits:
        """The limits of both kinds; if a decision is one control step, they are one."""
        return cls(float(steps), float(decisions)) if repeat.steps > 1 else cls(float(min(steps, decisions)), math.inf)


def bad_action(action: float, number: int) -> ValueError:
    """The error for an action that is NaN or infinite."""
    return ValueError(f"action must be a finite number (clipped to [-1, 1]), got {action} for environment {number}")
