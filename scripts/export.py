"""Write the policy of a training run as plain arrays, to play with only numpy, without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from jackbox_env.tools.command_line import called, command_line


@dataclass(frozen=True)
class Arguments:
    """Write the policy of a training run as plain arrays."""

    run: Path
    """Run folder, or a model file in it."""
    folder: Path
    """New folder for settings.json, weights.npz and, if there are any, the training's learning curve and times."""
    trust: bool = False
    """Run the code of a task, observation or action of a user that the run folder names."""


@command_line
def main() -> None:
    """Parse, convert, write."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__, config=(tyro.conf.PositionalRequiredArgs,))
    from agents.policies.network import WEIGHTS
    from agents.runs import read_settings
    from agents.training.exporting import export_policy
    from jackbox_env.tools.files import new_folder

    folder = new_folder(arguments.folder, "export", lambda made: export_policy(arguments.run, made, arguments.trust))
    size = (folder / WEIGHTS).stat().st_size
    print(f"Written: {folder} ({size / 1000:.0f} kB of weights)")
    settings = read_settings(folder)
    trust = ["--trust"] if settings.objects else []
    print("  " + called("evaluate", *settings.options, "--policy", "level", str(folder), *trust))


if __name__ == "__main__":
    main()
