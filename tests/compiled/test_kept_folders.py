"""Kept code where writing fails, and in which folder it is kept."""

from __future__ import annotations

import errno
import os
import re
import shutil
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from jackbox_env.compiled import compiler as _compiled
from jackbox_env.compiled import kept
from jackbox_env.compiled.impacts import quarter
from jackbox_env.compiled.trigonometry import cos_sin
from tests.compiled.kept_code import CALL, files, found, fresh, start

RIGHT = str([[x.hex() for x in quarter(0.8, 0.6, number)] for number in range(-5, 6)])


def told(place: Path, code: str = CALL, **environment: str) -> tuple[int, list[str]]:
    """How often another process loaded kept code, and its warnings; its results are right."""
    process = start(place, code, **environment)
    out, errors = process.communicate()
    assert process.returncode == 0, errors
    bits, hits, *said = out.splitlines()
    assert bits == RIGHT
    return int(hits), said


# -- writing fails -----------------------------------------------------------------------------------------------------


def test_a_full_disk_costs_one_warning(place: Path) -> None:
    pytest.importorskip("resource")  # no file may grow beyond 1,000 bytes; Python ignores the signal that says so
    full = "import resource; resource.setrlimit(resource.RLIMIT_FSIZE, (1000, 1000))\n" + CALL
    second = "    from jackbox_env.compiled.trigonometry import cos_sin; compiled(cos_sin)(1.0)\n    for warning"
    hits, said = told(place, full.replace("    for warning", second))
    (folder,) = place.iterdir()
    sentence = (
        f"compiled code cannot be kept in {folder} (File too large), so each process compiles it anew, which takes "
        "25 to 45 s; make room there or set NUMBA_CACHE_DIR to another folder"
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


@pytest.mark.slow
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


@pytest.mark.slow
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


# -- which folder ------------------------------------------------------------------------------------------------------


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
    package = Path(kept.__file__).parents[1]
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


def test_a_function_whose_source_cannot_be_read_is_kept_by_its_content(place: Path) -> None:
    for factor, hits in ((0.5, 0), (0.25, 0), (0.5, 1)):
        written: dict[str, Any] = {"__name__": "jackbox_env"}
        exec(f"def part(x):\n    return {factor} * x", written)
        part = fresh(written["part"])
        assert (part(4.0), found(part)) == (4.0 * factor, hits)
    assert len(files(place)) == 2


def test_functions_that_differ_in_anything_do_not_share_code(place: Path, tmp_path: Path) -> None:
    file, made = tmp_path / "scaling.py", []
    for text in ("BY = 2.0", "BY = 3.0"):  # read where the function stands
        file.write_text(f"{text}\n\n\ndef scaled(x):\n    return BY * x\n")
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
