"""Building blocks of the compiled code: cosines, random numbers, threads, arguments."""

from __future__ import annotations

import itertools
import math
from types import FunctionType
from typing import Any

import mpmath as mp
import numba
import numpy as np
import pytest
from numba.core.dispatcher import Dispatcher
from numba.core.registry import cpu_target

from jackbox_env.exact import run
from jackbox_env.exact.geometry import _TURNS, FARTHEST, ONE_REDUCTION, cos_sin, cos_sin_within
from jackbox_env.exact.pcg64 import fresh, seeded, uniform, words_of
from jackbox_env.jit import compiler
from jackbox_env.jit.compiler import compiled
from jackbox_env.model.landing import QUARTER
from jackbox_env.model.scene import remainder


def test_packed_arguments_have_room() -> None:
    context = cpu_target.target_context
    for make in compiler._EXAMPLES.values():
        assert context.get_abi_sizeof(context.get_value_type(numba.typeof(make()))) <= 8 * compiler.PACKED


# -- exceptions --------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("last", [1, 5, 40])
def test_an_exception_while_a_function_is_prepared_leaves_nothing(last: int, monkeypatch: pytest.MonkeyPatch) -> None:
    compilation, jitted, calls = compiler._Compilation((), True), compiler._jitted, itertools.count(1)

    def interrupted(*arguments: Any) -> Any:
        if next(calls) == last:
            raise KeyboardInterrupt
        return jitted(*arguments)

    monkeypatch.setattr(compiler, "_jitted", interrupted)
    with pytest.raises(KeyboardInterrupt):
        compilation.compiled(run.run)
    assert isinstance(compilation.compiled(run.run), Dispatcher)
    assert not [one for one in compilation._twins.values() if isinstance(one, FunctionType)]


# -- cosines ----------------------------------------------------------------------------------------------------------

RNG = np.random.default_rng(0)
QUARTERS = np.arange(-40, 41) * (math.pi / 2.0)
ANGLES = {
    "to the last place": [
        *RNG.uniform(-10.0, 10.0, 300), *RNG.uniform(-ONE_REDUCTION, ONE_REDUCTION, 300), *QUARTERS, *(QUARTERS + 1e-9),
        *np.ldexp(1.0, np.arange(-1074, 20)), *(RNG.integers(1, 600000, 300) * (math.pi / 2.0)), 0.0, -0.0,
    ],
    "after many turns": [
        *10.0 ** RNG.uniform(6.0, 15.95, 500), *(RNG.integers(10**6, 10**12, 300) * (math.pi / 2.0)), ONE_REDUCTION,
        *(RNG.integers(10**4, 10**12, 300) * _TURNS), np.nextafter(FARTHEST, 0.0), np.nextafter(ONE_REDUCTION, 0.0),
    ],
}  # fmt: skip


@pytest.mark.parametrize(("divisor", "largest"), [(_TURNS, 2.0**53), (QUARTER, 2.0**53), (3.0, 3.0 * 2.0**53)])
def test_a_remainder_has_the_bits_of_the_c_librarys(divisor: float, largest: float) -> None:
    multiples = np.floor(2.0 ** RNG.uniform(0.0, 45.0, 2000)) * divisor
    for number in (*2.0 ** RNG.uniform(-3.0, math.log2(largest), 4000), *multiples, *np.nextafter(multiples, 0.0), 0.0):
        assert compiled(remainder)(number, divisor) == math.fmod(number, divisor) == remainder(number, divisor)


@pytest.mark.parametrize(("kind", "ulps"), [("to the last place", 1.0), ("after many turns", 1.2)])
def test_cosine_and_sine_are_right(kind: str, ulps: float) -> None:
    fast = compiled(cos_sin)
    for angle in map(float, ANGLES[kind]):
        values = fast(angle)
        assert values == cos_sin(angle)  # compiled and plain give the same bits
        assert fast(-angle) == (values[0], -values[1])
        with mp.workdps(60):
            for value, reference in zip(values, (mp.cos(angle), mp.sin(angle)), strict=True):
                assert abs(value - reference) <= ulps * math.ulp(float(reference)) + (ulps > 1.0) * 1e-18


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
    np.testing.assert_array_equal(words, words_of(generator))


def test_unseeded_generators_differ_and_are_sound() -> None:
    words = fresh(1000)
    assert words.nbytes == 48 * 1000
    assert (words[:, 3] % 2 == 1).all()  # a PCG's increment is odd
    draws = np.array([compiled(uniform)(row) for row in words])
    assert len(np.unique(draws)) == 1000
    assert draws.mean() == pytest.approx(0.5, abs=0.05)


# -- threads ----------------------------------------------------------------------------------------------------------
