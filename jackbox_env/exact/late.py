"""What a step rarely needs is compiled when one first does: feet at rest, and impacts of several feet at a time.

It takes a third of the time to compile of all that a step may need. Steps call it by its address in the workspace, so
that the hot code is the same before and after. A step that needs it first changes nothing and returns UNCOMPILED; the
call is then repeated from there, with the same bits.
"""

from __future__ import annotations

from types import FunctionType

from jackbox_env.exact.contact import bounce_together, together_at
from jackbox_env.exact.rest import rest_at, settle_and_advance
from jackbox_env.exact.workspace import Call, Status, Workspaces
from jackbox_env.jit.compiler import address_of, compiled

AGAIN = Status.FULL, Status.UNCOMPILED  # ends of a call that goes on with :func:`repaired`


def with_all(workspaces: Workspaces) -> Workspaces:
    """The same workspaces, with the addresses of all that is compiled later; uncompiled, it needs none."""
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
