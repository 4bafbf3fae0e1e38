"""Plain functions, compiled by numba together with the plain functions that they call.

The functions stay plain Python where they are written: readable, importable without numba, and testable without it.

What is compiled is found by its content, in this process and on disk: the code, constants, defaults, closure and
globals of a function, and those of all functions that it calls. Names, modules and files do not count.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import sys
import threading
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType, NoneType
from typing import Any, TypeVar, cast

import numpy as np

from jackbox_env.compiled import address
from jackbox_env.scene import Scene

PACKAGE = Path(__file__).parents[1]
_OWN = "jackbox_env"
F = TypeVar("F", bound=Callable[..., Any])
_LOCK = threading.RLock()  # a function is compiled once, whichever threads ask for it
_NOT_READ = {"numba", "numpy", *sys.stdlib_module_names}  # numba knows what these do, or refuses it
_PLAIN = (bool, int, float, complex, str, bytes, NoneType)
_KEPT = 8  # folders of compiled code that are kept, one for each version of the source
_made: dict[str, Callable[..., Any]] = {}  # all that is compiled, by names that tell the content


def compiled(function: F, **instead: Callable[..., Any]) -> F:
    """Return ``function`` compiled, without the global interpreter lock, kept on disk for later processes.

    Arithmetic is IEEE float64 in the order written, so every caller gets the same bits; a division by zero gives an
    infinity.

    Args:
        function: a plain function of this package. A process reads it once.
        **instead: functions of this package to call in place of those of these names.
    """
    return cast(F, _compile(cast(FunctionType, function), tuple(instead.items()), True))


def compiled_with(function: F, **instead: Any) -> F:
    """Return ``function`` compiled with other functions or constants in place of those of these names, for comparisons.

    Not kept on disk.
    """
    return cast(F, _compile(cast(FunctionType, function), tuple(instead.items()), False))


def compiled_for_users(function: F, **instead: Callable[..., Any]) -> F:
    """Return ``function`` compiled with functions of a user's in place of those of these names, read as they are now.

    A division by zero raises ZeroDivisionError in them, as in Python. Not kept on disk.
    """
    return cast(F, _compile(cast(FunctionType, function), tuple(instead.items()), False, users=True))


def returned_by(function: FunctionType) -> Any:
    """Numba's type of what the function of a user's task returns.

    Raises:
        Exception: numba cannot compile it.
    """
    from numba import typeof, types

    with _LOCK:
        dispatcher: Any = _Reading(False, users=True).compiled(function, None)[0]
        scene = typeof(Scene().numbers)  # type: ignore[no-untyped-call]
        state = types.UniTuple(types.float64, 12)  # type: ignore[no-untyped-call]
        given = scene, state, types.float64, types.float64
        defaults, more = dispatcher.py_func.__defaults__ or (), function.__code__.co_argcount - len(given)
        left_out = map(types.Omitted, defaults[len(defaults) - more :] if more > 0 else ())
        dispatcher.compile((*given, *left_out))
        (result,) = dispatcher.overloads.values()
        return result.signature.return_type


def _compile(
    function: FunctionType, instead: tuple[tuple[str, Any], ...], keep: bool, users: bool = False
) -> Callable[..., Any]:
    with _LOCK:
        return (_compile_now if users else _compile_once)(function, instead, keep, users)


def _compile_now(
    function: FunctionType, instead: tuple[tuple[str, Any], ...], keep: bool, users: bool = False
) -> Callable[..., Any]:
    return cast(Callable[..., Any], _Reading(keep, users).compiled(function, dict(instead), inner=False)[0])


_compile_once = cache(_compile_now)


class _Reading:
    """Reads a function and all that it uses, as they are at this moment, and compiles what is new.

    For each thing that is read there is what stands for it in compiled code, and a text that nothing else has. The text
    of a function is its name there. Numba makes symbols of these names, and finds machine code by its symbol. So a
    process that loads what several others have kept does not take one function for another.
    """

    def __init__(self, keep: bool, users: bool) -> None:
        self._keep, self._users = keep, users
        self._read: dict[Any, tuple[Any, str]] = {}  # also what is being read: numba refuses it where it uses itself

    def compiled(
        self, function: FunctionType, instead: Mapping[str, Any] | None, inner: bool = True
    ) -> tuple[Any, str]:
        """A function compiled, and its name.

        Args:
            function: to be compiled.
            instead: what this function and those it calls use in place of their globals of these names. None: this one
                is in another's place, and uses its own.
            inner: whether only compiled code calls it.
        """
        place = function, instead is None
        if place not in self._read:
            self._read[place] = function, "itself"
            code, defaults = function.__code__, function.__defaults__ or ()
            used = self._used(_names(code), function.__globals__, instead)
            cells = [self._taken(cell.cell_contents, (), instead) for cell in function.__closure__ or ()]
            texts = [text for _, text in (*cells, *(self._taken(value, (), instead) for value in defaults))]
            checked = self._users and instead is None
            whole = repr((_told(code), [(name, used[name][1]) for name in used], len(cells), texts, inner, checked))
            name = f"{function.__qualname__}[{hashlib.sha256(whole.encode()).hexdigest()[:32]}]"
            if name not in _made:
                known, closure = {name: used[name][0] for name in used}, tuple(CellType(value) for value, _ in cells)
                twin = FunctionType(code, known, function.__name__, function.__defaults__, closure)
                twin.__qualname__, twin.__module__, twin.__doc__ = name, function.__module__, function.__doc__
                _made[name] = _jitted(twin, inner, checked, self._keep and not inner)
            self._read[place] = _made[name], name
        return self._read[place]

    def _used(
        self, names: tuple[str, ...], known: Mapping[str, Any], instead: Mapping[str, Any] | None
    ) -> dict[str, tuple[Any, str]]:
        """What code that uses these names finds under them."""
        given = instead or {}
        return {
            name: self._taken(given[name], names, None) if name in given else self._taken(known[name], names, instead)
            for name in names
            if name in given or name in known
        }

    def _taken(self, value: Any, names: tuple[str, ...], instead: Mapping[str, Any] | None) -> tuple[Any, str]:
        """What stands in compiled code for something that a function uses, and its text."""
        if isinstance(value, FunctionType) and value in address.CALLED:
            return address.compiled_call(value), address.CALLED[value]
        if isinstance(value, FunctionType) and _root(value.__globals__) not in _NOT_READ:
            return self.compiled(value, instead)
        if isinstance(value, ModuleType):
            return self._module(value, names, instead)
        if isinstance(value, tuple):
            parts = value if type(value) is tuple else (type(value), *value)
            return value, repr([self._taken(part, names, instead)[1] for part in parts])
        if isinstance(value, np.ndarray | np.generic) and not value.dtype.hasobject:
            digest = hashlib.sha256(value.tobytes()).hexdigest()
            return value.copy(), f"{type(value)} {value.dtype} {value.shape} {digest}"
        if type(value) in _PLAIN:
            return value, repr(value)
        if isinstance(value, type) and _is_ours(value):
            return value, f"{value.__module__}.{value.__qualname__}"  # the folder tells the version of the package
        self._keep = False
        return value, f"at {id(value)}"  # it stays there, because the compiled function holds it

    def _module(self, module: ModuleType, names: tuple[str, ...], instead: Mapping[str, Any] | None) -> tuple[Any, str]:
        """A module of the user's with what a function that uses these names may use of it; others as they are."""
        if _root(vars(module)) in _NOT_READ:
            return module, module.__name__
        place = module, names, instead is None
        if place not in self._read:
            self._read[place] = module, "itself"
            used = self._used(names, vars(module), instead)
            twin = ModuleType(module.__name__)
            vars(twin).update({name: value for name, (value, _) in used.items()})
            self._read[place] = twin, repr([(name, text) for name, (_, text) in used.items()])
        return self._read[place]


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


@cache
def _told(code: CodeType) -> str:
    """All of a code that counts: not its file and lines."""
    constants = [_told(one) if isinstance(one, CodeType) else repr(one) for one in code.co_consts]
    counts = code.co_argcount, code.co_posonlyargcount, code.co_kwonlyargcount, code.co_flags
    variables = code.co_varnames, code.co_cellvars, code.co_freevars
    return repr((code.co_code, code.co_exceptiontable, code.co_names, variables, counts, constants))


def _is_ours(kind: type) -> bool:
    """Whether a class is what stands under its name in this package."""
    home = vars(sys.modules.get(kind.__module__, ModuleType("")))
    return _root(home) == _OWN and home.get(kind.__qualname__) is kind


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
        for old in sorted(place.glob("compiled-*"), key=lambda folder: folder.stat().st_mtime)[:-_KEPT]:
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
