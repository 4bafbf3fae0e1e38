"""What a fidelity does to a learner: PPO trained on each fidelity, and every model run on all of them.

Two sweeps do the work: one of the trainings, one of their best models on every fidelity from the same starts. Both are
carried on by the same command. ``docs/archive/learning.md`` shows what an earlier, larger study found.
"""

from __future__ import annotations

import csv
import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is there: one thread for each trial

from agents.settings import TaskName
from jackbox_env import FIDELITIES
from jackbox_env import _validation as check
from jackbox_env.commands.common import command_line, json_object, tyro

if TYPE_CHECKING:
    from agents.sweeps.in_process import Trial


@dataclass(frozen=True)
class Arguments:
    """Train on each fidelity and run every model on all of them."""

    folder: Path = Path("runs/fidelity")
    """Folder to make, or to go on in: the same command goes on where it was interrupted."""
    task: TaskName = "juggle"
    """What is rewarded."""
    fidelities: tuple[str, ...] = tuple(FIDELITIES)
    """Trained on and run on."""
    scene: str = "{}"
    """Fields of the scene that differ from the default, as JSON, e.g. '{"restitution": 0.9}'."""
    train: str = "{}"
    """Settings of scripts/train.py that differ from the default, as JSON, e.g. '{"total_steps": 500000}'."""
    seeds: int = 5
    """Trainings on each fidelity, with seeds 0, 1, ..."""
    episodes: int = 128
    """Episodes of each model on each fidelity."""
    workers: int | None = None
    """With Ray on this machine, so many trials side by side; None: in this process, without Ray."""
    progress: bool = True
    """Show progress bars."""


def table(rows: list[tuple[str, str, float]]) -> str:
    """Mean return and half its 95 % interval over the trainings, as Markdown.

    Args:
        rows: fidelity trained on, fidelity run on, and mean return, one for each model and fidelity that it ran on.
    """
    from agents.evaluation.returns import Returns

    names = list(dict.fromkeys(trained for trained, _, _ in rows))
    lines = [f"| trained on \\ run on | {' | '.join(names)} |", f"| --- {'| ---: ' * len(names)}|"]
    for one in names:
        found = [Returns("", tuple(mean for *pair, mean in rows if pair == [one, other])) for other in names]
        lines.append(f"| {one} | {' | '.join(f'{cell.mean:.1f} ± {cell.half_width:.1f}' for cell in found)} |")
    return "\n".join(lines)


def swept(folder: Path, arguments: Arguments, trials: list[Trial]) -> Path:
    """Run what has not finished of a sweep's trials, and return its table.

    Raises:
        RuntimeError: some trials failed.
        ValueError: the folder's sweep was begun with other arguments or other code.
    """
    from agents.sweeps.journal import TABLE, carry_out, new_sweep, read_sweep
    from agents.sweeps.on_ray import runner_for
    from agents.sweeps.trials import check_trial, run_trial

    if not folder.exists():
        new_sweep(folder, {}, trials)
    elif [trial.key for trial in read_sweep(folder, check_trial)[1]] != [trial.key for trial in trials]:
        raise ValueError(f"{folder} was begun with other arguments: choose another folder")
    runner = runner_for(arguments.workers, None)
    outcome = carry_out(folder, trials, partial(run_trial, folder.resolve()), runner, arguments.progress)
    if outcome.failed:
        raise RuntimeError(f"{len(outcome.failed)} of {len(trials)} trials failed: {folder / TABLE} says which")
    return folder / TABLE


@command_line
def main() -> None:
    """Parse, train, run, print the table."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.sweeps.trials import RUNS, environments, policy_trials, training_trials

    check.known_keys("fidelities", arguments.fidelities, list(FIDELITIES))
    grid = environments((arguments.task,), arguments.fidelities, (arguments.scene,))
    varied = {name: [value] for name, value in json_object("train", arguments.train).items()}
    trainings = training_trials(varied, grid, arguments.seeds, arguments.episodes)
    runs = swept(arguments.folder / "trainings", arguments, trainings).resolve().parent / RUNS
    trained_on = {str(runs / trial.key): trial.settings["fidelity"] for trial in trainings}
    evaluations = policy_trials(tuple(trained_on), grid, 1, arguments.episodes)
    with swept(arguments.folder / "returns", arguments, evaluations).open() as file:
        rows = list(csv.DictReader(file))
    print(table([(trained_on[row["policy"]], row["fidelity"], float(row["mean"])) for row in rows]))
    print(f"Every model: {arguments.folder / 'returns'}")


if __name__ == "__main__":
    main()
