"""What a sweep takes: with one and two workers and on two nodes, for each trial on top of its work, and to start."""

from __future__ import annotations

import contextlib
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

from agents.settings import EnvSettings
from agents.sweeps.in_process import InTurn, Runner, Trial
from agents.sweeps.journal import JOURNAL, TABLE, TIMES, carry_out, new_sweep
from agents.sweeps.on_ray import OnRay, sent_to_machines
from agents.sweeps.trials import policy_trials, run_trial
from scripts.studies import timing

POLICIES, EPISODES = ("level", "ppo"), 4
PACKAGES = ("jackbox", "ray", "numpy", "numba", "torch")
_COMPILING = """
import time
from agents.settings import EnvSettings
from agents.sweeps.in_process import attempt
from agents.sweeps.trials import evaluated, policy_trials
began = time.process_time()
trial, = policy_trials(("zero",), [EnvSettings(contact="exact")], 1, 2)
done = attempt(evaluated, trial)
assert done.error is None, done.details
print(time.process_time() - began)
"""


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


def grid(count: int) -> list[Trial]:
    """``count`` short trials: both policies on the exact model, four episodes each."""
    return policy_trials(POLICIES, [EnvSettings(contact="exact")], count // len(POLICIES), EPISODES)


def swept(trials: list[Trial], runner: Runner) -> tuple[dict[str, float], bytes]:
    """Times of a sweep, and its table.

    Trials per second are counted from the first tenth that has finished to the last: without the start. ``own`` is the
    processor's time that this process used for a trial [s], which others on the machine do not change.
    """
    timed, began = _Timed(runner), time.process_time()
    with tempfile.TemporaryDirectory() as scratch:
        folder = new_sweep(Path(scratch) / "sweep", {}, trials)
        outcome = carry_out(folder, trials, partial(run_trial, folder), timed)
        if outcome.failed:
            raise RuntimeError(f"{len(outcome.failed)} of {len(trials)} trials failed")
        size = (folder / JOURNAL).stat().st_size / len(trials)
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


def journal_line(count: int) -> float:
    """Seconds that the folder takes for a trial: a line on the disk, and the tables."""
    trials = [Trial({"n": n}) for n in range(count)]
    with tempfile.TemporaryDirectory(dir=Path.cwd()) as scratch:
        folder = new_sweep(Path(scratch) / "sweep", {}, trials)
        began = time.perf_counter()
        carry_out(folder, trials, dict, InTurn(), progress=False)
        return (time.perf_counter() - began) / count


def first_trial(cache: Path) -> float:
    """Processor's seconds of a new process for the exact model's first trial, with compiled code kept in ``cache``."""
    command = [sys.executable, "-c", _COMPILING]
    env = {**os.environ, "NUMBA_CACHE_DIR": str(cache)}
    done = subprocess.run(command, env=env, capture_output=True, text=True, check=True)
    return float(done.stdout)


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
    before, short = busy(), grid(trials)
    runs, tables = dict[str, dict[str, float]](), dict[str, bytes]()
    runners: dict[str, Runner] = {"in this process": InTurn(), "1 worker": OnRay(1), "2 workers": OnRay(2)}
    for name, runner in runners.items():
        runs[name], tables[name] = swept(short, runner)
    empty = {name: overhead(1000, runner) for name, runner in {**runners, "2 workers": OnRay(2)}.items()}
    with two_nodes() as address:
        runs["2 nodes"], tables["2 nodes"] = swept(short, OnRay(address=address))
        runs["2 nodes, many"], _ = swept(grid(on_two_nodes), OnRay(address=address))
    if len(set(tables.values())) != 1:
        raise RuntimeError("tables must be the same wherever a sweep ran")
    with tempfile.TemporaryDirectory() as scratch:
        start = {"compiling": first_trial(Path(scratch)), "compiled": first_trial(Path(scratch))}
        folder = sent_to_machines(Path(scratch) / "sent")
        sent = sum(path.stat().st_size for path in folder.rglob("*") if path.is_file())
    return {
        "runs": runs,
        "empty": empty,
        "journal": journal_line(1000),
        "start": start,
        "sent": sent,
        "busy": [before, busy()],
        "made": timing.measured_with(PACKAGES),
    }
