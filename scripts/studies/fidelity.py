"""What a fidelity does to a learner: PPO trained on each fidelity, and every model run on all of them.

Two sweeps do the work: one of the trainings, one of their best models on every fidelity from the same starts. Both are
carried on by the same command. ``docs/archive/learning.md`` shows what an earlier, larger study found.
"""

from __future__ import annotations

import os
from dataclasses import dataclass
from functools import partial
from pathlib import Path

os.environ["OMP_NUM_THREADS"] = "1"  # before numpy is there: one thread for each trial

from agents.settings import TaskName
from jackbox_env import FIDELITIES
from jackbox_env import _validation as check
from jackbox_env.commands.common import command_line, json_object, tyro
from scripts.studies import pages


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
    lines = []
    for one in names:
        found = [Returns("", tuple(mean for *pair, mean in rows if pair == [one, other])) for other in names]
        lines.append([one, *(f"{cell.mean:.1f} ± {cell.half_width:.1f}" for cell in found)])
    return pages.table(["trained on \\ run on", *names], lines)


@command_line
def main() -> None:
    """Parse, train, run, print the table."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.sweeps.on_ray import runner_for
    from agents.sweeps.trials import RUNS, environments, policy_trials, run_trial, training_trials
    from scripts.studies.sweeping import swept

    check.known_keys("fidelities", arguments.fidelities, list(FIDELITIES))
    grid = environments((arguments.task,), arguments.fidelities, (arguments.scene,))
    varied = {name: [value] for name, value in json_object("train", arguments.train).items()}
    trainings = training_trials(varied, grid, arguments.seeds, arguments.episodes)
    runner, folder = runner_for(arguments.workers, None), arguments.folder.resolve()
    first, second = folder / "trainings", folder / "returns"
    swept(first, trainings, partial(run_trial, first), runner, arguments.progress)
    trained_on = {str(first / RUNS / trial.key): trial.settings["fidelity"] for trial in trainings}
    evaluations = policy_trials(tuple(trained_on), grid, 1, arguments.episodes)
    rows = swept(second, evaluations, partial(run_trial, second), runner, arguments.progress)
    print(table([(trained_on[row["policy"]], row["fidelity"], float(row["mean"])) for row in rows]))
    print(f"Every model: {second}")


if __name__ == "__main__":
    main()
