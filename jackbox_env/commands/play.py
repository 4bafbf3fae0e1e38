"""Play JackInBox-v0 in the browser, on the exact model, in one page that needs no network."""

from __future__ import annotations

import argparse
import shutil
import sys
import webbrowser
from pathlib import Path

from jackbox_env.commands.options import parser_of
from jackbox_env.tools.command_line import command_line
from jackbox_env.tools.files import check_new_file, new_file

PAGE = Path(__file__).parents[1] / "recording" / "web" / "play.html"


def options() -> argparse.Namespace:
    """The command's options; ``--help`` ends the process here.

    Raises:
        OSError: ``--out`` exists, or cannot be written.
    """
    parser = parser_of(__doc__)
    parser.add_argument("--no-browser", action="store_true", help="only print the path of the page")
    parser.add_argument(
        "--out",
        type=Path,
        metavar="FILE",
        help="write the page to this new file, which can be sent, and do not open it",
    )
    chosen = parser.parse_args()
    if chosen.out is not None:
        check_new_file(chosen.out)
    return chosen


def packaged() -> Path:
    """The path of the page that this package has.

    Raises:
        FileNotFoundError: this package was built without the page.
    """
    if not PAGE.is_file():
        raise FileNotFoundError(
            f"this jackbox was built without its page, {PAGE}: in a checkout `jackbox play` builds it"
        )
    return PAGE


@command_line
def main() -> None:
    """Show the page that this package has."""
    show(options(), packaged())


def show(chosen: argparse.Namespace, page: Path) -> None:
    """Write a page to ``--out``; else print its path, and open it unless the command's options forbid it."""
    if chosen.out is not None:
        with new_file(chosen.out) as partial:
            shutil.copyfile(page, partial)
        print(chosen.out)
        return
    print(page if chosen.no_browser else f"Opening {page}", flush=True)
    print("`jackbox play --out FILE` writes a copy to send.", file=sys.stderr)
    if not chosen.no_browser and not webbrowser.open(page.as_uri()):
        print("No browser could be opened: open this file in one.", file=sys.stderr)


if __name__ == "__main__":
    main()
