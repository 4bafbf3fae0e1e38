"""Play JackInBox-v0 in the browser, on the exact model, in one page that needs no network."""

from __future__ import annotations

import argparse
import sys
import webbrowser
from pathlib import Path

from jackbox_env.commands.options import parser_of
from jackbox_env.tools.command_line import command_line

PAGE = Path(__file__).parents[1] / "recording" / "web" / "play.html"


def options() -> argparse.Namespace:
    """The command's options; ``--help`` ends the process here."""
    parser = parser_of(__doc__)
    parser.add_argument("--no-browser", action="store_true", help="only print the path of the page")
    return parser.parse_args()


@command_line
def main() -> None:
    """Show the page that this package has.

    Raises:
        FileNotFoundError: this package was built without the page.
    """
    options()
    if not PAGE.is_file():
        raise FileNotFoundError(
            f"this jackbox was built without its page, {PAGE}: in a checkout `jackbox play` builds it"
        )
    show(PAGE)


def show(page: Path) -> None:
    """Print the path of a page, and open it unless the command's options forbid it."""
    print(page, flush=True)
    if not options().no_browser and not webbrowser.open(page.as_uri()):
        print("No browser could be opened: open this file in one.", file=sys.stderr)


if __name__ == "__main__":
    main()
