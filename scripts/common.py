"""What the command lines share."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from gymnasium.error import DependencyNotInstalled
from gymnasium.error import Error as GymnasiumError

from jackbox_env import _validation as check

if TYPE_CHECKING:
    import tyro as tyro


def __getattr__(name: str) -> Any:
    """Give ``tyro`` to the commands that read it here; where it is missing, say how to get it, and exit with 2."""
    if name != "tyro":
        raise AttributeError(name)
    try:
        import tyro
    except ImportError:
        print(check.extra_needed("this command", "tyro", "train"), file=sys.stderr)
        sys.exit(2)
    return tyro


def command_line(main: Callable[[], None]) -> Callable[[], None]:
    """Turn refusals into one sentence on standard error and exit status 2; Ctrl-C exits with 130."""

    @functools.wraps(main)
    def wrapped() -> None:
        try:
            main()
        except (ImportError, DependencyNotInstalled) as error:
            more = "; this command needs more packages: pip install -e '.[all,dev]' in a checkout"
            print(f"{error}{'' if 'pip install' in str(error) else more}", file=sys.stderr)
            sys.exit(2)
        except (ValueError, TypeError, OSError, RuntimeError, GymnasiumError) as error:
            print(error, file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            sys.exit(130)

    return wrapped
