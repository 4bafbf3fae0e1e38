"""The names that functions use, and where functions are from."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from types import CodeType, FunctionType
from typing import Any


def used_names(code: CodeType) -> set[str]:
    """The names of globals and attributes that code uses, functions defined in it included."""
    inner = (used_names(constant) for constant in code.co_consts if isinstance(constant, CodeType))
    return set(code.co_names).union(*inner)


@cache
def reachable_names(function: FunctionType) -> set[str]:
    """The names that a function of this package uses, itself or in functions of this package that it calls."""
    names = used_names(function.__code__)
    used = [one for one in map(function.__globals__.get, names) if isinstance(one, FunctionType)]
    return names.union(*(reachable_names(one) for one in used if not is_foreign(one)))


def full_name(function: Callable[..., Any]) -> str:
    """The name of a function, with its module's."""
    return f"{function.__module__}.{function.__qualname__}"


def top_level(named: Mapping[str, Any]) -> str:
    """The top-level package of the globals of a function or module."""
    return str(named.get("__name__")).split(".")[0]


def is_foreign(function: FunctionType) -> bool:
    """Whether a function is not of this package."""
    return top_level(function.__globals__) != top_level(globals())
