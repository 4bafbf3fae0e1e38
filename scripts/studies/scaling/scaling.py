"""Write docs/scaling.md: what a sweep takes on one and two workers, and what 100 machines would give."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path

from jackbox_env.commands.common import command_line


@dataclass(frozen=True)
class Arguments:
    """Measure with Ray on this machine; some minutes."""

    trials: int = 100
    """Trials of each sweep, 4 episodes each."""
    on_two_nodes: int = 1000
    """Trials of one more sweep on two nodes."""
    out: Path = Path("docs")
    """Folder of the page scaling.md and its results scaling.json."""
    render: bool = False
    """Measure nothing: write the page from the results that are stored."""


@command_line
def main() -> None:
    """Parse, measure, write, print."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    from jackbox_env import _validation as check
    from jackbox_env.recording.files import check_writable, write_json, write_text
    from scripts.studies.scaling.page import page

    for name in ("trials", "on_two_nodes"):
        check.whole(name, getattr(arguments, name), at_least=20)
    check_writable(arguments.out)
    path = arguments.out / "scaling.json"
    if not arguments.render:
        from scripts.studies.scaling.measured import measured

        write_json(path, measured(arguments.trials, arguments.on_two_nodes))
    text = page(json.loads(path.read_text()))
    write_text(arguments.out / "scaling.md", text)
    print(text)


if __name__ == "__main__":
    main()
