"""Measure every law on random scenes for hours. A case follows from its number, so a soak goes on from any number."""

from __future__ import annotations

import random
import sys
import time
from dataclasses import dataclass
from typing import Literal

from tqdm import tqdm

from jackbox_env import _validation as check
from jackbox_env.commands.common import command_line
from jackbox_env.simulators import CONTACT_MODELS
from scripts.studies.laws.laws import KEPT, Tally, examine
from scripts.studies.laws.random_cases import draw_case


@dataclass(frozen=True)
class Arguments:
    """Measure every law on random scenes; exit status 1 if one is broken."""

    hours: float = 1e5
    """How long at most [h]."""
    cases: int = 10**12
    """How many cases of each contact model at most."""
    first: int = 0
    """Number of the first case, for a soak that goes on."""
    contact: Literal["both", "pymunk", "exact"] = "both"
    """Contact model."""
    progress: bool = True
    """Show a progress bar."""


def soak(arguments: Arguments, tallies: dict[str, Tally]) -> None:
    """Examine case after case and add it to the tally; print the first broken ones at once."""
    end = time.monotonic() + 3600.0 * arguments.hours
    numbers = range(arguments.first, arguments.first + arguments.cases)
    for number in tqdm(numbers, unit=" cases", disable=not arguments.progress, leave=False):
        cases = {contact: draw_case(random.Random(number), contact) for contact in tallies}
        for contact, found in [(contact, examine(case)) for contact, case in cases.items()]:
            tallies[contact].enter(number, found)
            if found.broken and tallies[contact].broken <= KEPT:
                tqdm.write(f"--first {number} --cases 1 --contact {contact}: {found}\n{cases[contact]}", sys.stdout)
        if time.monotonic() > end:
            break


@command_line
def main() -> None:
    """Parse, soak, say what was found, interrupted or not."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    check.real("hours", arguments.hours, above=0.0, at_most=1e5)
    check.whole("cases", arguments.cases, at_least=1, at_most=10**12)
    check.whole("first", arguments.first, at_least=0)
    tallies = {name: Tally() for name in CONTACT_MODELS if arguments.contact in ("both", name)}
    try:
        soak(arguments, tallies)
    finally:
        print(*(f"{contact}: {tally}" for contact, tally in tallies.items()), sep="\n")
        print(f"go on with --first {arguments.first + min(tally.cases for tally in tallies.values())}")
    sys.exit(1 if any(tally.broken for tally in tallies.values()) else 0)


if __name__ == "__main__":
    main()
