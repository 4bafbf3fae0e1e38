"""Checks of arguments; each error is one sentence with the argument's name, its value and the allowed values."""

from __future__ import annotations

import difflib
import json
import math
import numbers
import operator
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import wraps
from inspect import signature
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

_Arguments = ParamSpec("_Arguments")
_Kind = TypeVar("_Kind", dict[str, Any], list[Any])


def real(
    name: str,
    value: Any,
    *,
    above: float = -math.inf,
    at_least: float = -math.inf,
    at_most: float = math.inf,
) -> float:
    """Return ``value`` as a finite Python float within the given bounds.

    Raises:
        TypeError: it is no real number.
        ValueError: it is NaN, infinite or out of bounds.
    """
    try:
        number = float(value) if type(value) is float or _is_real(value) else math.nan  # the first is fast
    except OverflowError:
        number = math.inf
    # NaN fails the comparisons; -inf and inf fail these open ends.
    if -math.inf < number < math.inf and number > above and at_least <= number <= at_most:
        return number
    bounds = [
        f"{word} {bound:g}"
        for word, bound in (("above", above), ("at least", at_least), ("at most", at_most))
        if math.isfinite(bound)
    ]
    message = f"{name} must be a finite number{' ' * bool(bounds)}{' and '.join(bounds)}, got {shown(value)}"
    raise (ValueError if _is_real(value) else TypeError)(message)


def _is_real(value: Any) -> bool:
    """Whether it is one real number: Python's, numpy's, or an array of shape () of them."""
    if isinstance(value, numbers.Real):
        return not isinstance(value, bool)
    return getattr(value, "ndim", None) == 0 and getattr(getattr(value, "dtype", None), "kind", None) in ("f", "i", "u")


def whole(name: str, value: Any, *, at_least: int, at_most: int | None = None) -> int:
    """Return ``value`` as a Python int within the given bounds; True, 2.0 and "2" are no whole numbers.

    Raises:
        TypeError: it is no whole number.
        ValueError: it is out of bounds.
    """
    expected = f"a whole number {f'>= {at_least}' if at_most is None else f'from {at_least} to {at_most}'}"
    if isinstance(value, bool):
        raise TypeError(f"{name} must be {expected}, got {shown(value)}")
    try:
        number = operator.index(value)
    except TypeError as error:
        raise TypeError(f"{name} must be {expected}, got {shown(value)}") from error
    if number < at_least or (at_most is not None and number > at_most):
        raise ValueError(f"{name} must be {expected}, got {shown(value)}")
    return number


def flag(name: str, value: Any) -> bool:
    """Return ``value`` if it is True or False.

    Raises:
        TypeError: it is neither.
    """
    if not isinstance(value, bool):
        raise TypeError(f"{name} must be True or False, got {shown(value)}")
    return value


def size(name: str, value: Any, *, at_least: int, at_most: int) -> tuple[int, int]:
    """Return ``value`` as width and height, two Python ints within the given bounds.

    Raises:
        TypeError: it is no pair of whole numbers.
        ValueError: one of them is out of bounds.
    """
    expected = f"(width, height), two whole numbers from {at_least} to {at_most}"
    try:
        width, height = (operator.index(side) for side in value if not isinstance(side, bool))
    except (TypeError, ValueError) as error:  # not a pair, or not of whole numbers
        raise TypeError(f"{name} must be {expected}, got {shown(value)}") from error
    if not (at_least <= width <= at_most and at_least <= height <= at_most):
        raise ValueError(f"{name} must be {expected}, got {shown(value)}")
    return width, height


def array(name: str, value: Any, requirement: str) -> NDArray[Any]:
    """Return ``value`` as an array of real numbers.

    Raises:
        TypeError: it is something else; the message is "<name> must <requirement>".
        ValueError: an element is masked; numpy would read the number behind the mask.
    """
    if np.ma.is_masked(value):
        raise ValueError(f"{name} must {requirement}, none of them masked, got {shown(value)}")
    if getattr(value, "requires_grad", None) is True:
        raise TypeError(f"{name} must {requirement}, got a tensor that requires grad: pass its detach()")
    try:
        converted = np.asarray(value)
    except (TypeError, ValueError, RuntimeError) as error:  # ragged lists; tensors on a GPU, or with gradients
        raise TypeError(f"{name} must {requirement}, got {shown(value)}") from error
    if converted.dtype.kind not in "fiu":
        raise TypeError(f"{name} must {requirement}, got {shown(value)}")
    return converted


def finite(name: str, value: Any, requirement: str = "be numbers") -> NDArray[np.float64]:
    """Return ``value`` as a new array of finite numbers.

    Raises:
        TypeError, ValueError: as :func:`array`; a number is NaN or infinite.
    """
    numbers = np.array(array(name, value, requirement), dtype=np.float64)
    if not np.isfinite(numbers).all():
        raise ValueError(f"{name} must be finite, got {numbers[~np.isfinite(numbers)][0]}")
    return numbers


def shown(value: Any) -> str:
    """A value as one short line."""
    line = " ".join(repr(value).split())
    return line if len(line) <= 80 else line[:77] + "..."


def from_json(name: str, text: str, kind: type[_Kind], finite: bool = False) -> _Kind:
    """Return the object (dict) or list that a text of JSON is.

    Args:
        name: of the text, for errors.
        text: to parse.
        kind: dict or list.
        finite: refuse NaN and Infinity, which only Python reads as JSON.

    Raises:
        ValueError: it is something else, or no JSON.
    """
    try:
        values = json.loads(text, parse_constant=_refuse if finite else None)
    except (RecursionError, TypeError, ValueError):
        values = None
    if not isinstance(values, kind):
        raise ValueError(f"{name} must be a JSON {'object' if kind is dict else 'list'}, got {shown(text)}")
    return values


def _refuse(constant: str) -> None:
    raise ValueError(constant)


def choice(name: str, value: Any, allowed: Iterable[str]) -> str:
    """Return ``value`` if it is one of the ``allowed`` names.

    Raises:
        ValueError: it is not.
    """
    names = list(allowed)
    if not isinstance(value, str) or value not in names:
        listed = ", ".join(repr(one) for one in names)
        raise ValueError(f"{name} must be one of {listed}, got {shown(value)}")
    return value


def known_keys(name: str, keys: Iterable[Any], allowed: Iterable[str]) -> None:
    """Check that all keys are ``allowed``.

    Raises:
        ValueError: there is an unknown key.
    """
    names = list(allowed)
    for key in keys:
        if key not in names:
            listed = ", ".join(repr(one) for one in names)
            raise ValueError(f"{name} accepts only {listed}, got {shown(key)}{closest(key, names)}")


def closest(key: Any, names: Iterable[str]) -> str:
    """`` (did you mean ...?)`` if one of the names resembles the key."""
    matches = difflib.get_close_matches(key, list(names), n=1) if isinstance(key, str) else []
    return f" (did you mean {matches[0]!r}?)" if matches else ""


@contextmanager
def extra(what: str, package: str, name: str) -> Iterator[None]:
    """Explain a ModuleNotFoundError of the block's imports by the extra that installs the package."""
    try:
        yield
    except ModuleNotFoundError as error:
        sentence = f'{what} needs {package}, the extra {name!r}: in a checkout of jackbox, pip install -e ".[{name}]"'
        raise ModuleNotFoundError(sentence) from error


def refuse_unknown(
    owner: str, elsewhere: Mapping[str, str], further: Iterable[str] = ()
) -> Callable[[Callable[_Arguments, None]], Callable[_Arguments, None]]:
    """Decorate an ``__init__`` so that unknown keywords raise TypeError with a list of the known ones.

    Args:
        owner: whose arguments they are.
        elsewhere: keywords of other classes, each with the end of the sentence "it ...".
        further: keywords that the ``__init__`` accepts as ``**settings``.
    """

    def refusing(init: Callable[_Arguments, None]) -> Callable[_Arguments, None]:
        names = [*(name for name in [*signature(init).parameters][1:] if name != "settings"), *further]

        @wraps(init)
        def checked(*args: _Arguments.args, **keywords: _Arguments.kwargs) -> None:
            for name in keywords:
                if name in elsewhere:
                    raise TypeError(f"{owner} has no argument {name!r}: it {elsewhere[name]}")
                if name not in names:
                    raise TypeError(
                        f"{owner} has no argument {name!r}{closest(name, names)}: it accepts {', '.join(names)}"
                    )
            init(*args, **keywords)

        return checked

    return refusing
