"""Play JackInBox-v0 with the keyboard: the command `jackbox play`, with the trained networks of the checkout."""

from __future__ import annotations

from agents.policies.network import SHIPPED, NetworkPolicy, read_policy
from agents.policies.one_bounce import LANDING, LandingPolicy, read_landing
from jackbox_env.command_line import command_line
from jackbox_env.commands.play import play_with


def trained(task: str) -> NetworkPolicy | LandingPolicy:
    """The best policy without a planner that comes with the repository."""
    folder = SHIPPED / f"{task}-distilled"
    return read_landing(folder) if (folder / LANDING).is_file() else read_policy(folder)


@command_line
def main() -> None:
    """Parse and play."""
    play_with(trained)


if __name__ == "__main__":
    main()
