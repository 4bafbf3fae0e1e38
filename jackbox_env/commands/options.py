"""Options that commands share; argparse reads them, so that they need no extra."""

from __future__ import annotations

import argparse
from typing import get_args, get_type_hints

from jackbox_env.simulators.fidelity import Setting, chosen, resolve


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
    text = """fields that differ from the default, as JSON, e.g. '{"gravity": 1.62}'"""
    model.add_argument("--scene", default="{}", metavar="JSON", help=text)


def chosen_setting(arguments: argparse.Namespace) -> Setting:
    """The contact model and settings of these options, by :func:`jackbox_env.simulators.fidelity.resolve`."""
    return resolve(**chosen(arguments))
