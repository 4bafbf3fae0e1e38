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


# What ``score.score_block`` and ``score.score_step`` return and take, as numba writes it.
_TYPES = {
    "score_block": "i8(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8, i8, i8, f8[::1], b1[::1], f8[:, ::1])",
    "score_step": "i8(f8[::1], f8[::1], f8, f8, f8[::1], i8)",
}
CALLED = {block_score: _TYPES["score_block"], step_score: _TYPES["score_step"]}


@cache
def compiled_call(function: Any) -> Any:
    """What :func:`block_score` or :func:`step_score` is in compiled code; itself under NUMBA_DISABLE_JIT."""
    from numba import config, types
    from numba.core import cgutils, sigutils
    from numba.extending import intrinsic

    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function
    arguments, result = sigutils.normalize_signature(CALLED[function])  # type: ignore[no-untyped-call]
    kind = types.FunctionType(result(*arguments))

    @intrinsic
    def at_address(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
            called = cgutils.create_struct_proxy(kind)(context, builder)  # type: ignore[no-untyped-call]
            # Numba's own way to call, in which errors come back. Its other two addresses stay 0.
            called.jit_addr = builder.inttoptr(given[0], cgutils.voidptr_t)
            return called._getvalue()

        return kind(types.int64), generate

    return at_address


def address_of(dispatcher: Any) -> int:
    """Where a task's compiled ``score_block`` or ``score_step`` lies; it lies there as long as the dispatcher lives.

    Uncompiled, the function itself is handed on. None lies at 0 and is never called. The dispatcher keeps the result,
    because numba finds it under a lock, for which a forked child waits for ever if another thread held it at the fork.
    """
    if dispatcher is None or isinstance(dispatcher, FunctionType):
        return cast(int, dispatcher or 0)
    if not hasattr(dispatcher, "address"):
        dispatcher.compile(_TYPES[dispatcher.__name__])
        (made,) = dispatcher.overloads.values()
        dispatcher.address = made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
    return cast(int, dispatcher.address)
