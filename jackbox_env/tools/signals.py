"""Keeps handlers of signals, which may raise as Ctrl-C's does, out of work that must not be cut anywhere."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

_handlers: dict[int, Callable[[int, FrameType | None], Any]] = {}  # that wait, by the number of their signal
_came: set[int] = set()  # signals of waiting handlers


@contextmanager
def uninterrupted() -> Iterator[None]:
    """Call Python's handlers of signals before or after this block, not within it.

    A block within a block calls those that wait before it begins, so a long block that consists of others ends soon.
    Python calls handlers in the main thread only, so in another one there is nothing to do.
    """
    if threading.current_thread() is not threading.main_thread():
        yield
    elif _handlers:
        while _came:
            number = _came.pop()
            _handlers[number](number, None)
        yield
    else:
        _came.clear()
        try:
            for number in signal.valid_signals():
                handler = signal.getsignal(number)
                if callable(handler):
                    _handlers[number] = handler
                    signal.signal(number, lambda number, _: _came.add(number))
            yield
        finally:
            _restore()


def _restore() -> None:
    """Set all handlers again, and call those whose signals came; one that raises keeps no other from being set."""
    try:
        while _handlers:
            number = next(iter(_handlers))
            signal.signal(number, _handlers[number])
            del _handlers[number]
            if number in _came:
                signal.raise_signal(number)
    finally:
        if _handlers:
            _restore()
