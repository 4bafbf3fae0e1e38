"""Play JackInBox-v0 with the keyboard: left and right arrows push, and while no key is pressed the chirp drives."""

from __future__ import annotations

import argparse

import gymnasium as gym

from jackbox_env.commands.common import add_model_options, command_line, extras, parser_of, scene_fields


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


@command_line
def main() -> None:
    """Parse and play."""
    arguments = _arguments()
    import numpy as np

    try:
        import pygame  # noqa: F401
    except ImportError as error:
        wanted = " ".join(f"'{requirement}'" for requirement in extras().get("render", ["pygame-ce"]))
        raise RuntimeError(f"play needs the render extra, which is not installed: pip install {wanted}") from error
    from gymnasium.utils.play import play

    env = gym.make(
        "jackbox_env:JackInBox-v0",
        render_mode="rgb_array",
        task=arguments.task,
        contact=arguments.contact,
        substeps=arguments.substeps,
        control_dt=arguments.control_dt,
        scene=scene_fields(arguments.scene),
        fidelity=arguments.fidelity,
    )
    play(env, noop=np.zeros(1, dtype=np.float32) if arguments.quiet else None, seed=arguments.seed)


if __name__ == "__main__":
    main()
