"""The motion between recorded moments: flight for any time from a state, as a step flies, without a search for impacts.

:mod:`jackbox_env.recording` calls it. :func:`coast` stands for ``step.advance`` in the compiled code, so drives, frames
and flight are those of a step: there is no other copy of them.
"""

from __future__ import annotations

from typing import NamedTuple

from jackbox_env.exact.flight import Piece, evolve, flight_of
from jackbox_env.exact.step import Pieces, leave_frame, make_parameters, step
from jackbox_env.exact.workspace import AFTER, BEFORE, Status, Workspace, Workspaces, make_numbers
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import Array, Counts, copy_numbers


class Moments(NamedTuple):
    """States from which to fly, and how far, for n moments."""

    starts: Array  # states, (n, 12)
    times: Array  # of the starts [s], (n,)
    torques: Array  # constant [N m], (n,); ignored under a drive
    durations: Array  # [s], (n,)
    table: Array  # pieces of the drive's functions, see flight.py
    first: Counts  # in the table, of each moment, (n,)
    last: Counts  # past the last


def coast(scene: SceneNumbers, memory: Workspace, log: Array, piece: Piece, tolerances: object) -> Status:
    """Fly through a piece without a search, or until the flight's time, the first number of the ``log``, has passed."""
    if not piece.curved:
        return Status.FREE
    time = min(piece.length, log[0, 0] - memory.elapsed)
    if time > 0.0:
        evolve(memory, flight_of(scene, memory.state, piece, 0.0), time)
        memory.elapsed += time
    return Status.DONE


def fly_to(values: Array, kind: int, moments: Moments, states: Array, workspaces: Workspaces, log: Array) -> int:
    """Fill in the states, shape (n, 12), after flight from each start; return the first row that failed, or -1.

    Compiled with :func:`coast` for ``advance``; without, it makes steps, in which feet may rest. ``log`` is scratch, of
    shape (rows, 4).
    """
    scene, memory = make_numbers(values), workspaces[0]
    for i in range(states.shape[0]):
        params, log[0, 0] = make_parameters(scene, moments.durations[i], kind), moments.durations[i]
        pieces = Pieces(moments.table, moments.first[i], moments.last[i])
        ended, _ = step(
            scene, params, moments.starts[i], states[i], moments.times[i], moments.torques[i], pieces, memory, log
        )
        if ended != Status.DONE:
            return i
    return -1


def leave_frames(values: Array, dt: float, kind: int, starts: Array, log: Array, workspaces: Workspaces) -> None:
    """Move the states in a log of jumps from the frames of their steps, which began in ``starts``, to the world."""
    memory = workspaces[0]
    params = make_parameters(make_numbers(values), dt, kind)
    for row in range(log.shape[0]):
        for first in (BEFORE, AFTER):
            copy_numbers(12, log[row, first:], memory.state)
            leave_frame(Status.DONE, params, starts[row], log[row, first:], memory, log[:0])
