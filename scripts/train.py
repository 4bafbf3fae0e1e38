"""Train PPO on JackInBox-v0 in a run folder. After Ctrl-C or a kill, --resume continues it."""

from __future__ import annotations

import shlex
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, TypedDict

from agents.runs import RUN, describe, trusted_settings
from agents.settings import SceneFields, TrainSettings, scene_as_json
from jackbox_env.tools.command_line import called, command_line, progress
from jackbox_env.tools.files import new_folder
from jackbox_env.tools.user_code import load


@dataclass(frozen=True)
class Arguments:
    """Train PPO on JackInBox-v0."""

    settings: TrainSettings
    scene_fields: SceneFields
    folder: Path | None = None
    """New folder for all that is written; None: runs/<task>-<date>-<time>."""
    resume: Path | None = None
    (
        "Run folder to resume, with its settings, from its newest intact checkpoint. With --total-steps N it "
        "continues to N steps in all, also if it was finished."
    )
    trust: bool = False
    """With --resume: run the code of the task, observation or action that the run folder names."""
    progress: bool = True
    """Show a progress bar."""


class Early(TypedDict, total=False):
    """The options on which other defaults depend."""

    task: str
    observation: str
    action: str
    action_repeat: int | Literal["bounce"]


def suited() -> TrainSettings:
    """The defaults of the command line, which depend on the task, and on the kind and duration of actions."""
    import tyro

    early, _ = tyro.cli(Early, add_help=False, return_unknown_args=True)
    return TrainSettings.suited(**early)


@command_line
def main() -> None:
    """Parse, train, print the path of the files."""
    import tyro

    config = (tyro.conf.OmitArgPrefixes,)
    arguments = tyro.cli(Arguments, description=__doc__, default=Arguments(suited(), SceneFields()), config=config)
    chosen = replace(arguments.settings, scene=scene_as_json(arguments.settings.scene, arguments.scene_fields))
    progress("Loading PyTorch and Stable-Baselines3 ...")
    from agents.evaluation.provenance import describe_env
    from agents.training.models import try_out
    from agents.training.ppo import extended, train

    load(chosen.objects.values())
    if arguments.resume is not None:
        others = replace(chosen, total_steps=TrainSettings.total_steps)
        if others != TrainSettings() or arguments.folder is not None:
            raise ValueError("--resume uses the settings of its run folder: only --total-steps may be added")
        folder, settings = arguments.resume, trusted_settings(arguments.resume, arguments.trust)
        if not (folder / RUN).is_file():
            raise FileNotFoundError(f"{folder} is no training run: it has no {RUN}")
        if any(word.split("=")[0] in ("--total-steps", "--total_steps") for word in sys.argv):
            settings = extended(folder, chosen.total_steps)
    else:
        settings = chosen
        try_out(settings)  # raises before there is a folder
        folder = new_folder(arguments.folder, settings.task.rpartition(":")[2], lambda made: describe(made, settings))
    trust = ["--trust"] if settings.objects else []
    print(f"Training on {describe_env(settings.env_settings, settings.objects)}")
    try:
        train(settings, folder, progress=arguments.progress)
    except KeyboardInterrupt:
        print(f"\nInterrupted. Continue with: {called('train', '--resume', str(folder), *trust)}", file=sys.stderr)
        raise
    print(f"Trained. Models, settings and evaluations: {folder}")
    print("  " + called("evaluate", *settings.options, "--policy", "zero", str(folder), *trust))
    print("  " + shlex.join(["tensorboard", "--logdir", str(folder)]))


if __name__ == "__main__":
    main()
