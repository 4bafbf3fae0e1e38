"""Play JackInBox-v0 in the browser: the command `jackbox play`, which builds the page first in a checkout."""

from __future__ import annotations

from jackbox_env.command_line import command_line
from jackbox_env.commands import play
from scripts.site.build import ensure_page


@command_line
def main() -> None:
    """Build the page unless it is up to date, and open it."""
    play.options()  # --help need not wait for the page
    ensure_page()
    play.main()


if __name__ == "__main__":
    main()
