"""Kept code is checked before it is loaded, whatever happened to its file."""

from __future__ import annotations

import os
import random
import shutil
import warnings
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
import pytest
from numba.core.caching import FunctionCache
from numba.core.dispatcher import Dispatcher

from jackbox_env.compiled import kept
from jackbox_env.compiled.impacts import quarter
from jackbox_env.compiled.trigonometry import cos_sin
from tests.compiled.kept_code import files, found, fresh, start

FULL = os.environ.get("JACKBOX_EXTREMES") == "full"


# -- what is relied on in numba ----------------------------------------------------------------------------------------


def test_numba_asks_the_cache_once_for_each_signature_and_never_for_a_call(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    for name in ("load_overload", "save_overload"):
        method = getattr(kept.CodeCache, name)

        def noted(*given: Any, name: str = name, method: Any = method) -> Any:
            asked.append(name)
            return method(*given)

        monkeypatch.setattr(kept.CodeCache, name, noted)
    turn = fresh(quarter)
    assert isinstance(turn, Dispatcher)  # numba's own class, so calls cost the same
    assert isinstance(vars(numba.njit(cache=True)(_on_disk))["_cache"], FunctionCache)  # the attribute that we replace
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


# -- damage ------------------------------------------------------------------------------------------------------------


def test_a_file_with_any_bit_flipped_or_cut_anywhere_is_not_read(place: Path) -> None:
    fresh(quarter)(0.8, 0.6, 1)
    (path,) = files(place)
    whole, rng = path.read_bytes(), random.Random(0)
    assert kept._read(path)
    cuts = [whole[:length] for length in (0, 1, 31, 32, 33, *rng.sample(range(len(whole)), 50), len(whole) - 1)]
    flips = [_flipped(whole, rng) for _ in range(500)]
    for damaged in (*cuts, *flips, whole + b"\0", bytes(len(whole))):
        path.write_bytes(damaged)
        with pytest.raises(kept._DamageError):
            kept._read(path)


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
        monkeypatch.setattr(kept, "_said", set())
        with warnings.catch_warnings(record=True) as said:
            warnings.simplefilter("always")
            made, angles = fresh(cos_sin), [rng.uniform(-1e4, 1e4) for _ in range(100)]
            assert [made(angle) for angle in angles] == [cos_sin(angle) for angle in angles]
        assert [str(warning.message) for warning in said] == [
            f"compiled code kept in {path.parent} cannot be used (damaged); compiling it anew takes 25 to 45 s"
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
    (name, kind, (code, _)), *others = kept._read(path)
    for content in ((), "text", ((name, kind, (code, b"no bitcode")), *others)):
        kept._said.clear()
        kept._write(path, content)
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
