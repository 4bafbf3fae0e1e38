"""The same bits on other machines: this one against itself as an older one, newer Pythons and an emulated ARM.

Four settings hide from a process what newer CPUs have: NumPy's and OpenBLAS's instructions, numba's, and the fused
multiply-add of the C library's sine and cosine. The default run combines them, the exact model in
``tests/commands/test_wheel.py``, which compiles for such a machine. ``JACKBOX_MACHINES=all`` tests them one by one as
well, and runs the newer Pythons on ``PATH`` and a Debian for ARM. ARM needs root, and Debian's packages debootstrap
and qemu-user-static. QEMU's user-mode emulation of a process needs no chroot and no registered binary format.
"""

from __future__ import annotations

import importlib
import json
import os
import platform
import shutil
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from tempfile import TemporaryDirectory

import numpy as np
import pytest

from tests.fingerprints import Digests, fingerprints

ROOT = Path(__file__).parents[2]

x86 = pytest.mark.skipif(platform.machine().lower() not in ("x86_64", "amd64"), reason="settings for x86-64 CPUs")
on_request = pytest.mark.skipif(
    os.environ.get("JACKBOX_MACHINES") != "all", reason="JACKBOX_MACHINES=all takes minutes"
)


def numpy_features() -> str:
    """CPU features that NumPy chooses its code by, and that this CPU has."""
    older = np.lib.NumpyVersion(np.__version__) < "2.0.0"
    core = importlib.import_module(f"numpy.{'core' if older else '_core'}._multiarray_umath")
    return " ".join(name for name in core.__cpu_dispatch__ if core.__cpu_features__[name])


def flags() -> set[str]:
    """The flags of this CPU, as Linux names them."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return set()
    return next((set(line.split()) for line in lines if line.startswith("flags")), set())


WITHOUT_FMA = {"GLIBC_TUNABLES": "glibc.cpu.hwcaps=-FMA,-AVX2,-AVX512F,-FMA_Usable,-AVX2_Usable"}
PLAIN_NUMPY = {"NPY_DISABLE_CPU_FEATURES": numpy_features()}
PLAIN_NUMBA = {"NUMBA_CPU_NAME": "generic"}
OLD_BLAS = {"OPENBLAS_CORETYPE": "Prescott"}
MACHINES = {
    "OpenBLAS as on Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "OpenBLAS as on Prescott": OLD_BLAS,
    "OpenBLAS as on Skylake": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "NumPy without dispatch": PLAIN_NUMPY,
    "numba for any x86-64": PLAIN_NUMBA,
    "C library without FMA": WITHOUT_FMA,
}
OLDEST = OLD_BLAS | PLAIN_NUMPY | PLAIN_NUMBA | WITHOUT_FMA
SAME_LIBRARY = OLD_BLAS | PLAIN_NUMPY | PLAIN_NUMBA


def differing(
    kinds: list[str], settings: dict[str, str], python: tuple[str, ...] = (sys.executable,)
) -> tuple[list[str], Digests]:
    """Names of the digests that differ in a process of ``python`` with ``settings``, and the digests here."""
    other = subprocess.Popen(
        [*python, "-m", "tests.fingerprints", *kinds],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, cwd=ROOT, env={**os.environ, **settings},
    )  # fmt: skip
    here = fingerprints(kinds)
    printed, failed = other.communicate()
    assert other.returncode == 0, failed
    there: Digests = json.loads(printed)
    assert there.keys() == here.keys()
    return [name for name in here if here[name] != there[name]], here


@x86
def test_scenes_and_cosines_are_the_same_on_the_oldest_machine_which_is_another() -> None:
    differ, _ = differing(["scenes", "libraries"], OLDEST)
    assert {*differ} <= {"BLAS", "numba", "NumPy", "C"}
    # Otherwise the tests compare a machine with itself.
    if not {"fma", "avx2"} <= flags() or not all(os.environ.get(name) is None for name in OLDEST):
        pytest.skip("this machine is an old one")
    assert {"BLAS", "numba"} <= {*differ}
    assert "NumPy" in differ or not numpy_features()
    assert "C" in differ or platform.libc_ver()[0] != "glibc"


@x86
def test_pymunk_gives_the_same_bits_on_every_machine_with_the_same_mathematics_library() -> None:
    # The engine and the environment use cosines and sines of the C library.
    differ, compared = differing(["pymunk"], SAME_LIBRARY)
    assert differ == []
    assert len(compared) > 20


@x86
@on_request
@pytest.mark.parametrize("machine", MACHINES)
def test_each_setting_alone_leaves_the_bits(machine: str) -> None:
    if machine == "OpenBLAS as on Skylake" and "avx512f" not in flags():
        pytest.skip("this CPU has no AVX-512")
    kinds = ["exact", "scenes"] if machine == "C library without FMA" else ["exact", "scenes", "pymunk"]
    differ, _ = differing(kinds, MACHINES[machine])
    assert differ == []


# -- newer Pythons and ARM --------------------------------------------------------------------------------------------

PINNED = ["--quiet", "--constraint", str(ROOT / "constraints.txt"), str(ROOT)]


@pytest.fixture
def folder() -> Iterator[Path]:
    """A folder in runs: temporary folders often allow no device files, without which debootstrap refuses."""
    (ROOT / "runs").mkdir(exist_ok=True)
    with TemporaryDirectory(dir=ROOT / "runs") as made:
        yield Path(made)


def assert_same(kinds: list[str], settings: dict[str, str], *python: str) -> None:
    """The digests are equal to those here, and the installation works."""
    differ, _ = differing(kinds, settings, python)
    assert differ == []
    subprocess.run([*python, "-m", "jackbox_env", "check"], cwd=ROOT, env={**os.environ, **settings}, check=True)


@on_request
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("version", ["3.12", "3.13", "3.14"])
def test_other_pythons_give_the_same_bits(version: str, folder: Path) -> None:
    command = [f"python{version}", "-m", "venv", str(folder)]
    if not shutil.which(command[0]) or subprocess.run(command, check=False).returncode != 0:
        pytest.skip(f"no python{version} on PATH makes virtual environments")
    python = str(folder / "bin" / "python")
    subprocess.run([python, "-m", "pip", "install", *PINNED], check=True)
    assert_same(["exact", "scenes", "pymunk"], {"NUMBA_CACHE_DIR": str(folder / "kept")}, python)


@on_request
@pytest.mark.timeout(5400)
def test_an_emulated_arm_gives_the_same_bits(folder: Path) -> None:
    missing = [name for name in ("debootstrap", "dpkg-deb", "qemu-aarch64-static") if not shutil.which(name)]
    if missing or os.geteuid() != 0:
        pytest.skip(f"an emulated ARM needs {', '.join(missing) or 'root'}, which is missing here")
    debian = ["--arch=arm64", "--foreign", "--variant=minbase", "--include=python3", "bookworm", str(folder)]
    subprocess.run(["debootstrap", *debian], check=True)
    for package in folder.glob("var/cache/apt/archives/*.deb"):
        subprocess.run(["dpkg-deb", "--extract", package, folder], check=True)
    packages = str(folder / "packages")
    wheels = [f"--platform=manylinux_2_{minor}_aarch64" for minor in range(17, 37)]  # for glibc 2.36, bookworm's
    target = ["--target", packages, "--python-version=3.11", "--only-binary=:all:", *wheels]
    subprocess.run([sys.executable, "-m", "pip", "install", *target, *PINNED], check=True)
    kinds = ["exact", "scenes", "pymunk"] if platform.libc_ver() == ("glibc", "2.36") else ["exact", "scenes"]
    settings = {"NUMBA_CACHE_DIR": str(folder / "kept"), "PYTHONPATH": packages}
    assert_same(kinds, settings, "qemu-aarch64-static", "-L", str(folder), str(folder / "usr" / "bin" / "python3"))
