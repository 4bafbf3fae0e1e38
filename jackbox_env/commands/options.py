"""Options that commands share; argparse reads them, so that they need no extra."""

from __future__ import annotations

import argparse
from typing import Any

from jackbox_env.tools import checks as check

SCENE_HELP = {
    "box_half_width": "L, the walls are at +-L in the box frame [m]",
    "box_mass": "mass of the box [kg]",
    "box_inertia": "inertia of the box [kg m^2]; default: follows its mass and half width",
    "jack_arm": "distance of each foot from the jack's centre [m]",
    "jack_mass": "mass of the jack [kg]",
    "jack_inertia": "inertia of the jack [kg m^2]; default: follows its mass and arm",
    "gravity": "acts downwards on the jack [m/s^2]",
    "restitution": "from 0 to 1, elastic",
    "torque_limit": "torque of an agent's action 1 [N m]",
}


def parser_of(text: str | None) -> argparse.ArgumentParser:
    """A parser that accepts whole names of options only."""
    return argparse.ArgumentParser(description=text, allow_abbrev=False)


def add_scene_options(parser: argparse._ActionsContainer) -> None:
    """Add --scene, and an option for each number of a scene; :func:`chosen_scene` reads them."""
    parser.add_argument(
        "--scene", default="{}", metavar="JSON",
        help="""fields that differ from the default, as JSON, e.g. '{"gravity": 1.62, "drive": null}'""",
    )  # fmt: skip
    for name, text in SCENE_HELP.items():
        parser.add_argument(f"--{name.replace('_', '-')}", type=float, metavar="N", help=text)


def chosen_scene(scene: str, options: object) -> dict[str, Any]:
    """Fields of the scene: those of the JSON of --scene, and the options of single ones, attributes of ``options``.

    Raises:
        ValueError: it is no JSON object, or a field is chosen by both.
    """
    fields = check.from_json("scene", scene, dict)
    single = {name: getattr(options, name) for name in SCENE_HELP if getattr(options, name) is not None}
    for name in fields.keys() & single.keys():
        raise ValueError(f"{name} must be chosen once, got {fields[name]!r} in --scene and {single[name]:g} beside it")
    return {**fields, **single}
