"""Play JackInBox-v0 with the keyboard: left and right arrows push, and while no key is pressed the chirp drives."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated

import gymnasium as gym
import tyro

from agents.settings import EnvSettings
from scripts.common import command_line


@dataclass(frozen=True)
class Arguments:
    """Play JackInBox-v0 with the keyboard."""

    settings: Annotated[EnvSettings, tyro.conf.arg(name="")]
    quiet: bool = False
    """Let the box coast instead of the chirp while no key is pressed."""
    seed: int | None = None
    """Of the start."""


@command_line
def main() -> None:
    """Parse and play."""
    arguments = tyro.cli(Arguments, description=__doc__)
    import numpy as np
    from gymnasium.utils.play import play

    import jackbox_env  # noqa: F401

    env = gym.make("JackInBox-v0", render_mode="rgb_array", **arguments.settings.env_settings)
    play(env, noop=np.zeros(1, dtype=np.float32) if arguments.quiet else None, seed=arguments.seed)


if __name__ == "__main__":
    main()
