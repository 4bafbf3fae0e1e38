"""Compiled code on disk: whatever happens to it, results are right and one warning names the folder."""

from __future__ import annotations

import errno
import linecache
import os
import random
import re
import shutil
import subprocess
import sys
import time
import warnings
from collections.abc import Callable
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
import pytest
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

from jackbox_env import _code_cache
from jackbox_env.compiled import compiler as _compiled
from jackbox_env.compiled.impacts import quarter
from jackbox_env.compiled.trigonometry import cos_sin

FULL = os.environ.get("JACKBOX_EXTREMES") == "full"
# One line for the results' bits, one for how often kept code was loaded, then the warnings.
CALL = """
import warnings
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.impacts import quarter
with warnings.catch_warnings(record=True) as said:
    warnings.simplefilter("always")
    turn = compiled(quarter)
    print([[x.hex() for x in turn(0.8, 0.6, number)] for number in range(-5, 6)])
    print(sum(turn.stats.cache_hits.values()))
    for warning in said:
        print(warning.message)
"""
RIGHT = str([[x.hex() for x in quarter(0.8, 0.6, number)] for number in range(-5, 6)])


@pytest.fixture(autouse=True)
def nothing_said(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(_code_cache, "_said", set())


@pytest.fixture
def place(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The only place for compiled code."""
    place = tmp_path / "place"
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(place))
    monkeypatch.setattr(_compiled, "PACKAGE", tmp_path / "package")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "home"))
    return place


def fresh(function: Callable[..., Any]) -> Any:
    """``function`` compiled as in a process that has not compiled it yet."""
    assert isinstance(function, FunctionType)
    return _compiled._compile_once.__wrapped__(function, (), True)


def found(made: Any) -> int:
    """How often kept code was loaded in place of compiling."""
    return sum(made.stats.cache_hits.values())


def files(place: Path, kind: str = "kept") -> list[Path]:
    return sorted(place.glob(f"compiled-*/*.{kind}"))


def start(place: Path, code: str = CALL, **environment: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
        env={**os.environ, "NUMBA_CACHE_DIR": str(place), **environment},
    )  # fmt: skip


def told(place: Path, code: str = CALL, **environment: str) -> tuple[int, list[str]]:
    """How often another process loaded kept code, and its warnings; its results are right."""
    process = start(place, code, **environment)
    out, errors = process.communicate()
    assert process.returncode == 0, errors
    bits, hits, *said = out.splitlines()
    assert bits == RIGHT
    return int(hits), said


# -- what is relied on in numba ---------------------------------------------------------------------------------------


def test_numba_asks_the_cache_once_for_each_signature_and_never_for_a_call(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    for name in ("load_overload", "save_overload"):
        method = getattr(_code_cache.CodeCache, name)

        def noted(*given: Any, name: str = name, method: Any = method) -> Any:
            asked.append(name)
            return method(*given)

        monkeypatch.setattr(_code_cache.CodeCache, name, noted)
    turn = fresh(quarter)
    assert isinstance(turn, Dispatcher)  # numba's own, called as directly as any
    assert isinstance(vars(numba.njit(cache=True)(_on_disk))["_cache"], FunctionCache)  # stands where ours does
    for number in range(100):
        turn(0.8, 0.6, number)
    assert asked == ["load_overload", "save_overload"]
    turn(0.8, 0.6, True)
    assert asked == ["load_overload", "save_overload"] * 2
    assert len(files(place)) == 2
    assert (turn.stats.cache_path, found(turn)) == (str(files(place)[0].parent), 0)
    again = fresh(quarter)
    again(0.8, 0.6, 1)
    assert (found(again), asked[4:]) == (1, ["load_overload"])


def _on_disk(x: float) -> float:
    return x


def test_without_a_compiler_nothing_is_kept(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "DISABLE_JIT", 1)
    assert isinstance(fresh(quarter), FunctionType)
    assert not place.exists()


# -- damage -----------------------------------------------------------------------------------------------------------


def test_a_file_with_any_bit_flipped_or_cut_anywhere_is_not_read(place: Path) -> None:
    fresh(quarter)(0.8, 0.6, 1)
    (path,) = files(place)
    whole, rng = path.read_bytes(), random.Random(0)
    assert _code_cache._read(path)
    cuts = [whole[:length] for length in (0, 1, 31, 32, 33, *rng.sample(range(len(whole)), 50), len(whole) - 1)]
    flips = [_flipped(whole, rng) for _ in range(500)]
    for damaged in (*cuts, *flips, whole + b"\0", bytes(len(whole))):
        path.write_bytes(damaged)
        with pytest.raises(_code_cache._DamageError):
            _code_cache._read(path)


def _flipped(whole: bytes, rng: random.Random) -> bytes:
    damaged = bytearray(whole)
    damaged[rng.randrange(len(whole))] ^= 1 << rng.randrange(8)
    return bytes(damaged)


def test_damaged_code_is_compiled_anew_and_replaced_and_the_folder_named(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    fresh(cos_sin)(1.0)
    (path,) = files(place)
    whole, rng = path.read_bytes(), random.Random(1)
    for number in range(400 if FULL else 8):
        path.write_bytes(whole[: rng.randrange(len(whole))] if number % 4 == 0 else _flipped(whole, rng))
        monkeypatch.setattr(_code_cache, "_said", set())
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            made, angles = fresh(cos_sin), [rng.uniform(-1e4, 1e4) for _ in range(100)]
            assert [made(angle) for angle in angles] == [cos_sin(angle) for angle in angles]
        assert [str(warning.message) for warning in said] == [
            f"compiled code kept in {path.parent} cannot be used (damaged); compiling it anew takes some 15 s"
        ]
        after = fresh(cos_sin)
        assert (after(1.0), found(after)) == (cos_sin(1.0), 1)


def test_code_under_another_name_is_damage(place: Path) -> None:
    turn, circle = fresh(quarter), fresh(cos_sin)
    turn(0.8, 0.6, 1)
    circle(1.0)
    of_circle, of_turn = sorted(files(place), key=lambda path: "quarter" in path.name)
    shutil.copy(of_turn, of_circle)
    with pytest.warns(UserWarning, match=r"cannot be used \(damaged\)"):
        assert fresh(cos_sin)(1.0) == cos_sin(1.0)


def test_whole_files_that_numba_cannot_load_are_replaced_too(place: Path) -> None:
    fresh(quarter)(0.8, 0.6, 1)
    (path,) = files(place)
    (name, kind, (code, _)), *others = _code_cache._read(path)
    for content in ((), "text", ((name, kind, (code, b"no bitcode")), *others)):
        _code_cache._said.clear()
        _code_cache._write(path, content)
        with pytest.warns(UserWarning, match=f"kept in {path.parent} cannot be used") as said:
            assert fresh(quarter)(0.8, 0.6, 1) == (-0.6, 0.8)
        assert len(said) == 1
        after = fresh(quarter)
        assert (after(0.8, 0.6, 1), found(after)) == ((-0.6, 0.8), 1)


def test_a_warning_made_an_error_leaves_the_function_usable(place: Path) -> None:
    fresh(quarter)(0.8, 0.6, 1)
    (path,) = files(place)
    path.write_bytes(b"")
    turn = fresh(quarter)
    with pytest.raises(UserWarning, match="cannot be used"):  # as pytest is told to make every warning
        turn(0.8, 0.6, 1)
    assert turn(0.8, 0.6, 1) == (-0.6, 0.8)


@pytest.mark.skipif(not FULL, reason="compiles the exact model three times; JACKBOX_EXTREMES=full runs it")
def test_a_damaged_simulator_takes_the_same_steps(place: Path) -> None:
    code = (
        "import jackbox_env, warnings\n"
        "with warnings.catch_warnings(record=True) as said:\n"
        "    warnings.simplefilter('always')\n"
        "    simulator = jackbox_env.make_simulator(contact='exact')\n"
        "    for _ in range(1000): simulator.step(0.02)\n"
        "print(simulator.state.tobytes().hex(), len(said))"
    )
    expected = start(place, code).communicate()[0].split()
    (path,) = files(place)
    whole = path.read_bytes()
    for damaged in (whole[: len(whole) // 2], _flipped(whole, random.Random(2))):
        path.write_bytes(damaged)
        assert start(place, code).communicate()[0].split() == [expected[0], "1"]
        assert start(place, code).communicate()[0].split() == [expected[0], "0"]


# -- writing fails ----------------------------------------------------------------------------------------------------


def test_a_full_disk_costs_one_warning(place: Path) -> None:
    pytest.importorskip("resource")  # no file may grow beyond 1,000 bytes; Python ignores the signal that says so
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n" + CALL
    second = "    from jackbox_env.compiled.trigonometry import cos_sin; compiled(cos_sin)(1.0)\n    for warning"
    hits, said = told(place, full.replace("    for warning", second))
    (folder,) = place.iterdir()
    sentence = (
        f"compiled code cannot be kept in {folder} (File too large), so each process compiles it anew, which takes "
        "some 15 s; make room there or set NUMBA_CACHE_DIR to another folder"
    )
    assert (hits, said) == (0, [sentence])
    assert not list(folder.iterdir())
    assert fresh(quarter)(0.8, 0.6, 1) == (-0.6, 0.8)
    assert len(files(place)) == 1


@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EDQUOT, errno.EROFS, errno.EACCES, errno.EIO])
@pytest.mark.parametrize("act", ["write_bytes", "replace"])
def test_a_folder_that_can_no_longer_be_written_is_named(
    act: str, number: int, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    turn = fresh(quarter)
    (folder,) = place.iterdir()

    def fail(self: Path, *_: Any) -> None:
        raise OSError(number, os.strerror(number), str(self))

    monkeypatch.setattr(Path, act, fail)
    sentence = f"compiled code cannot be kept in {folder} ({os.strerror(number)}), so each process compiles it anew"
    with pytest.warns(UserWarning, match=re.escape(sentence)) as said:
        assert turn(0.8, 0.6, 1) == fresh(quarter)(0.8, 0.6, 1) == (-0.6, 0.8)
    assert len(said) == 1
    assert not list(folder.iterdir())


def test_damage_on_a_full_disk_costs_one_warning(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fresh(quarter)(0.8, 0.6, 1)
    (path,) = files(place)
    path.write_bytes(b"")
    monkeypatch.setattr(Path, "replace", lambda self, _: self.rmdir())  # not for files
    with pytest.warns(UserWarning, match=str(path.parent)) as said:
        assert fresh(quarter)(0.8, 0.6, 1) == (-0.6, 0.8)
    assert len(said) == 1


def test_a_folder_removed_while_the_process_runs_is_made_again(place: Path) -> None:
    turn = fresh(quarter)
    shutil.rmtree(place)
    assert turn(0.8, 0.6, 1) == (-0.6, 0.8)
    after = fresh(quarter)
    after(0.8, 0.6, 1)
    assert found(after) == 1
    turn = fresh(cos_sin)
    shutil.rmtree(place)
    place.write_text("a file in its way")
    with pytest.warns(UserWarning, match=str(place)):
        assert turn(1.0) == cos_sin(1.0)


@pytest.mark.skipif(not hasattr(os, "fork"), reason="needs a process that is like another")
def test_a_writer_killed_at_any_moment_leaves_nothing_that_is_loaded(place: Path) -> None:
    code = f"""
import os, signal
from pathlib import Path
from jackbox_env.compiled.compiler import compiled
from jackbox_env.compiled.impacts import quarter

kill = lambda: os.kill(os.getpid(), signal.SIGKILL)
write, put = Path.write_bytes, Path.replace
kills = [
    (lambda self, data: kill(), put),
    (lambda self, data: (write(self, data[:999]), kill()), put),
    (write, lambda self, to: kill()),
    (write, lambda self, to: (put(self, to), kill())),
]
for Path.write_bytes, Path.replace in kills:
    child = os.fork()
    if not child:
        compiled(quarter)(0.8, 0.6, 1)
        os._exit(0)
    assert os.waitpid(child, 0)[1] == signal.SIGKILL
    print(len(list(Path({str(place)!r}).rglob("*.kept"))), len(list(Path({str(place)!r}).rglob("*.tmp"))))
"""
    out, errors = start(place, code).communicate()
    assert out.splitlines() == ["0 0", "0 1", "0 2", "1 2"], errors
    turn, circle = fresh(quarter), fresh(cos_sin)
    assert (turn(0.8, 0.6, 1), found(turn)) == ((-0.6, 0.8), 1)
    old, young = files(place, "tmp")
    os.utime(old, (time.time() - 4000.0,) * 2)
    assert circle(1.0) == cos_sin(1.0)
    assert files(place, "tmp") == [young]  # whose writer may still be at work


def test_processes_that_compile_at_once_do_not_disturb_each_other(place: Path) -> None:
    # Two kinds of processor among them, as where the folder lies on a network.
    for process in [start(place), start(place), start(place, NUMBA_CPU_NAME="generic")]:
        out, errors = process.communicate()
        assert process.returncode == 0, errors
        assert out.splitlines()[0] == RIGHT
        assert len(out.splitlines()) == 2  # without a warning
    assert (len(files(place)), len(files(place, "tmp"))) == (2, 0)
    assert told(place, NUMBA_CPU_NAME="generic") == (1, [])
    turn = fresh(quarter)
    assert (turn(0.8, 0.6, 1), found(turn)) == ((-0.6, 0.8), 1)


# -- which folder -----------------------------------------------------------------------------------------------------


def test_a_folder_that_can_only_be_read_is_read(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    fresh(quarter)(0.8, 0.6, 1)
    (path,) = files(place)
    monkeypatch.setattr(os, "access", lambda where, mode: place not in Path(where).parents)
    turn, circle = fresh(quarter), fresh(cos_sin)
    assert (turn(0.8, 0.6, 1), found(turn)) == ((-0.6, 0.8), 1)
    assert circle(1.0) == cos_sin(1.0)  # is not there, and is kept in the next place
    assert files(place) == [path]
    assert len(files(_compiled.PACKAGE / "__pycache__")) == 1
    again = fresh(cos_sin)
    again(1.0)
    assert found(again) == 1


def test_a_place_that_was_named_and_cannot_be_used_is_said(place: Path) -> None:
    place.write_text("a file")
    with pytest.warns(UserWarning, match="as NUMBA_CACHE_DIR cannot be used") as said:
        assert fresh(quarter)(0.8, 0.6, 1) == fresh(quarter)(0.8, 0.6, 1)
    (folder,) = (_compiled.PACKAGE / "__pycache__").iterdir()
    assert [str(warning.message) for warning in said] == [
        f"compiled code is kept in {folder}, as NUMBA_CACHE_DIR cannot be used ({place}: Not a directory)"
    ]


def test_a_user_without_a_home_is_told_too(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def homeless() -> Path:
        raise RuntimeError("Could not determine home directory.")

    monkeypatch.setattr(Path, "home", homeless)
    monkeypatch.delenv("XDG_CACHE_HOME")
    for file in (place, _compiled.PACKAGE):
        file.write_text("a file, not a folder")
    with pytest.warns(UserWarning, match="no folder to keep compiled code in can be written") as said:
        assert fresh(quarter)(0.8, 0.6, 1) == (-0.6, 0.8)
    assert str(place) in str(said[0].message)


def test_a_change_of_the_working_folder_does_not_move_the_kept_code(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(place.parent)
    monkeypatch.setenv("NUMBA_CACHE_DIR", "place")
    turn = fresh(quarter)
    (place.parent / "elsewhere").mkdir()
    monkeypatch.chdir("elsewhere")
    turn(0.8, 0.6, 1)
    assert len(files(place)) == 1


def test_a_package_in_an_archive_knows_its_source(tmp_path: Path) -> None:
    package = Path(_code_cache.__file__).parent
    shutil.copytree(package, tmp_path / "all" / package.name, ignore=shutil.ignore_patterns("__pycache__"))
    archive = shutil.make_archive(str(tmp_path / "archive"), "zip", tmp_path / "all")
    code = CALL + "    import jackbox_env.compiled.compiler as c; print(c.__file__, c._digest())"
    _, said = told(tmp_path / "place", code, PYTHONPATH=archive, PYTHONSAFEPATH="1")
    file, digest = said[0].split()
    assert (Path(file).is_relative_to(archive), digest) == (True, _compiled._digest())
    assert len(files(tmp_path / "place")) == 1


def test_folders_that_vanish_while_old_ones_are_tidied_away_do_no_harm(place: Path) -> None:
    place.mkdir()
    (place / "compiled-gone").symlink_to(place / "nothing")
    assert fresh(quarter)(0.8, 0.6, 1) == (-0.6, 0.8)
    assert len(files(place)) == 1


def test_a_function_without_its_source_is_not_kept(place: Path) -> None:
    written: dict[str, Any] = {"__name__": "jackbox_env"}
    exec("def halved(x):\n    return 0.5 * x", written)
    with pytest.warns(UserWarning, match="the source of halved cannot be read, so what is compiled of it is not kept"):
        assert fresh(written["halved"])(3.0) == 1.5
    assert not files(place)


def test_functions_that_differ_in_anything_do_not_share_code(place: Path, tmp_path: Path) -> None:
    file, made = tmp_path / "scaling.py", []
    for text in ("BY = 2.0", "BY = 3.0"):  # read where the function stands
        file.write_text(f"{text}\n\n\ndef scaled(x):\n    return BY * x\n")
        linecache.checkcache(str(file))
        read: dict[str, Any] = {"__name__": "scaling"}
        exec(compile(file.read_text(), file, "exec"), read)
        made.append(fresh(read["scaled"]))
    made += [fresh(_scaling(4.0)), fresh(_scaling(5.0))]  # held in a closure
    assert [scaled(1.0) for scaled in made] == [2.0, 3.0, 4.0, 5.0]
    assert [found(scaled) for scaled in made] == [0] * 4
    again = fresh(_scaling(4.0))
    assert (again(1.0), found(again)) == (4.0, 1)


def _scaling(by: float) -> Callable[[float], float]:
    def scaled(x: float) -> float:
        return by * x

    return scaled
