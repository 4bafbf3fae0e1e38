"""Plain functions, compiled by numba together with the plain functions of this package that they call.

The functions stay plain Python where they are written: readable, importable without numba, and testable without it.
"""

from __future__ import annotations

import contextlib
import hashlib
import linecache
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator
from functools import cache
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from types import CellType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

from jackbox_env.compiled import address
from jackbox_env.scene import Scene

PACKAGE = Path(__file__).parents[1]
F = TypeVar("F", bound=Callable[..., Any])
_LOCK = threading.RLock()  # a function is compiled once, whichever threads ask for it
_OWN = "jackbox_env"
_NUMBAS_OWN = ("numba", "numpy")  # numba knows what these do
_KEPT = 8  # folders of compiled code that are kept, one for each version of the source


def compiled(function: F, **instead: Callable[..., Any]) -> F:
    """Return ``function`` compiled, without the global interpreter lock, kept on disk for later processes.

    Arithmetic is IEEE float64 in the order written, so every caller gets the same bits; a division by zero gives an
    infinity.

    Args:
        function: a plain function of this package.
        **instead: functions to call in place of those of these names. With a user's own function the result is not kept
            on disk: its name does not tell its code, nor that of what it calls.
    """
    keep = all(_root(other) == _OWN for other in instead.values())
    return cast(F, _compile(cast(FunctionType, function), tuple(instead.items()), keep))


def compiled_with(function: F, **instead: Any) -> F:
    """Return ``function`` compiled with other functions or constants in place of those of these names, for comparisons.

    Not kept on disk.
    """
    return cast(F, _compile(cast(FunctionType, function), tuple(instead.items()), keep=False))


def returned_by(function: Callable[..., Any], name: str) -> Any:
    """Numba's type of what a user's function returns, where it is compiled in place of ``name``, a task's function.

    Raises:
        Exception: numba cannot compile it.
    """
    from numba import typeof, types

    with _LOCK:
        dispatcher: Any = _compile_once(cast(FunctionType, function), ((name, function),), keep=False, inner=True)
        scene = typeof(Scene().numbers)  # type: ignore[no-untyped-call]
        given = scene, types.UniTuple(types.float64, 12), types.float64, types.float64
        dispatcher.compile(given)
        return dispatcher.overloads[given].signature.return_type


def _compile(function: FunctionType, instead: tuple[tuple[str, Any], ...], keep: bool) -> Callable[..., Any]:
    with _LOCK:
        return _compile_once(function, instead, keep)


@cache
def _compile_once(
    function: FunctionType, instead: tuple[tuple[str, Any], ...], keep: bool, inner: bool = False
) -> Callable[..., Any]:
    from numba import njit
    from numba.extending import is_jitted

    def ready(value: Any) -> Any:
        """What stands in compiled code for something that the function reads."""
        if isinstance(value, FunctionType) and value in address.CALLED:
            return address.compiled_call(address.CALLED[value])
        if isinstance(value, FunctionType) and (_followed(function, value) or value in dict(instead).values()):
            return _compile_once(value, instead, keep=False, inner=True)  # what is kept of a caller holds what it calls
        return _Module(value, ready) if isinstance(value, ModuleType) and _followed(function, value) else value

    known = {**function.__globals__, **dict(instead)}
    for name in function.__code__.co_names:
        if name in known:
            known[name] = ready(known[name])
    cells = tuple(CellType(ready(cell.cell_contents)) for cell in function.__closure__ or ())
    twin = FunctionType(function.__code__, known, function.__name__, function.__defaults__, cells)
    twin.__qualname__ = _full_name(function, instead)
    twin.__module__, twin.__doc__ = function.__module__, function.__doc__
    # Without the runtime that counts references to arrays: nothing compiled here makes an array, and counting took
    # two thirds of a step.
    settings: dict[str, Any] = {"nogil": True, "error_model": "numpy", "_nrt": False}
    if inner:  # only compiled code calls it: a third of the time to compile goes without ways in from Python
        settings |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    dispatcher = njit(**settings)(twin)
    if keep and is_jitted(dispatcher):  # it is the plain function under NUMBA_DISABLE_JIT
        _keep(dispatcher, twin)
    return cast(Callable[..., Any], dispatcher)


def _full_name(function: FunctionType, instead: tuple[tuple[str, Any], ...]) -> str:
    """The name that numba makes a symbol of, with what the function calls in place of those of its source.

    Machine code is found by its symbol: a name, argument types, and a count of the functions that a process has
    compiled. Two processes may have counted alike, so in a third one, which loads what both have kept, the name alone
    tells one task's reward from another's.
    """
    changes = (f"{name}={getattr(to, '__module__', '')}.{getattr(to, '__qualname__', to)}" for name, to in instead)
    return f"{function.__qualname__}[{', '.join(changes)}]" if instead else function.__qualname__


class _Module(ModuleType):
    """A module of the user's whose functions are compiled where compiled code calls them."""

    def __init__(self, module: ModuleType, ready: Callable[[Any], Any]) -> None:
        super().__init__(module.__name__)
        self._given, self._ready = module, ready

    def __getattr__(self, name: str) -> Any:
        return self._ready(getattr(self._given, name))


def _root(thing: FunctionType | ModuleType | Callable[..., Any]) -> str:
    """The package or module that something is from."""
    name = thing.__name__ if isinstance(thing, ModuleType) else thing.__module__
    return str(name).split(".")[0]


def _followed(caller: FunctionType, called: FunctionType | ModuleType) -> bool:
    """Whether something that a function reads is compiled with it: all of ours, and what a user's function reads."""
    if _root(caller) in (_OWN, "scripts"):
        return isinstance(called, FunctionType) and _root(called) in (_OWN, "scripts")
    return _root(called) not in _NUMBAS_OWN and _root(called) not in sys.stdlib_module_names


def _keep(dispatcher: Any, function: FunctionType) -> None:
    """Let numba look for compiled code on disk before it compiles, and save there what it compiles."""
    from jackbox_env.compiled.kept import CodeCache, say_once

    name, source = (
        function.__qualname__,
        "".join(linecache.getlines(function.__code__.co_filename, function.__globals__)),
    )
    if not source:  # then a changed function could not be told from the one whose code is kept
        say_once(name, f"the source of {name} cannot be read, so what is compiled of it is not kept")
    elif folders := _cache_folders():
        dispatcher._cache = CodeCache(function, source, folders)  # where njit(cache=True) puts numba's own


@cache
def _digest() -> str:
    """Digest of the package's whole source, because the kept code of a function includes what it calls elsewhere."""
    digest = hashlib.sha256()
    for text in _sources(files("jackbox_env")):
        digest.update(text)
    return digest.hexdigest()[:16]


def _sources(folder: Traversable) -> Iterator[bytes]:
    for entry in sorted(folder.iterdir(), key=lambda entry: entry.name):  # of an archive too
        if entry.is_dir():
            yield from _sources(entry)
        elif entry.name.endswith(".py"):
            yield entry.read_bytes()


def _cache_places() -> Iterator[Path]:
    given = os.environ.get("NUMBA_CACHE_DIR")
    if given:
        yield Path(given).absolute()  # saving comes later, perhaps after a change of folder
    yield PACKAGE / "__pycache__"
    with contextlib.suppress(RuntimeError):  # a user without a home
        yield Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache").absolute() / "jackbox"


def _tidy(place: Path) -> None:
    """Remove code that was compiled from old versions of the source."""
    with contextlib.suppress(OSError):  # another process may be tidying too
        folders = sorted(place.glob("compiled-*"), key=lambda folder: folder.stat().st_mtime, reverse=True)
        for folder in folders[_KEPT:]:
            shutil.rmtree(folder, ignore_errors=True)


def _cache_folders() -> list[Path]:
    """Folders to look for compiled code in, one in each place: the last of them can be written.

    The folders before it can only be read. A warning says that none can be written, or that the place the user
    named cannot be used.
    """
    from jackbox_env.compiled.kept import say_once

    found, refused = list[Path](), list[str]()
    for place in _cache_places():
        folder = place / f"compiled-{_digest()}"
        try:
            new = not folder.is_dir()
            folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            refused.append(f"{place}: {error.strerror}")
            continue
        found.append(folder)
        if new:
            _tidy(place)
            print("jackbox compiles its exact contact model, once: 25 to 45 s", file=sys.stderr)
        if os.access(folder, os.W_OK):
            break
    if not found:
        tried = "; ".join(refused)
        say_once(
            "nowhere",
            "no folder to keep compiled code in can be written, so each process compiles it anew, which takes "
            f"25 to 45 s; set NUMBA_CACHE_DIR to one that can (tried {tried})",
        )
    elif refused and os.environ.get("NUMBA_CACHE_DIR"):  # it comes first
        say_once("elsewhere", f"compiled code is kept in {found[-1]}, as NUMBA_CACHE_DIR cannot be used ({refused[0]})")
    return found
