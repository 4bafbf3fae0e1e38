"""The memory that a step of the exact contact model works in: one array, so that nothing is allocated on the way.

A workspace has rows of 16 numbers, named by what they hold. It is handed on as one small array, because a compiled call
that passes many arrays spends more time on passing than on physics.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Workspace = NDArray[np.float64]  # (at least RECORD, 16)

STATE = 0  # the state in a frame near the box; 12 used
TALLY = 1  # what the step has done so far, in the places below
PIECE = 2  # accelerations of the box, 9 rows, see drives.py
GRADIENTS = 11  # of the gaps that are closed, 16 rows; 6 used of each
UNIT = 27  # the same in weighted coordinates, at length 1
BASE = 43  # of Gram-Schmidt, 3 rows
TALL = 46  # of Gram-Schmidt, 3 rows
IMPULSES = 49  # [N s] of the gaps that are closed
PAIRS = 50  # 4 * wall + foot of them
LENGTHS = 51  # of their weighted gradients
RATES = 52  # weighted
POINT = 53  # the weighted rates' projection
PUSHES = 54  # that lead to it
BEST = 55  # of the pushes
BEFORE = 56  # a state that is stepped, where it is gathered from many
AFTER = 57  # where it goes
RECORD = 58  # from here on, one row per impact: time since the step's start, wall, foot, impulse

# Places of TALLY: impacts, their impulse [N s], gaps evaluated, time since the step's start [s].
HITS, IMPULSE, WORK, ELAPSED = range(4)


def new_workspace(impacts: int = 0) -> Workspace:
    """Memory for one thread, with room to record so many impacts of a step."""
    return np.zeros((RECORD + impacts, 16))
