"""Refuses a second thread in an object that only one may use at a time."""

from __future__ import annotations

from _thread import get_ident
from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, Protocol, TypeVar

P = ParamSpec("P")
R = TypeVar("R")


class ThreadNote(dict[int, int]):
    """The thread that is in an object, under the key 0; empty if none is. A copy of it, or a pickle, is empty.

    A thread enters by ``note.setdefault(0, get_ident())``, which is atomic, and leaves by ``note.clear()``. If an
    interruption has cut its leaving, it may enter again.
    """

    def __reduce__(self) -> Any:
        return ThreadNote, ()


class _Noted(Protocol):
    _inside: ThreadNote


def in_use(what: str) -> RuntimeError:
    """The error for a thread that finds another one in an object."""
    return RuntimeError(f"{what} must be used by one thread at a time, but another one is in it now; make one for each")


def by_one_thread(
    method: Callable[Concatenate[Any, P], R],
) -> Callable[Concatenate[Any, P], R]:
    """Decorate a method of a vector environment: it raises RuntimeError while another thread is in one of them.

    They do not call each other. The object has a :class:`ThreadNote`, ``_inside``.
    """

    @wraps(method)
    def alone(self: _Noted, /, *args: P.args, **kwargs: P.kwargs) -> R:
        inside, thread = self._inside, get_ident()
        if inside.setdefault(0, thread) != thread:
            raise in_use("a vector environment")
        try:
            return method(self, *args, **kwargs)
        finally:
            inside.clear()

    return alone
