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

# While feet are held: powers of time over a stretch, on the box's axes, see constrained.py.
PLACE_X, PLACE_Y, PSI, TURNED = 11, 12, 13, 14  # jack's centre [m], its relative angle, the box's turn [rad]
RATE_X, RATE_Y, SPIN, OMEGA = 15, 16, 17, 18  # their rates, per stretch
ALPHA, JACK_ALPHA = 19, 20  # angular accelerations of box and jack, per stretch squared
DRIVEN, PUSHED_X, PUSHED_Y = 21, 22, 23  # what the drive gives the box: angular acceleration, and that of its centre
BOX_COSINE, BOX_SINE, COSINE, SINE = 24, 25, 26, 27  # of the box's angle and of psi
OMEGA_SQUARED, SPIN_SQUARED = 28, 29
FORCE = 30  # at held feet, 3 rows; of each the levers about box and jack [m], and the foot's extent along the normal
BOX_LEVER, JACK_LEVER, EXTENT = 33, 36, 39  # 3 rows each

GRADIENTS = 42  # of the gaps that are closed, 17 rows; 6 used of each
UNIT = 59  # the same in weighted coordinates, at length 1
BASE = 75  # of Gram-Schmidt, 3 rows
TALL = 78  # of Gram-Schmidt, 3 rows
IMPULSES = 81  # [N s] of the gaps that are closed
PAIRS = 82  # 4 * wall + foot of them
LENGTHS = 83  # of their weighted gradients
RATES = 84  # weighted
POINT = 85  # the weighted rates' projection
PUSHES = 86  # that lead to it
BEST = 87  # of the pushes
BEFORE = 88  # a state that is stepped, where it is gathered from many
AFTER = 89  # where it goes
BIAS = 90  # what is added to the rates of the gaps that are closed, in units of their weighted gradients
GOALS = 91  # of Gram-Schmidt
GAPS = 92  # of the gaps that are closed [m]
TARGETS = 93  # the same, where held feet are brought back to [m]
FREE = 94  # accelerations without contact; 6 used
RESTING = 95  # impulses of held feet in this step [N s], by 4 * wall + foot
HOLDING = 96  # which feet are held, in the places below
ORDER = 97  # of held feet in the list of contacts
SPARE = 98  # in passing
INVERSE = 99  # of J M^-1 J^T at held feet, 3 rows
LACK = 102  # of J qddot at held feet
RECORD = 103  # from here on, one row per impact: time since the step's start, wall, foot, impulse

# Places of TALLY: impacts, their impulse [N s], gaps evaluated, time since the step's start [s].
HITS, IMPULSE, WORK, ELAPSED = range(4)
# Places of HOLDING: how many pairs are held, and those that were let go at this moment, as bits.
COUNT, LOOSE = range(2)

# Rows of a thread's memory for a block of environments, (LANES, width); 0 to 3 are scratch.
TORQUE, TURNING = 4, 5  # [N m]; angular acceleration of the box [rad/s^2], or a bound of it
NEAR, HIT, IMPULSE_SUM = 6, 7, 8  # whether a foot may touch a wall; impacts, their impulse [N s]
# Where lanes near a wall are brought together, see ``glide.look_at_walls``.
AT_MOST, LANE_COSINE, LANE_SINE, AHEAD, ASIDE, LANE_OMEGA, BEND, LANE, APART, PULL, OFF = range(9, 20)
LANES = 20


def new_lanes(width: int) -> NDArray[np.float64]:
    """Memory for one thread's blocks of so many environments."""
    return np.zeros((LANES, width))


def new_workspace(impacts: int = 0) -> Workspace:
    """Memory for one thread, with room to record so many impacts of a step."""
    return np.zeros((RECORD + impacts, 16))
