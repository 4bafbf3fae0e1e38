"""Speed against accuracy: sweep every contact model and setting over the same cases and write docs/accuracy.md."""

from __future__ import annotations

import dataclasses
import shutil
import statistics
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from scripts.common import command_line

if TYPE_CHECKING:
    from scripts.studies.accuracy.settings import Setting

PICTURE, PAGE, TABLE, INTERACTIVE = "work_precision.png", "accuracy.md", "results.csv", "work_precision.html"


@dataclass(frozen=True)
class Arguments:
    """Sweep; an interrupted sweep is taken up again by the same command."""

    quick: bool = False
    """Two minutes: fewer settings, cases and rounds."""
    cases: int | None = None
    """Seeded cases of each kind (chirp, held, weightless); None: 34, or 5 when quick."""
    rounds: int | None = None
    """Rounds in which the costs are measured; None: 7, or 3 when quick."""
    seconds: float = 0.3
    """Time per measurement of cost [s]."""
    folder: Path | None = None
    """Run folder to make or to go on in; None: an unfinished one of the same sweep, or runs/benchmark-<date>-<time>."""
    out: Path | None = None
    """Where the page goes as well, its files beside it in accuracy/, e.g. docs; None: into the run folder only."""
    progress: bool = True
    """Show progress bars."""


def swept(folder: Path, settings: list[Setting], count: int, progress: bool) -> dict[str, list[dict[str, Any]]]:
    """Measure what is not measured yet, and return all records by setting."""
    from tqdm import tqdm

    from scripts.studies.accuracy.cases import DIGITS, KINDS, known_to_60_digits, seeded_with_references
    from scripts.studies.accuracy.records import append, measured, read

    done = read(folder)
    records: dict[str, list[dict[str, Any]]] = {setting.name: [] for setting in settings if setting.make is not None}
    for kind in (DIGITS, *KINDS):
        cases = known_to_60_digits() if kind == DIGITS else seeded_with_references(kind, count)
        todo = [(setting, case) for setting in settings if setting.make is not None for case in cases]
        for setting, (case, reference) in tqdm(todo, desc=kind, unit="run", disable=not progress, leave=False):
            record = done.get((setting.name, case.name))
            if record is None:
                record = measured(setting, kind, case, reference)
                append(folder, record)
            records[setting.name].append(record)
    return records


def costs(settings: list[Setting], rounds: int, seconds: float, progress: bool) -> dict[str, dict[str, float]]:
    """Microseconds per simulated second, and the ratio to the default's within rounds."""
    from scripts.studies.accuracy.page import DEFAULT
    from scripts.studies.accuracy.settings import cost_of
    from scripts.studies.timing import measure, ratios

    rates = measure({setting.name: cost_of(setting, seconds) for setting in settings}, rounds, progress)
    found = {}
    for name, values in rates.items():
        taken = [1e6 / rate for rate in values]
        over = statistics.median(ratios(rates, DEFAULT, name))
        found[name] = {"median": statistics.median(taken), "low": min(taken), "high": max(taken), "over_default": over}
    return found


def collected(
    settings: list[Setting], records: dict[str, list[dict[str, Any]]], cost: dict[str, dict[str, float]]
) -> dict[str, Any]:
    """All results in one structure for JSON."""
    from scripts.studies import rivals
    from scripts.studies.accuracy.summary import claims, kinds_of, orders, summed_up

    entries = {}
    for setting in settings:
        entry: dict[str, Any] = {
            "family": setting.family, "substeps": setting.substeps, "contact": setting.contact,
            "cost": cost[setting.name],
        }  # fmt: skip
        if setting.make is not None:
            entry["kinds"] = {kind: summed_up(part) for kind, part in kinds_of(records[setting.name]).items()}
        entries[setting.name] = entry
    results: dict[str, Any] = {"settings": entries, "missing": rivals.missing(), "orders": orders(settings, records)}
    results["claims"] = [list(claim) for claim in claims(results)]
    return results


def how(arguments: Arguments, before: tuple[float, float]) -> list[str]:
    """What the figures come from."""
    from agents.runs import PACKAGES, machine, versions
    from scripts.studies.timing import meanwhile

    known = versions((*(name for name in PACKAGES if name != "torch"), "numba", "mujoco", "box2d"))
    command = " ".join(["python scripts/studies/accuracy/benchmark.py", *sys.argv[1:]])
    return [
        f"Written by `{command}`: {arguments.cases} seeded cases of each kind; costs are medians (smallest to largest) "
        f"over {arguments.rounds} interleaved rounds after one to warm up, at least {arguments.seconds:g} s each, of "
        "the simulator's thread: while others have the processor its time stands still.",
        "",
        f"{machine()}; " + ", ".join(f"{name} {version}" for name, version in known.items()),
        "",
        meanwhile(before),
    ]


def write(results: dict[str, Any], folder: Path, out: Path | None) -> None:
    """Files into the run folder, and the page with its files into ``out``."""
    from agents.runs import write_json
    from scripts.studies.accuracy import page, pictures
    from scripts.studies.accuracy.records import RESULTS

    files = (RESULTS, TABLE)
    pictures.draw(results, folder / PICTURE)
    pictures.interactive(results, folder / INTERACTIVE)
    page.write_csv(results, folder / TABLE)
    (folder / PAGE).write_text(page.page(results, PICTURE, INTERACTIVE, [f"[{name}]({name})" for name in files]))
    if out is not None:
        beside = out / "accuracy"
        beside.mkdir(exist_ok=True)
        for name in (PICTURE, INTERACTIVE, TABLE):
            shutil.copyfile(folder / name, beside / name)
        write_json(beside / RESULTS, results)
        links = [f"[{name}](accuracy/{name})" for name in files]
        (out / PAGE).write_text(page.page(results, f"accuracy/{PICTURE}", f"accuracy/{INTERACTIVE}", links))
    write_json(folder / RESULTS, results)  # last: the sweep is finished


def resolved(arguments: Arguments) -> Arguments:
    """Arguments with the numbers that are meant, checked."""
    from jackbox_env import _validation as check

    cases = (5 if arguments.quick else 34) if arguments.cases is None else arguments.cases
    rounds = (3 if arguments.quick else 7) if arguments.rounds is None else arguments.rounds
    check.whole("cases", cases, at_least=2)
    check.whole("rounds", rounds, at_least=1)
    check.real("seconds", arguments.seconds, above=0.0)
    if arguments.out is not None and not arguments.out.is_dir():
        raise FileNotFoundError(f"{arguments.out} is no folder to write a page in")
    return dataclasses.replace(arguments, cases=cases, rounds=rounds)


@command_line
def main() -> None:
    """Parse, sweep, sum up, write."""
    import tyro

    arguments = resolved(tyro.cli(Arguments, description=__doc__))
    import bokeh  # noqa: F401  # refused now rather than after the sweep
    import matplotlib  # noqa: F401

    from scripts.studies.accuracy.page import fidelity_table
    from scripts.studies.accuracy.records import open_folder
    from scripts.studies.accuracy.settings import settings
    from scripts.studies.timing import others

    before, chosen = others(), settings(arguments.quick)
    asked = {"quick": arguments.quick, "cases": arguments.cases}
    folder = open_folder(asked, arguments.folder, "benchmark-quick" if arguments.quick else "benchmark")
    try:
        records = swept(folder, chosen, arguments.cases or 0, arguments.progress)
        cost = costs(chosen, arguments.rounds or 0, arguments.seconds, arguments.progress)
        results = collected(chosen, records, cost)
    except KeyboardInterrupt:
        print(f"\nInterrupted; the same command goes on in {folder}", file=sys.stderr)
        raise
    results |= {"arguments": asked, "how": how(arguments, before)}
    write(results, folder, arguments.out)
    print("\n".join(fidelity_table(results)))
    for what, seen, holds in results["claims"]:
        print(f"{'holds' if holds else 'FAILS'}: {what}: {seen}")
    print(f"Wrote {folder}" + (f" and {arguments.out / PAGE}" if arguments.out else ""))
    failed = [what for what, _, holds in results["claims"] if not holds]
    if failed:
        raise RuntimeError(f"{len(failed)} claims do not hold: " + "; ".join(failed))


if __name__ == "__main__":
    main()
