"""Objects of a user's files by name, ``file.py:name`` or ``module:name``: nothing runs until it is trusted.

Only :func:`load` runs code. Command lines call it for the names among their own options, and with ``--trust`` for those
in folders of others. A run or a sweep stores the text of each file, so the same code runs later and elsewhere.
"""

from __future__ import annotations

import hashlib
import importlib
import linecache
import sys
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from jackbox_env.tools import checks as check
from jackbox_env.tools.reading import as_value_error, read_json


class _Loaded(NamedTuple):
    module: ModuleType
    text: str  # of its file; empty: of an importable module


CODE = "code.json"  # of a folder: the texts of files, by path
_NAMED = ("task", "observation", "action", "scene", "randomize")  # keywords of an environment that may name objects
_loaded = dict[str, _Loaded]()  # by the absolute path of the file, or the module's name


def is_object(value: Any) -> bool:
    """Whether a setting names an object of a user, ``file.py:name`` or ``module:name``."""
    return isinstance(value, str) and ":" in value


def load(names: Iterable[str], texts: Mapping[str, str] | None = None) -> None:
    """Run the code of these objects, each file once, so that :func:`loaded` returns them.

    Args:
        names: of objects.
        texts: of files by path, as :func:`texts_of` returned them; they replace what the files have now.

    Raises:
        ValueError: an object cannot be imported, or its file is loaded already with another text.
    """
    for name in names:
        source, _, attribute = name.rpartition(":")
        if source.endswith(".py"):
            with as_value_error(f"{name} cannot be imported"):
                text = (texts or {}).get(source) or Path(source).read_text(encoding="utf-8")
            if (known := _loaded.get(_key(source))) and known.text != text:
                raise ValueError(f"{source} has two versions here, one of them stored: give one of them another name")
        with as_value_error(f"{name} cannot be imported"):
            if _key(source) not in _loaded:
                _loaded[_key(source)] = _from_text(source, text) if source.endswith(".py") else _from_module(source)
            getattr(_loaded[_key(source)].module, attribute)


def is_loaded(name: str) -> bool:
    """Whether :func:`load` has run the code of an object."""
    return _key(name.rpartition(":")[0]) in _loaded


def loaded(name: str) -> Any:
    """An object that is loaded.

    Raises:
        ValueError: it is not.
    """
    source, _, attribute = name.rpartition(":")
    if not is_loaded(name):
        raise ValueError(f"{name} is code, which runs only with --trust")
    with as_value_error(f"{name} cannot be imported"):
        return getattr(_loaded[_key(source)].module, attribute)


def load_trusted(folder: Path, names: Iterable[str], trust: bool) -> None:
    """Load objects that a folder of somebody names, with the texts in its code.json.

    Raises:
        ValueError: code would run that is neither trusted nor loaded, or cannot.
    """
    names = list(names)
    if not (trust or all(map(is_loaded, names))):
        raise ValueError(f"{folder} runs code ({check.shown(names[0])}): if you trust its author, use --trust")
    with as_value_error(f"{folder} cannot be used"):
        texts = read_json(folder / CODE) if names and (folder / CODE).is_file() else {}
        load(names, {str(path): str(text) for path, text in dict(texts).items()})


def with_objects(keywords: Mapping[str, Any]) -> dict[str, Any]:
    """The keywords of an environment with objects in place of ``module:name`` and ``file.py:name``.

    Raises:
        ValueError: one is not loaded (:func:`load`).
    """
    named = [name for name in _NAMED if is_object(keywords.get(name))]
    return {**keywords, **{name: loaded(keywords[name]) for name in named}}


def texts_of(names: Iterable[str]) -> dict[str, str]:
    """The texts of the files of objects, as loaded, by path as in their names; without modules that they import.

    Raises:
        ValueError: there is no such file.
    """
    sources = {source for source, _, _ in (name.rpartition(":") for name in names) if source.endswith(".py")}
    with as_value_error("a file of code cannot be stored"):
        return {
            source: known.text if (known := _loaded.get(_key(source))) else Path(source).read_text(encoding="utf-8")
            for source in sorted(sources)
        }


def _key(source: str) -> str:
    return str(Path(source).resolve()) if source.endswith(".py") else source


def _from_module(name: str) -> _Loaded:
    with _importing_from(Path.cwd()):
        return _Loaded(importlib.import_module(name), "")


def _from_text(source: str, text: str) -> _Loaded:
    file = Path(source).resolve()
    module = ModuleType(f"{file.stem}_{hashlib.sha256(str(file).encode()).hexdigest()[:8]}")
    module.__file__ = str(file)
    linecache.cache[str(file)] = len(text), None, text.splitlines(keepends=True), str(file)  # for tracebacks
    sys.modules[module.__name__] = module  # where dataclasses look
    before = set(sys.modules)
    try:
        with _importing_from(file.parent):
            exec(compile(text, str(file), "exec"), vars(module))
    except BaseException:
        del sys.modules[module.__name__]
        raise
    finally:
        for name in set(sys.modules) - before:  # another file's module of this name may be another one
            if Path(getattr(sys.modules[name], "__file__", None) or "/").parent == file.parent:
                del sys.modules[name]
    return _Loaded(module, text)


@contextmanager
def _importing_from(folder: Path) -> Iterator[None]:
    sys.path.insert(0, str(folder))
    try:
        yield
    finally:
        sys.path.remove(str(folder))
