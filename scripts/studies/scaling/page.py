"""docs/scaling.md: how to run a sweep on more cores and machines, what that takes, and where it stops to help."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from scripts.studies.pages import rough

MACHINES, CORES = 100, 2  # that the table asks about
_UNSTEADY = 0.1  # share of the machine that others use, above which rates are not compared
NETWORK = 125e6  # of the head [bytes/s]: 1 Gbit/s
PLANNED, TRAINED = 24.0, 180.0  # 16 episodes of the planner, a training as `make demo`'s: one core each [s]

HOW = """## How to run one

```sh
python scripts/sweep.py --policy level ppo --setting exact balanced --scene '{}' '{"gravity": 1.62}' --seeds 10
python scripts/sweep.py --train '{"total_steps": [100000], "learning_rate": [0.0005, 0.001]}' --seeds 5
```

Every combination is a trial: policies, or PPO trainings whose best model is evaluated, over tasks, settings, scenes and
seeds. Without more options the trials run in this process, one after the other. With the extra `scale`
(`pip install -e ".[scale]"`) they run side by side:

```sh
python scripts/sweep.py --seeds 500 --workers 8             # on this machine's cores
ray start --head --port 6379                                # on a cluster: on its first machine,
ray start --address <first machine>:6379                    # on each other one,
python scripts/sweep.py --seeds 500 --address auto          # and then on one of them
```

The machines of a cluster need this project's requirements and Ray in the same versions; a machine with others ends the
sweep with a sentence that names them. The checkout's code and the code that is compiled for the exact model are sent to
them. Trainings keep their run folders below the sweep's folder, which must then be on a disk that all machines share.
`scripts/studies/accuracy/benchmark.py` takes `--workers` and `--address` too.

The folder of a sweep holds `table.csv`, a row for each trial in the order of the grid, and `times.csv`. On one kind of
processor the table has the same bytes in this process, on cores and on a cluster. Each trial runs in one thread.

- **Interrupted or killed**: `python scripts/sweep.py --resume <folder>` runs what has not finished. A training that was
  interrupted starts over, because one that goes on from a checkpoint takes other starts and ends elsewhere.
- **A worker or a machine dies**: its trials run again elsewhere, up to four times each. A test kills two workers and a
  node in the middle; the table is the same.
- **A trial fails**: the others go on, its row has its settings and its error, `trials.jsonl` the traceback. The command
  ends with status 1. `--resume` tries it again.
- **The code or a version changes**: the sweep is not continued, and the sentence says what changed.

Sweeps stand on Ray's plain tasks (`agents/sweeps/on_ray.py`). Ray Tune would add
schedulers that stop trials early, and seven packages.

## Training itself on more cores: RLlib

`python scripts/recipes/run.py rllib` sets up an environment of its own in `runs/recipes/rllib`, because RLlib pins
Gymnasium 1.2.2, and trains PPO there with two env runners. Each steps eight environments in one compiled batch,
`JackInBoxVectorEnv`. It needs a connection to a package index, 2 GB of disk and three processes. At first it takes some
5 minutes, nearly all to install, and later a minute. `make recipes` runs it with the others. Where that environment is
ready, `pytest tests/agents/test_rllib.py` runs it and asserts what it prints; elsewhere the test is skipped.
"""


def per_trial(stored: dict[str, Any]) -> float:
    """Seconds of the one process that hands trials out and writes them down, for each of them."""
    return float(stored["empty"]["2 workers"]["own"] + stored["journal"])


def most_cores(stored: dict[str, Any], seconds: float) -> float:
    """Cores that trials of so many seconds keep busy at most."""
    return seconds / per_trial(stored)


def at_once(stored: dict[str, Any], seconds: float, cores: int) -> float:
    """Trials per second on so many cores."""
    return min(cores / seconds, 1.0 / per_trial(stored))


def page(stored: dict[str, Any]) -> str:
    """The page of what was measured."""
    runs, short = stored["runs"], stored["runs"]["in this process"]["own"]
    many = runs["2 nodes, many"]
    cores = rough(float(f"{most_cores(stored, 1.0):.2g}"))
    parts = [
        "# When one machine is not enough",
        f"A sweep gives the same table wherever it runs. It keeps up to {cores} cores busy if each trial takes a "
        "second, and more in proportion if it takes longer. The one process that hands the trials out is the limit.",
        HOW.rstrip(),
        "## Measured",
        _circumstances(stored),
        _table(
            ("where", "trials", "workers", "trials per second", "first trial after [s]"),
            [
                (name, f"{run['trials']:,}", run["workers"], rough(run["rate"]), rough(run["first"]))
                for name, run in runs.items()
            ],
        ),
        f"The sweep of {many['trials']:,} trials ran on a cluster of two nodes, two raylets on loopback. "
        "The others gave tables of the same bytes.",
        _table(
            ("what", "takes"),
            [
                ("such a trial, of one core", _ms(short)),
                ("a trial of nothing, in this process", _ms(stored["empty"]["in this process"]["passed"])),
                ("a trial of nothing, 2 workers of Ray on 2 cores", _ms(stored["empty"]["2 workers"]["passed"])),
                ("of that the process that hands it out, of one core", _ms(stored["empty"]["2 workers"]["own"])),
                ("a line in the sweep's folder, on the disk", _ms(stored["journal"])),
                ("what a trial leaves there", f"{rough(runs['1 worker']['size'])} bytes"),
                ("the exact model's first trial where nothing is compiled", f"{rough(stored['start']['compiling'])} s"),
                ("the same where compiled code is there", f"{rough(stored['start']['compiled'])} s"),
                ("code sent to each machine, compiled code included", f"{rough(stored['sent'] / 1e6)} MB"),
            ],
        ),
        f"Measured by `make scaling` on {stored['made']}.",
        "## What 100 machines would give",
        _table(
            ("a trial", "takes on one core [s]", "1 machine, per hour", f"{MACHINES} machines, per hour", "gain",
             "cores that can be kept busy"),
            [_row(stored, *kind) for kind in (("4 episodes of `level` or `ppo`", short),
             ("16 episodes of the planner", PLANNED), ("a training as `make demo`'s", TRAINED))],
        ),
        _assumptions(stored),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def _circumstances(stored: dict[str, Any]) -> str:
    runs, others = stored["runs"], " and ".join(f"{share:.0%}" for share in stored["busy"])
    if max(stored["busy"]) > _UNSTEADY:
        gain = "So these rates are low, and too unsteady to compare with each other."
    else:
        gain = f"Two workers finished {runs['2 workers']['rate'] / runs['1 worker']['rate']:.2f} times as many as one."
    return (
        "Trials of four episodes of `level` and `ppo` on `exact`. Trials per second are counted without the start. "
        f"Other processes used {others} of the machine just before and after. {gain} Times of one core below are the "
        "processor's, which others change less."
    )


def _row(stored: dict[str, Any], name: str, seconds: float) -> tuple[Any, ...]:
    one, many = at_once(stored, seconds, CORES), at_once(stored, seconds, MACHINES * CORES)
    busy = float(f"{most_cores(stored, seconds):.2g}")
    return name, rough(seconds), rough(3600.0 * one), rough(3600.0 * many), rough(many / one), rough(busy)


def _assumptions(stored: dict[str, Any]) -> str:
    megabytes, sending = rough(stored["sent"] / 1e6), rough(MACHINES * stored["sent"] / NETWORK)
    compiling = rough(stored["start"]["compiling"] - stored["start"]["compiled"])
    size, first = rough(stored["runs"]["1 worker"]["size"]), rough(stored["runs"]["2 nodes"]["first"])
    return f"""It is computed, not measured, and assumes:

- **Machines**: {MACHINES} of {CORES} cores like this one. Trials do not wait for each other, and nothing of a trial
  travels but its settings and its row. Machines that join later are used; one that leaves costs what it had under way.
  Ray's own limits, of some hundreds of machines and more, are not measured here.
- **Handing out** is done by one process, which takes {_ms(per_trial(stored))} for a trial: its own processor time and
  the line on the disk. This limits short trials first. Give each trial more episodes then: ten times the episodes keep
  ten times the cores busy.
- **Results** are rows of {size} bytes. Ray returns what is below 100 kB in its reply, so nothing enters the object
  store. The process keeps all rows in memory, a few GB for a million. It writes the table anew every 10 s, and less
  often where that would take more than a twentieth of its time.
- **Starting**: the head sends each machine {megabytes} MB, {sending} s for all of them at 1 Gbit/s. The first trial on
  two nodes came {first} s after the start here. A sweep should take ten times that.
- **Compiled code** is for one kind of processor. Machines of the head's kind load what they are sent and save
  {compiling} s each. A machine of another kind does not load it: it compiles for itself, once, and keeps that.
  `exact` gives the same bits on every x86-64 processor; trained networks may differ in the last bits from one kind to
  another ([what is trusted](trust.md)). A sweep that ran on several kinds says so at its end."""


def _ms(seconds: float) -> str:
    return f"{rough(1e3 * seconds)} ms"


def _table(head: Iterable[str], rows: Iterable[Iterable[Any]]) -> str:
    lines = [list(map(str, row)) for row in (head, *rows)]
    ruled = [lines[0], ["---", *["---:"] * (len(lines[0]) - 1)], *lines[1:]]
    return "\n".join(f"| {' | '.join(line)} |" for line in ruled)
