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
HELD = 11  # accelerations of box and jack and the forces at held feet, 27 rows, see collocation.py
GRADIENTS = 38  # of the gaps that are closed, 17 rows; 6 used of each
UNIT = 55  # the same in weighted coordinates, at length 1
BASE = 71  # of Gram-Schmidt, 3 rows
TALL = 74  # of Gram-Schmidt, 3 rows
IMPULSES = 77  # [N s] of the gaps that are closed
PAIRS = 78  # 4 * wall + foot of them
LENGTHS = 79  # of their weighted gradients
RATES = 80  # weighted
POINT = 81  # the weighted rates' projection
PUSHES = 82  # that lead to it
BEST = 83  # of the pushes
BEFORE = 84  # a state that is stepped, where it is gathered from many
AFTER = 85  # where it goes
BIAS = 86  # what is added to the rates of the gaps that are closed, in units of their weighted gradients
GOALS = 87  # of Gram-Schmidt
GAPS = 88  # of the gaps that are closed [m]
TARGETS = 89  # the same, where held feet are brought back to [m]
NODE = 90  # a state on the way of a held foot; 12 used
FREE = 91  # accelerations without contact; 6 used
VALUES = 92  # at 13 moments, 9 rows, see collocation.py
RESTING = 101  # impulses of held feet in this step [N s], by 4 * wall + foot
HOLDING = 102  # which feet are held, in the places below
ORDER = 103  # of held feet in the list of contacts
SPARE = 104  # in passing
RECORD = 105  # from here on, one row per impact: time since the step's start, wall, foot, impulse

# Places of TALLY: impacts, their impulse [N s], gaps evaluated, time since the step's start [s].
HITS, IMPULSE, WORK, ELAPSED = range(4)
# Places of HOLDING: how many pairs are held, and those that were let go at this moment, as bits.
COUNT, LOOSE = range(2)


def new_workspace(impacts: int = 0) -> Workspace:
    """Memory for one thread, with room to record so many impacts of a step."""
    return np.zeros((RECORD + impacts, 16))
