"""Write the numbers of docs/scaling.md: what a sweep takes on one and two workers and on two nodes, and its limit."""

from __future__ import annotations

import contextlib
import json
import os
import tempfile
import time
from collections.abc import Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

from agents.settings import EnvSettings
from agents.sweeps.in_process import InTurn, Runner, Trial
from agents.sweeps.on_ray import OnRay, sent_to_machines
from agents.sweeps.results_log import LOG, TABLE, TIMES, carry_out, new_sweep
from agents.sweeps.trials import policy_trials, run_trial
from jackbox_env.commands.common import command_line
from scripts.studies import timing
from scripts.studies.pages import fill, rough, table

PACKAGES = ("jackbox", "ray", "numpy", "numba", "torch")


class _Timed:
    """A runner that notes when it began, and when each trial finished."""

    def __init__(self, runner: Runner) -> None:
        self._runner, self.began, self.ends = runner, 0.0, list[float]()

    def run(self, *given: Any) -> Iterator[Any]:
        """See :class:`agents.sweeps.in_process.Runner`."""
        self.began = time.perf_counter()
        for done in self._runner.run(*given):
            self.ends.append(time.perf_counter())
            yield done


def swept(count: int, runner: Runner) -> tuple[dict[str, float], bytes]:
    """Times of a sweep of ``count`` trials, two policies on the exact model with four episodes each, and its table.

    Trials per second are counted from the first tenth that has finished to the last: without the start. ``own`` is the
    processor's time that this process used for a trial [s], which others on the machine do not change.
    """
    trials = policy_trials(("level", "ppo"), [EnvSettings(contact="exact")], count // 2, 4)
    timed, began = _Timed(runner), time.process_time()
    with tempfile.TemporaryDirectory() as scratch:
        folder = new_sweep(Path(scratch) / "sweep", {}, trials)
        outcome = carry_out(folder, trials, partial(run_trial, folder), timed)
        if outcome.failed:
            raise RuntimeError(f"{len(outcome.failed)} of {len(trials)} trials failed")
        size = (folder / LOG).stat().st_size / len(trials)
        workers = len({line.split(",")[2] for line in (folder / TIMES).read_text().splitlines()[1:]})
        table = (folder / TABLE).read_bytes()
    own, tenth = (time.process_time() - began) / len(trials), len(trials) // 10
    rate = (len(trials) - tenth) / (timed.ends[-1] - timed.ends[tenth - 1])
    first = timed.ends[0] - timed.began
    figures = {"rate": rate, "first": first, "own": own, "trials": len(trials), "workers": workers, "size": size}
    return figures, table


def overhead(count: int, runner: Runner) -> dict[str, float]:
    """Seconds for a trial that does nothing, without the start: passed, and of the processor in this process."""

    def nothing(settings: dict[str, Any]) -> dict[str, Any]:
        return settings

    trials = [Trial({"n": n}) for n in range(count)]
    ends = [(time.perf_counter(), time.process_time()) for _ in runner.run(trials, nothing, lambda: None)]
    tenth = count // 10
    passed, own = ((end - begin) / (count - tenth) for begin, end in zip(ends[tenth - 1], ends[-1], strict=True))
    return {"passed": passed, "own": own}


def log_line(count: int) -> float:
    """Seconds that the folder takes for a trial: a line on the disk, and the tables."""
    trials = [Trial({"n": n}) for n in range(count)]
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as scratch:
        folder = new_sweep(Path(scratch) / "sweep", {}, trials)
        began = time.perf_counter()
        carry_out(folder, trials, dict, InTurn(), progress=False)
        return (time.perf_counter() - began) / count


def busy(seconds: float = 5.0) -> float:
    """The share of the machine's time that other processes use just now, while this one sleeps."""
    before = timing.others()
    time.sleep(seconds)
    after = timing.others()
    return (after[0] - before[0]) / max(after[1] - before[1], 1e-9)


@contextlib.contextmanager
def two_nodes() -> Iterator[str]:
    """A cluster of two nodes of a core each, on loopback; gives its address."""
    from ray.cluster_utils import Cluster

    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1, "include_dashboard": False})
    cluster.add_node(num_cpus=1)
    try:
        yield cluster.address
    finally:
        cluster.shutdown()


def measured(trials: int, on_two_nodes: int) -> dict[str, Any]:
    """Everything that the page shows.

    Raises:
        RuntimeError: a trial failed, or two tables differ.
    """
    before = busy()
    runs, tables = dict[str, dict[str, float]](), dict[str, bytes]()
    runners: dict[str, Runner] = {"in this process": InTurn(), "1 worker": OnRay(1), "2 workers": OnRay(2)}
    for name, runner in runners.items():
        runs[name], tables[name] = swept(trials, runner)
    empty = {"in this process": overhead(1000, InTurn()), "2 workers": overhead(1000, OnRay(2))}
    with two_nodes() as address:
        runs["2 nodes"], tables["2 nodes"] = swept(trials, OnRay(address=address))
        runs["2 nodes, many"], _ = swept(on_two_nodes, OnRay(address=address))
    if len(set(tables.values())) != 1:
        raise RuntimeError("tables must be the same wherever a sweep ran")
    with tempfile.TemporaryDirectory() as scratch:
        folder = sent_to_machines(Path(scratch) / "sent")
        sent = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return {
        "runs": runs,
        "empty": empty,
        "journal": log_line(1000),
        "sent": sent,
        "busy": [before, busy()],
        "made": timing.measured_with(PACKAGES),
    }


def per_trial(stored: dict[str, Any]) -> float:
    """Seconds of the one process that hands trials out and writes them down, for each of them."""
    return float(stored["empty"]["2 workers"]["own"] + stored["journal"])


def page(text: str, stored: dict[str, Any]) -> str:
    """The page with its numbers anew; the rest of it is written there."""
    runs, empty = stored["runs"], stored["empty"]
    busy = " and ".join(f"{share:.0%}" for share in stored["busy"])
    rows = [
        (name, f"{run['trials']:,}", str(run["workers"]), rough(run["rate"]), rough(run["first"]))
        for name, run in runs.items()
    ]
    takes = {
        "such a trial, of one core": _ms(runs["in this process"]["own"]),
        "a trial of nothing, in this process": _ms(empty["in this process"]["passed"]),
        "a trial of nothing, 2 workers of Ray on 2 cores": _ms(empty["2 workers"]["passed"]),
        "of that the process that hands it out, of one core": _ms(empty["2 workers"]["own"]),
        "a line in the sweep's folder, on the disk": _ms(stored["journal"]),
        "what a trial leaves there": f"{rough(runs['1 worker']['size'])} bytes",
        "code sent to each machine, compiled code included": f"{rough(stored['sent'] / 1e6)} MB",
    }
    cores = f"{float(f'{1.0 / per_trial(stored):.2g}'):,.0f}"
    lines = (
        table(("where", "trials", "workers", "trials per second", "first trial after [s]"), rows),
        table(("what", "takes"), takes.items()),
        f"Other processes used {busy} of the machine just before and after. {stored['made']}.",
    )
    answer = (
        f"A sweep gives the same table wherever it runs. It keeps up to {cores} cores busy if each trial takes a "
        "second, and more in proportion if it takes longer. The one process that hands the trials out is the limit: "
        f"it takes {_ms(per_trial(stored))} for each."
    )
    return fill(fill(text, "answer", answer), "measured", "\n\n".join(lines))


def _ms(seconds: float) -> str:
    return f"{rough(1e3 * seconds)} ms"


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
    """Parse, measure, write."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    from jackbox_env import _validation as check
    from jackbox_env.recording.files import write_json, write_text

    for name in ("trials", "on_two_nodes"):
        check.whole(name, getattr(arguments, name), at_least=20)
    path, stored = arguments.out / "scaling.md", arguments.out / "scaling.json"
    text = path.read_text()  # refused now rather than after the sweeps
    if not arguments.render:
        write_json(stored, measured(arguments.trials, arguments.on_two_nodes))
    write_text(path, page(text, json.loads(stored.read_text())))
    print(f"Wrote {path}")


if __name__ == "__main__":
    main()
