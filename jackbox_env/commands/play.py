"""Play JackInBox-v0 in the browser, on the exact model, in one page that needs no network."""

from __future__ import annotations

import argparse
import sys
import webbrowser
from pathlib import Path

from jackbox_env.command_line import command_line
from jackbox_env.commands.options import parser_of

PAGE = Path(__file__).parents[1] / "page" / "play.html"


def options() -> argparse.Namespace:
    """The command's options; ``--help`` ends the process here."""
    parser = parser_of(__doc__)
    parser.add_argument("--no-browser", action="store_true", help="only print the path of the page")
    return parser.parse_args()


@command_line
def main() -> None:
    """Print the path of the page, and open it.

    Raises:
        FileNotFoundError: this package was built without the page.
    """
    chosen = options()
    if not PAGE.is_file():
        raise FileNotFoundError(
            f"this jackbox was built without its page, {PAGE}: in a checkout `jackbox play` builds it"
        )
    print(PAGE, flush=True)
    if not chosen.no_browser and not webbrowser.open(PAGE.as_uri()):
        print("No browser could be opened: open this file in one.", file=sys.stderr)


if __name__ == "__main__":
    main()
