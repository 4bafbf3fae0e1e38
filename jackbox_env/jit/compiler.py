"""Compiles plain functions with numba, together with the plain functions that they call.

The functions stay plain Python where they are written: readable, importable and testable without numba.
Compiled functions of this package are stored on disk for later processes (``code_cache.py``). Those compiled for a
user's task, or with a substitute for a comparison, are freed once nothing refers to them (``pipelines.py``).

The loop of ``run.py`` calls compiled functions of tasks, observations and actions by their address, so it is compiled
once for all of them. Numba can pass a compiled function to another one, but looks up its address in Python at each
call, which takes longer than a step of a small batch. Here the address is looked up once and passed as a number.
"""

from __future__ import annotations

import builtins
import itertools
import math
import sys
import threading
from collections.abc import Callable, Mapping
from functools import cache
from types import CellType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

import numpy as np

from jackbox_env.jit.folders import HASHED, cache_folders, shipped_folder
from jackbox_env.jit.names import full_name, is_foreign, reachable_names, top_level, used_names
from jackbox_env.model.scene import Scene
from jackbox_env.model.states import State
from jackbox_env.tools.signals import uninterrupted

F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")
Substitutes = tuple[tuple[str, Any], ...]  # names of globals, each with its substitute
_LOCK = threading.RLock()  # a function is compiled once, also if several threads need it
_KNOWN_TO_NUMBA = {"numba", "numpy", *sys.stdlib_module_names}  # packages whose functions numba knows or refuses
_numbers = itertools.count()


def compiled(function: F, **substitutes: Callable[..., Any]) -> F:
    """Return ``function`` compiled, without the global interpreter lock, and stored on disk for later processes.

    Arithmetic is IEEE float64 in the order written, so every caller gets the same bits; a division by zero gives an
    infinity.

    Args:
        function: a plain function of this package.
        **substitutes: functions of this package that replace those of these names.
    """
    return cast(F, _compiled_once(function, tuple(substitutes.items()), True))


def compiled_with(function: F, **substitutes: Any) -> F:
    """Return ``function`` compiled with substitutes for the functions or constants of these names, for comparisons.

    Not stored on disk.
    """
    return cast(F, _compiled_once(function, tuple(substitutes.items()), False))


def intermediate_code(
    function: Callable[..., Any], arguments: tuple[Any, ...], **substitutes: Callable[..., Any]
) -> tuple[str, str]:
    """LLVM's code of a function with all that it calls, before LLVM's passes, and the function's name in it.

    Args:
        function: a plain function.
        arguments: numba's types of them.
        **substitutes: functions that replace those of these names.
    """
    return _Compilation(tuple(substitutes.items())).intermediate_code(function, arguments)


def kinds_of(values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Numba's types of values."""
    return tuple(map(_native().typeof, values))


@cache
def _native() -> ModuleType:
    """The module that imports numba, without interruption: a second import of what is half imported fails.

    Raises:
        ImportError: there is no numba.
    """
    with uninterrupted():
        try:
            from jackbox_env.jit import pipelines
        except ModuleNotFoundError as error:
            raise ImportError(
                'the exact model, fidelity="exact", and pictures as observations need numba, which CPython 3.11 to '
                f'3.14 have: there is no {error.name}; fidelity="balanced" needs none'
            ) from error
    return pipelines


def is_disabled() -> bool:
    """Whether ``NUMBA_DISABLE_JIT`` leaves all functions as they are."""
    return bool(_native().numba.config.DISABLE_JIT)


def inlined(function: F) -> F:
    """Mark a function that is compiled into each of its callers: faster than passing many numbers to it and back."""
    _INLINED.add(function)
    return function


_INLINED: set[Callable[..., Any]] = set()


@cache
def _compiled_once(function: Callable[..., Any], substitutes: Substitutes, on_disk: bool) -> Any:
    for one in (function, *dict(substitutes).values()) if on_disk else ():
        if not f"{one.__module__.partition('.')[2].replace('.', '/')}.py".startswith(HASHED):
            raise ValueError(f"code of {full_name(one)} cannot be stored: the hash of the source leaves its file out")
    with _LOCK, uninterrupted():
        return _compilation(substitutes, on_disk).compiled(function)


class _Compilation:
    """Compiles functions of this package and those they call, with substitutes for some functions or constants.

    Numba names machine code after the function, so each name must be unique: that of the function in this package, with
    a label if it uses a substitute. Functions without substitutes are shared by all compilations.

    Args:
        substitutes: names of globals of functions of this package, each with its substitute.
        on_disk: whether to store the code on disk. Substitutes then are of this package too.
        users: whether functions from elsewhere are a user's.
    """

    def __init__(self, substitutes: Substitutes, on_disk: bool = False, users: bool = False) -> None:
        self._substitutes, self._on_disk, self._users = dict(substitutes), on_disk, users
        self._label = (
            "".join(f"[{name}={full_name(by)}]" for name, by in substitutes) if on_disk else f"[{next(_numbers)}]"
        )
        self._twins: dict[tuple[Any, bool], Any] = {}

    def compiled(self, function: Any, inner: bool = False) -> Any:
        """The compiled function; ``inner`` if only compiled code calls it."""
        foreign, names = is_foreign(function), used_names(function.__code__)
        if (
            (self._substitutes or self._users)
            and not foreign
            and reachable_names(function).isdisjoint(self._substitutes)
        ):
            return _compilation((), True).compiled(function, inner)
        if (function, inner) not in self._twins:
            self._twins[function, inner] = function
            try:
                self._twins[function, inner] = self._twin(function, inner, foreign, names)
            except BaseException:
                del self._twins[function, inner]
                raise
        elif self._twins[function, inner] is function and not is_disabled():
            raise TypeError(f"{function.__name__} calls itself")
        return self._twins[function, inner]

    def intermediate_code(self, function: Any, arguments: tuple[Any, ...]) -> tuple[str, str]:
        """LLVM's code of a function and its name there: :func:`intermediate_code`."""
        with _LOCK, uninterrupted():
            result = _native().compiled_at(self.compiled(function, inner=True), arguments)
            return _native().unoptimized(result.library), result.fndesc.llvm_func_name

    def _twin(self, function: Any, inner: bool, foreign: bool, names: set[str]) -> Any:
        """The function compiled, which uses these ``names`` and is ``foreign`` if it is not of this package."""
        if function.__code__.co_kwonlyargcount:
            raise TypeError(f"{function.__name__} has arguments by keyword only")
        namespace = function.__globals__ if foreign else {**function.__globals__, **self._substitutes}
        known = self._counterparts(names, namespace)
        cells = tuple(CellType(self._counterpart(cell.cell_contents, names)) for cell in function.__closure__ or ())
        defaults = tuple(map(_signed, map(_copied, function.__defaults__ or ())))
        twin = FunctionType(function.__code__, known, function.__name__, defaults, cells)
        twin.__module__ = function.__module__ or "__main__"  # exec makes functions without a module
        twin.__qualname__ = f"{full_name(function)}{'()' if inner else ''}{self._label}"
        inline, checked = inner and function in _INLINED, foreign and self._users
        return _jitted(twin, inner, inline, checked, self._on_disk and not inner)

    def _counterparts(self, names: set[str], values: Mapping[str, Any]) -> dict[str, Any]:
        """The globals, or a module's attributes, of these names, as their counterparts in compiled code."""
        return {name: self._counterpart(values[name], names) for name in names if name in values}

    def _counterpart(self, value: Any, names: set[str]) -> Any:
        """The counterpart in compiled code of a global or cell; ``names`` are the attributes that the function uses."""
        value = getattr(value, "py_func", value)  # a user's function of numba's is compiled with checks like the others
        if isinstance(value, FunctionType) and (native := _intrinsic(value)) is not None:
            return native
        if isinstance(value, FunctionType) and top_level(value.__globals__) not in _KNOWN_TO_NUMBA:
            return self.compiled(value, inner=True)
        if isinstance(value, ModuleType) and top_level(vars(value)) not in _KNOWN_TO_NUMBA:
            twin = ModuleType(value.__name__)
            vars(twin).update(self._counterparts(names, vars(value)))
            return twin
        return _copied(value)


_compilation = cache(_Compilation)


class UsersFunctions(_Compilation):
    """Compiles functions of this package with a user's functions, each of which it reads once.

    In those a division by zero raises ZeroDivisionError, and an index past the end IndexError, as in Python. Nothing is
    stored on disk.

    Args:
        substitutes: function of this object that returns the user's functions, with those that they replace by name.
    """

    def __init__(self, substitutes: Callable[[UsersFunctions], dict[str, Any]]) -> None:
        super().__init__((), users=True)
        self.entries: dict[Callable[..., Any], Any] = {}
        self._substitutes = substitutes(self)

    def entry(self, function: F) -> F:
        """A function of this package, compiled."""
        if function not in self.entries:
            with _LOCK, uninterrupted():
                self.entries[function] = self.compiled(function)
        return cast(F, self.entries[function])

    def besides(self, substitutes: dict[str, Any], *others: UsersFunctions) -> UsersFunctions:
        """A copy with further substitutes, and with those of others; the users' functions are not read again."""
        parts = [self, *others]
        joined = UsersFunctions(lambda _: {k: v for one in parts for k, v in one._substitutes.items()} | substitutes)
        joined._twins = {key: twin for one in parts for key, twin in one._twins.items() if is_foreign(key[0])}
        return joined

    def returned_by(self, function: Callable[..., Any], further: tuple[Any, ...]) -> tuple[Any, str]:
        """The type that a user's function of scene, state and ``further`` arguments returns, and numba's name of it.

        The type is ``bool``, ``float`` for another real number, ``(float, float)`` for two numbers, or None.

        Raises:
            Exception: numba cannot compile it.
        """
        native = _native()
        types, arguments = native.types, kinds_of((Scene().numbers, State(*[0.0] * 12), *further))
        with _LOCK, uninterrupted():
            returned = native.return_type(self.compiled(function, inner=True), arguments)
        kinds = tuple(returned) if isinstance(returned, types.BaseTuple) else (returned,)
        if not all(isinstance(kind, types.Float | types.Integer | types.Boolean) for kind in kinds):
            return None, str(returned)
        if isinstance(returned, types.BaseTuple):
            return (float,) * len(kinds), str(returned)
        return bool if isinstance(returned, types.Boolean) else float, str(returned)


def _copied(value: Any) -> Any:
    """A value as it is now: its arrays are copied, read-only as numba's constants are."""
    if isinstance(value, np.ndarray):
        value = value.copy()
        value.flags.writeable = False
    elif isinstance(value, tuple):
        return tuple.__new__(type(value), map(_copied, value))
    return value


class _MinusZero(float):
    """-0.0, but not equal to 0.0: numba takes equal defaults of arguments for one, whatever function has them."""

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _MinusZero)

    def __hash__(self) -> int:
        return hash("-0.0")


def _signed(default: Any) -> Any:
    """A default of an argument, in which -0.0 differs from 0.0."""
    if type(default) is tuple:
        return tuple(map(_signed, default))
    minus_zero = isinstance(default, float) and default == 0.0 and math.copysign(1.0, default) < 0.0
    return _MinusZero(default) if minus_zero else default


def _jitted(twin: FunctionType, inner: bool, inline: bool, checked: bool, on_disk: bool) -> Any:
    if is_disabled():
        twin.__globals__["__builtins__"] = builtins  # numpy imports ctypes in the function that asks for an address
        return twin if inner else np.errstate(all="ignore")(twin)  # compiled integers wrap around in silence
    from jackbox_env.jit.code_cache import CodeCache, warn_once

    native = _native()
    if native.LACKING:
        warn_once(
            f"the exact model is compiled more slowly, and anew in each process, without {native.LACKING[0]}, which "
            "numba 0.61 to 0.69 have"
        )
    dispatcher = native.jitted(twin, inner, inline, checked, on_disk)
    if on_disk and not native.LACKING:
        native.set_cache(dispatcher, CodeCache(twin, cache_folders(), shipped_folder()))
    return dispatcher


def called_at(signature: Callable[[Any], Any]) -> Callable[[Any], Callable[..., int]]:
    """A function that returns the function at an address of :func:`address_of`; ``signature`` is one of numba's types.

    Uncompiled, the address is the function itself.
    """

    def function_at(address: Any) -> Callable[..., int]:
        return cast(Callable[..., int], address)

    _SIGNATURES[function_at] = lambda: signature(_native().types)
    return function_at


PACKED = 512  # float64 numbers, enough memory for the arguments of ``run.run``


def packed(address: Any, value: T) -> T:
    """Store a value at the address of an array, shape (PACKED,), and return it; uncompiled, the value itself.

    Passing an address to compiled code takes less time than passing 30 arrays. The arrays must live as long.
    """
    return value


def called_later(function: Callable[[], F], example: Callable[[], tuple[Any, ...]]) -> Callable[[Any], F]:
    """A :func:`called_at` for a function of this package that may be compiled later than those that call it.

    Uncompiled, the function is called, whatever the address.

    Args:
        function: returns the plain function.
        example: returns a value that it returns, and arguments of it.
    """

    def function_at(_address: Any) -> F:
        return function()

    def signature() -> Any:
        result, *arguments = kinds_of(example())
        return result(*arguments)

    _SIGNATURES[function_at] = signature
    return function_at


_SIGNATURES: dict[Callable[..., Any], Callable[[], Any]] = {}  # return numba's signatures


def is_compiled(_address: Any) -> bool:
    """Whether there is a function at an address of :func:`called_later`; True if nothing is compiled."""
    return True


def numbers_in(values: Any) -> Any:
    """A number, or those of a tuple, as an array of float64 that lasts as long as the function that calls this."""
    return np.array(values, dtype=np.float64, ndmin=1)


def unpacked_as(example: Callable[[], T]) -> Callable[[Any], T]:
    """A function that returns the value of an address from :func:`packed`, of the type of ``example()``."""

    def unpacked(address: Any) -> T:
        return cast(T, address)

    _EXAMPLES[unpacked] = example
    return unpacked


_EXAMPLES: dict[Callable[..., Any], Callable[[], Any]] = {}


def _intrinsic(function: Any) -> Any:
    """The compiled counterpart of a function that only compiled code can have, or None."""
    known = function in (packed, is_compiled, numbers_in) or function in _EXAMPLES or function in _SIGNATURES
    return _make_intrinsic(function) if known else None


@cache
def _make_intrinsic(function: Any) -> Any:
    """Itself under NUMBA_DISABLE_JIT."""
    if is_disabled():
        return function
    if function is is_compiled:
        return bool
    native = _native()
    if function is numbers_in:
        return native.numbers_on_stack
    if function is packed:
        return native.stored_at(lambda: [made() for made in _EXAMPLES.values()])
    if function in _SIGNATURES:
        return native.loaded_from(native.types.FunctionType(_SIGNATURES[function]()))
    return native.loaded_from(native.typeof(_EXAMPLES[function]()))


def address_of(dispatcher: Any, function_at: Callable[[Any], Any]) -> int:
    """The address of a compiled function for ``function_at``, valid as long as the dispatcher lives; 0 for None.

    Uncompiled, the function itself. The dispatcher stores the result, because numba looks it up under a lock: a forked
    child would wait for ever if another thread had the lock at the fork.
    """
    if dispatcher is None or isinstance(dispatcher, FunctionType):
        return cast(int, dispatcher or 0)
    if not hasattr(dispatcher, "address"):
        native = _native()
        dispatcher.address = native.address_in(native.compiled_at(dispatcher, _SIGNATURES[function_at]()))
    return cast(int, dispatcher.address)
