"""Plain functions, compiled by numba together with the plain functions that they call.

The functions stay plain Python where they are written: readable, importable without numba, and testable without it.
What is compiled of this package is kept on disk for later processes (``kept.py``); what is compiled for a task of a
user's, or with a substitution for a comparison, lives as long as its process needs it.
"""

from __future__ import annotations

import contextlib
import hashlib
import itertools
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

import numpy as np

from jackbox_env.compiled import address
from jackbox_env.scene import Scene
from jackbox_env.states import State

PACKAGE = Path(__file__).parents[1]
F = TypeVar("F", bound=Callable[..., Any])
_LOCK = threading.RLock()  # a function is compiled once, whichever threads ask for it
_NOT_READ = {"numba", "numpy", *sys.stdlib_module_names}  # numba knows these functions, or refuses them
_MOST_FOLDERS = 8  # of compiled code, one for each version of the source
_shared: dict[str, Callable[..., Any]] = {}  # compiled functions that no substitution reaches, by their names
_numbers = itertools.count()


def compiled(function: F, **instead: Callable[..., Any]) -> F:
    """Return ``function`` compiled, without the global interpreter lock, kept on disk for later processes.

    Arithmetic is IEEE float64 in the order written, so every caller gets the same bits; a division by zero gives an
    infinity.

    Args:
        function: a plain function of this package.
        **instead: functions of this package to call in place of those of these names.
    """
    return cast(F, _compiled_once(function, tuple(sorted(instead.items())), True))


def compiled_with(function: F, **instead: Any) -> F:
    """Return ``function`` compiled with other functions or constants in place of those of these names, for comparisons.

    Not kept on disk.
    """
    return cast(F, _compiled_once(function, tuple(sorted(instead.items())), False))


def compiled_for_users(function: F, **instead: Callable[..., Any]) -> F:
    """Return ``function`` compiled with functions of a user's in place of those of these names, read as they are now.

    A division by zero raises ZeroDivisionError in them, as in Python. Not kept on disk.
    """
    with _LOCK:
        return cast(F, _Compilation(instead, str(next(_numbers)), users=True).compiled(function, False, inner=False)[0])


def returned_by(function: FunctionType) -> Any:
    """Numba's type of what the function of a user's task returns.

    Raises:
        Exception: numba cannot compile it.
    """
    from numba import typeof, types

    with _LOCK:
        dispatcher: Any = _Compilation({}, str(next(_numbers)), users=True).compiled(function, True)[0]
        scene = typeof(Scene().numbers)  # type: ignore[no-untyped-call]
        state = types.NamedUniTuple(types.float64, 12, State)  # type: ignore[no-untyped-call]
        arguments = scene, state, types.float64, types.float64
        defaults, more = dispatcher.py_func.__defaults__ or (), function.__code__.co_argcount - len(arguments)
        left_out = map(types.Omitted, defaults[len(defaults) - more :] if more > 0 else ())
        dispatcher.compile((*arguments, *left_out))
        (result,) = dispatcher.overloads.values()
        return result.signature.return_type


def _compiled_once(function: Callable[..., Any], instead: tuple[tuple[str, Any], ...], keep: bool) -> Any:
    with _LOCK:
        return _compiled_now(function, instead, keep)


@cache
def _compiled_now(function: Any, instead: tuple[tuple[str, Any], ...], keep: bool) -> Any:
    label = ", ".join(f"{name}={_name(by)}" for name, by in instead) if keep else str(next(_numbers))
    return _Compilation(dict(instead), label, keep).compiled(function, False, inner=False)[0]


class _Compilation:
    """Compiles a function with some functions or constants of other names in place of its globals.

    Numba makes symbols of the functions' names, and finds machine code by its symbol. So each name is unique: that of
    the function in this package, with the ``label`` if a substitution reaches it or it is a user's.

    Args:
        instead: what to use in place of globals of these names.
        label: unique for these substitutions.
        keep: whether to keep the code on disk.
        users: whether functions in ``instead`` are a user's.
    """

    def __init__(self, instead: Mapping[str, Any], label: str, keep: bool = False, users: bool = False) -> None:
        self._instead, self._label, self._keep, self._users = instead, label, keep, users
        self._made: dict[tuple[Any, bool], tuple[Any, bool]] = {}  # compiled, and whether a substitution reaches it

    def compiled(self, function: Any, own: bool, inner: bool = True) -> tuple[Any, bool]:
        """A function compiled, and whether a substitution reaches it.

        Args:
            function: to be compiled.
            own: whether it is in another's place, and so uses its own globals.
            inner: whether only compiled code calls it.
        """
        if (function, own) not in self._made:
            self._made[function, own] = function, False  # numba refuses a function that calls itself
            checked = self._users and own
            known, reached = self._globals(_names(function.__code__), function.__globals__, own)
            cells = [self._value(cell.cell_contents, (), own)[0] for cell in function.__closure__ or ()]
            apart = reached or checked or bool(cells)
            name = f"{_name(function)}{'' if inner else '()'}{f'[{self._label}]' if apart else ''}"
            if apart or name not in _shared:
                closure = tuple(map(CellType, cells))
                twin = FunctionType(function.__code__, known, function.__name__, function.__defaults__, closure)
                twin.__qualname__, twin.__module__, twin.__doc__ = name, function.__module__, function.__doc__
                made = _jitted(twin, inner, checked, self._keep and not inner)
                if not apart:
                    _shared[name] = made
            self._made[function, own] = made if apart else _shared[name], reached
        return self._made[function, own]

    def _globals(self, names: tuple[str, ...], known: Mapping[str, Any], own: bool) -> tuple[dict[str, Any], bool]:
        """The globals of code that uses these names, and whether a substitution reaches any."""
        instead = {} if own else self._instead
        found = {name: self._value(known[name], names, own) for name in names if name in known and name not in instead}
        used = {name: self._value(instead[name], names, True)[0] for name in names if name in instead}
        return {name: value for name, (value, _) in found.items()} | used, bool(used) or any(
            r for _, r in found.values()
        )

    def _value(self, value: Any, names: tuple[str, ...], own: bool) -> tuple[Any, bool]:
        """What stands in compiled code for a value that a function uses, and whether a substitution reaches it."""
        if isinstance(value, FunctionType) and value in address.CALLED:
            return address.compiled_call(value), False
        if isinstance(value, FunctionType) and _root(value.__globals__) not in _NOT_READ:
            return self.compiled(value, own)
        if isinstance(value, ModuleType) and _root(vars(value)) not in _NOT_READ:
            twin = ModuleType(value.__name__)
            known, reached = self._globals(names, vars(value), own)
            vars(twin).update(known)
            return twin, reached
        return value, False


def _jitted(twin: FunctionType, inner: bool, checked: bool, keep: bool) -> Callable[..., Any]:
    from numba import config, njit

    from jackbox_env.compiled.kept import CodeCache

    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return twin if inner else np.errstate(all="ignore")(twin)  # compiled integers wrap around in silence
    # Without the runtime that counts references to arrays: nothing compiled here makes an array, and counting took
    # two thirds of a step.
    twin.__defaults__ = _apart(twin.__defaults__) if checked else twin.__defaults__
    settings: dict[str, Any] = {"nogil": True, "error_model": "python" if checked else "numpy", "_nrt": False}
    if inner:  # a third of the time to compile goes without ways in from Python
        settings |= {"no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    dispatcher = njit(**settings)(twin)
    if keep:
        # where njit(cache=True) puts numba's own
        dispatcher._cache = CodeCache(twin, cache_folders(), shipped_in(PACKAGE))
    return cast(Callable[..., Any], dispatcher)


class _Float(float):
    """A default that numba identifies by its address. It identifies others by their values, and -0.0 equals 0.0."""

    __hash__ = None  # type: ignore[assignment]


def _apart(value: Any) -> Any:
    """A default, or a tuple of them, with its floats as :class:`_Float`."""
    if isinstance(value, float):
        return _Float(value)
    return tuple(map(_apart, value)) if type(value) is tuple else value


@cache
def _names(code: CodeType) -> tuple[str, ...]:
    """The names that code uses of globals and of attributes, that of functions within it included."""
    inner = (_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return tuple(sorted({*code.co_names, *(name for names in inner for name in names)}))


def _name(function: Callable[..., Any]) -> str:
    return f"{function.__module__}.{function.__qualname__}"


def _root(named: Mapping[str, Any]) -> str:
    """The package or module of a function's globals, or of a module's."""
    return str(named.get("__name__")).split(".")[0]


@cache
def _digest(package: Path = PACKAGE) -> str:
    """Digest of the package's whole source, because the kept code of a function includes what it calls elsewhere."""
    digest = hashlib.sha256()
    for source in sorted(package.rglob("*.py")):
        digest.update(source.read_bytes())
    return digest.hexdigest()[:16]


def shipped_in(package: Path) -> Path:
    """The folder of compiled code that comes with a wheel."""
    return package / "compiled" / "shipped" / f"compiled-{_digest()}"


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
        for old in sorted(place.glob("compiled-*"), key=lambda folder: folder.stat().st_mtime)[:-_MOST_FOLDERS]:
            shutil.rmtree(old, ignore_errors=True)


def cache_folders() -> list[Path]:
    """Folders to look for compiled code in, one in each place: the last of them can be written.

    The folders before it can only be read. A warning says that none can be written, or that the place the user
    named cannot be used.
    """
    from jackbox_env.compiled.kept import say_once

    found, refused = list[Path](), list[str]()
    for place in _cache_places():
        folder = place / f"compiled-{_digest()}"
        try:
            if not folder.is_dir():
                folder.mkdir(parents=True, exist_ok=True)
                _tidy(place)
        except OSError as error:
            refused.append(f"{place}: {error.strerror}")
            continue
        found.append(folder)
        if os.access(folder, os.W_OK):
            break
    if refused and (not found or os.environ.get("NUMBA_CACHE_DIR")):  # it comes first
        kept_in = found[-1] if found else "no folder, so each process compiles it anew"
        say_once(f"compiled code is kept in {kept_in}, because others cannot be used ({'; '.join(refused)})")
    return found
