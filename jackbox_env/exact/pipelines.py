"""Numba's compiler as this package needs it: inner functions without machine code, and machine code that is freed."""

from __future__ import annotations

import itertools
from typing import Any

from llvmlite.binding import ffi, newpassmanagers  # type: ignore[import-untyped]
from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
from numba.core.compiler import Compiler
from numba.core.compiler_lock import global_compiler_lock

_numbers = itertools.count()

# Since llvmlite 0.45 an empty method of another base class hides the one that frees a pass manager. Each has 30 kB, and
# numba makes one for each function in what it compiles: about 2 MB for a user's task.
for _kind in newpassmanagers.ModulePassManager, newpassmanagers.FunctionPassManager:
    if _kind._dispose is ffi.ObjectRef._dispose:
        _kind._dispose = newpassmanagers.NewPassManager._dispose


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


class InnerCompiler(Compiler):
    """Emits no machine code, which only entry points need.

    Numba would optimize and emit each function together with its callees, at every level of calls again.
    """

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        library = _IntermediateCode(target.codegen(), f"inner{next(_numbers)}")  # type: ignore[no-untyped-call]
        library.enable_object_caching()
        super().__init__(typing, target, library, *rest)  # type: ignore[no-untyped-call]


class FreedCompiler(Compiler):
    """Emits machine code that is freed with the function, in an engine of its own; numba's one engine frees none."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        name = f"freed{next(_numbers)}"
        library = JITCPUCodegen(name).create_library(name)  # type: ignore[no-untyped-call]
        super().__init__(typing, target, library, *rest)  # type: ignore[no-untyped-call]
