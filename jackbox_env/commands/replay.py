"""Replay a game shared by the page of `jackbox play`, and compare its motion bit for bit."""

from __future__ import annotations

import sys

from jackbox_env.commands.options import parser_of
from jackbox_env.tools.command_line import command_line


@command_line
def main() -> None:
    """Parse, replay, compare; exit with 1 if the motion differs."""
    parser = parser_of(__doc__)
    parser.add_argument("text", metavar="TEXT", help="the shared text, or the link that ends in it")
    from jackbox_env.commands.game import read_game, replay_game
    from jackbox_env.model.action import EPISODE_STEPS
    from jackbox_env.model.states import total

    game = read_game(parser.parse_args().text)
    count = len(game.shares)
    differs, steps = replay_game(game)
    played = f"{count:,} steps of {game.task}, {count * game.dt:g} s"
    if not count:
        print(f"This game of {game.task} has no steps: there is nothing to compare")
    elif differs is not None:
        print(f"{played}: it differs from step {differs:,} on")
        sys.exit(1)
    else:
        first = f" in the first {EPISODE_STEPS * game.dt:g} s" if count > EPISODE_STEPS else ""
        earned = total([step.result.reward for step in steps[:EPISODE_STEPS]])
        print(f"{played}, return {earned:.1f}{first}: the same, bit for bit")


if __name__ == "__main__":
    main()
