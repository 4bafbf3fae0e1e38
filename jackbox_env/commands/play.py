"""Play JackInBox-v0 with the keyboard; the window shows the keys."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from importlib.util import find_spec
from typing import TYPE_CHECKING

import gymnasium as gym

from jackbox_env.commands.common import (
    add_model_options,
    chosen_setting,
    command_line,
    extras,
    in_checkout,
    parser_of,
    scene_fields,
)

if TYPE_CHECKING:
    from jackbox_env.render.window import Predicts


def _arguments() -> argparse.Namespace:
    from jackbox_env.tasks import TASKS

    parser = parser_of(None, __doc__)
    parser.add_argument("--task", choices=tuple(TASKS), default="juggle", help="what is rewarded; default: juggle")
    text = "duration of a control step [s]; default: 0.02"
    parser.add_argument("--control-dt", type=float, default=0.02, metavar="S", help=text)
    add_model_options(parser)
    text = "let the box coast instead of the chirp while no key is pressed"
    parser.add_argument("--quiet", action="store_true", help=text)
    parser.add_argument("--seed", type=int, help="of the start")
    return parser.parse_args()


def play_with(trained: Callable[[str], Predicts] | None = None) -> None:
    """Parse and play; ``trained`` loads the agent of a task, of which there is none without a checkout."""
    arguments = _arguments()
    from jackbox_env.render.window import play
    from jackbox_env.simulators.fidelity import words

    if find_spec("pygame") is None and not in_checkout():
        wanted = " ".join(f"'{requirement}'" for requirement in extras().get("render", ["pygame-ce"]))
        raise RuntimeError(f"play needs the render extra, which is not installed: pip install {wanted}")
    setting = chosen_setting(arguments)
    print(f"Playing {arguments.task}, {words(setting)}", flush=True)
    env = gym.make(
        "jackbox_env:JackInBox-v0",
        render_mode="rgb_array",
        task=arguments.task,
        **setting._asdict(),
        control_dt=arguments.control_dt,
        scene=scene_fields(arguments.scene),
    )
    play(env, arguments.seed, not arguments.quiet, None if trained is None else partial(trained, arguments.task))


@command_line
def main() -> None:
    """Parse and play."""
    play_with()


if __name__ == "__main__":
    main()
