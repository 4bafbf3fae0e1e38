"""Each private name of numba may be missing: the same bits from public names, with one warning, or one sentence."""

from __future__ import annotations

import ast
import os
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

from jackbox_env.exact import pipelines
from tests.renamed import judged

ROOT = Path(__file__).parents[2]
QUICK = {"numba.core.options:DefaultOptions._nrt", "numba.core.compiler_machinery:PassManager.__init__ passes"}
QUICK |= {"numba.core.codegen:JITCodeLibrary._optimize_final_module"}


@pytest.mark.parametrize(
    "name",
    [
        pytest.param(name, marks=[] if name in QUICK else pytest.mark.slow)
        for name in (*pipelines.NEEDED, *pipelines.FASTER)
    ],
)
def test_without_a_name_of_numba_the_bits_are_the_same_or_a_sentence_names_it(name: str, tmp_path: Path) -> None:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path)}
    command = [sys.executable, "-m", "tests.renamed", name]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    said = ran.stdout.splitlines()
    if name in pipelines.NEEDED:
        assert said[0].startswith("the exact model cannot be compiled without ")
    else:
        assert said[0] == judged()
        assert said[1].startswith("the exact model is compiled more slowly, and anew in each process, without ")
    sentence = said[0 if name in pipelines.NEEDED else 1]
    assert sentence.endswith(", which numba 0.61 to 0.69 have")
    assert name.split(".")[-1].split(" ")[-1].split(":")[-1] in sentence or "Dispatcher" in sentence
    assert len(said) == 1 + (name not in pipelines.NEEDED)


def test_names_that_all_need_are_few_and_the_versions_are_those_of_the_package() -> None:
    assert len(pipelines.NEEDED) <= 8
    assert "numba>=0.61,<0.70" in tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]


def test_only_one_file_imports_private_modules_of_numba() -> None:
    private = set()
    for path in (ROOT / "jackbox_env").rglob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or ""] if isinstance(node, ast.ImportFrom) else []
            private |= {(path.name, name) for name in names if name.split(".")[0] in ("numba", "llvmlite")}
    assert {file for file, _ in private} == {"pipelines.py", "code_cache.py"}
    assert {name for file, name in private if file == "code_cache.py"} == {"numba", "llvmlite"}
