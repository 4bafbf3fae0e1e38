"""What the tests see: small faults are put into the code one by one, and tests run until one fails.

``python -m tests.mutants --seed 1 --number 60`` (``make mutants``) draws half of the places in the law and the compiled
code, a third in the rest of jackbox_env, the others in agents/. Each result is a line of ``runs/mutants/*.jsonl``; a
second call goes on after the last line. The code is copied, and faults are only in the copy.
"""

from __future__ import annotations

import argparse
import ast
import copy
import json
import os
import queue
import random
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from multiprocessing.pool import ThreadPool
from pathlib import Path

ROOT = Path(__file__).parents[1]
LAW = ["jackbox_env/mechanics.py", "jackbox_env/complementarity.py", "jackbox_env/compiled/*.py"]
GROUPS = [(LAW, 30), (["jackbox_env/**/*.py"], 20), (["agents/**/*.py"], 10)]  # of 60
OPERATORS = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult, ast.Pow: ast.Mult}
COMPARISONS = {ast.Lt: ast.LtE, ast.LtE: ast.Gt, ast.Gt: ast.GtE, ast.GtE: ast.Lt, ast.Eq: ast.NotEq, ast.NotEq: ast.Eq}
COMPARISONS |= {ast.Is: ast.IsNot, ast.IsNot: ast.Is, ast.In: ast.NotIn, ast.NotIn: ast.In}
DROPPED = (ast.Expr, ast.Assign, ast.AugAssign, ast.Return, ast.Raise, ast.Continue, ast.Break)


def changed(node: ast.AST) -> ast.AST | None:
    """Copy of a node with one fault, or None where there is none to make."""
    new = copy.deepcopy(node)
    if isinstance(new, ast.BinOp | ast.AugAssign) and type(new.op) in OPERATORS:
        new.op = OPERATORS[type(new.op)]()
    elif isinstance(new, ast.Compare) and type(new.ops[0]) in COMPARISONS:
        new.ops[0] = COMPARISONS[type(new.ops[0])]()
    elif isinstance(new, ast.BoolOp):
        new.op = ast.Or() if isinstance(new.op, ast.And) else ast.And()
    elif isinstance(new, ast.UnaryOp) and isinstance(new.op, ast.Not | ast.USub):
        return new.operand
    elif isinstance(new, ast.Constant) and isinstance(new.value, bool):
        new.value = not new.value
    elif isinstance(new, ast.Constant) and isinstance(new.value, int | float):
        new.value = new.value + 1 if isinstance(new.value, int) else 1.1 * new.value or 1.0
    else:
        return None
    return new


def nodes(tree: ast.AST) -> Iterator[ast.expr | ast.stmt]:
    """Expressions and statements but those of types and texts."""
    for name, value in ast.iter_fields(tree):
        if name in ("annotation", "returns"):
            continue
        for child in value if isinstance(value, list) else [value]:
            if isinstance(child, ast.expr | ast.stmt) and not isinstance(child, ast.JoinedStr):
                yield child
            if isinstance(child, ast.AST) and not isinstance(child, ast.JoinedStr):
                yield from nodes(child)


def faults(path: Path) -> Iterator[tuple[str, str]]:
    """Name and new text of each fault that a file can have."""
    text = path.read_text()
    lines = text.splitlines(keepends=True)
    starts = [0]
    for line in lines:
        starts.append(starts[-1] + len(line.encode()))
    raw, tree = text.encode(), ast.parse(text)
    for node in nodes(tree):
        news = [changed(node)]
        if isinstance(node, DROPPED) and not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)):
            news.append(ast.Pass())
        for new in news:
            if new is None:
                continue
            first = starts[node.lineno - 1] + node.col_offset
            last = starts[(node.end_lineno or 0) - 1] + (node.end_col_offset or 0)
            old, put = " ".join(raw[first:last].decode().split()), ast.unparse(new)
            name = f"{path.relative_to(ROOT)}:{node.lineno}:{node.col_offset} {old[:60]} -> {put[:60]}"
            yield name, (raw[:first] + put.encode() + raw[last:]).decode()


def drawn(seed: int, number: int) -> list[tuple[str, str]]:
    """Faults of a seed, each a name and the file's new text."""
    rng, chosen, taken = random.Random(seed), [], set[Path]()
    for patterns, share in GROUPS:
        paths = sorted({path for pattern in patterns for path in ROOT.glob(pattern)} - taken)
        taken |= set(paths)
        every = [fault for path in paths for fault in faults(path)]
        chosen += rng.sample(every, round(number * share / 60))
    rng.shuffle(chosen)
    return chosen


def nearest(root: Path, module: str) -> list[str]:
    """Files of tests: first those that name the module, and among equals those that need no compiler."""
    stem = Path(module).stem

    def distance(path: Path) -> tuple[bool, bool, int]:
        text = path.read_text()
        plain = "plain_step" in text or "symbolic" in text
        return not re.search(rf"import.*\b{stem}\b|\.{stem} import", text), not plain, len(text)

    return [str(path.relative_to(root)) for path in sorted((root / "tests").rglob("test_*.py"), key=distance)]


def verdict(root: Path, module: str, limit: float) -> str:
    """The first test that fails in a copy of the project, "survived", or "timed out"."""
    given = {
        "NUMBA_CACHE_DIR": str(root.parent / "kept"),
        "PYTHONPATH": str(root),
        "SDL_VIDEODRIVER": "dummy",
        "OMP_NUM_THREADS": "1",
    }
    options = ["-x", "-q", "--tb=no", "-rfE", "--timeout=200", "-p", "no:cacheprovider", "-m", "not slow"]
    command = [sys.executable, "-m", "pytest", *options, *nearest(root, module)]
    try:
        run = subprocess.run(
            command, cwd=root, env=os.environ | given, capture_output=True, text=True, timeout=limit, check=False
        )
    except subprocess.TimeoutExpired:
        return "timed out"
    failed = re.search(r"^(?:FAILED|ERROR) (\S+)", run.stdout, re.MULTILINE)
    if run.returncode == 0:
        return "survived"
    return failed[1] if failed else "stopped: " + (run.stderr or run.stdout)[-200:].strip()


def main() -> None:
    """Try each fault that has no result yet, after the code without one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--number", type=int, default=60)
    parser.add_argument("--limit", type=float, default=1500.0, help="seconds for each fault")
    parser.add_argument("--jobs", type=int, default=2)
    parser.add_argument("--out", type=Path, default=ROOT / "runs/mutants/results.jsonl")
    options = parser.parse_args()
    options.out.parent.mkdir(parents=True, exist_ok=True)
    lines = options.out.read_text().splitlines() if options.out.exists() else []
    done = {json.loads(line)["fault"] for line in lines}
    ignored = shutil.ignore_patterns(".venv", ".git", "runs", "_build", ".*_cache")
    roots = queue.Queue[Path]()

    def tried(fault: tuple[str, str]) -> tuple[str, str, int]:
        root, start = roots.get(), time.monotonic()
        module = fault[0].split(":")[0]
        before = (root / module).read_text()
        (root / module).write_text(fault[1])
        found = verdict(root, module, options.limit)
        (root / module).write_text(before)
        roots.put(root)
        return fault[0], found, round(time.monotonic() - start)

    none = "jackbox_env/mechanics.py: no fault"
    faults = [(none, (ROOT / "jackbox_env/mechanics.py").read_text()), *drawn(options.seed, options.number)]
    with tempfile.TemporaryDirectory() as folder, ThreadPool(options.jobs) as pool:
        for number in range(options.jobs):
            root = Path(folder) / str(number) / "project"
            shutil.copytree(ROOT, root, ignore=ignored)
            roots.put(root)
        for name, found, seconds in pool.imap_unordered(tried, [fault for fault in faults if fault[0] not in done]):
            if name == none and found != "survived":
                raise SystemExit(f"The tests fail without a fault: {found}")
            with options.out.open("a") as file:
                file.write(json.dumps({"fault": name, "by": found, "seconds": seconds}) + "\n")
            print(f"{name}\n    {found}, {seconds} s", flush=True)


if __name__ == "__main__":
    main()
