"""Options that commands share; argparse reads them, so that they need no extra."""

from __future__ import annotations

import argparse
from typing import Any, get_args, get_type_hints

from jackbox_env.fits.torques import TORQUE_KINDS
from jackbox_env.simulators.fidelity import Setting
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


def add_model_options(parser: argparse.ArgumentParser) -> None:
    """Add the options of scene and contact model: fidelity, contact and its settings, dt, scene."""
    model = parser.add_argument_group("scene and contact model")
    text = "how impacts are computed: coarse, balanced, fine or exact; default: exact"
    model.add_argument("--fidelity", metavar="NAME", help=text)
    model.add_argument("--contact", metavar="NAME", help="in place of a fidelity: pymunk or exact")
    hints = get_type_hints(Setting, include_extras=True)
    for name in Setting._fields[1:]:
        kind, text = get_args(hints[name])
        model.add_argument(f"--{name}", type=get_args(kind)[0], metavar="N", help=text)
    text = "duration of a control step [s]; default: 0.02"
    model.add_argument("--dt", "--control-dt", type=float, default=0.02, metavar="S", help=text)
    add_scene_options(model)


def add_torque_column(parser: argparse.ArgumentParser, default: str) -> None:
    """Add --torque-column; ``default`` follows "default: held"."""
    text = (
        "whether each torque in a file was held to the next row, sampled from a smooth curve, or changes linearly to "
        f"the next row; default: held{default}"
    )
    parser.add_argument("--torque-column", choices=TORQUE_KINDS, help=text)


def add_scene_options(parser: argparse._ActionsContainer) -> None:
    """Add --scene, and an option for each number of a scene; :func:`chosen_scene` reads them."""
    text = """fields that differ from the default, as JSON, e.g. '{"gravity": 1.62}'"""
    parser.add_argument("--scene", default="{}", metavar="JSON", help=text)
    for name, text in SCENE_HELP.items():
        spellings = dict.fromkeys((f"--{name.replace('_', '-')}", f"--{name}"))
        parser.add_argument(*spellings, type=float, metavar="N", help=text)


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
