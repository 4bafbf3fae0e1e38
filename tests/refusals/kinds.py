"""Kinds of arguments: a good value, values that must be refused, and other forms of the good one."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np


@dataclass(frozen=True)
class Hostile:
    """A value, the error that it must raise, and what the error must contain besides the argument's name."""

    value: Any
    error: type[Exception]
    mentioned: tuple[str, ...]
    named: str = ""  # what the error names instead of the argument


@dataclass(frozen=True)
class Argument:
    """What is passed for one argument."""

    good: Any
    refused: Mapping[str, Hostile]
    alike: Mapping[str, Any] = field(default_factory=dict)  # the good value in other forms
    accepted: tuple[Any, ...] = ()  # other good values: ends of a range, None
    named: str = ""  # its name in errors; "": as in the signature

    def but(self, named: str = "", /, **refused: Hostile | None) -> Argument:
        """The same under another name, or with other hostile values; None removes one."""
        values = {name: value for name, value in {**self.refused, **refused}.items() if value is not None}
        return replace(self, refused=values, named=named or self.named)


def wrong(value: Any, *mentioned: str, named: str = "", error: type[Exception] = TypeError) -> Hostile:
    return Hostile(value, error, mentioned or (" ".join(repr(value).split())[:60],), named)


def out(value: Any, *mentioned: str, named: str = "") -> Hostile:
    return wrong(value, *mentioned, named=named, error=ValueError)


def each(make: Any, values: Mapping[str, Any], *mentioned: str) -> dict[str, Hostile]:
    return {name: make(value, *make(value).mentioned, *mentioned) for name, value in values.items()}


# No number; LISTS are of numbers.
THINGS: dict[str, Any] = {
    "nothing": None, "text": "nan", "empty_text": "", "dict": {"something": 1}, "function": print, "complex": 1j,
    "true": True, "numpy_bool": np.bool_(True), "datetime": np.datetime64("NaT", "s"),
    "list": [1.0], "ragged": [[1.0], [1.0, 2.0]], "array": np.zeros((2, 2)),
}  # fmt: skip
LISTS = ("list", "ragged", "array")


def things(*without: str) -> dict[str, Any]:
    return {name: value for name, value in THINGS.items() if name not in without}


def real(
    good: float | None, above: float = -math.inf, at_least: float = -math.inf, at_most: float = math.inf,
    none: bool = False, ends: bool = True,
) -> Argument:  # fmt: skip
    """A finite number; with ``ends`` those of its range are accepted too."""
    limits = above, math.nextafter(at_least, -math.inf), math.nextafter(at_most, math.inf)
    bad = {"nan": math.nan, "inf": math.inf, "-inf": -math.inf, "0-d_nan": np.array(math.nan), "huge": 10**400}
    bad |= {f"beyond {limit}": limit for limit in limits if math.isfinite(limit)}
    bounds = tuple(f"{bound:g}" for bound in (above, at_least, at_most) if math.isfinite(bound))
    refused = {**each(out, bad, *bounds), **each(wrong, things(*["nothing"] * none), *bounds)}
    forms = {} if good is None else {"numpy": np.float64(good), "0-d": np.array(good), "float32": np.float32(good)}
    accepted = tuple(end for end in (at_least, at_most) if ends and math.isfinite(end)) + (None,) * none
    return Argument(good, refused, forms, accepted)


def whole(good: int | None, at_least: int, at_most: int | None = None, none: bool = False) -> Argument:
    """A whole number; its least value is accepted too."""
    ends = (at_least,) if at_most is None else (at_least, at_most)
    bad = {"below": at_least - 1, "numpy_below": np.int64(at_least - 1)} | {f"above {end}": end + 1 for end in ends[1:]}
    others = {"1.5": 1.5, "2.0": 2.0, "numpy_2.0": np.float64(2.0), "nan": math.nan, **things(*["nothing"] * none)}
    refused = {**each(out, bad, *map(str, ends)), **each(wrong, others, *map(str, ends))}
    forms = {} if good is None else {"numpy": np.int64(good), "0-d": np.array(good)}
    return Argument(good, refused, forms, (at_least,) + (None,) * none)


def flag(good: bool) -> Argument:
    return Argument(good, each(wrong, {"0": 0, "nan": math.nan, **things("true")}), accepted=(not good,))


def choice(good: str | None, names: Iterable[str], none: bool = False) -> Argument:
    """One of some names, all of which errors list."""
    listed = tuple(names)
    values = {"unknown": "nothing", "upper": listed[0].title(), "1": 1, **things(*["nothing"] * none)}
    return Argument(good, each(out, values, *map(repr, listed)), accepted=(None,) * none)


def array(good: Any, scalar: bool = False, none: bool = False) -> Argument:
    """Finite numbers of the shape of ``good``; with ``scalar`` one number stands for all."""
    values = np.array(good, dtype=np.float64)
    shape, last = values.shape, np.arange(values.size).reshape(values.shape) == values.size - 1
    shapes = {"more": (*shape[:-1], shape[-1] + 1), "deeper": (1, *shape, 1), "empty": (*shape[:-1], 0)}
    refused = {name: out(np.zeros(wrong_shape), str(wrong_shape)) for name, wrong_shape in shapes.items()}
    refused |= {f"{bad}_inside": out(np.where(last, bad, values), str(bad)) for bad in (math.nan, math.inf, -math.inf)}
    refused["scalar"] = out(math.nan, "nan") if scalar else out(1.0, "()")
    refused["masked"] = out(np.ma.array(values, mask=last), "masked")
    others = {
        "complex_inside": values + 1j, "bools": values > 1e9, "texts": values.astype(str),
        "objects": values.astype(object), "ragged": [[1.0], [1.0, 2.0]], **things(*LISTS, *["nothing"] * none),
    }  # fmt: skip
    frozen = values.copy()
    frozen.flags.writeable = False
    forms = {
        "list": values.tolist(), "Fortran": np.asfortranarray(values), "read_only": frozen,
        "strided": np.repeat(values, 3, axis=-1)[..., ::3], "float32": values.astype(np.float32),
    }  # fmt: skip
    return Argument(values, {**refused, **each(wrong, others)}, forms)


def mask(good: Any) -> Argument:
    """Which of several, as an array of bool."""
    values = np.array(good)
    others = {"numbers": values.astype(int), **things("nothing", "true", "numpy_bool")}
    refused = {**each(wrong, others), "short": out(values[:-1], f"({len(values) - 1},)"), "one": out(True, "()")}
    return Argument(values, refused, {"list": values.tolist()})


def size(good: tuple[int, int], at_least: int, at_most: int) -> Argument:
    """Width and height."""
    bad = {"narrow": (at_least - 1, at_least), "low": (at_least, at_least - 1), "wide": (at_most + 1, at_most)}
    others = {"one": (at_least,), "three": (at_least,) * 3, "floats": (1.5, 16.0), "number": 16, "bools": (True, 16)}
    bounds = str(at_least), str(at_most)
    refused = {**each(out, bad, *bounds), **each(wrong, others | things(), *bounds)}
    return Argument(
        good, refused, {"list": list(good), "array": np.array(good)}, ((at_least, at_most), (at_most, at_least))
    )


def instance(good: Any, *without: str, **refused: Hostile) -> Argument:
    """An object of one type; objects of other types are refused."""
    return Argument(good, {**each(wrong, {"number": 3.0, **things(*without)}), **refused})
