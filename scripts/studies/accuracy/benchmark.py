"""Speed against accuracy: sweep every contact model and setting over the same cases and write docs/accuracy.md."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from jackbox_env.commands.common import command_line


@dataclass(frozen=True)
class Arguments:
    """Sweep; the same command continues an interrupted sweep."""

    quick: bool = False
    """Two minutes: fewer settings, cases and rounds."""
    cases: int | None = None
    """Seeded cases of each kind (chirp, held, weightless); None: 34, or 5 when quick."""
    rounds: int | None = None
    """Rounds in which the costs are measured; None: 7, or 3 when quick."""
    seconds: float = 0.3
    """Time per measurement of cost [s]."""
    folder: Path | None = None
    """Run folder to make or to continue in; None: an unfinished one of the same sweep in runs/, or a new one."""
    page_from: Path | None = None
    """Do not sweep: write page and pictures again from this results.json and the results.csv beside it."""
    loss: bool = False
    """With --page-from: measure the trajectories with loss anew, and nothing else."""
    workers: int | None = None
    """Settings measured side by side with Ray on this machine; None: one after the other. Costs are measured alone."""
    address: str | None = None
    """With Ray on a cluster: the address of its head, or auto on one of its machines."""
    out: Path | None = None
    """Folder for one more copy of the page, with its files beside it in accuracy/, e.g. docs."""
    progress: bool = True
    """Show progress bars."""


@command_line
def main() -> None:
    """Sweep or read, write, check."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    import bokeh  # noqa: F401  # refused now rather than after the sweep
    import matplotlib  # noqa: F401

    from agents.sweeps.on_ray import runner_for
    from jackbox_env import _validation as check
    from scripts.studies.accuracy import sweep
    from scripts.studies.accuracy.claims import claims
    from scripts.studies.accuracy.page import fidelity_table
    from scripts.studies.accuracy.results import Results

    few = arguments.quick
    cases = check.whole("cases", (5 if few else 34) if arguments.cases is None else arguments.cases, at_least=2)
    rounds = check.whole("rounds", (3 if few else 7) if arguments.rounds is None else arguments.rounds, at_least=1)
    seconds = check.real("seconds", arguments.seconds, above=0.0)
    if arguments.out is not None and not arguments.out.is_dir():
        raise FileNotFoundError(f"{arguments.out} is no folder to write a page in")
    runner = runner_for(arguments.workers, arguments.address)
    if arguments.loss and arguments.page_from is None:
        raise ValueError("--loss adds to stored results: give --page-from too")
    if arguments.page_from is not None:
        results, folder = Results.load(arguments.page_from.parent), arguments.page_from.resolve().parents[1]
        results = sweep.with_loss(results, arguments.progress) if arguments.loss else results
    else:
        results, folder = sweep.run(few, cases, rounds, seconds, arguments.folder, arguments.progress, runner)
    for place in filter(None, (arguments.out, folder)):
        sweep.write(results, place)
    found = claims(results)
    print(fidelity_table(results))
    print("\n".join(f"{'holds' if claim.holds else 'FAILS'}: {claim.what}: {claim.seen}" for claim in found))
    print(f"Wrote {folder}" + (f" and {arguments.out / sweep.PAGE}" if arguments.out else ""))
    failed = [claim.what for claim in found if not claim.holds]
    if failed:
        raise RuntimeError(f"{len(failed)} claims do not hold: " + "; ".join(failed))


if __name__ == "__main__":
    main()
