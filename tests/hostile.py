"""Values that people and programs pass by mistake, and how a call may answer."""

from __future__ import annotations

import decimal
import fractions
import math
import warnings
from collections.abc import Callable
from typing import Any

import gymnasium as gym
import numpy as np


class FailsError(Exception):
    """Raised by values that fail when they are looked at; no call may pass it on."""


class FailsToConvert:
    """Fails as a number, as an index, as an array, as a sequence, and when shown."""

    def _fail(self, *_: Any, **__: Any) -> Any:
        raise FailsError("what a value\nraises is its own")

    __float__ = __int__ = __index__ = __array__ = __len__ = __iter__ = __getitem__ = __repr__ = __str__ = _fail
    __bool__ = __eq__ = __lt__ = __gt__ = __le__ = __ge__ = __abs__ = __neg__ = _fail
    __hash__ = object.__hash__


class FailsAsFloat(float):
    """A float that fails when made a plain one, and when shown."""

    def __float__(self) -> float:
        raise FailsError("no")

    def __repr__(self) -> str:
        raise FailsError("no")


class LongToShow:
    """Its repr has many lines."""

    def __repr__(self) -> str:
        return "long\n" * 10_000


def longdouble(digits: str) -> Any:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return np.longdouble(digits)


def read_only(values: Any) -> Any:
    array = np.array(values)
    array.flags.writeable = False
    return array


def failing(count: int) -> Any:
    array = np.full(count, None, dtype=object)
    for place in range(count):
        array[place] = FailsToConvert()
    return array


def with_itself() -> list[Any]:
    listed: list[Any] = []
    listed.append(listed)
    return listed


NUMBERS: dict[str, Callable[[], Any]] = {
    "nan": lambda: math.nan,
    "inf": lambda: math.inf,
    "-inf": lambda: -math.inf,
    "1e308": lambda: 1e308,
    "-1e308": lambda: -1e308,
    "1e60": lambda: 1e60,
    "1e30": lambda: 1e30,
    "1e9": lambda: 1e9,
    "1e-9": lambda: 1e-9,
    "1e-60": lambda: 1e-60,
    "5e-324": lambda: 5e-324,
    "0": lambda: 0,
    "-0.0": lambda: -0.0,
    "-1": lambda: -1,
    "2.5": lambda: 2.5,
    "10^18": lambda: 10**18,
    "-10^400": lambda: -(10**400),
    "10^400": lambda: 10**400,
    "True": lambda: True,
    "None": lambda: None,
    "complex": lambda: 1.0 + 2.0j,
    "fraction": lambda: fractions.Fraction(10**400, 3),
    "decimal": lambda: decimal.Decimal("NaN"),
    "float16 inf": lambda: np.float16(math.inf),
    "float32": lambda: np.float32(0.5),
    "longdouble": lambda: longdouble("0.5"),
    "longdouble 1e4000": lambda: longdouble("1e4000"),
    "uint64": lambda: np.uint64(2**64 - 1),
    "numpy bool": lambda: np.bool_(True),
    "datetime64": lambda: np.datetime64("NaT"),
    "0-d": lambda: np.array(0.5),
    "0-d nan": lambda: np.array(math.nan),
    "0-d object": lambda: np.array(None, dtype=object),
    "fails as float": lambda: FailsAsFloat(0.5),
}
OTHERS: dict[str, Callable[[], Any]] = {
    "empty text": lambda: "",
    "text": lambda: "nan",
    "long text": lambda: "x\n" * 100_000,
    "bytes": lambda: b"1",
    "empty list": lambda: [],
    "list": lambda: [1.0],
    "ragged": lambda: [[1.0], [1.0, 2.0]],
    "deep": with_itself,
    "set": lambda: {1.0},
    "range": lambda: range(3),
    "generator": lambda: iter([1.0]),
    "dict": lambda: {},
    "dict of something": lambda: {"something": 1, 2: None},
    "function": lambda: lambda: 1.0,
    "function of time that fails": lambda: lambda time: 1.0 / 0.0,
    "type": lambda: float,
    "object": object,
    "fails": FailsToConvert,
    "long to show": LongToShow,
    "empty array": lambda: np.zeros(0),
    "array (0, 12)": lambda: np.zeros((0, 12)),
    "array (1, 1, 1)": lambda: np.zeros((1, 1, 1)),
    "array (13,)": lambda: np.zeros(13),
    "array (2, 2)": lambda: np.zeros((2, 2)),
    "masked": lambda: np.ma.masked_invalid([math.nan]),
    "structured": lambda: np.zeros(12, dtype=[("a", float)]),
}


def arrays(*shape: int) -> dict[str, Callable[[], Any]]:
    """Arrays of the right shape with the wrong things in them, or in an unusual form."""
    return {
        "nan inside": lambda: np.where(np.arange(math.prod(shape)) == math.prod(shape) - 1, math.nan, 0).reshape(shape),
        "inf inside": lambda: np.full(shape, -math.inf),
        "1e308 inside": lambda: np.full(shape, 1e308),
        "1e99 inside": lambda: np.full(shape, 1e99),
        "1e30 inside": lambda: np.full(shape, 1e30),
        "5e-324 inside": lambda: np.full(shape, 5e-324),
        "-0.0 inside": lambda: np.full(shape, -0.0),
        "complex inside": lambda: np.full(shape, 1j),
        "bools": lambda: np.ones(shape, dtype=bool),
        "objects": lambda: np.full(shape, None, dtype=object),
        "numbers as objects": lambda: np.full(shape, 0.0, dtype=object),
        "failing objects": lambda: failing(math.prod(shape)).reshape(shape),
        "texts": lambda: np.full(shape, "0"),
        "datetimes": lambda: np.zeros(shape, dtype="datetime64[s]"),
        "float16": lambda: np.zeros(shape, dtype=np.float16),
        "float16 inf": lambda: np.full(shape, math.inf, dtype=np.float16),
        "longdouble": lambda: np.zeros(shape, dtype=np.longdouble),
        "longdouble 1e4000": lambda: np.full(shape, longdouble("1e4000")),
        "int8": lambda: np.zeros(shape, dtype=np.int8),
        "uint64": lambda: np.full(shape, 2**64 - 1, dtype=np.uint64),
        "huge ints": lambda: (np.zeros(shape, dtype=object) + 10**400).tolist(),
        "big endian": lambda: np.zeros(shape, dtype=">f8"),
        "read-only": lambda: read_only(np.zeros(shape)),
        "strided": lambda: np.zeros((*shape[:-1], 3 * shape[-1]))[..., ::-3],
        "Fortran order": lambda: np.asfortranarray(np.zeros(shape)),
        "broadcast": lambda: np.broadcast_to(0.0, shape),
        "nested list": lambda: np.zeros(shape).tolist(),
        "list with a text": lambda: [*np.zeros(shape).tolist()[:-1], "x"],
        "list with None": lambda: [*np.zeros(shape).tolist()[:-1], None],
        "one too many": lambda: np.zeros((*shape[:-1], shape[-1] + 1)),
        "a dimension more": lambda: np.zeros((1, *shape)),
    }


EVERYTHING = NUMBERS | OTHERS
# A sentence for what a contact model can not follow.
_CAN_NOT_FOLLOW = ("would leave the box", "too fast to be followed", "gap evaluations")


def answer(call: Callable[[], Any]) -> Exception | None:
    """What a call raised, None if it worked.

    Raises:
        AssertionError: no call may raise this kind of error, or its message is bad.
    """
    try:
        call()
    except (ValueError, TypeError, gym.error.Error) as error:
        refusal: Exception = error
    except Exception as error:
        if isinstance(error, RuntimeError) and any(words in str(error) for words in _CAN_NOT_FOLLOW):
            return error
        raise AssertionError(f"raised {type(error).__name__}: {str(error)[:300]}") from error
    else:
        return None
    told = str(refusal).split(" was raised from the environment creator")[0]  # Gymnasium repeats what it was given
    assert 10 < len(told) < 300, f"{len(told)} characters: {told[:400]}"
    assert "\n" not in told, told
    return refusal
