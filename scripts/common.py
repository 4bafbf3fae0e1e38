"""What the command lines share."""

from __future__ import annotations

import functools
import sys
from collections.abc import Callable


def command_line(main: Callable[[], None]) -> Callable[[], None]:
    """Turn refusals into one sentence on standard error and exit status 2; Ctrl-C exits with 130."""

    @functools.wraps(main)
    def wrapped() -> None:
        try:
            main()
        except (ValueError, TypeError, FileNotFoundError, FileExistsError) as error:
            print(f"{type(error).__name__}: {error}", file=sys.stderr)
            sys.exit(2)
        except KeyboardInterrupt:
            sys.exit(130)

    return wrapped
