"""Mutation testing: small faults are put into the code, one at a time, and tests run until one fails.

``python -m tests.mutants --seed 1 --number 60`` (``make mutants``) draws half of the faults in the law and the compiled
code, a third in the whole of jackbox_env, the others in agents/. Each result is a line of
``runs/mutants/results.jsonl``; a second call continues after the last line. The faults are in a copy of the code.
"""

from __future__ import annotations

import argparse
import ast
import json
import random
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).parents[1]
OUT = ROOT / "runs" / "mutants"
LAW = ("jackbox_env/model/mechanics.py", "jackbox_env/model/complementarity.py", "jackbox_env/exact/*.py")
GROUPS = ((LAW, 1 / 2), (("jackbox_env/**/*.py",), 1 / 3), (("agents/**/*.py",), 1 / 6))
PARTS: dict[type, Callable[..., ast.AST]] = {
    ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult, ast.USub: ast.UAdd,
    ast.Lt: ast.LtE, ast.LtE: ast.Gt, ast.Gt: ast.GtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq,
    ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In, ast.And: ast.Or, ast.Or: ast.And,
    ast.Assign: ast.Pass, ast.AugAssign: ast.Pass, ast.Return: ast.Pass, ast.Raise: ast.Pass,
    bool: lambda value: ast.Constant(not value),
    int: lambda value: ast.Constant(value + 1),
    float: lambda value: ast.Constant(1.1 * value or 1.0),
}  # fmt: skip


class Fault(ast.NodeTransformer):
    """Counts the faults that a program can have, and puts the one of number ``wanted`` into it."""

    def __init__(self, wanted: int) -> None:
        self.wanted, self.seen = wanted, 0

    def visit(self, node: ast.AST) -> ast.AST:
        kind, value = (type(node.value), [node.value]) if isinstance(node, ast.Constant) else (type(node), [])
        self.seen += kind in PARTS
        return PARTS[kind](*value) if kind in PARTS and self.seen == self.wanted else self.generic_visit(node)


def faulty(path: Path, number: int) -> tuple[str, str, int]:
    """A file's text with the fault of this number, 0: none; the fault in words; and how many the file can have."""
    tree, fault = ast.parse(path.read_text()), Fault(number)
    before, after = ast.unparse(tree).splitlines(), ast.unparse(fault.visit(tree)).splitlines()
    pairs = (f"{old.strip()} -> {new.strip()}" for old, new in zip(before, after, strict=True) if old != new)
    return "\n".join(after), f"{path.relative_to(ROOT)}, fault {number}: {next(pairs, 'none')}", fault.seen


def drawn(seed: int, number: int) -> list[tuple[Path, int]]:
    """Files and numbers of the faults of a seed; each pattern must match a file."""
    rng, chosen = random.Random(seed), list[tuple[Path, int]]()
    for patterns, share in GROUPS:
        matched = [sorted(ROOT.glob(pattern)) for pattern in patterns]
        assert all(matched), f"one of {', '.join(patterns)} matches no file"
        every = [(path, index + 1) for paths in matched for path in paths for index in range(faulty(path, 0)[2])]
        chosen += rng.sample(every, round(number * share))
    return chosen


def first_failure(copy: Path, module: str) -> str:
    """The first test that fails in a copy of the project, or "survived"; tests that name the module run first."""
    tests = sorted(copy.glob("tests/**/test_*.py"), key=lambda path: (module not in path.read_text(), path))
    run = subprocess.run([
        "timeout", "1500", "env", f"PYTHONPATH={copy}", f"NUMBA_CACHE_DIR={OUT}/compiled", "OMP_NUM_THREADS=1",
        sys.executable, "-m", "pytest", "-xq", "--tb=no", "-rfE", "--timeout=200", "-m", "not slow", *map(str, tests),
    ], cwd=copy, stdout=subprocess.PIPE, text=True, check=False)  # fmt: skip
    failed = (line for line in run.stdout.splitlines() if line.startswith(("FAILED", "ERROR")))
    return next(failed, f"stopped with {run.returncode}" if run.returncode else "survived")


def main() -> None:
    """Run the tests without a fault, then with each that has no result yet."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--number", type=int, default=60)
    arguments, copy, results = parser.parse_args(), OUT / "project", OUT / "results.jsonl"
    for path, number in [(ROOT / LAW[0], 0), *drawn(arguments.seed, arguments.number)]:
        shutil.copytree(ROOT, copy, ignore=shutil.ignore_patterns(".*", "runs", "_build"), dirs_exist_ok=True)
        text, name, _ = faulty(path, number)
        (copy / path.relative_to(ROOT)).write_text(text)
        if not results.exists() or json.dumps(name) not in results.read_text():
            with results.open("a") as file:
                print(json.dumps({"fault": name, "by": first_failure(copy, path.stem)}), file=file)


if __name__ == "__main__":
    main()
