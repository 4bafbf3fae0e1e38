"""Play JackInBox-v0 with the keyboard; the window shows the keys."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import gymnasium as gym

from agents.settings import EnvSettings
from scripts.common import command_line, tyro


@dataclass(frozen=True)
class Arguments:
    """Play JackInBox-v0 with the keyboard."""

    settings: Annotated[EnvSettings, tyro.conf.arg(name="")]
    quiet: bool = False
    """Let the box coast instead of the chirp while no key is pressed."""
    seed: int | None = None
    """Of the first start."""


@command_line
def main() -> None:
    """Parse and play."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.network import SHIPPED, read_policy
    from jackbox_env.playing_window import play

    env = gym.make("JackInBox-v0", render_mode="rgb_array", **arguments.settings.env_settings)
    agent = SHIPPED / f"{arguments.settings.task}-ppo"
    play(env, arguments.seed, not arguments.quiet, lambda: read_policy(agent))


if __name__ == "__main__":
    main()
