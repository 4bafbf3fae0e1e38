"""Compiled code on disk: it is checked before it is loaded, keyed by a hash of its sources, and never stops a run."""

from __future__ import annotations

import os
import pickle
import random
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import llvmlite  # type: ignore[import-untyped]
import numba
import pytest
from numba.core.codegen import JITCPUCodegen

import jackbox_env
from jackbox_env.exact.geometry import cos_sin, cos_sin_within, quarter
from jackbox_env.jit import code_cache, compiler, folders
from tests.test_architecture import _graph, _sources

TURN = (0.8, 0.6, 1), (-0.6, 0.8)  # arguments and result of ``quarter``


@pytest.fixture
def cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The first folder for compiled code, empty; the others are next to it."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "place"))
    monkeypatch.setattr(folders, "PACKAGE", tmp_path / "package")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    code_cache.warn_once.cache_clear()
    return tmp_path / "place"


def fresh(function: Callable[..., Any]) -> Any:
    """``function`` compiled as in a process that has not compiled it yet."""
    return compiler._Compilation((), on_disk=True).compiled(function)


def turned() -> int:
    """How often a fresh call of ``quarter`` loads cached code instead of compiling. Asserts the result."""
    made = fresh(quarter)
    assert made(*TURN[0]) == TURN[1]
    return sum(made.stats.cache_hits.values())


def files(cache: Path) -> list[Path]:
    return sorted(cache.glob("compiled-*/*.kept"))


def test_a_later_process_loads_the_whole_exact_model() -> None:
    jackbox_env.make_simulator(contact="exact").step(0.02, 1.0)
    code = (
        "import jackbox_env; jackbox_env.make_simulator(contact='exact').step(0.02, 1.0)\n"
        "from jackbox_env.jit.compiler import compiled; from jackbox_env.exact.run import run\n"
        "stats = compiled(run).stats; print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (ran.stdout, ran.stderr) == ("1 0\n", "")


# -- damage -----------------------------------------------------------------------------------------------------------


def write(path: Path, code: bytes) -> None:
    """Write code to a file under its correct checksum."""
    path.write_bytes(code_cache._checksum(path, code) + code)


def test_a_file_with_any_bit_flipped_or_cut_anywhere_is_not_read(
    cache: Path, cases: Callable[[int], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = fresh(quarter)
    made(*TURN[0])
    (path,), (signature,) = files(cache), made.signatures
    whole, rng = path.read_bytes(), random.Random(0)
    monkeypatch.setattr(pickle, "loads", lambda _: pytest.fail("damaged code is read"))
    flips = [(at, 1 << rng.randrange(8)) for at in rng.sample(range(len(whole)), cases(400))]
    damaged = [whole[:at] + bytes([whole[at] ^ bit]) + whole[at + 1 :] for at, bit in flips]
    cut = [whole[:length] for length in (0, 31, 32, len(whole) - 1)]
    for content in [*damaged, *cut, whole + b"\0", bytes(len(whole))]:
        code_cache.warn_once.cache_clear()
        path.write_bytes(content)
        with pytest.warns(UserWarning, match="damaged"):
            assert made._cache.load_overload(signature, made.targetctx) is None


def test_code_that_cannot_be_loaded_is_compiled_anew_and_replaced_and_one_warning_names_the_folder(cache: Path) -> None:
    turned()
    (path,) = files(cache)
    write(path, b"no code")
    with pytest.warns(UserWarning, match=f"{path.parent} cannot be used") as said:
        assert (turned(), turned()) == (0, 1)
    assert len(said) == 1


def test_another_functions_code_is_damage_and_would_run_without_the_checksum(cache: Path) -> None:
    fresh(cos_sin)(1.0), fresh(cos_sin_within)(1.0)
    one, other = files(cache)
    shutil.copy(other, one)
    with pytest.warns(UserWarning, match="damaged"):
        assert fresh(cos_sin)(1e15) == cos_sin(1e15)
    write(one, other.read_bytes()[code_cache._HEAD :])
    assert fresh(cos_sin)(1e15) == fresh(cos_sin_within)(1e15) != cos_sin(1e15)


# -- which folder -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("owner", "act"), [(Path, "write_bytes"), (os, "replace")])
def test_a_folder_that_can_no_longer_be_written_is_named_once(
    owner: Any, act: str, cache: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Path, *_: Any) -> None:
        raise OSError(28, "No space left on device", str(self))

    monkeypatch.setattr(owner, act, fail)
    with pytest.warns(UserWarning, match=f"cannot be kept in {cache}/compiled-.* .No space left on device") as said:
        assert turned() == turned() == 0
    assert len(said) == 1
    assert not list(cache.glob("*/*"))


def test_a_folder_that_can_only_be_read_is_read(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    turned()
    monkeypatch.setattr(os, "access", lambda where, mode: cache not in Path(where).parents)
    assert turned() == 1
    assert fresh(cos_sin)(1.0) == cos_sin(1.0)  # not cached there, and cached in the next folder
    assert len(files(cache)) == len(files(folders.PACKAGE / "__pycache__")) == 1


def test_the_first_writable_folder_is_used_and_a_warning_says_that_there_is_none(cache: Path) -> None:
    for unusable in (cache, folders.PACKAGE, cache.parent / "home"):
        assert turned() == 0
        assert len(list(unusable.rglob("*.kept"))) == 1
        shutil.rmtree(unusable)
        unusable.write_text("a file, not a folder")
    with pytest.warns(UserWarning, match=f"cannot be kept in {cache.parent}/home/.* compiles it anew"):
        assert turned() == 0


@pytest.mark.usefixtures("cache")
@pytest.mark.parametrize(("stored", "how_often"), [(True, "once on this machine"), (False, "in each process, as it")])
def test_once_is_promised_where_code_is_stored(
    stored: bool, how_often: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(code_cache._LONG, "cos_sin", (f"{stored} turns", "1 second"))
    monkeypatch.setattr(os, "access", lambda where, mode: stored)
    fresh(cos_sin)(1.0)
    assert f"for {stored} turns, {how_often}" in capsys.readouterr().err


# -- shipped with a wheel ---------------------------------------------------------------------------------------------

NEWER = "x86_64-unknown-linux-gnu", "newer", ",".join(sorted(code_cache._NEEDS))


@pytest.fixture
def shipped(cache: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The compiled ``quarter`` of a wheel, on a machine with an empty cache."""
    monkeypatch.setattr(JITCPUCodegen, "magic_tuple", lambda self: (NEWER[0], code_cache.SHIPPED_FOR, ""))
    assert turned() == 0
    (path,) = files(cache)
    moved = folders.PACKAGE / "exact" / "shipped" / path.parent.name
    shutil.move(path.parent, moved)
    monkeypatch.setattr(JITCPUCodegen, "magic_tuple", lambda self: NEWER)


@pytest.mark.usefixtures("shipped")
def test_shipped_code_is_loaded_if_nothing_is_cached(cache: Path) -> None:
    assert turned() == 1
    assert fresh(cos_sin)(1.0) == cos_sin(1.0)  # is not shipped
    assert len(files(cache)) == 1


@pytest.mark.usefixtures("shipped")
@pytest.mark.parametrize(
    ("owner", "name", "other"),
    [
        (JITCPUCodegen, "magic_tuple", lambda self: (*NEWER[:2], NEWER[2].replace("+fma", "-fma"))),
        (JITCPUCodegen, "magic_tuple", lambda self: (*NEWER[:2], "")),  # the name of the CPU is not reported
        (JITCPUCodegen, "magic_tuple", lambda self: ("aarch64-unknown-linux-gnu", *NEWER[1:])),
        (code_cache, "EXTENSION_SUFFIXES", [".cpython-310-x86_64-linux-gnu.so"]),
        (numba, "__version__", "0.69.0"),
        (llvmlite, "__version__", "0.51.0"),
    ],
)
def test_shipped_code_that_does_not_fit_is_not_loaded(
    owner: Any, name: str, other: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(owner, name, other)
    assert turned() == 0


# -- keys -------------------------------------------------------------------------------------------------------------


def test_a_change_in_what_compiled_code_comes_from_gives_new_code_and_none_elsewhere(tmp_path: Path) -> None:
    package, folder_name, changing = tmp_path / "jackbox_env", folders.folder_name.__wrapped__, set[str]()
    shutil.copytree(Path(jackbox_env.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    before = folder_name(package)
    assert before == folders.folder_name()
    for path in package.rglob("*.py"):
        source = path.read_text()
        path.write_text(f"{source}CHANGED = 1\n")
        if folder_name(package) != before:
            changing.add(".".join(path.relative_to(tmp_path).with_suffix("").parts).removesuffix(".__init__"))
        path.write_text(source)
    assert {"jackbox_env.exact.run", "jackbox_env.model.tasks", "jackbox_env.render.raster"} < changing
    assert set[str]().union(*map(_graph(_sources()).__getitem__, changing)) <= changing  # constants come from there too
    assert {module.split(".")[1] for module in changing} == {"tools", "model", "jit", "exact", "gpu", "render"}
    assert "jackbox_env.render.renderer" not in changing


@pytest.mark.parametrize(("function", "others"), [(jackbox_env.rollout, {}), (quarter, {"abs": jackbox_env.rollout})])
def test_code_of_a_function_from_elsewhere_is_not_stored(function: Any, others: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=r"^code of jackbox_env.planning.rollouts.rollout cannot be stored: "):
        compiler.compiled(function, **others)
