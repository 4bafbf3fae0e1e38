"""How a step of the exact contact model ends."""

from __future__ import annotations

from enum import IntEnum


class Status(IntEnum):
    """How a step ended; all but DONE, PAUSED and FULL are refusals, after which the state is as it was."""

    DONE = 0
    TOO_MUCH_WORK = 1  # more gap evaluations than a step may take
    TOO_FAST = 2  # motion that float64 no longer resolves, or too far off
    TOO_MANY_TURNS = 3  # of the chirp, within one step
    BAD_ACTION = 4  # NaN or infinite
    TOO_LATE = 5  # the time would not move, or would pass its limit
    BAD_REWARD = 6  # NaN or infinite
    PAUSED = 7  # after long work, so that an interruption is heard: to be called again
    FULL = 8  # no room for a step's impacts: to be called again with more
