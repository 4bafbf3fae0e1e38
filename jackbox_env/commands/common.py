"""What the command lines share."""

from __future__ import annotations

import argparse
import errno
import functools
import json
import os
import re
import shlex
import sys
from collections.abc import Callable
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

from gymnasium.error import DependencyNotInstalled
from gymnasium.error import Error as GymnasiumError

from jackbox_env import checks as check

if TYPE_CHECKING:
    import tyro as tyro

    from jackbox_env.simulators.fidelity import Setting

Kind = TypeVar("Kind", dict[str, Any], list[Any])
JACKBOX = "jackbox"  # the command, and with a command's name the first word of what it was started by
_UNREAD = 128 + 13  # exit status of what SIGPIPE ends
_UNWRITABLE = (errno.ENOSPC, errno.EDQUOT, errno.EIO)  # standard output's errors do not say what they are about
ROOT = Path(__file__).parents[2]  # of a checkout; above an installed package there is none


def __getattr__(name: str) -> Any:
    """Give ``tyro`` to the scripts that read it here; where it is missing, say how to get it, and exit with 2."""
    if name != "tyro":
        raise AttributeError(name)
    try:
        import tyro
    except ImportError:
        print(check.extra_needed("this command", "tyro", "train"), file=sys.stderr)
        sys.exit(2)
    return tyro


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
    """What an error says; one of the system's own says which file it is about, without its number."""
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


def extras() -> dict[str, list[str]]:
    """What each extra asks for, e.g. {"render": ["pygame-ce>=2.5"]}, by the installed package's own record."""
    asked = dict[str, list[str]]()
    for line in metadata.requires("jackbox") or []:
        requirement, _, condition = line.partition(";")
        named = re.search(r"extra == ['\"](\w+)['\"]", condition)
        if named and not requirement.startswith("jackbox["):
            asked.setdefault(named[1], []).append(requirement.strip())
    return asked


def from_json(name: str, text: str, kind: type[Kind]) -> Kind:
    """What an option called ``name`` holds that is given as JSON: an object (dict) or a list.

    Raises:
        ValueError: it is something else.
    """
    try:
        values = json.loads(text)
    except (RecursionError, TypeError, ValueError):
        values = None
    if not isinstance(values, kind):
        raise ValueError(f"{name} must be a JSON {'object' if kind is dict else 'list'}, got {check.shown(text)}")
    return values


def json_object(name: str, text: str) -> dict[str, Any]:
    """What an option holds that is given as a JSON object; see :func:`from_json`."""
    return from_json(name, text, dict)


def scene_fields(text: str) -> dict[str, Any]:
    """Fields of a scene that are given as JSON; see :func:`from_json`."""
    return from_json("scene", text, dict)


def parser_of(program: str | None, text: str | None) -> argparse.ArgumentParser:
    """A parser that shows defaults and takes whole names only."""
    return argparse.ArgumentParser(program, description=text, allow_abbrev=False)


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Add what chooses the scene and the contact model: fidelity, contact, substeps, scene."""
    model = parser.add_argument_group("scene and contact model")
    text = "how impacts are computed: coarse, balanced, fine or exact; default: exact"
    model.add_argument("--fidelity", metavar="NAME", help=text)
    model.add_argument("--contact", metavar="NAME", help="in place of a fidelity: pymunk or exact")
    text = "engine steps of pymunk per step, beside --contact; default: 4"
    model.add_argument("--substeps", type=int, metavar="N", help=text)
    text = """fields that differ from the default, as JSON, e.g. '{"gravity": 1.62}'"""
    model.add_argument("--scene", default="{}", metavar="JSON", help=text)


def chosen_setting(arguments: argparse.Namespace) -> Setting:
    """The contact model and substeps that these options mean; :func:`jackbox_env.simulators.fidelity.resolve`."""
    from jackbox_env.simulators.fidelity import COMMANDS, resolve

    given = arguments.fidelity, arguments.contact, arguments.substeps
    return resolve(*given) if any(one is not None for one in given) else resolve(COMMANDS, None, None)
