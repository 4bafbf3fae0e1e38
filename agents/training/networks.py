"""Train the networks of agents/trained again, with their stored settings.

An interrupted training resumes. A finished one is only exported.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from agents.policies.network import TRAINED
from jackbox_env.tools.command_line import command_line


@dataclass(frozen=True)
class Arguments:
    """Train and export the networks that come with the repository."""

    runs: Path = Path("runs/networks")
    """Folder of the trainings; made if there is none."""
    out: Path = Path("agents/trained")
    """Folder with a folder <task>-ppo for each task, which has its settings; its other files are replaced."""
    progress: bool = True
    """Show a progress bar."""


def run_of(folder: Path, task: str, seed: int) -> Path:
    """Run folder of a training by the settings of the shipped network, which is that of seed 0."""
    return folder / f"{task}-{seed}"


@command_line
def main() -> None:
    """Parse, finish the trainings, export."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.runs import read_settings
    from agents.training.exporting import export_policy
    from agents.training.ppo import trained_in

    for task in TRAINED:
        folder = arguments.out / f"{task}-ppo"
        run = run_of(arguments.runs, task, 0)
        trained_in(run, read_settings(folder), arguments.progress)
        export_policy(run, folder)
        print(f"Written: {folder}", flush=True)


if __name__ == "__main__":
    main()
