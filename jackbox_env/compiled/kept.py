"""Compiled code kept on disk for later processes, in files that are checked before they are loaded.

Numba's own cache trusts its files: a full disk or a damaged file stops every later process, and machine code with a
flipped bit may crash or compute something else. Here a file is used only if its checksum is right. It appears whole or
not at all. Whatever is wrong with the disk, the code is compiled anew and one warning names the folder.

Nothing here stands between a caller and compiled code: numba asks for kept code once for each signature, when a
function is first called with it.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import pickle
import secrets
import sys
import time
import warnings
from collections.abc import Sequence
from pathlib import Path
from types import FunctionType
from typing import Any

import numba
from numba.core.caching import NullCache
from numba.core.compiler import CompileResult
from numba.core.serialize import dumps

_HEAD = hashlib.sha256().digest_size  # bytes of the checksum, which stands before the code
_LEFT_BEHIND = 3600.0  # [s] age of a scratch file whose writer must have been killed
_said: set[Path | str] = set()


def say_once(about: Path | str, text: str) -> None:
    """Warn, if nothing has been said about this folder or matter in this process."""
    if about not in _said:
        _said.add(about)
        warnings.warn(text, stacklevel=2)


class CodeCache(NullCache):
    """The cache of one compiled function: what numba loads from before it compiles and saves to after.

    One file for each signature, kind of processor, and version of Python and numba.

    Args:
        function: the plain function, with a qualified name that tells its content.
        folders: where to look, in this order; the last is where code is saved.
    """

    def __init__(self, function: FunctionType, folders: Sequence[Path]) -> None:
        self._name = f"{Path(function.__code__.co_filename).stem}.{function.__name__.strip('<>')}"
        self._version = sys.version, numba.__version__, function.__qualname__
        self._folders = folders

    @property
    def cache_path(self) -> str:
        """The folder where code is saved."""
        return str(self._folders[-1])

    def load_overload(self, signature: Any, context: Any) -> Any:
        """Return what was compiled for this signature, or None where it is not kept or cannot be used."""
        context.refresh()
        name = self._file_name(signature, context.codegen())
        for folder in self._folders:
            try:
                return CompileResult._rebuild(context, *_read(folder / name))  # type: ignore[no-untyped-call]
            except FileNotFoundError:
                continue
            except Exception as error:  # whatever it is, compiling anew repairs it
                say_once(
                    folder,
                    f"compiled code kept in {folder} cannot be used ({_reason(error)}); "
                    "compiling it anew takes 25 to 45 s",
                )
        return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep what was compiled for this signature."""
        if result.lifted or result.library.has_dynamic_globals:  # addresses, which no other process shares
            say_once(self._name, f"what is compiled of {self._name} holds addresses, so it is not kept")
            return
        folder = self._folders[-1]
        try:
            _write(folder / self._file_name(signature, result.library.codegen), result._reduce())
        except OSError as error:
            say_once(
                folder,
                f"compiled code cannot be kept in {folder} ({_reason(error)}), so each process compiles it anew, "
                "which takes 25 to 45 s; make room there or set NUMBA_CACHE_DIR to another folder",
            )

    def _file_name(self, signature: Any, codegen: Any) -> str:
        whole = repr((self._version, str(signature), codegen.magic_tuple()))
        return f"{self._name}-{hashlib.sha256(whole.encode()).hexdigest()[:32]}.kept"


class _DamageError(Exception):
    pass


def _reason(error: Exception) -> str:
    if isinstance(error, OSError) and error.strerror:
        return error.strerror
    return str(error) if isinstance(error, _DamageError) else f"{type(error).__name__}: {error}"


def _checksum(path: Path, data: bytes) -> bytes:
    """Checksum of the name and the code: a file under another function's name is then seen to be wrong."""
    return hashlib.sha256(path.name.encode() + b"\0" + data).digest()


def _write(path: Path, content: Any) -> None:
    """Write a file that is seen whole or not at all, by other processes and after this one is killed."""
    data: bytes = dumps(content)  # type: ignore[no-untyped-call]
    path.parent.mkdir(parents=True, exist_ok=True)  # it may have been removed since this process looked
    _sweep(path.parent)
    scratch = path.with_name(f"{path.name}.{os.getpid()}-{secrets.token_hex(4)}.tmp")
    try:
        scratch.write_bytes(_checksum(path, data) + data)
        scratch.replace(path)
    finally:
        with contextlib.suppress(OSError):
            scratch.unlink()  # there only where writing failed or was interrupted


def _read(path: Path) -> Any:
    whole = path.read_bytes()
    if _checksum(path, whole[_HEAD:]) != whole[:_HEAD]:
        raise _DamageError("damaged")
    return pickle.loads(whole[_HEAD:])


def _sweep(folder: Path) -> None:
    """Remove what writers that were killed have left."""
    for scratch in folder.glob("*.tmp"):
        with contextlib.suppress(OSError):
            if time.time() - scratch.stat().st_mtime > _LEFT_BEHIND:
                scratch.unlink()
