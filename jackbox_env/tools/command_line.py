"""Every command line of the project: errors as one sentence, and an exit status for each end."""

from __future__ import annotations

import errno
import functools
import importlib.util
import os
import shlex
import signal
import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace
from typing import Any

from gymnasium.error import DependencyNotInstalled
from gymnasium.error import Error as GymnasiumError

JACKBOX = "jackbox"  # the command; `jackbox NAME` sets sys.argv[0] to "jackbox NAME"
ROOT = Path(__file__).parents[2]  # of a checkout; meaningless for an installed package
_SIGPIPE_STATUS = 128 + 13
_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EIO)  # errors of standard output, which have no file name


def command_line(main: Callable[[], None]) -> Callable[[], None]:
    """Print an error as one sentence on standard error and exit with 2; Ctrl-C exits with 130.

    SIGTERM ends the command by an exception, with 143, so that no partial file is left.
    If standard output is closed by its reader, as by ``| head``, exit quietly with 141.
    """

    @functools.wraps(main)
    def wrapped() -> None:
        _open_closed()
        with suppress(ValueError):  # another thread than the main one cannot set handlers
            if signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
                signal.signal(signal.SIGTERM, lambda number, _: sys.exit(128 + number))
        try:
            main()
            sys.stdout.flush()  # a full disk fails here, not at Python's end
        except (ImportError, DependencyNotInstalled) as error:
            how = (
                "pip install -e '.[all,dev]'"
                if in_checkout()
                else "`jackbox check` lists them, and how to install them"
            )
            more = "" if "pip install" in str(error) else f"; this command needs more packages: {how}"
            print(f"{error}{more}", file=sys.stderr)
            sys.exit(2)
        except BrokenPipeError:
            sys.exit(_SIGPIPE_STATUS)
        except (ValueError, TypeError, OSError, RuntimeError, MemoryError, GymnasiumError) as error:
            print(_sentence(error), file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            sys.exit(130)
        finally:
            _drop_unwritten()

    return wrapped


def _open_closed() -> None:
    """Open a closed standard output or error to nowhere, before another file gets its number."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115


def _drop_unwritten() -> None:
    """Discard unwritable output; else Python would try again at its end and print a traceback."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _sentence(error: Exception) -> str:
    """The error's message; for an error of the system, with the file's name and without the error number."""
    if isinstance(error, OSError) and error.strerror and (error.filename is not None or error.errno in _UNWRITABLE):
        return f"{error.filename or 'standard output, or a file,'} cannot be used: {error.strerror}"
    return str(error) or "there is not enough memory"


def progress(text: str) -> None:
    """Print on a terminal what begins now and lasts some seconds."""
    if sys.stderr is not None and sys.stderr.isatty():
        print(text, file=sys.stderr, flush=True)


def bar(total: int, shown: bool, unit: str = "step") -> AbstractContextManager[Any]:
    """A progress bar of tqdm, whose ``update`` moves it on by a number of units; it is erased at the block's end.

    Nothing is written if it is not ``shown``, if standard error is no terminal, or if tqdm is not installed.
    """
    if shown and sys.stderr is not None and importlib.util.find_spec("tqdm"):
        return importlib.import_module("tqdm").tqdm(total=total, unit=unit, leave=False, disable=None)  # type: ignore[no-any-return]
    return nullcontext(SimpleNamespace(update=lambda count: None))


def called(name: str, *arguments: str) -> str:
    """A command line to continue with: of ``jackbox`` if that started this process, else of the script of that name."""
    by_jackbox = sys.argv[0].startswith(f"{JACKBOX} ")
    return shlex.join([*((JACKBOX, name) if by_jackbox else ("python", f"scripts/{name}.py")), *arguments])


def in_checkout() -> bool:
    """Whether this package is part of a checkout, which has the scripts too."""
    return (ROOT / "scripts" / "train.py").is_file() and (ROOT / "pyproject.toml").is_file()
