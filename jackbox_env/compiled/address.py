"""Compiled functions called by their address, so that a caller need not be compiled anew for each of them.

Numba can hand a compiled function to another one, but looks its address up in Python at each call, which takes longer
than a step of a small batch. Here the address is looked up once and handed on as a number.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import cache
from types import FunctionType
from typing import Any, cast


def block_score(address: Any) -> Callable[..., int]:
    """The function at an address, with the arguments of ``score.score_block``.

    Compiled code takes a number here. Uncompiled, the function itself is handed in.
    """
    return cast(Callable[..., int], address)


def step_score(address: Any) -> Callable[..., int]:
    """The function at an address, with the arguments of ``score.score_step``; see :func:`block_score`."""
    return cast(Callable[..., int], address)


@cache
def signature(name: str) -> Any:
    """The types of ``score.score_block`` or ``score.score_step``: what it takes and returns."""
    from numba import types

    table, row = types.Array(types.float64, 2, "C"), types.Array(types.float64, 1, "C")
    if name == "score_step":
        return types.int64(row, row, types.float64, types.float64, row, types.int64)
    flags = types.Array(types.boolean, 1, "C")
    whole = types.int64
    return whole(table, table, table, row, whole, whole, whole, row, flags, table)


CALLED = {block_score: "score_block", step_score: "score_step"}


@cache
def compiled_call(function: Any) -> Any:
    """What :func:`block_score` or :func:`step_score` is in compiled code; itself under NUMBA_DISABLE_JIT."""
    from numba import config, types
    from numba.core import cgutils
    from numba.extending import intrinsic

    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    kind = types.FunctionType(signature(CALLED[function]))

    @intrinsic
    def at_address(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
            function = cgutils.create_struct_proxy(kind)(context, builder)  # type: ignore[no-untyped-call]
            place = builder.inttoptr(arguments[0], cgutils.voidptr_t)
            function.c_addr = function.py_addr = cgutils.get_null_value(cgutils.voidptr_t)  # type: ignore[no-untyped-call]
            function.jit_addr = place  # numba's own way to call, in which errors come back
            return function._getvalue()

        return kind(types.int64), generate

    return at_address


@cache
def address_of(dispatcher: Any) -> int:
    """Where a task's compiled ``score_block`` or ``score_step`` lies; it lies there as long as the dispatcher lives.

    Uncompiled, the function itself is handed on. None lies at 0 and is never called. The result is kept, because numba
    finds it under a lock, for which a forked child waits for ever if another thread held it at the fork.
    """
    if dispatcher is None:
        return 0
    if isinstance(dispatcher, FunctionType):
        return cast(int, dispatcher)
    wanted = signature(dispatcher.__name__)
    dispatcher.compile(wanted)
    result = dispatcher.overloads[wanted.args]
    return cast(int, result.library.get_pointer_to_function(result.fndesc.llvm_func_name))
