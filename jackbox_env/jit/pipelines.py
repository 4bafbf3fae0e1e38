"""Numba's compiler as this package needs it: faster, inner functions without machine code, machine code that is freed.

Four fifths of the time to compile go to Python code that derives types and writes LLVM's code. :class:`PackageCompiler`
saves half of it for the functions of this package. Users' functions are compiled by numba's own passes.

No other file uses names of numba or llvmlite that their manuals lack. Without one of ``NEEDED`` nothing is compiled.
Without one of ``FASTER`` numba's public ``njit`` compiles the same code, more slowly, anew in each process and never
freed; ``LACKING`` has those names.
"""

from __future__ import annotations

import contextlib
import gc
import inspect
import itertools
import pickle
import pkgutil
from collections.abc import Callable, Iterator
from functools import cache
from operator import getitem, setitem
from types import FunctionType
from typing import TYPE_CHECKING, Any, ClassVar, cast

import numba
from llvmlite import binding as llvm  # type: ignore[import-untyped]
from numba import njit, typeof, types
from numba.core import cgutils
from numba.core.compiler_lock import global_compiler_lock
from numba.extending import intrinsic, overload

from jackbox_env.tools.signals import uninterrupted

# Where a name is, or a function that uses it and the name.
NEEDED = (
    "numba.core.options:DefaultOptions._nrt", "numba.core.dispatcher:_DispatcherBase.get_overload overloads",
    "numba.core.compiler:CompileResult.library", "numba.core.compiler:CompileResult.fndesc",
    "numba.core.compiler:CompileResult.signature", "numba.core.funcdesc:FunctionDescriptor.llvm_func_name",
    "numba.core.codegen:JITCodeLibrary.get_pointer_to_function",
    "numba.experimental.function_type:FunctionModel.__init__ jit_addr",
)  # fmt: skip
FASTER = (
    "llvmlite.binding.ffi:ObjectRef._dispose", "llvmlite.binding.newpassmanagers:ModulePassManager",
    "llvmlite.binding.newpassmanagers:FunctionPassManager",
    "numba.core.codegen:CodeLibrary._ensure_finalized", "numba.core.codegen:CPUCodeLibrary.finalize _final_module",
    "numba.core.caching:NullCache.load_overload", "numba.core.caching:NullCache.save_overload",
    "numba.core.codegen:JITCPUCodegen.create_library", "numba.core.codegen:JITCPUCodegen.magic_tuple",
    "numba.core.codegen:JITCPUCodegen.set_env", "numba.core.codegen:JITCodeLibrary._finalize_dynamic_globals",
    "numba.core.codegen:JITCodeLibrary._finalize_final_module", "numba.core.codegen:JITCodeLibrary._finalized",
    "numba.core.codegen:JITCodeLibrary._optimize_final_module", "numba.core.codegen:JITCodeLibrary.codegen",
    "numba.core.codegen:JITCodeLibrary.has_dynamic_globals", "numba.core.compiler:Compiler.compile_extra",
    "numba.core.compiler:Compiler.define_pipelines", "numba.core.compiler:CompilerBase.__init__ typingctx",
    "numba.core.compiler:CompileResult._rebuild", "numba.core.compiler:CompileResult._reduce",
    "numba.core.compiler:CompileResult.target_context",
    "numba.core.compiler_machinery:PassManager.add_pass", "numba.core.compiler_machinery:PassManager.finalize",
    "numba.core.compiler_machinery:PassManager.__init__ passes",
    "numba.core.compiler_machinery:PassManager.__init__ pipeline_name", "numba.core.cpu:CPUContext.codegen",
    "numba.core.cpu:CPUContext.refresh", "numba.core.dispatcher:Dispatcher.__init__ _cache",
    "numba.core.options:DefaultOptions.forceinline", "numba.core.options:DefaultOptions.no_cfunc_wrapper",
    "numba.core.options:DefaultOptions.no_cpython_wrapper", "numba.core.serialize:dumps",
    "numba.core.types:BaseFunction", "numba.core.types:Dispatcher", "numba.core.types:unliteral",
    "numba.core.typing.context:Context.resolve_function_type",
)  # fmt: skip


def _lacking(names: tuple[str, ...]) -> list[str]:
    """The names among these that the installed numba and llvmlite lack."""
    lacking = []
    for name in names:
        where, _, used = name.partition(" ")
        try:
            code = pkgutil.resolve_name(where)
            if used and used not in (*code.__code__.co_names, *code.__code__.co_consts):
                lacking.append(used)
        except (ImportError, AttributeError):
            lacking.append(where)
    return lacking


for _name in _lacking(NEEDED):
    raise RuntimeError(f"the exact model cannot be compiled without {_name}, which numba 0.61 to 0.69 have")
LACKING = _lacking(FASTER)
if TYPE_CHECKING or not LACKING:
    from llvmlite.binding import ffi, newpassmanagers  # type: ignore[import-untyped]
    from numba.core.caching import NullCache as NullCache
    from numba.core.codegen import JITCodeLibrary, JITCPUCodegen
    from numba.core.compiler import Compiler, CompileResult
    from numba.core.compiler_machinery import PassManager
    from numba.core.serialize import dumps
    from numba.core.typing.context import Context

    # Since llvmlite 0.45 an empty method of another base class hides the one that frees a pass manager. Each has 30 kB,
    # and numba makes one for each function in what it compiles: about 2 MB for a user's task.
    for _kind in newpassmanagers.ModulePassManager, newpassmanagers.FunctionPassManager:
        for _base in _kind.__mro__:
            if "_dispose" in vars(_base) and _base is not ffi.ObjectRef:
                _kind._dispose = _base._dispose
else:  # of what follows, only the functions at the end are used
    Compiler = Context = JITCodeLibrary = JITCPUCodegen = NullCache = object

_numbers = itertools.count()

# Passes for what no function of this package has: closures, comprehensions, expressions of whole arrays, arguments that
# are None, with-statements, literal_unroll.
_NEEDLESS = {
    "WithLifting", "InlineClosureLikes", "RewriteSemanticConstants", "DeadBranchPrune", "RewriteDynamicRaises",
    "MakeFunctionToJitFunction", "InlineInlinables", "FindLiterallyCalls", "LiteralUnroll",
    "LiteralPropagationSubPipelinePass", "NopythonRewrites",
}  # fmt: skip


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
            arguments = tuple(map(cast(Any, types.unliteral), arguments))
            keywords = {name: cast(Any, types.unliteral)(kind) for name, kind in keywords.items()}
        elif isinstance(function, types.BaseFunction) or function in (getitem, setitem):
            key = function, tuple(arguments), tuple(dict(keywords).items())
            if key not in self._resolved:
                self._resolved[key] = cast(Any, super()).resolve_function_type(function, arguments, keywords)
            return self._resolved[key]
        return cast(Any, super()).resolve_function_type(function, arguments, keywords)


@contextlib.contextmanager
def _uncollected() -> Iterator[None]:
    """Pause Python's search for cycles, which took a fifth of the time: next to nothing is garbage meanwhile."""
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
                raise numba.TypingError("an index of .flat is not checked; use the array's own indices")
        return compiled

    def define_pipelines(self) -> list[PassManager]:
        """Numba's passes, of which functions of this package need only some."""
        (whole,) = super().define_pipelines()  # type: ignore[no-untyped-call]
        if not self._plain:
            return [whole]
        lighter = PassManager(whole.pipeline_name)  # type: ignore[no-untyped-call]
        for one, purpose in whole.passes:
            if one.__name__ not in _NEEDLESS:
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
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:
        return 0

    @property
    def codegen(self) -> Any:
        return _NoEnvironment


class InnerCompiler(PackageCompiler):
    """Emits no machine code, which only entry points need.

    Numba would optimize and emit each function together with its callees, at every level of calls again.
    """

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        library = _IntermediateCode(target.codegen(), f"inner{next(_numbers)}")  # type: ignore[no-untyped-call]
        super().__init__(typing, target, library, *rest)  # type: ignore[no-untyped-call]


class FreedCompiler(PackageCompiler):
    """Emits machine code that is freed with the function, in an engine of its own; numba's one engine frees none."""

    def __init__(self, typing: Any, target: Any, library: Any, *rest: Any) -> None:
        name = f"freed{next(_numbers)}"
        library = JITCPUCodegen(name).create_library(name)  # type: ignore[no-untyped-call]
        super().__init__(typing, target, library, *rest)  # type: ignore[no-untyped-call]


def dumped(result: Any) -> bytes | None:
    """The machine code of a result of :func:`compiled_at`, or None if it has addresses of this process."""
    if result.library.has_dynamic_globals:
        return None
    return cast(bytes, dumps(result._reduce()))  # type: ignore[no-untyped-call]


def loaded(code: bytes, context: Any) -> Any:
    """The result whose machine code was :func:`dumped`."""
    return CompileResult._rebuild(context, *pickle.loads(code))  # type: ignore[no-untyped-call]


def unoptimized(library: Any) -> str:
    """LLVM's code of a library and all that it calls, before LLVM's passes."""
    with global_compiler_lock:
        library._ensure_finalized()
    return str(library._final_module)


def optimized(code: str, triple: str, chip: str, features: str, kept: str) -> tuple[Any, Any]:
    """LLVM's module of code, optimized, in which others see the function ``kept`` alone, and its target machine."""
    llvm.initialize_all_targets()
    llvm.initialize_all_asmprinters()
    module = llvm.parse_assembly(code)
    for defined in [*module.functions, *module.global_variables]:
        if not defined.is_declaration and defined.name != kept:
            defined.linkage = "internal"
    machine = llvm.Target.from_triple(triple).create_target_machine(cpu=chip, features=features, opt=3)
    options = llvm.create_pipeline_tuning_options(speed_level=3)
    options.loop_unrolling = False
    builder = llvm.create_pass_builder(machine, options)
    builder.getModulePassManager().run(module, builder)
    return module, machine


def target_of(context: Any) -> tuple[str, str, str]:
    """The triple, CPU and features that code is compiled for."""
    context.refresh()
    return cast("tuple[str, str, str]", context.codegen().magic_tuple())


# -- what is left without FASTER --------------------------------------------------------------------------------------


@cache
def _uncut(kind: Any) -> Any:
    """A class of numba's functions whose compiling is not interrupted, which would leave tables half written."""

    class Uncut(kind):  # type: ignore[misc]
        def compile(self, signature: Any) -> Any:
            """Compile, unless it is compiled for this signature."""
            with uninterrupted():
                return super().compile(signature)

    return Uncut


def jitted(twin: FunctionType, inner: bool, inline: bool, checked: bool, on_disk: bool) -> Any:
    """Numba's object that compiles a function when it is first called.

    Without the runtime that counts references to arrays: nothing compiled here makes an array, and counting took two
    thirds of a step. And without entry points from Python for ``inner`` functions, which only compiled code calls: they
    take a third of the time to compile.
    """
    options: dict[str, Any] = {
        "no_cpython_wrapper": inner, "no_cfunc_wrapper": inner, "forceinline": inline,
        "pipeline_class": InnerCompiler if inner else PackageCompiler if on_disk else FreedCompiler,
    }  # fmt: skip
    dispatcher = cast(Any, njit)(
        nogil=True, error_model="python" if checked else "numpy", boundscheck=checked, _nrt=False,
        **({} if LACKING else options),
    )(twin)  # fmt: skip
    dispatcher.__class__ = _uncut(cast(Any, type(dispatcher)))
    return dispatcher


def set_cache(dispatcher: Any, cached: Any) -> None:
    """Let numba load from this cache before it compiles; njit(cache=True) would set numba's own."""
    dispatcher._cache = cached


def compiled_at(dispatcher: Any, arguments: Any) -> Any:
    """The result of compiling for these types of arguments, or this signature."""
    dispatcher.compile(arguments)
    return dispatcher.overloads[getattr(arguments, "args", arguments)]


def address_in(result: Any) -> int:
    """The address of the machine code of a result, valid as long as its dispatcher lives."""
    return cast(int, result.library.get_pointer_to_function(result.fndesc.llvm_func_name))


def return_type(dispatcher: Any, arguments: tuple[Any, ...]) -> Any:
    """Numba's type of what a function returns for arguments of these types, and its defaults."""
    bound = inspect.signature(dispatcher.py_func).bind(*arguments)  # its error is shorter than numba's
    kinds = list[Any]()
    for name, parameter in bound.signature.parameters.items():
        if parameter.kind is parameter.VAR_POSITIONAL:
            kinds.append(cast(Any, types.StarArgTuple)(bound.arguments.get(name, ())))
        else:
            kinds.append(bound.arguments.get(name) or cast(Any, types.Omitted)(parameter.default))
    return compiled_at(dispatcher, tuple(kinds)).signature.return_type


def stored_at(examples: Callable[[], list[Any]]) -> Any:
    """A compiled function that stores a value, of the type of one of the examples, at an address, and returns it."""

    @intrinsic
    def store(typing: Any, address: Any, value: Any) -> Any:
        if value not in map(cast(Any, typeof), examples()):
            raise numba.TypingError(
                f"packed: {value} is of no type that is unpacked"
            )  # it would be read as something else

        def generate(context: Any, builder: Any, signature: Any, values: Any) -> Any:
            builder.store(values[1], builder.inttoptr(values[0], values[1].type.as_pointer()))
            return builder.bitcast(values[0], context.get_value_type(types.int64))

        return types.int64(address, value), generate

    return store


@overload(float, strict=False)
def _float_of(number: Any) -> Any:
    """The number of a comparison, which numba's ``float`` refuses."""
    return (lambda number: 1.0 if number else 0.0) if isinstance(number, types.Boolean) else None


@intrinsic
def numbers_on_stack(typing: Any, values: Any) -> Any:
    """Compiled, it returns a number, or the numbers of a tuple, as an array of float64 on the stack.

    A loop over an array takes less time to compile than one over a tuple, for which numba writes a case for each item.
    """
    several, kind = isinstance(values, types.BaseTuple), types.Array(types.float64, 1, "C")
    kinds = tuple(values) if several else (values,)

    def generate(context: Any, builder: Any, _: Any, arguments: Any) -> Any:
        tools: Any = cgutils
        count, width = (context.get_constant(types.intp, number) for number in (len(kinds), 8))
        array = tools.create_struct_proxy(kind)(context, builder)
        array.data = tools.alloca_once(builder, context.get_value_type(types.float64), count)
        array.nitems, array.itemsize = count, width
        array.shape, array.strides = (tools.pack_array(builder, [one]) for one in (count, width))
        for k, one in enumerate(kinds):
            number = builder.extract_value(arguments[0], k) if several else arguments[0]
            number = context.cast(builder, number, one, types.float64)
            builder.store(number, tools.gep_inbounds(builder, array.data, k))
        return array._getvalue()

    return kind(values), generate


def loaded_from(kind: Any) -> Any:
    """A compiled function that returns the value of this type at an address, or the function there, if it is one's."""

    @intrinsic
    def load(typing: Any, address: Any) -> Any:
        def generate(context: Any, builder: Any, _: Any, values: Any) -> Any:
            if not isinstance(kind, types.FunctionType):
                return builder.load(builder.inttoptr(values[0], context.get_value_type(kind).as_pointer()))
            called = cgutils.create_struct_proxy(kind)(context, builder)  # type: ignore[no-untyped-call]
            # Numba's own way to call, in which errors come back. Its other two addresses stay 0.
            called.jit_addr = builder.inttoptr(values[0], context.get_value_type(types.voidptr))
            return called._getvalue()

        return kind(types.int64), generate

    return load
