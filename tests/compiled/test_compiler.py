"""What the compiled code relies on: its cache, its cosines, its random numbers, its threads."""

from __future__ import annotations

import itertools
import math
import os
import shutil
import subprocess
import sys
import time
from pathlib import Path

import mpmath as mp
import numpy as np
import pytest
from numpy.typing import NDArray

import jackbox_env
from jackbox_env.batches.threads import Threads, thread_count
from jackbox_env.compiled.compiler import compiled, compiled_with
from jackbox_env.compiled.generator import fresh, packed, seeded, uniform
from jackbox_env.compiled.trigonometry import _TURNS, _TURNS_OVER, FARTHEST, LARGEST, cos_sin, cos_sin_within

PACKAGE = Path(jackbox_env.__file__).parent
STEP = "import jackbox_env; s = jackbox_env.make_simulator(contact='exact'); s.step(0.02, 1.0); "


def run(code: str, **environment: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False, env={**os.environ, **environment}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.strip()


# -- the cache --------------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_a_later_process_finds_the_compiled_code(tmp_path: Path) -> None:
    stats = (
        "from jackbox_env.compiled.compiler import compiled; from jackbox_env.compiled.step import step_one;"
        "c = compiled(step_one).stats; print(sum(c.cache_hits.values()), sum(c.cache_misses.values()))"
    )
    assert run(STEP + stats, NUMBA_CACHE_DIR=str(tmp_path)) == "0 1"
    assert run(STEP + stats, NUMBA_CACHE_DIR=str(tmp_path)) == "1 0"


def test_a_change_in_any_file_is_seen(tmp_path: Path) -> None:
    # Numba itself looks only at the file of the function that is kept; here the turn of a wall is in another one.
    shutil.copytree(PACKAGE, tmp_path / "jackbox_env", ignore=shutil.ignore_patterns("__pycache__"))
    gap = (
        "from jackbox_env.compiled.compiler import compiled; from jackbox_env.compiled.motion import foot_gap;"
        "gap, *_ = compiled(foot_gap)(jackbox_env.Scene().numbers, 1.0, 0.0, 0.8, 0.6, 0.0, 1);"
        "print(round(gap, 3), jackbox_env.__file__)"
    )
    places = {"NUMBA_CACHE_DIR": str(tmp_path / "cache")}
    first = f"import sys; sys.path.insert(0, {str(tmp_path)!r}); import jackbox_env; "
    before, file = run(first + gap, **places).split()
    assert Path(file) == tmp_path / "jackbox_env" / "__init__.py"
    assert run(first + gap, **places).split()[0] == before
    law = tmp_path / "jackbox_env" / "compiled" / "impacts.py"
    law.write_text(law.read_text() + "\n\ndef quarter(turns, x, y):\n    return 0.25, 0.5\n")
    assert run(first + gap, **places).split()[0] == "4.75"


def test_nowhere_to_keep_compiled_code_is_said(tmp_path: Path) -> None:
    blocked = tmp_path / "a file, not a folder"
    blocked.write_text("")
    code = (
        "import warnings, jackbox_env.compiled.compiler as c; from pathlib import Path;"
        f"c.PACKAGE = Path({str(blocked)!r}); c._digest = lambda: 'x';"
        "warnings.simplefilter('error');"
        "from jackbox_env.compiled.trigonometry import cos_sin;"
        "\ntry: c.compiled(cos_sin)\nexcept UserWarning as w: print(w)"
    )
    said = run(code, NUMBA_CACHE_DIR=str(blocked), XDG_CACHE_HOME=str(blocked))
    assert said.startswith("no folder to keep compiled code in can be written, so each process compiles it anew")


def test_another_function_can_take_a_functions_place() -> None:
    # Compiled code turns by quarters with ``quarter``; here another rule takes its place.
    from jackbox_env.compiled.impacts import quarter
    from jackbox_env.compiled.motion import foot_gap

    numbers = jackbox_env.Scene().numbers
    given = numbers, 1.0, 0.0, 0.8, 0.6, 0.0, 1
    assert compiled_with(foot_gap)(*given) == compiled(foot_gap)(*given) == foot_gap(*given)
    swapped = compiled_with(foot_gap, quarter=_other_quarter)(*given)
    assert swapped[0] == numbers.box_half_width - 1.0 - 0.25
    assert quarter(0.8, 0.6, 1) == (-0.6, 0.8)


def _other_quarter(cosine: float, sine: float, quarters: int) -> tuple[float, float]:
    return 0.25, 0.75


_other_quarter.__module__ = "jackbox_env"


@pytest.mark.slow
def test_compiled_code_of_old_sources_is_tidied_away(tmp_path: Path) -> None:
    for number in range(12):
        folder = tmp_path / f"compiled-{number:02d}"
        folder.mkdir()
        os.utime(folder, (number, number))
    run(STEP, NUMBA_CACHE_DIR=str(tmp_path))
    left = sorted(path.name for path in tmp_path.iterdir())
    assert len(left) == 8
    assert "compiled-04" not in left
    assert "compiled-11" in left


# -- cosines ----------------------------------------------------------------------------------------------------------


def test_cosine_and_sine_are_right_to_the_last_place() -> None:
    rng = np.random.default_rng(0)
    quarters = np.arange(-40, 41) * (math.pi / 2.0)
    angles = [
        *rng.uniform(-10.0, 10.0, 500), *rng.uniform(-LARGEST, LARGEST, 500), *quarters, *(quarters + 1e-9),
        *np.ldexp(1.0, np.arange(-1074, 20)), *(rng.integers(1, 600000, 300) * (math.pi / 2.0)), 0.0, -0.0,
    ]  # fmt: skip
    fast = compiled(cos_sin)
    for angle in map(float, angles):
        with mp.workdps(60):
            expected = float(mp.cos(angle)), float(mp.sin(angle))
        found = fast(angle)
        assert found == cos_sin(angle)  # compiled and plain give the same bits
        for value, reference in zip(found, expected, strict=True):
            assert abs(value - reference) <= math.ulp(reference)


def test_many_turns_are_taken_off_first() -> None:
    with mp.workdps(40):
        assert mp.mpf(_TURNS) - 58 * mp.pi == pytest.approx(_TURNS_OVER, rel=1e-15)
    rng = np.random.default_rng(1)
    angles = [
        *10.0 ** rng.uniform(6.0, 15.95, 1000), *(rng.integers(10**6, 10**12, 500) * (math.pi / 2.0)), LARGEST,
        *(rng.integers(10**4, 10**12, 500) * _TURNS), np.nextafter(FARTHEST, 0.0), np.nextafter(LARGEST, 0.0),
    ]  # fmt: skip
    fast = compiled(cos_sin)
    for angle in map(float, angles):
        with mp.workdps(60):
            expected = mp.cos(angle), mp.sin(angle)
            found = fast(angle)
            for value, reference in zip(found, expected, strict=True):
                assert abs(value - reference) <= 1.2 * math.ulp(float(reference)) + 1e-18
        assert found == cos_sin(angle)
        assert fast(-angle) == (found[0], -found[1])


def test_angles_beyond_the_reduction_are_handed_on() -> None:
    fast = compiled(cos_sin)
    for angle in (2.0**53, -1e22, 1e300):
        assert fast(angle) == (math.cos(angle), math.sin(angle))
    for angle in (math.inf, -math.inf, math.nan):
        assert all(math.isnan(value) for value in fast(angle))
    assert abs(cos_sin_within(1e15)[0] - math.cos(1e15)) > 1e-3  # so they go to ``math``


# -- random numbers ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("seed", [0, 1, 12345, 2**32, 2**64 + 5, 2**200])
def test_draws_are_those_of_numpys_generator(seed: int) -> None:
    bits = np.random.PCG64(seed)
    draw, words, generator = compiled(uniform), seeded(seed), np.random.Generator(bits)
    assert [draw(words) for _ in range(1000)] == generator.uniform(size=1000).tolist()
    np.testing.assert_array_equal(words, packed(generator))


def test_unseeded_generators_differ_and_are_sound() -> None:
    words = fresh(1000)
    assert words.nbytes == 32 * 1000
    assert (words[:, 3] % 2 == 1).all()  # a PCG's increment is odd
    draw = compiled(uniform)
    draws = np.array([[draw(words[number]) for _ in range(50)] for number in range(1000)])
    assert len(np.unique(draws)) == draws.size
    assert draws.mean() == pytest.approx(0.5, abs=0.01)
    assert np.abs(np.corrcoef(draws[:, 0], draws[:, 1])[0, 1]) < 0.15


# -- threads ----------------------------------------------------------------------------------------------------------


def test_threads_share_out_everything_once() -> None:
    for count in (1, 2, 3, 7):
        for total in (7, 8, 1000):
            seen = np.zeros(total, dtype=np.int64)

            def work(number: int, low: int, high: int, seen: NDArray[np.int64] = seen) -> int:
                seen[low:high] += 1
                return number

            numbers = Threads(count).run(work, total)
            assert set(numbers) <= set(range(count))
            assert (seen == 1).all()
            lows = Threads(count).run(lambda number, low, high: low, total, grain=3)
            assert lows == sorted(lows)
            assert all(after - before >= 3 for before, after in itertools.pairwise(lows))


def test_an_error_in_a_thread_is_raised_and_the_threads_live_on() -> None:
    threads = Threads(2)

    def fail(number: int, low: int, high: int) -> None:
        time.sleep(0.01)
        if number == 1:
            raise ValueError("from a thread")

    with pytest.raises(ValueError, match="from a thread"):
        threads.run(fail, 10)
    assert sum(threads.run(lambda number, low, high: high - low, 10)) == 10


def test_nobody_works_on_after_an_interruption() -> None:
    threads, begun, done = Threads(4), [], []

    def interrupted(number: int, low: int, high: int) -> None:
        if number == 0:
            time.sleep(0.1)  # until the others are at work
            raise KeyboardInterrupt
        begun.append(low)
        time.sleep(0.2)
        done.append(low)

    with pytest.raises(KeyboardInterrupt):
        threads.run(interrupted, 1000)
    left = list(done)
    assert sorted(begun) == sorted(left)
    assert len(left) == 3
    time.sleep(0.3)
    assert done == left


def test_the_number_of_threads() -> None:
    assert thread_count(3, 100) == 3
    assert thread_count(3, 2) == 2
    assert thread_count(None, 0) == 1
    assert 1 <= thread_count(None, 10**9) <= (os.cpu_count() or 1)
    for bad in (0, -1, 1.5, "2", True):
        with pytest.raises((TypeError, ValueError), match="num_threads must be a whole number >= 1, got"):
            thread_count(bad, 10)  # type: ignore[arg-type]
