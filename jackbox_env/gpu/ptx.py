"""PTX, the code of NVIDIA's GPUs, of :func:`jackbox_env.gpu.row.play`, by the LLVM that numba brings; no toolkit.

Numba's code for the CPU is compiled for another machine, as it is for WebAssembly. Each operation on float64 is rounded
alone (``.rn``), which the driver may not contract, so a GPU computes the CPU's bits. :func:`refuse_inexact` refuses
PTX that has anything else. PTX for sm_80 runs on all later cards too: their driver compiles it.
"""

from __future__ import annotations

import contextlib
import hashlib
import re
from collections.abc import Callable
from functools import cache
from importlib.metadata import version
from typing import Any

from jackbox_env.exact.workspace import Status
from jackbox_env.gpu.row import SUBSTITUTES, arguments, play
from jackbox_env.jit.compiler import UsersFunctions, intermediate_code, kinds_of
from jackbox_env.jit.folders import cache_folders
from jackbox_env.model.tasks import TASKS
from jackbox_env.tools import files

TRIPLE = "nvptx64-nvidia-cuda"
_LAYOUT = "e-p6:32:32-i64:64-i128:128-i256:256-v16:16-v32:32-n16:32:64"
_ROUNDED = {"add", "sub", "mul", "div", "sqrt", "rcp"}  # operations on float64 with .rn
# and those that are exact
_EXACT = {"abs", "neg", "copysign", "mov", "ld", "st", "selp", "setp", "min", "max", "cvt"}
_KNOWN = re.compile(
    r"llvm\.(nvvm|sqrt|fabs|copysign|floor|ceil|trunc|[su]m(ax|in)|abs|mem(set|cpy|move)|lifetime|assume|fsh[lr])\b"
)
_OF_64_BITS = re.compile(r"^\s+(?:@!?%p\d+\s+)?([a-z]\w*)(\.[a-z0-9_.:]*)?\s", re.MULTILINE)

_KERNEL = """
declare i32 @llvm.nvvm.read.ptx.sreg.tid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
declare i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
define ptx_kernel void @rollout(ptr %call, i64 %count) {{
  %thread = call i32 @llvm.nvvm.read.ptx.sreg.tid.x()
  %width = call i32 @llvm.nvvm.read.ptx.sreg.ntid.x()
  %block = call i32 @llvm.nvvm.read.ptx.sreg.ctaid.x()
  %before = mul i32 %block, %width
  %number = add i32 %before, %thread
  %row = zext i32 %number to i64
  %inside = icmp slt i64 %row, %count
  br i1 %inside, label %play, label %end
play:
  {memory}
  %result = alloca ptr, align 8
  %error = alloca ptr, align 8
  %address = ptrtoint ptr %call to i64
  %raised = call i32 @{name}(ptr %result, ptr %error, {arguments})
  %failed = icmp ne i32 %raised, 0
  br i1 %failed, label %leave, label %end
leave:
  %ended_at = getelementptr i64, ptr %call, i64 4
  %ended = load ptr, ptr %ended_at
  %stride_at = getelementptr i64, ptr %call, i64 6
  %stride = load i64, ptr %stride_at
  %offset = mul i64 %row, %stride
  %mine = getelementptr i8, ptr %ended, i64 %offset
  store i64 {status}, ptr %mine
  br label %end
end:
  ret void
}}
"""


@cache
def ptx_of(task: str, chip: str = "sm_80") -> str:
    """The PTX of rollouts with a built-in task's rewards, stored with the other compiled code.

    Args:
        task: its name.
        chip: the oldest that the code runs on.
    """

    def made() -> str:
        code = intermediate_code(play, kinds_of(arguments()), **SUBSTITUTES, task_terms=TASKS[task].values)
        return checked(*code, chip, arguments())

    return stored(f"{task}-{chip}", made)


def stored(name: str, made: Callable[[], str]) -> str:
    """PTX of this name as it was stored with the other compiled code; else as it is ``made`` now, which is stored."""
    name += f"-{version('numba')}-{version('llvmlite')}.ptx"
    for folder in cache_folders():
        text, _, checksum = (folder / name).read_text().rpartition("// ") if (folder / name).is_file() else ("", "", "")
        if text and _checksum(name, text) == checksum:
            return text
    ptx = made()
    with contextlib.suppress(OSError):  # then it is compiled anew in each process
        files.write_text(cache_folders()[-1] / name, f"{ptx}// {_checksum(name, ptx)}")
    return ptx


def ptx_with(users: UsersFunctions, chip: str = "sm_80") -> str:
    """The same with the rewards of a user's task, not stored.

    Raises:
        TypeError: its functions need more than arithmetic.
    """
    return checked(*users.besides(SUBSTITUTES).intermediate_code(play, kinds_of(arguments())), chip, arguments())


def _checksum(name: str, ptx: str) -> str:
    return hashlib.sha256(f"{name}\0{ptx}".encode()).hexdigest()


def checked(code: str, name: str, chip: str, example: tuple[Any, ...]) -> str:
    """The PTX of a kernel around the function of this name in LLVM's code; :func:`refuse_inexact` has passed it.

    Its arguments are an address, memory like the arrays of the ``example``, which each thread has, and a row.
    """
    memory, passed = "", ["i64 %address"]
    for number, array in enumerate(example[1:-1]):
        memory += f"%memory_{number} = alloca [{max(8, array.nbytes)} x i8], align 16\n  "
        numbers = [f"i64 {one}" for one in (array.size, array.itemsize, *array.shape, *array.strides)]
        passed += ["ptr null, ptr null", *numbers[:2], f"ptr %memory_{number}", *numbers[2:]]
    call = ", ".join([*passed, "i64 %row"])
    kernel = _KERNEL.format(name=name, status=Status.UNCOMPILED.value, memory=memory, arguments=call)
    ptx = emitted(code + kernel, chip)
    refuse_inexact(ptx)
    return ptx


def emitted(code: str, chip: str) -> str:
    """The PTX of LLVM's code for the CPU with a kernel, everything inlined into it."""
    code = re.sub(r"^target datalayout = .*$", f'target datalayout = "{_LAYOUT}"', code, flags=re.MULTILINE)
    code = re.sub(r"^target triple = .*$", f'target triple = "{TRIPLE}"', code, flags=re.MULTILINE)
    code = re.sub(r"^declare double @(llvm\.)?sqrt(\.f64)?\(double\).*$", "", code, flags=re.MULTILINE)
    code = code.replace("@sqrt(", "@llvm.sqrt.f64(") + "declare double @llvm.sqrt.f64(double)\n"
    code = code.replace("noinline", "")
    code = re.sub(r"^(define (?!ptx_kernel).*)\{$", r"\1alwaysinline {", code, flags=re.MULTILINE)
    code = re.sub(r"^(define .*)\{$", r'\1"no-jump-tables"="true" {', code, flags=re.MULTILINE)
    from jackbox_env.jit.pipelines import optimized

    module, machine = optimized(code, TRIPLE, chip, "+ptx78", "rollout")
    refuse_more_than_arithmetic(module)
    return str(machine.emit_assembly(module))


def refuse_more_than_arithmetic(module: Any) -> None:
    """Refuse LLVM's code that needs a function, or ``%``, which the backend would round or not know.

    Raises:
        TypeError: it does.
    """
    needed = [one.name for one in module.functions if one.is_declaration and not _KNOWN.match(one.name)]
    if " frem " in str(module):
        needed.append("%")
    if needed:
        raise TypeError(f'device="cuda" runs functions of + - * / and square roots, this one needs {needed[0]}')


def refuse_inexact(ptx: str) -> None:
    """Refuse PTX in which an operation may round otherwise than the CPU's, or that calls something.

    Raises:
        TypeError: one does.
    """
    for operation, how in _OF_64_BITS.findall(ptx):
        of_floats = {"f64", "f32", "f16", "f16x2", "bf16"}.intersection(how.split("."))
        known = operation in _EXACT or (operation in _ROUNDED and ".rn." in how)
        known = (known and of_floats == {"f64"}) or operation + how == "cvt.rn.f32.f64"  # of observations, as IEEE 754
        if operation == "call" or (of_floats and not known):
            raise TypeError(f"a GPU would not get the CPU's bits by {operation}{how}")
