"""Write the policy of a training run as plain arrays: it then plays with numpy alone, without torch."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from scripts.common import command_line, tyro


@dataclass(frozen=True)
class Arguments:
    """Write the policy of a training run as plain arrays."""

    run: tyro.conf.Positional[Path]
    """Run folder, or a model file in it."""
    folder: tyro.conf.Positional[Path]
    """New folder to write settings.json and weights.npz to."""


@command_line
def main() -> None:
    """Parse, convert, write."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.models import load_model, run_folder
    from agents.network import WEIGHTS, layers_of, write_policy
    from agents.runs import new_folder, read_settings

    layers = layers_of(load_model(arguments.run))
    settings = read_settings(run_folder(arguments.run) or arguments.run)
    folder = new_folder(arguments.folder, "export", lambda made: write_policy(made, settings, layers))
    size = (folder / WEIGHTS).stat().st_size
    print(f"Written: {folder} ({size / 1000:.0f} kB of weights)")
    print(f"  python scripts/evaluate.py --task {settings.task} --policy level {folder}")


if __name__ == "__main__":
    main()
