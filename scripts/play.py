"""Play JackInBox-v0 in the browser: the command `jackbox play`, which builds the page first in a checkout."""

from __future__ import annotations

import sys
import tempfile
from pathlib import Path

from jackbox_env.commands import play
from jackbox_env.tools.command_line import command_line
from scripts.site.build import ensure_page


@command_line
def main() -> None:
    """Build the page unless it is up to date, and open it; in a temporary folder if the package cannot be written."""
    chosen = play.options()  # --help need not wait for the page
    try:
        page = ensure_page()
    except OSError as error:
        page = ensure_page(Path(tempfile.mkdtemp(prefix="jackbox-"), play.PAGE.name))
        print(f"{play.PAGE} cannot be written ({error.strerror}): the page is in a temporary folder", file=sys.stderr)
    play.show(chosen, page)


if __name__ == "__main__":
    main()
