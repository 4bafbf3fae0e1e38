"""Train an algorithm of your own, and compare what it learns with docs/benchmark.md."""

from __future__ import annotations

import hashlib
import sys
import traceback
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated

import tyro
from tqdm import tqdm

from agents.policies.network import TRAINED
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import command_line
from jackbox_env.tools.files import stamped, write_json
from jackbox_env.tools.reading import first_line, read_json
from jackbox_env.tools.user_code import is_object, load, loaded, texts_of


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
    runs: Path | None = None
    """Folder of finished trainings, a file each; what is there, of the same code, is not repeated. None: a new one."""


@command_line
def main() -> None:
    """Parse, train, print the table."""
    arguments = tyro.cli(Arguments, description=__doc__)
    name = arguments.train
    check.whole("seeds", arguments.seeds, at_least=1)
    check.known_keys("tasks", arguments.tasks, TRAINED)
    if not is_object(name):
        raise ValueError(f"train must be file.py:function, got {name}")
    load([name])
    train = loaded(name)
    from scripts.studies.benchmark.benchmark import DOCS, STUDY, learnt
    from scripts.studies.benchmark.trainings import EPISODES, measured

    runs = (arguments.runs or stamped("benchmark")).resolve()
    runs.mkdir(parents=True, exist_ok=True)
    code = hashlib.sha256(repr((name, texts_of([name]))).encode()).hexdigest()[:12]
    print(f"Trainings are stored in {runs}; after an interruption --runs {runs} continues", file=sys.stderr)
    rows = []
    for seed, task in tqdm([*product(range(arguments.seeds), arguments.tasks)], desc=name, unit="training"):
        file = runs / f"{task}-{seed}-{code}.json"
        if not file.is_file():
            try:
                row = measured(Path(name.rpartition(":")[0]).stem, train, task, seed, EPISODES)
            except Exception as error:
                traceback.print_exc()
                raise RuntimeError(f"the training on {task} with seed {seed} failed: {first_line(error)}") from error
            write_json(file, row)
        rows.append(read_json(file))
    stored = STUDY.read(DOCS)
    print(learnt({**stored, "trainings": [*stored["trainings"], *rows]}))


if __name__ == "__main__":
    main()
