"""Train PPO on JackInBox-v0 in a run folder; interrupt it with Ctrl-C, or kill it, and resume it with --resume."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypedDict

from agents.runs import RUN, describe, read_settings
from agents.settings import TaskName, TrainSettings
from jackbox_env.command_line import called, command_line
from jackbox_env.commands.options import SceneFields, scene_as_json
from jackbox_env.files import new_folder


@dataclass(frozen=True)
class Arguments:
    """Train PPO on JackInBox-v0."""

    settings: TrainSettings
    scene_fields: SceneFields
    folder: Path | None = None
    """New folder for all that is written; None: runs/<task>-<date>-<time>."""
    resume: Path | None = None
    """Run folder to resume, with its own settings, from its newest whole checkpoint; with --total-steps N a run goes on
    to N steps in all, a finished one too."""
    progress: bool = True
    """Show a progress bar."""


class Early(TypedDict, total=False):
    """The options that the other options' defaults depend on, if the command line has them."""

    task: TaskName
    lookahead: int
    landing: bool
    repeat: int | Literal["bounce"]
    hold: int | Literal["bounce"]


def suited() -> TrainSettings:
    """The defaults of the command line: they depend on the task, on what an action is and on how long it lasts."""
    import tyro

    early, _ = tyro.cli(Early, add_help=False, return_unknown_args=True)
    if "hold" in early:  # the name of earlier versions
        early.setdefault("repeat", early.pop("hold"))
    return TrainSettings.suited(**early)


@command_line
def main() -> None:
    """Parse, train, print where the files are."""
    import tyro

    config = (tyro.conf.OmitArgPrefixes,)
    arguments = tyro.cli(Arguments, description=__doc__, default=Arguments(suited(), SceneFields()), config=config)
    chosen = replace(arguments.settings, scene=scene_as_json(arguments.settings.scene, arguments.scene_fields))
    from agents.evaluation.provenance import describe_env
    from agents.training.models import make_vec_env
    from agents.training.ppo import extended, train

    if arguments.resume is not None:
        others = replace(chosen, total_steps=TrainSettings.total_steps)
        if others != TrainSettings() or arguments.folder is not None:
            raise ValueError("--resume uses the settings of its run folder: give no other settings than --total-steps")
        folder, settings = arguments.resume, read_settings(arguments.resume)
        if not (folder / RUN).is_file():
            raise FileNotFoundError(f"{folder} is no training run: it has no {RUN}, so there is nothing to resume")
        if any(word.split("=")[0] in ("--total-steps", "--total_steps") for word in sys.argv):
            settings = extended(folder, chosen.total_steps)
    else:
        settings = chosen
        make_vec_env(settings.env_settings, 1, 0).close()  # raises before there is a folder
        folder = new_folder(arguments.folder, settings.task, lambda made: describe(made, settings))
    print(f"Training on {describe_env(settings)}")
    try:
        train(settings, folder, progress=arguments.progress)
    except KeyboardInterrupt:
        print(f"\nInterrupted. Go on with: {called('train', '--resume', str(folder))}", file=sys.stderr)
        raise
    print(f"Trained. Models, settings and evaluations: {folder}")
    print("  " + called("evaluate", *settings.options, "--policy", "zero", str(folder)))
    print("  " + shlex.join(["tensorboard", "--logdir", str(folder)]))


if __name__ == "__main__":
    main()
