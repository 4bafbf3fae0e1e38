"""Kinds of arguments: a good value, what must be refused in its place, and other forms of the same value."""

from __future__ import annotations

import datetime
import decimal
import fractions
import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

BEYOND_FLOATS = 10**400
NOT_SHOWN = "can not be shown"


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

    def _fail(self) -> Any:
        raise FailsError("no")

    __float__ = __repr__ = _fail


class LongToShow:
    """Its repr has many lines."""

    def __repr__(self) -> str:
        return "long\n" * 10_000


@dataclass(frozen=True)
class Hostile:
    """A value, the error that it must raise, and what the error must tell besides the argument's name."""

    value: Any
    error: type[Exception]
    told: tuple[str, ...]
    named: str = ""  # what the error names instead of the argument


@dataclass(frozen=True)
class Argument:
    """What is given for one argument."""

    good: Any
    refused: Mapping[str, Hostile]
    alike: Mapping[str, Any] = field(default_factory=dict)  # the good value in other forms
    taken: tuple[Any, ...] = ()  # other good values: ends of a range, None
    named: str = ""  # how errors call it; "": as the signature does

    def but(self, named: str = "", /, **refused: Hostile | None) -> Argument:
        """The same under another name, or with other hostile values; None takes one away."""
        values = {name: value for name, value in {**self.refused, **refused}.items() if value is not None}
        return replace(self, refused=values, named=named or self.named)


def as_told(value: Any) -> str:
    """The beginning of how an error shows a value."""
    try:
        return " ".join(repr(value).split())[:60]
    except FailsError:
        return NOT_SHOWN


def wrong(value: Any, *told: str, named: str = "") -> Hostile:
    return Hostile(value, TypeError, told or (as_told(value),), named)


def out(value: Any, *told: str, named: str = "") -> Hostile:
    return Hostile(value, ValueError, told or (as_told(value),), named)


def each(make: Any, values: Mapping[str, Any], *told: str) -> dict[str, Hostile]:
    return {name: make(value, as_told(value), *told) for name, value in values.items()}


# No number, and nothing that holds numbers.
THINGS: dict[str, Any] = {
    "nothing": None,
    "text": "nan",
    "empty_text": "",
    "long_text": "x\n" * 100_000,
    "bytes": b"1",
    "dict": {"something": 1},
    "function": print,
    "object": LongToShow(),
    "fails": FailsToConvert(),
    "complex": 1.0 + 2.0j,
    "true": True,
    "numpy_bool": np.bool_(True),
    "datetime": np.datetime64("NaT", "s"),
}
LISTS: dict[str, Any] = {"list": [1.0], "ragged": [[1.0], [1.0, 2.0]], "array": np.zeros((2, 2)), "set": {1.0}}


def things(*without: str, lists: bool = True) -> dict[str, Any]:
    return {name: value for name, value in (THINGS | (LISTS if lists else {})).items() if name not in without}


def real(
    good: float | None, above: float = -math.inf, at_least: float = -math.inf, at_most: float = math.inf,
    none: bool = False, ends: bool = True,
) -> Argument:  # fmt: skip
    """A finite number; with ``ends`` those of its range are taken too."""
    bounds = tuple(f"{bound:g}" for bound in (above, at_least, at_most) if math.isfinite(bound))
    bad: dict[str, Any] = {
        "nan": math.nan, "inf": math.inf, "-inf": -math.inf, "float16_inf": np.float16(math.inf),
        "beyond_floats": BEYOND_FLOATS, "fraction": fractions.Fraction(BEYOND_FLOATS, 3), "masked": np.ma.masked,
        "longdouble": np.longdouble(2) ** 5000, "fails_as_float": FailsAsFloat(0.5), "0-d_nan": np.array(math.nan),
    }  # fmt: skip
    if math.isfinite(above):
        bad["open_end"] = above
    if math.isfinite(at_least):
        bad["just_below"] = math.nextafter(at_least, -math.inf)
    if math.isfinite(at_most):
        bad["just_above"] = math.nextafter(at_most, math.inf)
    others = {"decimal": decimal.Decimal("0.5"), "date": datetime.date(2020, 1, 1), **things(*["nothing"] * none)}
    forms = {} if good is None else {"numpy": np.float64(good), "0-d": np.array(good), "float32": np.float32(good)}
    taken = tuple(end for end in (at_least, at_most) if ends and math.isfinite(end)) + (None,) * none
    return Argument(good, {**each(out, bad, *bounds), **each(wrong, others, *bounds)}, forms, taken)


def whole(good: int | None, at_least: int, at_most: int | None = None, none: bool = False) -> Argument:
    """A whole number; its least value is taken too."""
    bounds = (str(at_least),) if at_most is None else (str(at_least), str(at_most))
    bad = {"just_below": at_least - 1, "numpy_below": np.int64(at_least - 1), "far_below": -BEYOND_FLOATS}
    if at_most is not None:
        bad |= {"just_above": at_most + 1, "far_above": BEYOND_FLOATS}
    others = {"1.5": 1.5, "2.0": 2.0, "numpy_2.0": np.float64(2.0), "nan": math.nan, **things(*["nothing"] * none)}
    forms = {} if good is None else {"numpy": np.int64(good), "uint16": np.uint16(good), "0-d": np.array(good)}
    refused = {**each(out, bad, *bounds), **each(wrong, others, *bounds), "masked": out(np.ma.array(1, mask=True))}
    return Argument(good, refused, forms, (at_least,) + (None,) * none)


def flag(good: bool) -> Argument:
    return Argument(good, each(wrong, {"0": 0, "1": 1, "nan": math.nan, **things("true")}), taken=(not good,))


def choice(good: str | None, names: Iterable[str], none: bool = False) -> Argument:
    """One of some names, all of which errors list."""
    listed = tuple(names)
    values = {"unknown": "nothing", "upper": listed[0].title(), "1": 1, **things(*["nothing"] * none)}
    return Argument(good, each(out, values, *map(repr, listed)), taken=(None,) * none)


def array(good: Any, scalar: bool = False, none: bool = False) -> Argument:
    """Finite numbers of the shape of ``good``; with ``scalar`` one number is taken for all."""
    values = np.array(good, dtype=np.float64)
    shape, last = values.shape, np.arange(values.size).reshape(values.shape) == values.size - 1
    hidden = np.ma.array(values, mask=last)
    shapes = {"one_too_many": np.zeros((*shape[:-1], shape[-1] + 1)), "a_dimension_more": np.zeros((1, *shape, 1))}
    shapes |= {"empty": np.zeros((*shape[:-1], 0)), "cube": np.zeros((1, 1, 1))}
    numbers: dict[str, Any] = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf}
    inside = {f"{name}_inside": out(np.where(last, value, values), name) for name, value in numbers.items()}
    inside["longdouble_inside"] = out(np.where(last, np.longdouble(2) ** 5000, values), "inf")
    inside["float16_inf_inside"] = out(np.where(last, math.inf, 0.0).astype(np.float16), "inf")
    others = {
        "complex_inside": values + 1j, "bools": values > 1e9, "texts": values.astype(str),
        "objects": values.astype(object), "huge": np.full(shape, BEYOND_FLOATS, dtype=object).tolist(),
        "failing": np.frompyfunc(lambda _: FailsToConvert(), 1, 1)(values), "ragged": [[1.0], [1.0, 2.0]],
        "datetimes": values.astype("datetime64[s]"), "structured": np.zeros(shape, dtype=[("a", float)]),
        **things(*["nothing"] * none, lists=False),
    }  # fmt: skip
    if scalar:
        inside["scalar_nan"] = out(math.nan, "nan")
    else:
        shapes["scalar"] = np.array(1.0)
    refused = inside | {name: out(value, str(value.shape)) for name, value in shapes.items()} | each(wrong, others)
    spread = np.zeros((*shape[:-1], 3 * shape[-1]))
    spread[..., ::-3] = values
    frozen = values.copy()
    frozen.flags.writeable = False
    forms = {
        "list": values.tolist(), "big_endian": values.astype(">f8"), "Fortran": np.asfortranarray(values),
        "strided": spread[..., ::-3], "read_only": frozen, "float16": values.astype(np.float16),
        "longdouble": values.astype(np.longdouble), "nothing_masked": np.ma.array(values, mask=False),
    }  # fmt: skip
    return Argument(values, {**refused, "masked": out(hidden, "masked")}, forms)


def mask(good: Any) -> Argument:
    """Which of several, as an array of bool."""
    values = np.array(good)
    others = {
        "numbers": values.astype(int),
        "numbers_in_a_list": [1] * len(values),
        **things("nothing", "true", "numpy_bool"),
    }
    refused = {**each(wrong, others), "short": out(values[:-1], f"({len(values) - 1},)"), "one": out(True, "()")}
    refused["masked"] = out(np.ma.array(values, mask=[True] + [False] * (len(values) - 1)), "masked")
    return Argument(values, refused, {"list": values.tolist()})


def size(good: tuple[int, int], at_least: int, at_most: int) -> Argument:
    """Width and height."""
    bounds = str(at_least), str(at_most)
    bad = {"narrow": (at_least - 1, at_least), "low": (at_least, at_least - 1), "wide": (at_most + 1, at_most)}
    bad |= {"high": (at_most, at_most + 1), "huge": (BEYOND_FLOATS, at_least)}
    others = {"one": (at_least,), "three": (at_least,) * 3, "floats": (1.5, 16.0), "number": 16, "bools": (True, 16)}
    others |= {"masked": np.ma.array([16, 16], mask=[False, True]), **things()}
    refused = {**each(out, bad, *bounds), **each(wrong, others, *bounds)}
    forms = {"list": list(good), "array": np.array(good)}
    return Argument(good, refused, forms, ((at_least, at_most), (at_most, at_least)))


def instance(good: Any, *without: str, **refused: Hostile) -> Argument:
    """Something that no other thing may stand for."""
    return Argument(good, {**each(wrong, {"number": 3.0, **things(*without)}), **refused})
