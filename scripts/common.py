"""What the command lines share."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable

from gymnasium.error import DependencyNotInstalled
from gymnasium.error import Error as GymnasiumError


def command_line(main: Callable[[], None]) -> Callable[[], None]:
    """Turn refusals into one sentence on standard error and exit status 2; Ctrl-C exits with 130."""

    @functools.wraps(main)
    def wrapped() -> None:
        try:
            main()
        except (ImportError, DependencyNotInstalled) as error:
            print(
                f"{error}; this command needs more packages: pip install -e '.[all,dev]' in a checkout", file=sys.stderr
            )
            sys.exit(2)
        except (ValueError, TypeError, OSError, RuntimeError, GymnasiumError) as error:
            print(error, file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            sys.exit(130)

    return wrapped
