"""Compiled code stored on disk for later processes, in files that are checked before they are loaded.

``compiler.py`` sets this cache in place of numba's own, which trusts its files: a full disk or a damaged file would
stop every later process, and machine code with a flipped bit may crash or compute something else. Here a file is used
only if its checksum is right, and it appears whole or not at all. If anything is wrong with the disk, the code is
compiled anew and one warning names the folder. The checksum detects damage, not malice: whoever may write to the folder
can put any code there, as in a package's ``__pycache__``.

A wheel can ship such files (scripts/wheel.py), compiled for ``SHIPPED_FOR``. They serve every CPU with the features of
this target, unless there is code that was compiled for the CPU itself. Numba searches the cache once for each
signature, when a function is first called with it.
"""

from __future__ import annotations

import hashlib
import os
import sys
import warnings
from collections.abc import Sequence
from functools import cache
from importlib.machinery import EXTENSION_SUFFIXES
from pathlib import Path
from types import FunctionType
from typing import Any

import llvmlite  # type: ignore[import-untyped]
import numba

from jackbox_env.jit.pipelines import NullCache, dumped, loaded, target_of
from jackbox_env.tools import files

_HEAD = hashlib.sha256().digest_size  # bytes of the checksum, which stands before the code
SHIPPED_FOR = "x86-64-v3"  # Intel's CPUs from Haswell (2013) on, AMD's from Excavator (2015) on
_NEEDS = {"+avx2", "+bmi", "+bmi2", "+cx16", "+f16c", "+fma", "+lzcnt", "+movbe", "+popcnt", "+sahf", "+xsave"}
# Functions that take long to compile: their purpose, and the time.
_LONG = {
    "run": ("all environments", "10 s on a fast machine, 40 s on a slow one"),
    "settle_and_advance": ("feet at rest", "5 to 20 s"),
    **dict.fromkeys(("mark_smooth", "matrices", "pull_back"), ("derivatives", "5 to 20 s")),
}


@cache
def warn_once(text: str) -> None:
    """Warn, once in this process."""
    warnings.warn(text, stacklevel=3)


@cache
def _announce(purpose: str, time: str, folder: Path) -> None:
    """Print to standard error that compiling for this purpose begins, once in this process."""
    often = "once on this machine" if os.access(folder, os.W_OK) else "in each process, as it can be kept nowhere"
    print(f"jackbox compiles its exact contact model for {purpose}, {often} ({time})", file=sys.stderr, flush=True)


def _checksum(path: Path, code: bytes) -> bytes:
    """Checksum of the name and the code, so that a file under another function's name is refused."""
    return hashlib.sha256(path.name.encode() + b"\0" + code).digest()


class CodeCache(NullCache):
    """The cache of one compiled function: numba loads from it before it compiles, and saves to it afterwards.

    One file for each signature, kind of processor, version of numba, and binary interface of Python, which decides
    which compiled extensions it loads.

    Args:
        function: the plain function, with a unique qualified name.
        folders: searched in this order; code is saved in the last.
        shipped: searched after them, for code compiled for ``SHIPPED_FOR``; it need not exist.
    """

    def __init__(self, function: FunctionType, folders: Sequence[Path], shipped: Path) -> None:
        self._name = f"{Path(function.__code__.co_filename).stem}.{function.__name__.strip('<>')}"
        self._version = EXTENSION_SUFFIXES[0], numba.__version__, llvmlite.__version__, function.__qualname__
        self._folders, self._shipped, self._long = folders, shipped, _LONG.get(function.__name__)

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return the code compiled for these arguments, or None if there is none or it cannot be used.

        A signature may have the type of the result, for calls by address. Code with another type is compiled anew.
        Before a function that takes long to compile, a line is printed to standard error.
        """
        triple, _, features = target = target_of(context)  # numba loads code whatever it was compiled for
        paths = [folder / self._file_name(signature, target) for folder in self._folders]
        if _NEEDS.issubset(features.split(",")):
            paths.append(self._shipped / self._file_name(signature, (triple, SHIPPED_FOR, "")))
        for path in paths:
            try:
                whole = path.read_bytes()
                if _checksum(path, whole[_HEAD:]) != whole[:_HEAD]:
                    raise ValueError("damaged")
                made = loaded(whole[_HEAD:], context)
                result = made.signature.return_type
                if getattr(signature, "return_type", result) == result:
                    return made
            except (FileNotFoundError, NotADirectoryError):
                continue
            except Exception as error:  # whatever it is, compiling anew repairs it
                warn_once(f"compiled code kept in {path.parent} cannot be used ({error}), so it is compiled anew")
        if self._long is not None:
            _announce(*self._long, self._folders[-1])
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Save the code compiled for this signature, unless it contains addresses, which hold in one process only."""
        code = dumped(result)
        if code is None:
            return
        path = self._folders[-1] / self._file_name(signature, target_of(result.target_context))
        try:
            path.parent.mkdir(parents=True, exist_ok=True)  # it may have been removed since this process looked
            with files.replacing(path) as partial:
                partial.write_bytes(_checksum(path, code) + code)
        except OSError as error:
            warn_once(
                f"compiled code cannot be kept in {path.parent} ({error.strerror}), so each process compiles it anew; "
                "make room there or set NUMBA_CACHE_DIR to another folder"
            )

    def _file_name(self, signature: Any, target: tuple[str, str, str]) -> str:
        # By the arguments alone: before a call compiles it, the type of the result is unknown.
        whole = repr((self._version, str(getattr(signature, "args", signature)), target))
        return f"{self._name}-{hashlib.sha256(whole.encode()).hexdigest()[:32]}.kept"
