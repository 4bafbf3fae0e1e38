"""Play JackInBox-v0 with the keyboard; the window shows the keys."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING

import gymnasium as gym

from jackbox_env import checks as check
from jackbox_env.command_line import command_line
from jackbox_env.commands.options import add_model_options, chosen_setting, parser_of

if TYPE_CHECKING:
    from jackbox_env.render.window import Predicts


def _arguments() -> argparse.Namespace:
    from jackbox_env.tasks import TASKS

    parser = parser_of(__doc__)
    parser.add_argument("--task", choices=tuple(TASKS), default="juggle", help="what is rewarded; default: juggle")
    add_model_options(parser)
    text = "let the box coast instead of the chirp while no key is pressed"
    parser.add_argument("--quiet", action="store_true", help=text)
    parser.add_argument("--seed", type=int, help="seed of all that is drawn; default: another each time")
    return parser.parse_args()


def play_with(trained: Callable[[str], Predicts] | None = None) -> None:
    """Parse and play; ``trained`` loads the agent of a task, which needs a checkout."""
    arguments = _arguments()
    from jackbox_env.render.window import play
    from jackbox_env.simulators.fidelity import words

    setting = chosen_setting(arguments)
    print(f"Playing {arguments.task}, {words(setting)}", flush=True)
    env = gym.make(
        "jackbox_env:JackInBox-v0",
        render_mode="rgb_array",
        task=arguments.task,
        **setting._asdict(),
        control_dt=arguments.dt,
        scene=check.from_json("scene", arguments.scene, dict),
    )
    play(env, arguments.seed, not arguments.quiet, None if trained is None else partial(trained, arguments.task))


@command_line
def main() -> None:
    """Parse and play."""
    play_with()


if __name__ == "__main__":
    main()
