"""Compiles plain functions for WebAssembly, with numba.

Numba's lowering and LLVM's passes stay as they are; only the machine differs. LLVM's object file is itself a module
that browsers load once its functions name their exports. Nothing has to be linked, because numba puts all that a
function calls into its own module. Arithmetic is IEEE float64 in the order written, as on the machines of
:mod:`jackbox_env.exact`, so a browser gets the same bits.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any, NamedTuple

import llvmlite.binding as llvm  # type: ignore[import-untyped]
from numba.core import codegen, cpu
from numba.core.registry import cpu_target

from jackbox_env.jit.compiler import intermediate_code

TRIPLE = "wasm32-unknown-unknown"


class Export(NamedTuple):
    """An exported function: the function, numba's types of its arguments, and substitutes for what it calls."""

    function: Callable[..., Any]
    arguments: tuple[Any, ...]
    substitutes: Mapping[str, Callable[..., Any]] = {}


class _Codegen(codegen.AOTCPUCodegen):
    """LLVM's modules and passes for this machine."""

    def _init(self, llvm_module: Any) -> None:
        llvm.initialize_all_targets()
        llvm.initialize_all_asmprinters()
        target = llvm.Target.from_triple(TRIPLE)
        self._tm_features = "+bulk-memory"
        self._tm = target.create_target_machine(opt=3, features=self._tm_features, reloc="static", codemodel="small")
        self._target_data = self._tm.target_data
        self._data_layout = str(self._target_data)
        self._loopvect, self._opt_level = False, 0

    def _create_empty_module(self, name: str) -> Any:
        module = super()._create_empty_module(name)  # type: ignore[no-untyped-call]
        module.triple = TRIPLE
        return module

    @property
    def target_data(self) -> Any:
        return self._target_data


class _Context(cpu.CPUContext):
    """Numba's lowering for this machine: integers keep 64 bits, pointers have 32."""

    def init(self) -> None:
        self.is32bit = False
        self._internal_codegen: Any = _Codegen("wasm")  # type: ignore[no-untyped-call]

    def get_executable(self, library: Any, fndesc: Any, env: Any) -> Any:
        return [library].append  # numba wants a builtin function, another one each time


def compile_for_webassembly() -> None:
    """Let numba compile for WebAssembly in this process from now on; nothing that it compiles can then be called.

    Raises:
        RuntimeError: numba has compiled for this machine before.
    """
    if "_toplevel_target_context" in vars(cpu_target):
        raise RuntimeError("numba has compiled for this machine already: begin in a fresh process")
    vars(cpu_target)["_toplevel_target_context"] = _Context(  # type: ignore[no-untyped-call]
        cpu_target.typing_context, "cpu"
    )


def module_of(exports: Mapping[str, Export]) -> bytes:
    """A WebAssembly module that exports these functions by name."""
    linked = llvm.parse_assembly("")
    for name, export in exports.items():
        code, function = intermediate_code(export.function, export.arguments, **export.substitutes)
        module = llvm.parse_assembly(code)
        module.get_function(function).name = name
        for variable in module.global_variables:
            if not variable.is_declaration:
                variable.linkage = "internal"
        linked.link_in(module)
    for function in linked.functions:
        if not function.is_declaration and function.name not in exports:
            function.linkage = "internal"
    machine = cpu_target.target_context.codegen()._tm
    builder = llvm.create_pass_builder(machine, llvm.create_pipeline_tuning_options(speed_level=2))
    builder.getModulePassManager().run(linked, builder)
    text = str(linked)
    for name in exports:
        text, count = re.subn(rf"^(define .*@{name}\(.*)\{{$", rf'\1"wasm-export-name"="{name}" {{', text, flags=re.M)
        assert count == 1, name
    emitted: bytes = machine.emit_object(llvm.parse_assembly(text))
    return emitted[:8] + b"".join(emitted[first:last] for kind, first, last in _sections(emitted) if kind)


def _sections(module: bytes) -> Iterator[tuple[int, int, int]]:
    """Kind, begin and end of each section; those of kind 0 are for linkers."""
    position = 8
    while position < len(module):
        begin, size, shift = position, 0, 0
        position += 1
        while True:  # LEB128
            size |= (module[position] & 127) << shift
            position, shift, more = position + 1, shift + 7, module[position] & 128
            if not more:
                break
        position += size
        yield module[begin], begin, position
