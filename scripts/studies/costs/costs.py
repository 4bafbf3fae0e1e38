"""Write docs/costs.md: what each thing that is modelled costs per control step, and that what is off costs nothing."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from scripts.common import command_line
from scripts.studies import timing

PACKAGES = ("jackbox", "gymnasium", "numpy", "pymunk", "numba")
PASSES = 9  # through everything, in a round


@dataclass(frozen=True)
class Arguments:
    """Measure in interleaved rounds; every figure is the median over the rounds."""

    rounds: int = 7
    """Rounds; each measures everything nine times in turn, and takes the median."""
    seconds: float = 0.03
    """Time per measurement [s], or once through the moments."""
    out: Path = Path("docs")
    """Folder of the page costs.md, its picture costs.png and its results costs.json."""
    render: bool = False
    """Measure nothing: write the page from the results that are stored."""


def measured(rounds: int, seconds: float) -> dict[str, Any]:
    """Everything that the page shows."""
    from scripts.studies.costs import cost_steps as these
    from scripts.studies.costs.page import BATCH, EXACT, PYMUNK, figures

    before = timing.others()
    usual, far = these.moments(these.FEW, 4), these.moments(these.FEW, 4, these.LONG)
    many, many_far = these.moments(these.TOGETHER, 40), these.moments(these.TOGETHER, 40, these.LONG)
    timed = {
        f"{contact}: {kind}": these.stepped(contact, far if kind == "long arm" else usual, seconds, kind)
        for contact in (PYMUNK, EXACT)
        for kind in (*these.KINDS, *these.TAKEN_OUT)
    }
    for kind, settings in (these.KINDS | {"infos": {"with_infos": True}}).items():
        if kind != "drawn":
            given = many_far if kind == "long arm" else many
            timed[f"{BATCH}: {kind}"] = these.batched(EXACT, given, seconds, **settings)
    timed[f"{PYMUNK}: together"] = these.batched(PYMUNK, usual, seconds)
    rates = timing.measure(timed, rounds * PASSES)
    made = f"{timing.measured_with(PACKAGES)}; {rounds} rounds of {PASSES} passes. {timing.meanwhile(before)}"
    impacts = {"usual": float(usual.hits.mean()), "long arm": float(far.hits.mean())}
    asked = {contact: these.asked(contact) for contact in (PYMUNK, EXACT)}
    return figures(rates, PASSES) | {"impacts": impacts, "asked": asked, "made": made}


@command_line
def main() -> None:
    """Parse, measure, count, write, print."""
    import tyro

    from agents.storage import write_json, write_text
    from jackbox_env import _validation as check
    from scripts.studies.costs.page import page, pictured

    arguments = tyro.cli(Arguments, description=__doc__)
    rounds = check.whole("rounds", arguments.rounds, at_least=1)
    seconds = check.real("seconds", arguments.seconds, above=0.0)
    if not arguments.out.is_dir():
        raise FileNotFoundError(f"{arguments.out} is no folder to write a page in")
    path, picture = arguments.out / "costs.json", arguments.out / "costs.png"
    if not arguments.render:
        timing.on_cores({max(os.sched_getaffinity(0))} if timing.PINNED else ())
        write_json(path, measured(rounds, seconds))
    results = json.loads(path.read_text())
    timing.bars(picture, "ns of a control step of one environment", pictured(results))
    write_text(arguments.out / "costs.md", page(results, picture.name))
    print(page(results, picture.name))


if __name__ == "__main__":
    main()
