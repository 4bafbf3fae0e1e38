"""Each private name of numba may be missing: the same bits from public names, with one warning, or one sentence."""

from __future__ import annotations

import os
import subprocess
import sys
import tomllib
from collections.abc import Sequence
from pathlib import Path

import pytest

from jackbox_env.jit import pipelines
from tests.renamed import judged

ROOT = Path(__file__).parents[2]


def said_without(names: Sequence[str], folder: Path) -> list[str]:
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(folder)}
    command = [sys.executable, "-m", "tests.renamed", *names]
    ran = subprocess.run(command, env=environment, capture_output=True, text=True, check=False)
    assert (ran.returncode, ran.stderr) == (0, "")
    return ran.stdout.splitlines()


@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=[pytest.mark.slow] if number else []) for number, name in enumerate(pipelines.NEEDED)],
)
def test_without_a_name_that_is_needed_a_sentence_names_it(name: str, tmp_path: Path) -> None:
    (sentence,) = said_without([name], tmp_path)
    lacking = f"the exact model cannot be compiled without {name.split(' ')[-1]}, which numba 0.61 to 0.69 have"
    assert sentence == lacking or "Dispatcher" in sentence


@pytest.mark.slow
def test_without_all_other_names_the_bits_are_the_same_and_each_is_noticed(tmp_path: Path) -> None:
    bits, lacking, warning = said_without(pipelines.FASTER, tmp_path)
    assert bits == judged()
    assert int(lacking) == len(pipelines.FASTER)
    assert warning.startswith("the exact model is compiled more slowly, and anew in each process, without ")
    assert warning.endswith(", which numba 0.61 to 0.69 have")


def test_the_versions_in_the_sentence_are_those_of_the_package() -> None:
    required = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["dependencies"]
    assert "numba>=0.61,<0.70; python_version < '3.15'" in required
