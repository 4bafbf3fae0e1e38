"""PTX as C: one statement for each instruction, so that the machine code of any CPU shows what a GPU would compute.

What each instruction does is in ``instructions.h``; an instruction that is not there fails to compile.
"""

from __future__ import annotations

import ctypes
import re
import subprocess
from collections.abc import Callable
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

HERE = Path(__file__).parent
WIDTH = 128  # threads in a block
_TYPES = {"pred": "int", "b16": "u16", "b32": "u32", "b64": "u64"}
_SPECIAL = {"%tid.x": "thread", "%ntid.x": str(WIDTH), "%ctaid.x": "block", "__local_depot0": "(u64)local"}
_STATEMENT = re.compile(r"(?:@(!?)%(p\d+) )?([a-z]\w*)([.\w]*)(.*)")
_SPACES = re.compile(r"\.(local|global|param)\b")


def _value(operand: str) -> str:
    operand = operand.strip("[] ")
    if operand in _SPECIAL:
        return _SPECIAL[operand]
    if operand.startswith("0d"):
        return f"0x{operand[2:]}ull"
    return operand.removeprefix("%") + ("" if operand.startswith("%") else "ll")


def _address(operand: str) -> str:
    base, _, offset = operand.strip("[] ").partition("+")
    return f"{_value(base)} + {offset or 0}"


def _statement(name: str, kinds: str, operands: list[str]) -> str:
    """One instruction, by its name, its kinds and its operands, of which the first is the result's register."""
    if name in ("ret", "exit"):
        return "return;"
    if name == "bra":
        return f"goto {operands[0].removeprefix('$')};"
    if name == "ld" and kinds.startswith(".param"):
        return f"{_value(operands[0])} = parameters[{operands[1].strip('[]')[-1]}];"
    if name in ("ld", "st"):
        kind = kinds.rpartition(".")[2]
        at, registers = (operands[-1], operands[:-1]) if name == "ld" else (operands[0], operands[1:])
        places = [f"{_address(at)} + {number * int(kind[1:]) // 8}" for number in range(len(registers))]
        if name == "ld":
            return " ".join(f"{_value(one)} = ld_{kind}({at});" for one, at in zip(registers, places, strict=True))
        return " ".join(f"st_{kind}({at}, {_value(one)});" for one, at in zip(registers, places, strict=True))
    result, *values = map(_value, operands)
    if name in ("mov", "cvta"):
        return f"{result} = {values[0]};"
    if name == "selp":
        return f"{result} = {values[2]} ? {values[0]} : {values[1]};"
    return f"{result} = {(name + kinds).replace('.', '_')}({', '.join(values)});"


def _line(line: str) -> str:
    """A line of a kernel's body as C."""
    line = re.sub(r"\s+", " ", line.split("//")[0]).strip().rstrip(";")
    if not line or line.startswith(".pragma"):
        return ""
    if registers := re.fullmatch(r"\.reg \.(\w+) %(\w+?)(?:<(\d+)>)?", line):
        kind, name, count = registers.groups()
        names = [f"{name}{number} = 0" for number in range(1, int(count))] if count else [f"{name} = 0"]
        return f"{_TYPES[kind]} {', '.join(names)};"
    if depot := re.fullmatch(r"\.local \.align \d+ \.b8 __local_depot0\[(\d+)\]", line):
        return f"_Alignas(16) char local[{depot[1]}];"
    if line.startswith("$"):
        return line.removeprefix("$") + ";"
    unless, predicate, name, kinds, operands = _STATEMENT.fullmatch(line).groups()  # type: ignore[union-attr]
    spaceless = kinds if ".param" in kinds else _SPACES.sub("", kinds)
    listed = [one.strip(" {}") for one in operands.split(",")] if operands else []
    statement = _statement(name, spaceless, listed)
    return f"if ({unless or ''}{predicate}) {{ {statement} }}" if predicate else statement


def translated(ptx: str) -> str:
    """C with a function ``played`` of the kernel's parameters, which plays all rows."""
    body = ptx[ptx.index(".visible .entry") :]
    lines = body[body.index("{") + 1 : body.rindex("}")].splitlines()
    statements = "\n".join(map(_line, lines))
    return f"""#include "{HERE / "instructions.h"}"
static void kernel(const u64 *parameters, u32 thread, u32 block) {{
{statements}
}}
void played(const u64 *parameters) {{
  for (u64 row = 0; row < parameters[1]; row++) kernel(parameters, row % {WIDTH}, row / {WIDTH});
}}
"""


@cache
def loaded(ptx: str) -> Callable[[int, int], None]:
    """The kernel as machine code of this CPU, a function of the address of a call and the number of rows."""
    command = ["gcc", "-std=c11", "-O0", "-ffp-contract=off", "-w", "-Werror=implicit-function-declaration"]
    with TemporaryDirectory() as folder:
        source, library = Path(folder, "kernel.c"), Path(folder, "kernel.so")
        source.write_text(translated(ptx))
        subprocess.run([*command, "-shared", "-fPIC", str(source), "-o", str(library), "-lm"], check=True)
        played: Any = ctypes.CDLL(str(library)).played
    return lambda call, count: played((ctypes.c_uint64 * 2)(call, count))
