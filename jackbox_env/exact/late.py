"""Code that a step rarely needs, compiled when one first does: feet at rest, and impacts of several feet at a time.

It takes a third of the time to compile of all that a step may need. Steps call it by its address in the workspace, so
that the hot code is the same before and after. A step that needs it first changes nothing and returns UNCOMPILED; the
call is then repeated from there, with the same bits.
"""

from __future__ import annotations

from types import FunctionType
from typing import Any

import numpy as np

from jackbox_env.exact.contact import ContactTolerances, bounce_together, together_at
from jackbox_env.exact.flight import Flight, Piece, constant_piece, flight_of
from jackbox_env.exact.rest import advance_held, settle
from jackbox_env.exact.workspace import Call, Status, Workspace, Workspaces, new_log, new_workspaces
from jackbox_env.jit.compiler import address_of, called_later, compiled, is_compiled
from jackbox_env.model.scene import SceneNumbers
from jackbox_env.model.states import Array

AGAIN = Status.FULL, Status.UNCOMPILED  # ends of a call that goes on with :func:`repaired`


def settle_and_advance(
    scene: SceneNumbers, memory: Workspace, log: Array, piece: Piece, flight: Flight, horizon: float,
    tolerances: ContactTolerances, resolution: float,
) -> tuple[Status, float]:  # fmt: skip
    """:func:`settle`, and then :func:`advance_held`, from ``flight.since``; FREE and 0 if no foot rests."""
    held = settle(scene, memory, piece, flight, horizon, tolerances, resolution)
    if held == 0:
        return Status.FREE, 0.0
    return advance_held(scene, memory, log, piece, tolerances, resolution, flight.since, held)


def example() -> tuple[Any, ...]:
    """A value that :func:`settle_and_advance` returns, and arguments of it."""
    scene, piece = SceneNumbers(*[0.0] * len(SceneNumbers._fields)), constant_piece(0.0, 0.0)
    flight, tolerances = flight_of(scene, np.zeros(12), piece, 0.0), ContactTolerances(0.0, 0.0)
    return (Status.DONE, 0.0), scene, new_workspaces()[0], new_log(), piece, flight, 0.0, tolerances, 0.0


rest_at = called_later(lambda: settle_and_advance, example)


def advance_resting(
    scene: SceneNumbers, memory: Workspace, log: Array, piece: Piece, flight: Flight, horizon: float,
    tolerances: ContactTolerances, resolution: float,
) -> tuple[Status, float]:  # fmt: skip
    """Call :func:`settle_and_advance` by its address; UNCOMPILED if it is not compiled yet."""
    if not is_compiled(memory.rest):
        return Status.UNCOMPILED, 0.0
    return rest_at(memory.rest)(scene, memory, log, piece, flight, horizon, tolerances, resolution)


def with_all(workspaces: Workspaces) -> Workspaces:
    """Workspaces with the addresses of all that is compiled later; uncompiled code needs none."""
    rest, together = compiled(settle_and_advance), compiled(bounce_together)
    if not isinstance(rest, FunctionType):
        workspaces["rest"], workspaces["together"] = address_of(rest, rest_at), address_of(together, together_at)
    return workspaces


def repaired(call: Call, ended: int) -> Call:
    """The call with what it lacked when it ``ended``, to go on where it did."""
    if ended == Status.FULL:
        return call.with_room()
    with_all(call.memory.workspaces)
    return call
