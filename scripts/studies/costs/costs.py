"""Write docs/costs.md: what each thing that is modelled costs per control step, and that what is off costs nothing."""

from __future__ import annotations

import json
import os
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jackbox_env.commands.common import command_line
from scripts.studies import pages, timing

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
    loss: bool = False
    """Measure only the steps with loss, and keep the rest of what is stored."""
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
    for kind, settings in (these.KINDS | these.IN_BATCHES).items():
        if kind != "drawn":
            given = many_far if kind == "long arm" else many
            timed[f"{BATCH}: {kind}"] = these.batched(EXACT, given, seconds, **settings)
    timed[f"{PYMUNK}: together"] = these.batched(PYMUNK, usual, seconds)
    rates = timing.measure(timed, rounds * PASSES)
    impacts = {"usual": float(usual.hits.mean()), "long arm": float(far.hits.mean())}
    asked = {contact: these.asked(contact) for contact in (PYMUNK, EXACT)}
    return figures(rates, PASSES) | {"impacts": impacts, "asked": asked, "made": made(rounds, before)}


def measured_with_loss(rounds: int, seconds: float) -> dict[str, Any]:
    """What the page shows of steps with loss and at rest."""
    from scripts.studies.costs import cost_steps as these
    from scripts.studies.costs.page import BATCH, EXACT, loss_figures

    before, timed, impacts = timing.others(), dict[str, timing.Timed](), dict[str, float]()
    for kind, scene in these.LOSS.items():
        given = these.with_loss(kind)
        impacts[kind] = float(given.hits.mean())
        timed[f"{EXACT}: {kind}"] = these.alone(scene, given, seconds)
        timed[f"{BATCH}: {kind}"] = these.batched(EXACT, given, seconds, scene=scene)
    steps = loss_figures(timing.measure(timed, rounds * PASSES), PASSES)
    return {"steps": steps, "impacts": impacts, "made": made(rounds, before)}


def made(rounds: int, before: tuple[float, float]) -> str:
    """What the figures come from."""
    return f"{timing.measured_with(PACKAGES)}; {rounds} rounds of {PASSES} passes. {timing.meanwhile(before)}"


@command_line
def main() -> None:
    """Parse, measure, count, write, print."""
    import tyro

    from jackbox_env import _validation as check
    from jackbox_env.recording.files import write_json, write_text
    from scripts.studies.costs.page import page, pictured

    arguments = tyro.cli(Arguments, description=__doc__)
    rounds = check.whole("rounds", arguments.rounds, at_least=1)
    seconds = check.real("seconds", arguments.seconds, above=0.0)
    if not arguments.out.is_dir():
        raise FileNotFoundError(f"{arguments.out} is no folder to write a page in")
    path, picture = arguments.out / "costs.json", arguments.out / "costs.png"
    if not arguments.render:
        timing.on_cores({max(os.sched_getaffinity(0))} if timing.PINNED else ())
        kept = json.loads(path.read_text()) if arguments.loss else measured(rounds, seconds)
        write_json(path, kept | {"loss": measured_with_loss(rounds, seconds)})
    results = json.loads(path.read_text())
    pages.bars(picture, "ns of a control step of one environment", pictured(results))
    write_text(arguments.out / "costs.md", page(results, picture.name))
    print(page(results, picture.name))


if __name__ == "__main__":
    main()
