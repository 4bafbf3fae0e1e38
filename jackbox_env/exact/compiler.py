"""Plain functions, compiled by numba together with the plain functions that they call.

The functions stay plain Python where they are written: readable, importable without numba, and testable without it.
Compiled functions of this package are kept on disk for later processes (``kept.py``). Those compiled for a user's task,
or with a substitution for a comparison, live as long as their process needs them.

The loops call a task's compiled functions by their address, so they are compiled once for all tasks. Numba can hand a
compiled function to another one, but looks its address up in Python at each call, which takes longer than a step of a
small batch. Here it is looked up once and handed on as a number.
"""

from __future__ import annotations

import contextlib
import hashlib
import inspect
import itertools
import os
import shutil
import sys
import threading
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from types import CellType, CodeType, FunctionType, ModuleType
from typing import Any, TypeVar, cast

import numpy as np

from jackbox_env.scene import Scene
from jackbox_env.states import State

PACKAGE = Path(__file__).parents[1]
F = TypeVar("F", bound=Callable[..., Any])
T = TypeVar("T")
Instead = tuple[tuple[str, Any], ...]  # names, each with what to use in its place
_LOCK = threading.RLock()  # a function is compiled once, whichever threads ask for it
_NOT_READ = {"numba", "numpy", *sys.stdlib_module_names}  # numba knows these functions, or refuses them
_MOST_FOLDERS = 8  # of compiled code, one for each version of the source
_numbers = itertools.count()


def compiled(function: F, **instead: Callable[..., Any]) -> F:
    """Return ``function`` compiled, without the global interpreter lock, kept on disk for later processes.

    Arithmetic is IEEE float64 in the order written, so every caller gets the same bits; a division by zero gives an
    infinity.

    Args:
        function: a plain function of this package.
        **instead: functions of this package to call in place of those of these names.
    """
    return cast(F, _compiled_once(function, tuple(instead.items()), True))


def compiled_with(function: F, **instead: Any) -> F:
    """Return ``function`` compiled with other functions or constants in place of those of these names, for comparisons.

    Not kept on disk.
    """
    return cast(F, _compiled_once(function, tuple(instead.items()), False))


def compiled_for_users(function: F, **instead: Callable[..., Any]) -> F:
    """Return ``function`` compiled with functions of a user's in place of those of these names, read as they are now.

    A division by zero raises ZeroDivisionError in them, as in Python. Not kept on disk.
    """
    with _LOCK:
        return cast(F, _Compilation(tuple(instead.items()), users=True).compiled(function))


def returned_by(function: Callable[..., Any]) -> Any:
    """Numba's type of what the function of a user's task returns.

    Raises:
        Exception: numba cannot compile it.
    """
    from numba import typeof, types

    number, scene = types.float64, typeof(Scene().numbers)  # type: ignore[no-untyped-call]
    arguments = scene, types.NamedUniTuple(number, 12, State), number, number  # type: ignore[no-untyped-call]
    inspect.signature(function).bind(*arguments)  # refuses in fewer words than numba
    dispatcher = _Compilation((), users=True).compiled(function, inner=True)
    dispatcher.get_call_template(arguments, {})
    return dispatcher.nopython_signatures[0].return_type


@cache
def _compiled_once(function: Callable[..., Any], instead: Instead, keep: bool) -> Any:
    with _LOCK:
        return _compilation(instead, keep).compiled(function)


class _Compilation:
    """Compiles functions of this package and what they call, with other functions or constants in place of some.

    Numba makes symbols of the functions' names, and finds machine code by its symbol. So each name is unique: that of
    the function in this package, with a label for the substitutions that reach it. All compilations share the others.

    Args:
        instead: names of globals of functions of this package, each with what to use in its place.
        keep: whether to keep the code on disk. What is in the place of others is then of this package too.
        users: whether functions from elsewhere are a user's.
    """

    def __init__(self, instead: Instead, keep: bool = False, users: bool = False) -> None:
        self._instead, self._keep, self._users = dict(instead), keep, users
        self._label = "".join(f"[{name}={_name(by)}]" for name, by in instead) if keep else f"[{next(_numbers)}]"
        self._made: dict[tuple[Any, bool], Any] = {}

    def compiled(self, function: Any, inner: bool = False) -> Any:
        """A function compiled; ``inner`` if only compiled code calls it."""
        foreign, names = _root(function.__globals__) != _root(globals()), _names(function.__code__)
        if self._instead and not foreign and _reach(function).isdisjoint(self._instead):
            return _compilation((), True).compiled(function, inner)
        if (function, inner) not in self._made:
            self._made[function, inner] = function  # numba refuses a function that calls itself
            known = self._known(names, function.__globals__ if foreign else {**function.__globals__, **self._instead})
            cells = tuple(CellType(self._value(cell.cell_contents, names)) for cell in function.__closure__ or ())
            twin = FunctionType(function.__code__, known, function.__name__, function.__defaults__, cells)
            twin.__module__ = function.__module__
            twin.__qualname__ = f"{_name(function)}{'()' if inner else ''}{self._label}"
            self._made[function, inner] = _jitted(twin, inner, foreign and self._users, self._keep and not inner)
        return self._made[function, inner]

    def _known(self, names: set[str], given: Mapping[str, Any]) -> dict[str, Any]:
        """The globals, or a module's attributes, of these names, as compiled code uses them."""
        return {name: self._value(given[name], names) for name in names if name in given}

    def _value(self, value: Any, names: set[str]) -> Any:
        """What stands in compiled code for a value that a function uses, which uses attributes of these names."""
        if isinstance(value, FunctionType) and (native := _native(value)) is not None:
            return native
        if isinstance(value, FunctionType) and _root(value.__globals__) not in _NOT_READ:
            return self.compiled(value, inner=True)
        if isinstance(value, ModuleType) and _root(vars(value)) not in _NOT_READ:
            twin = ModuleType(value.__name__)
            vars(twin).update(self._known(names, vars(value)))
            return twin
        return value


_compilation = cache(_Compilation)


def _jitted(twin: FunctionType, inner: bool, checked: bool, keep: bool) -> Any:
    from numba import config, njit

    from jackbox_env.exact.kept import CodeCache

    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return twin if inner else np.errstate(all="ignore")(twin)  # compiled integers wrap around in silence
    # Without the runtime that counts references to arrays: nothing compiled here makes an array, and counting took
    # two thirds of a step. And without ways in from Python for what only compiled code calls: a third of the time to
    # compile goes into them.
    dispatcher = cast(Any, njit)(
        nogil=True, error_model="python" if checked else "numpy", _nrt=False,
        no_cpython_wrapper=inner, no_cfunc_wrapper=inner, pipeline_class=_pipeline(inner),
    )(twin)  # fmt: skip
    if keep:  # where njit(cache=True) puts numba's own
        dispatcher._cache = CodeCache(twin, cache_folders(), PACKAGE / "compiled" / "shipped" / _folder_name())
    return dispatcher


@cache
def _pipeline(inner: bool) -> Any:
    """Numba's compiler; for ``inner`` functions without machine code, which is made of whole entries only.

    Numba would optimize and emit each function with all that it calls, at every level of calls again.
    """
    from numba.core.codegen import JITCodeLibrary
    from numba.core.compiler import Compiler

    class NoEnvironment:
        @staticmethod
        def set_env(name: str, environment: Any) -> None:
            pass

    class IntermediateCode(JITCodeLibrary):
        def _optimize_final_module(self) -> None:
            pass

        def _finalize_final_module(self) -> None:
            self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
            self._verify_declare_only_symbols()  # type: ignore[no-untyped-call]
            self._finalized = True

        def get_pointer_to_function(self, name: str) -> int:
            return 0

        @property
        def codegen(self) -> Any:
            return NoEnvironment

    class InnerCompiler(Compiler):
        def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
            library = IntermediateCode(target.codegen(), f"inner{next(_numbers)}")  # type: ignore[no-untyped-call]
            library.enable_object_caching()
            super().__init__(typing, target, library, *rest)  # type: ignore[no-untyped-call]

    return InnerCompiler if inner else Compiler


def _names(code: CodeType) -> set[str]:
    """The names that code uses of globals and of attributes, that of functions within it included."""
    inner = (_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


@cache
def _reach(function: FunctionType) -> set[str]:
    """The names that a function of this package uses, and those of this package that it calls."""
    names = _names(function.__code__)
    used = [one for one in map(function.__globals__.get, names) if isinstance(one, FunctionType)]
    return names.union(*(_reach(one) for one in used if _root(one.__globals__) == _root(globals())))


def _name(function: Callable[..., Any]) -> str:
    return f"{function.__module__}.{function.__qualname__}"


def _root(named: Mapping[str, Any]) -> str:
    """The package or module of a function's globals, or of a module's."""
    return str(named.get("__name__")).split(".")[0]


@cache
def _folder_name(package: Path = PACKAGE) -> str:
    """Of compiled code, by the package's whole source: the kept code of a function includes what it calls elsewhere."""
    sources = (source.read_bytes() for source in sorted(package.rglob("*.py")))
    return f"compiled-{hashlib.sha256(b''.join(sources)).hexdigest()[:16]}"


def _tidy(place: Path) -> None:
    """Remove code that was compiled from old versions of the source."""
    with contextlib.suppress(OSError):  # another process may be tidying too
        for old in sorted(place.glob("compiled-*"), key=lambda folder: folder.stat().st_mtime)[:-_MOST_FOLDERS]:
            shutil.rmtree(old, ignore_errors=True)


def cache_folders() -> list[Path]:
    """Folders to look for compiled code in, one in each place. It is saved in the last: no other can be written."""
    home = os.environ.get("XDG_CACHE_HOME") or os.path.expanduser("~/.cache")
    places, found = [os.environ.get("NUMBA_CACHE_DIR"), PACKAGE / "__pycache__", Path(home, "jackbox")], list[Path]()
    for place in (Path(place).absolute() for place in places if place):  # the process may change its folder
        folder = place / _folder_name()
        with contextlib.suppress(OSError):
            if not folder.is_dir():
                folder.mkdir(parents=True, exist_ok=True)
                _tidy(place)
            found.append(folder)
            if os.access(folder, os.W_OK):
                break
    return found or [folder]


def block_score(address: Any) -> Callable[..., int]:
    """The function at an address, with the arguments of ``score.score_block``.

    Compiled code takes a number here. Uncompiled, the function itself is handed in.
    """
    return cast(Callable[..., int], address)


_SCORE = "i8(f8[:, ::1], f8[:, ::1], f8[:, ::1], f8[::1], i8, i8, f8[::1], b1[::1], f8[:, ::1])"  # score_block's
PACKED = 512  # float64 numbers that have room for the arguments of ``run.run``


def packed(memory: Any, value: T) -> T:
    """Store a value in ``memory``, shape (PACKED,), and return the address; uncompiled, the value itself.

    To pass an address to compiled code takes less time than to pass 30 arrays. The arrays must live as long.
    """
    return value


def unpacked_as(example: Callable[[], T]) -> Callable[[Any], T]:
    """A function that returns the value of an address from :func:`packed`, of the type of ``example()``."""

    def unpacked(place: Any) -> T:
        return cast(T, place)

    _EXAMPLES[unpacked] = example
    return unpacked


_EXAMPLES: dict[Callable[..., Any], Callable[[], Any]] = {}


def _native(function: Any) -> Any:
    """The compiled counterpart of :func:`block_score`, :func:`packed` or a function of :func:`unpacked_as`, or None."""
    known = function in (block_score, packed) or function in _EXAMPLES
    return _native_once(function) if known else None


@cache
def _native_once(function: Any) -> Any:
    """Itself under NUMBA_DISABLE_JIT."""
    from numba import config, typeof, types
    from numba.core import cgutils, sigutils
    from numba.core.errors import TypingError
    from numba.core.typing.templates import Signature
    from numba.extending import intrinsic

    if config.DISABLE_JIT:  # type: ignore[attr-defined]
        return function

    @intrinsic
    def store(typing: Any, memory: Any, value: Any) -> Any:
        if value not in [typeof(made()) for made in _EXAMPLES.values()]:  # type: ignore[no-untyped-call]
            raise TypingError(f"packed: {value} is of no type that is unpacked")  # it would be read as something else

        def generate(context: Any, builder: Any, signature: Signature, given: Any) -> Any:
            if context.get_abi_sizeof(given[1].type) > 8 * PACKED:
                raise ValueError(f"{value} has no room in {PACKED} numbers")
            place = context.make_array(memory)(context, builder, given[0]).data
            builder.store(given[1], builder.bitcast(place, given[1].type.as_pointer()))
            return builder.ptrtoint(place, context.get_value_type(types.int64))

        return types.int64(memory, value), generate

    if function is packed:
        return store
    if function is block_score:
        arguments, result = sigutils.normalize_signature(_SCORE)  # type: ignore[no-untyped-call]
        kind: Any = types.FunctionType(result(*arguments))
    else:
        kind = typeof(_EXAMPLES[function]())  # type: ignore[no-untyped-call]

    @intrinsic
    def load(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, _: Any, given: Any) -> Any:
            if function is not block_score:
                return builder.load(builder.inttoptr(given[0], context.get_value_type(kind).as_pointer()))
            called = cgutils.create_struct_proxy(kind)(context, builder)  # type: ignore[no-untyped-call]
            # Numba's own way to call, in which errors come back. Its other two addresses stay 0.
            called.jit_addr = builder.inttoptr(given[0], cgutils.voidptr_t)
            return called._getvalue()

        return kind(types.int64), generate

    return load


def address_of(dispatcher: Any) -> int:
    """Where a task's compiled ``score_block`` lies; it lies there as long as the dispatcher lives.

    Uncompiled, the function itself is handed on. None lies at 0 and is never called. The dispatcher keeps the result,
    because numba finds it under a lock, for which a forked child waits for ever if another thread held it at the fork.
    """
    if dispatcher is None or isinstance(dispatcher, FunctionType):
        return cast(int, dispatcher or 0)
    if not hasattr(dispatcher, "address"):
        dispatcher.compile(_SCORE)
        (made,) = dispatcher.overloads.values()
        dispatcher.address = made.library.get_pointer_to_function(made.fndesc.llvm_func_name)
    return cast(int, dispatcher.address)
