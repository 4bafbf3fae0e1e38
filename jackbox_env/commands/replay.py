"""Replay a game shared by the page of `jackbox play`, and compare its motion bit for bit."""

from __future__ import annotations

import argparse
import sys
from typing import cast

from jackbox_env.commands.options import parser_of
from jackbox_env.tools.command_line import command_line

_MOST_READ = 1 << 20  # bytes of standard input: more than any game has


def _arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    text = "the shared text, or the link that ends in it; - reads it from standard input"
    parser.add_argument("text", metavar="TEXT", help=text)
    return parser.parse_args()


@command_line
def main() -> None:
    """Parse, replay, compare; exit with 1 if the motion differs."""
    text: str = _arguments().text
    import gymnasium as gym

    from jackbox_env.model.scene import total
    from jackbox_env.recording.game import read_game, replay_game

    if text == "-":
        text = sys.stdin.buffer.read(_MOST_READ).decode(errors="replace")
    game = read_game(text)
    steps, episode = len(game.shares), cast(int, gym.spec("JackInBox-v0").max_episode_steps)
    if not steps:
        print(f"This game of {game.task} has no steps: there is nothing to compare")
        return
    differs, rewards = replay_game(game)
    played = f"{steps:,} steps of {game.task}, {steps * game.dt:g} s"
    if differs is not None:
        print(f"{played}: it differs from step {differs:,} on")
        sys.exit(1)
    first = f" in the first {episode * game.dt:g} s" if steps > episode else ""
    print(f"{played}, return {total(rewards[:episode]):.1f}{first}: the same, bit for bit")


if __name__ == "__main__":
    main()
