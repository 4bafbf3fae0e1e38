"""Numba's compiler as this package needs it: faster, inner functions without machine code, machine code that is freed.

Four fifths of the time to compile go to Python code that derives types and writes LLVM's code. :class:`PackageCompiler`
saves half of it for the functions of this package. Users' functions are compiled by numba's own passes.
"""

from __future__ import annotations

import contextlib
import gc
import itertools
from collections.abc import Iterator
from operator import getitem, setitem
from typing import Any, ClassVar, cast

from llvmlite.binding import ffi, newpassmanagers  # type: ignore[import-untyped]
from numba.core import typed_passes, types, untyped_passes
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock
from numba.core.compiler_machinery import PassManager
from numba.core.errors import TypingError
from numba.core.typing.context import Context

_numbers = itertools.count()

# Since llvmlite 0.45 an empty method of another base class hides the one that frees a pass manager. Each has 30 kB, and
# numba makes one for each function in what it compiles: about 2 MB for a user's task.
for _kind in newpassmanagers.ModulePassManager, newpassmanagers.FunctionPassManager:
    if _kind._dispose is ffi.ObjectRef._dispose:
        _kind._dispose = newpassmanagers.NewPassManager._dispose


# Passes for what no function of this package has: closures, comprehensions, expressions of whole arrays, arguments that
# are None, with-statements, literal_unroll.
_NEEDLESS = {
    untyped_passes.WithLifting, untyped_passes.InlineClosureLikes, untyped_passes.RewriteSemanticConstants,
    untyped_passes.DeadBranchPrune, untyped_passes.RewriteDynamicRaises, untyped_passes.MakeFunctionToJitFunction,
    untyped_passes.InlineInlinables, untyped_passes.FindLiterallyCalls, untyped_passes.LiteralUnroll,
    untyped_passes.LiteralPropagationSubPipelinePass, typed_passes.NopythonRewrites,
}  # fmt: skip


_unliteral: Any = types.unliteral


class _Typing(Context):
    """Numba's types of functions, resolved once for the same types of arguments.

    Numba tries all overloads of an operator at each use of it. And it compiles a function anew for each whole number
    that is a literal argument.
    """

    _resolved: ClassVar[dict[Any, Any]] = {}

    def __init__(self, context: Context) -> None:
        self.__dict__ = vars(context)

    def resolve_function_type(self, function: Any, arguments: Any, keywords: Any) -> Any:
        """Numba's signature of a call of ``function`` with arguments of these types."""
        if isinstance(function, types.Dispatcher):
            arguments = tuple(map(_unliteral, arguments))
            keywords = {name: _unliteral(kind) for name, kind in keywords.items()}
        elif isinstance(function, types.BaseFunction) or function in (getitem, setitem):
            key = function, tuple(arguments), tuple(dict(keywords).items())
            if key not in self._resolved:
                self._resolved[key] = cast(Any, super()).resolve_function_type(function, arguments, keywords)
            return self._resolved[key]
        return cast(Any, super()).resolve_function_type(function, arguments, keywords)


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Without Python's search for cycles, which took a fifth of the time: next to nothing is garbage meanwhile."""
    if not gc.isenabled():
        yield
        return
    gc.disable()
    try:
        yield
    finally:
        gc.enable()


class PackageCompiler(Compiler):
    """Compiles functions of this package in half of numba's time: plain arithmetic and loops need fewer passes.

    All others, a user's, are compiled as numba does.
    """

    def compile_extra(self, function: Any) -> Any:
        """Compile a function."""
        self._plain = function.__module__.startswith("jackbox_env.")
        if self._plain:
            self.state.typingctx = _Typing(self.state.typingctx)
        with _uncollected():
            compiled = super().compile_extra(function)  # type: ignore[no-untyped-call]
        for signature in () if self._plain else self.state.calltypes.values():
            if signature and len(signature.args) > 1 and isinstance(signature.args[0], types.NumpyFlatType):
                raise TypingError("an index of .flat is not checked; use the array's own indices")
        return compiled

    def define_pipelines(self) -> list[PassManager]:
        """Numba's passes, of which functions of this package need only some."""
        (whole,) = super().define_pipelines()  # type: ignore[no-untyped-call]
        if not self._plain:
            return [whole]
        lighter = PassManager(whole.pipeline_name)  # type: ignore[no-untyped-call]
        for one, purpose in whole.passes:
            if one not in _NEEDLESS:
                lighter.add_pass(one, purpose)  # type: ignore[no-untyped-call]
        lighter.finalize()  # type: ignore[no-untyped-call]
        return [lighter]


class _NoEnvironment:
    @staticmethod
    def set_env(name: str, environment: Any) -> None:
        pass


class _IntermediateCode(JITCodeLibrary):
    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()  # type: ignore[no-untyped-call]
        self._verify_declare_only_symbols()  # type: ignore[no-untyped-call]
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    def linked_module(self) -> Any:
        with global_compiler_lock:
            self._ensure_finalized()  # type: ignore[no-untyped-call]
        return self._final_module.clone()

    @property
    def codegen(self) -> Any:
        return _NoEnvironment


class InnerCompiler(PackageCompiler):
    """Emits no machine code, which only entry points need.

    Numba would optimize and emit each function together with its callees, at every level of calls again.
    """

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        library = _IntermediateCode(target.codegen(), f"inner{next(_numbers)}")  # type: ignore[no-untyped-call]
        library.enable_object_caching()
        super().__init__(typing, target, library, *rest)  # type: ignore[no-untyped-call]


class FreedCompiler(PackageCompiler):
    """Emits machine code that is freed with the function, in an engine of its own; numba's one engine frees none."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        name = f"freed{next(_numbers)}"
        library = JITCPUCodegen(name).create_library(name)  # type: ignore[no-untyped-call]
        super().__init__(typing, target, library, *rest)  # type: ignore[no-untyped-call]
