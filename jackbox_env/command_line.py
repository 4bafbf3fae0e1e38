"""What every command line of the project has: refusals in one sentence, an exit status for each end."""

from __future__ import annotations

import errno
import functools
import os
import shlex
import sys
from collections.abc import Callable
from pathlib import Path

from gymnasium.error import DependencyNotInstalled
from gymnasium.error import Error as GymnasiumError

JACKBOX = "jackbox"  # the command, and with a command's name the first word of what it was started by
ROOT = Path(__file__).parents[1]  # of a checkout; above an installed package there is none
_UNREAD = 128 + 13  # exit status of what SIGPIPE ends
_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EIO)  # standard output's errors do not say what they are about


def command_line(main: Callable[[], None]) -> Callable[[], None]:
    """Turn refusals into one sentence on standard error and exit status 2; Ctrl-C exits with 130.

    Where nobody reads standard output any more, as behind ``| head``, it ends quietly with 141.
    """

    @functools.wraps(main)
    def wrapped() -> None:
        _open_closed()
        try:
            main()
            sys.stdout.flush()  # a full disk is met here, not at Python's end
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
            sys.exit(_UNREAD)
        except (ValueError, TypeError, OSError, RuntimeError, GymnasiumError) as error:
            print(_sentence(error), file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            sys.exit(130)
        finally:
            _drop_unwritten()

    return wrapped


def _open_closed() -> None:
    """Let a closed standard output or error lead nowhere, before a file of ours takes its number."""
    for name in ("stdout", "stderr"):
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "w"))  # noqa: SIM115


def _drop_unwritten() -> None:
    """Drop what standard output does not take, or Python would try again at its end and show a traceback."""
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _sentence(error: Exception) -> str:
    """The error's message; for an error of the system, with the file's name and without the error number."""
    if isinstance(error, OSError) and error.strerror and (error.filename is not None or error.errno in _UNWRITABLE):
        return f"{error.filename or 'standard output, or a file,'} cannot be used: {error.strerror}"
    return str(error)


def called(name: str, *arguments: str) -> str:
    """A command line to go on with: by ``jackbox`` where that started this process, else by the script of that name."""
    by_jackbox = sys.argv[0].startswith(f"{JACKBOX} ")
    return shlex.join([*((JACKBOX, name) if by_jackbox else ("python", f"scripts/{name}.py")), *arguments])


def in_checkout() -> bool:
    """Whether this package is that of a checkout, with the scripts beside it."""
    return (ROOT / "scripts" / "train.py").is_file() and (ROOT / "pyproject.toml").is_file()
