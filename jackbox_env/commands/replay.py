"""Replay a game shared by the page of `jackbox play`, and compare its motion bit for bit."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from jackbox_env.commands.options import parser_of
from jackbox_env.tools.command_line import command_line

_MOST_READ = 1 << 20  # bytes of standard input: more than any game has


def _arguments() -> argparse.Namespace:
    parser = parser_of(__doc__)
    text = "the shared text, or the link that ends in it; - reads it from standard input"
    parser.add_argument("text", metavar="TEXT", help=text)
    text = (
        "also write what was played to this new CSV file: the columns of states.csv of `jackbox simulate`, and the "
        "impacts, their impulse and the reward of each step"
    )
    parser.add_argument("--csv", type=Path, metavar="FILE", help=text)
    return parser.parse_args()


@command_line
def main() -> None:
    """Parse, replay, compare, write; exit with 1 if the motion differs."""
    arguments = _arguments()
    text: str = arguments.text
    from jackbox_env.commands.game import played_columns, read_game, replay_game
    from jackbox_env.model.action import EPISODE_STEPS
    from jackbox_env.model.states import total
    from jackbox_env.recording.files import write_table
    from jackbox_env.tools.files import check_new_file

    if arguments.csv is not None:
        check_new_file(arguments.csv)
    if text == "-":
        text = sys.stdin.buffer.read(_MOST_READ).decode(errors="replace")
    game = read_game(text)
    count = len(game.shares)
    differs, steps = replay_game(game)
    played = f"{count:,} steps of {game.task}, {count * game.dt:g} s"
    if not count:
        print(f"This game of {game.task} has no steps: there is nothing to compare")
    elif differs is not None:
        print(f"{played}: it differs from step {differs:,} on")
    else:
        first = f" in the first {EPISODE_STEPS * game.dt:g} s" if count > EPISODE_STEPS else ""
        earned = total([step.result.reward for step in steps[:EPISODE_STEPS]])
        print(f"{played}, return {earned:.1f}{first}: the same, bit for bit")
    if arguments.csv is not None:
        write_table(played_columns(game, steps), arguments.csv)
        print(f"{arguments.csv} has {len(steps):,} steps")
    if differs is not None:
        sys.exit(1)


if __name__ == "__main__":
    main()
