"""Write docs/speed.md: how fast the environment and the exact model are, beside others on the same core."""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from jackbox_env.commands.common import command_line
from scripts.studies import pages, timing
from scripts.studies.timing import meanwhile

Part = Literal["alone", "together", "threads", "start"]
PACKAGES = ("jackbox", "gymnasium", "numpy", "pymunk", "numba", "stable-baselines3", "envpool")
STARTS = 3  # cold starts of each kind at most: each compiles everything


@dataclass(frozen=True)
class Arguments:
    """Measure in interleaved rounds; every figure is the median over the rounds."""

    parts: tuple[Part, ...] = ("alone", "together", "threads", "start")
    """Parts of the page to measure; the others stay as stored. None: only write the page from what is stored."""
    rounds: int = 5
    """Rounds; each measures everything once, so that a slow moment of the machine falls on all."""
    seconds: float = 0.4
    """Time per measurement [s]."""
    out: Path = Path("docs")
    """Folder of the page speed.md, its picture speed.png and its results speed.json."""


def measured(part: Part, rounds: int, seconds: float, stored: dict[str, Any]) -> dict[str, Any]:
    """Measure a part of the page. Keep the ``stored`` figures of peers that are not installed now."""
    from scripts.studies.speed import measured as these
    from scripts.studies.speed.page import before_of, kept_of, ratios_of

    before, cores = timing.others(), os.sched_getaffinity(0) if timing.PINNED else {0}
    timing.on_cores(cores if part == "threads" else {max(cores)})
    found: dict[str, Any] = {}
    if part == "start":
        found = these.start(min(rounds, STARTS))
    else:
        makes: dict[str, Callable[[float], dict[str, timing.Timed]]] = {
            "alone": these.alone, "together": these.together, "threads": partial(these.threads, len(cores))
        }  # fmt: skip
        found["rates"] = timing.measure(makes[part](seconds), rounds)
        found["ratios"] = ratios_of(part, found["rates"])
        found["kept"], found["before"] = kept_of(stored, found["ratios"]), before_of(stored)
    if part == "together":
        found["lost"] = these.lost()
    timing.on_cores(cores)
    made = f"{timing.measured_with(PACKAGES)}; {rounds} rounds of {seconds:g} s. {meanwhile(before)}"
    return found | {"made": made}


@command_line
def main() -> None:
    """Parse, measure, write, print."""
    import tyro

    from jackbox_env import _validation as check
    from jackbox_env.recording.files import write_json, write_text
    from scripts.studies.speed.page import page, pictured, told

    arguments = tyro.cli(Arguments, description=__doc__)
    check.whole("rounds", arguments.rounds, at_least=1)
    check.real("seconds", arguments.seconds, above=0.0)
    if not arguments.out.is_dir():
        raise FileNotFoundError(f"{arguments.out} is no folder to write a page in")
    path, picture = arguments.out / "speed.json", arguments.out / "speed.png"
    results: dict[str, Any] = json.loads(path.read_text()) if path.exists() else {}
    for part in arguments.parts:
        results[part] = measured(part, arguments.rounds, arguments.seconds, results.get(part, {}))
        write_json(path, results)
    pages.bars(picture, "control steps per second on one core", pictured(results), log=True)
    write_text(arguments.out / "speed.md", page(results, picture.name))
    print(told(results))


if __name__ == "__main__":
    main()
