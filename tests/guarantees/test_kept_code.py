"""Compiled code on disk: checked before it is loaded, found by its content, and never in the way."""

from __future__ import annotations

import os
import pickle
import random
import re
import shutil
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any
from unittest.mock import patch

import llvmlite  # type: ignore[import-untyped]
import numba
import pytest
from numba.core.codegen import JITCPUCodegen
from numba.core.serialize import dumps

import jackbox_env
from jackbox_env.compiled import compiler, kept, tangents
from jackbox_env.compiled.impacts import quarter
from jackbox_env.compiled.trigonometry import cos_sin, cos_sin_within

TURN = (0.8, 0.6, 1), (-0.6, 0.8)  # what ``quarter`` is given and returns


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The first place for compiled code, empty; the others are beside it."""
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "place"))
    monkeypatch.setattr(compiler, "PACKAGE", tmp_path / "package")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    kept.say_once.cache_clear()
    return tmp_path / "place"


def fresh(function: Callable[..., Any]) -> Any:
    """``function`` compiled as in a process that has not compiled it yet."""
    with patch.dict(compiler._shared, clear=True):
        return compiler._compiled_now.__wrapped__(function, (), True)


def turned() -> int:
    """How often kept code is loaded in place of compiling, where ``quarter`` is called afresh. It turns right."""
    made = fresh(quarter)
    assert made(*TURN[0]) == TURN[1]
    return sum(made.stats.cache_hits.values())


def files(place: Path) -> list[Path]:
    return sorted(place.glob("compiled-*/*.kept"))


def test_code_is_kept_once_for_each_signature_and_loaded_by_later_processes(place: Path) -> None:
    made = fresh(quarter)
    for number in range(4):
        made(0.8, 0.6, number)
    assert len(files(place)) == 1
    made(0.8, 0.6, True)
    assert len(files(place)) == 2
    assert turned() == 1


def test_without_a_compiler_nothing_is_kept(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert isinstance(fresh(quarter), FunctionType)
    assert not place.exists()


def test_a_later_process_loads_the_whole_exact_model() -> None:
    jackbox_env.make_simulator(contact="exact").step(0.02, 1.0)
    code = (
        "import jackbox_env; jackbox_env.make_simulator(contact='exact').step(0.02, 1.0)\n"
        "from jackbox_env.compiled.compiler import compiled; from jackbox_env.compiled.step import step_one\n"
        "stats = compiled(step_one).stats; print(sum(stats.cache_hits.values()), sum(stats.cache_misses.values()))"
    )
    ran = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert (ran.stdout, ran.stderr) == ("1 0\n", "")


@pytest.mark.slow  # compiles anew
def test_what_is_compiled_is_said_before_any_bar_and_once(tmp_path: Path) -> None:
    root = Path(jackbox_env.__file__).parents[1]
    command = [sys.executable, str(root / "scripts" / "evaluate.py"), "--policy", "planner", "--episodes", "1"]
    environment = {**os.environ, "NUMBA_CACHE_DIR": str(tmp_path), "PYTHONPATH": str(root)}

    def said() -> str:
        return subprocess.run(command, capture_output=True, text=True, check=True, env=environment).stderr

    before, bar = said().split("planner:", 1)
    assert re.findall(r"for ([a-z ]+), once", before) == ["rollouts", "batches of environments"]
    assert "compiles" not in bar
    assert "compiles" not in said()


def test_compiling_derivatives_is_announced_once(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    kept._announce.cache_clear()
    context = fresh(quarter).targetctx
    for function in (tangents.mark_smooth, tangents.matrices, tangents.pull_back, tangents.push_forward):
        assert kept.CodeCache(function, [place], place).load_overload("numbers", context) is None  # type: ignore[arg-type]
    assert capsys.readouterr().err.count("for derivatives, once on this machine") == 1
    assert kept.CodeCache(quarter, [place], place).load_overload("numbers", context) is None  # type: ignore[arg-type]
    assert capsys.readouterr().err == ""


# -- damage -----------------------------------------------------------------------------------------------------------


def read(path: Path) -> Any:
    return pickle.loads(path.read_bytes()[kept._HEAD :])


def write(path: Path, content: Any) -> None:
    """Put content there under a checksum that is right."""
    code: bytes = dumps(content)
    path.write_bytes(kept._checksum(path, code) + code)


def test_a_file_with_any_bit_flipped_or_cut_anywhere_is_not_read(
    place: Path, cases: Callable[[int], int], monkeypatch: pytest.MonkeyPatch
) -> None:
    made = fresh(quarter)
    made(*TURN[0])
    (path,), (signature,) = files(place), made.signatures
    context = made.targetctx
    whole, rng = path.read_bytes(), random.Random(0)
    assert made._cache.load_overload(signature, context) is not None
    monkeypatch.setattr(pickle, "loads", lambda _: pytest.fail("damaged code is read"))
    damaged = [whole[:length] for length in (0, 1, 31, 32, 33, len(whole) // 2, len(whole) - 1)]
    damaged += [whole + b"\0", bytes(len(whole))]
    for place_of in rng.sample(range(len(whole)), cases(400)):
        flipped = whole[place_of] ^ 1 << rng.randrange(8)
        damaged.append(whole[:place_of] + bytes([flipped]) + whole[place_of + 1 :])
    for content in damaged:
        kept.say_once.cache_clear()
        path.write_bytes(content)
        with pytest.warns(UserWarning, match="damaged"):
            assert made._cache.load_overload(signature, context) is None


def cut(path: Path) -> None:
    path.write_bytes(path.read_bytes()[:1000])


def fill_with_what_numba_cannot_load(path: Path) -> None:
    (name, kind, (code, _)), *others = read(path)
    write(path, ((name, kind, (code, b"no bitcode")), *others))


@pytest.mark.parametrize("damage", [cut, fill_with_what_numba_cannot_load])
def test_damaged_code_is_compiled_anew_and_replaced_and_one_warning_names_the_folder(
    damage: Callable[[Path], None], place: Path
) -> None:
    turned()
    (path,) = files(place)
    damage(path)
    with pytest.warns(UserWarning, match=f"{path.parent} cannot be used") as said:
        assert turned() == 0
    assert len(said) == 1
    assert turned() == 1


def test_another_functions_code_is_damage_and_would_run_without_the_checksum(place: Path) -> None:
    fresh(cos_sin)(1.0), fresh(cos_sin_within)(1.0)
    one, other = files(place)
    content = read(other)
    shutil.copy(other, one)
    with pytest.warns(UserWarning, match="damaged"):
        fresh(cos_sin)(1.0), fresh(cos_sin_within)(1.0)
    write(one, content)
    assert fresh(cos_sin)(1e15) == fresh(cos_sin_within)(1e15) != cos_sin(1e15)


# -- writing fails ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("owner", "act"), [(Path, "write_bytes"), (os, "replace")])
def test_a_folder_that_can_no_longer_be_written_is_named_once(
    owner: Any, act: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(self: Path, *_: Any) -> None:
        raise OSError(28, "No space left on device", str(self))

    monkeypatch.setattr(owner, act, fail)
    with pytest.warns(UserWarning, match=r"cannot be kept in .*compiled-.* \(No space left on device\)") as said:
        assert turned() == turned() == 0
    assert len(said) == 1
    assert str(place) in str(said[0].message)
    assert not list(place.glob("*/*"))


# -- which folder -----------------------------------------------------------------------------------------------------


def test_a_folder_that_can_only_be_read_is_read(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    turned()
    monkeypatch.setattr(os, "access", lambda where, mode: place not in Path(where).parents)
    assert turned() == 1
    circle = fresh(cos_sin)
    assert circle(1.0) == cos_sin(1.0)  # is not there, and is kept in the next place
    assert len(files(place)) == len(files(compiler.PACKAGE / "__pycache__")) == 1


def test_a_named_place_that_cannot_be_used_is_said(place: Path) -> None:
    place.write_text("a file")
    with pytest.warns(UserWarning, match=f"kept in .*__pycache__.* cannot be used .*{place}") as said:
        assert (turned(), turned()) == (0, 1)
    assert len(said) == 1
    assert len(files(compiler.PACKAGE / "__pycache__")) == 1


def test_where_no_place_can_be_written_it_is_said(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(Path, "home", lambda: (_ for _ in ()).throw(RuntimeError("no home")))
    monkeypatch.delenv("XDG_CACHE_HOME")
    for file in (place, compiler.PACKAGE):
        file.write_text("a file, not a folder")
    with pytest.warns(UserWarning, match=f"no folder, .* compiles it anew.*{place}"):
        assert turned() == 0


def test_code_of_old_sources_is_tidied_away(place: Path) -> None:
    for number in range(12):
        folder = place / f"compiled-{number:02d}"
        folder.mkdir(parents=True)
        os.utime(folder, (number, number))
    turned()
    left = {path.name for path in place.iterdir()}
    assert left >= {f"compiled-{number:02d}" for number in range(5, 12)}
    assert len(left) == 8


# -- shipped with a wheel ---------------------------------------------------------------------------------------------

NEWER = "x86_64-unknown-linux-gnu", "newer", ",".join(sorted(kept._NEEDS))


@pytest.fixture
def shipped(place: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """What a wheel brings of ``quarter``, to a machine that has kept nothing."""
    monkeypatch.setattr(JITCPUCodegen, "magic_tuple", lambda self: NEWER)
    made = fresh(quarter)
    made(*TURN[0])
    (path,), (signature,) = files(place), made.signatures
    moved: Path = list(made._cache._paths(signature, NEWER))[-1]
    moved.parent.mkdir(parents=True)
    write(moved, read(path))
    path.unlink()
    return moved


@pytest.mark.parametrize("folders", [1, 0])
def test_shipped_code_is_loaded_where_nothing_is_kept(
    folders: int, shipped: Path, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(compiler, "cache_folders", lambda: [place][:folders])
    assert turned() == 1
    assert fresh(cos_sin)(1.0) == cos_sin(1.0)  # is not shipped
    assert len(list(place.glob("*.kept"))) == folders


@pytest.mark.parametrize(
    ("owner", "name", "other"),
    [
        (JITCPUCodegen, "magic_tuple", lambda self: (*NEWER[:2], NEWER[2].replace("+fma", "-fma"))),
        (JITCPUCodegen, "magic_tuple", lambda self: (*NEWER[:2], "")),  # what a CPU is named for is not told
        (JITCPUCodegen, "magic_tuple", lambda self: ("aarch64-unknown-linux-gnu", *NEWER[1:])),
        (kept, "EXTENSION_SUFFIXES", [".cpython-310-x86_64-linux-gnu.so"]),
        (numba, "__version__", "0.69.0"),
        (llvmlite, "__version__", "0.51.0"),
    ],
)
def test_shipped_code_that_does_not_fit_is_not_loaded(
    owner: Any, name: str, other: Any, shipped: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(owner, name, other)
    assert turned() == 0


# -- named by its source ----------------------------------------------------------------------------------------------


def test_a_change_in_any_source_of_the_package_is_seen(tmp_path: Path) -> None:
    package = tmp_path / "jackbox_env"
    shutil.copytree(Path(jackbox_env.__file__).parent, package, ignore=shutil.ignore_patterns("__pycache__"))
    digest = compiler._digest.__wrapped__
    assert digest(package) == compiler._digest()
    (package / "compiled" / "impacts.py").write_text("")
    assert digest(package) != compiler._digest()
