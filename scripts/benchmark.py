"""Train an algorithm of your own, and compare what it learns with docs/benchmark.md."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated, Any

import tyro

from agents.policies.network import TRAINED
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import command_line
from jackbox_env.tools.files import check_new_file, stamped, write_text
from jackbox_env.tools.user_code import load, loaded


@dataclass(frozen=True)
class Arguments:
    """Train, evaluate and compare."""

    train: Annotated[str, tyro.conf.Positional]
    (
        "file.py:function of (task, seed) that trains, and returns a model or yields it as it learns. Its "
        "environment's observation, action and action_repeat may come with it: return model, {'action_repeat': 4}."
    )
    seeds: int = 10
    """Trainings on each task."""
    tasks: tuple[str, ...] = TRAINED
    """Tasks to train on."""
    episodes: int = 256
    """Episodes of each trained model."""
    runs: Path | None = None
    """Folder of finished trainings; what is finished there is not done again. None: a new one in runs."""
    json: Path | None = None
    """New file for the trainings' results; None: results.json in that folder."""


def trained(train: str, code: str, task: str, seed: int, episodes: int) -> dict[str, Any]:
    """One training by the function of that name; ``code`` is its file's digest: a changed file is another trial."""
    from scripts.studies.benchmark.trainings import measured

    return measured(train, loaded(train), task, seed, episodes)


@command_line
def main() -> None:
    """Parse, train, print the table."""
    arguments = tyro.cli(Arguments, description=__doc__)
    check.whole("seeds", arguments.seeds, at_least=1)
    check.whole("episodes", arguments.episodes, at_least=4)
    check.known_keys("tasks", arguments.tasks, TRAINED)
    load([arguments.train])
    if not callable(loaded(arguments.train)):
        raise TypeError(f"train must name a function, got {arguments.train}")
    from agents.runners import in_turn
    from scripts.studies.benchmark.benchmark import DOCS, STUDY, learnt
    from scripts.studies.study import as_text, by_part, measured, swept

    runs = (arguments.runs or stamped("benchmark")).resolve()
    file = arguments.json or runs / "results.json"
    runs.mkdir(parents=True, exist_ok=True)
    check_new_file(file)
    code = hashlib.sha256(Path(arguments.train.rpartition(":")[0]).read_bytes()).hexdigest()
    trials = [
        {"part": "trainings", "train": arguments.train, "code": code, "task": task, "seed": seed,
         "episodes": arguments.episodes}
        for seed in range(arguments.seeds) for task in arguments.tasks
    ]  # fmt: skip
    work = partial(measured, {"trainings": trained}, STUDY.packages)
    record = by_part(STUDY, swept(runs / "sweep", trials, (), work, in_turn, True))
    write_text(file, as_text(record))
    stored = STUDY.read(DOCS)
    print(learnt({**stored, "trainings": [*stored["trainings"], *record["trainings"]]}))
    print(f"Written: {file}")


if __name__ == "__main__":
    main()
