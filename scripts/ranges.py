"""Run the core of the tests with the oldest and the newest dependencies that pyproject.toml allows; compare the bits.

Two environments are made anew, `.venv/ranges-lowest` and `.venv/ranges-newest`. Each gets the package's own
dependencies and what these tests need, no extras: a test that needs an extra is skipped. The lowest releases exist for
Python 3.11 and 3.12.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import tomllib
import venv
from pathlib import Path

from jackbox_env.tools.command_line import ROOT, command_line

CORE = [
    "tests/environment/test_env.py",
    "tests/batches/test_vector_env.py",
    "tests/guarantees/test_bits.py",
    "tests/guarantees/test_exact_impacts.py",
    "tests/guarantees/test_flight.py",
    "tests/guarantees/test_derivatives.py",
]
TOOLS = ["hypothesis", "mpmath", "pytest", "pytest-timeout", "pytest-xdist", "sympy"]


def dependencies(kind: str) -> list[str]:
    """Requirements of the package, ``numba>=0.61,<0.70``; the ``lowest`` as ``numba==0.61``."""
    names: list[str] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]["dependencies"]
    return [one.split(",")[0].replace(">=", "==") for one in names] if kind == "lowest" else names


def environment(kind: str) -> str:
    """Make an environment of this kind and print its versions; return the path of its Python."""
    folder = ROOT / ".venv" / f"ranges-{kind}"
    venv.create(folder, clear=True, with_pip=True)
    python = str(folder / Path(sys.executable).relative_to(sys.prefix))
    pip = [python, "-m", "pip", "--disable-pip-version-check"]
    subprocess.run([*pip, "install", "--quiet", "--editable", str(ROOT), *dependencies(kind), *TOOLS], check=True)
    listed = subprocess.run([*pip, "list", "--format=json"], check=True, capture_output=True, text=True).stdout
    versions = {one["name"]: one["version"] for one in json.loads(listed)}
    print(kind, ", ".join(f"{name} {versions[name]}" for name in ("gymnasium", "numba", "numpy", "pymunk")), flush=True)
    return python


def settings(python: str) -> dict[str, str]:
    """Environment variables: one thread, and a cache of compiled code in the environment of another Python."""
    cache = {} if python == sys.executable else {"NUMBA_CACHE_DIR": str(Path(python).parents[1] / "kept")}
    return {**os.environ, "OMP_NUM_THREADS": "1", **cache}


def bits(python: str) -> dict[str, str]:
    """Digests of what both contact models compute under this Python."""
    command = [python, "-m", "tests.fingerprints", "exact", "pymunk"]
    done = subprocess.run(command, cwd=ROOT, env=settings(python), check=True, stdout=subprocess.PIPE, text=True)
    digests: dict[str, str] = json.loads(done.stdout)
    return digests


@command_line
def main() -> None:
    """Test both; fail if a test fails or a bit differs from this environment's."""
    import tyro

    tyro.cli(lambda: None, description=__doc__)
    here, failed = bits(sys.executable), False
    for kind in ("lowest", "newest"):
        python = environment(kind)
        there = bits(python)
        differing = [name for name in here if there[name] != here[name]]
        print(f"{len(here) - len(differing)} of {len(here)} digests are equal to those here; not:", differing or "none")
        tests = [python, "-m", "pytest", "-q", "-m", "not slow", *CORE]
        code = subprocess.run(tests, cwd=ROOT, env=settings(python), check=False).returncode
        failed |= bool(differing) or code != 0
    raise SystemExit(int(failed))


if __name__ == "__main__":
    main()
