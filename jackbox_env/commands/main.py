"""The command ``jackbox``, also ``python -m jackbox_env``: runs the command named by its first argument."""

from __future__ import annotations

import importlib
import sys

from jackbox_env import __version__
from jackbox_env.tools.command_line import JACKBOX, ROOT, command_line, in_checkout

_PACKAGED = {
    "simulate": "simulate the scene; write CSV or npz, plots, an animated page",
    "play": "play in the browser, or write the page to send",
    "replay": "replay a shared game and compare it bit for bit",
    "fit": "fit a scene's fields to recordings (needs the train extra)",
    "check": "check this installation",
}
_IN_CHECKOUT = {
    "demo": "train an agent, compare it with baselines, film it",
    "train": "train PPO",
    "evaluate": "evaluate policies",
    "export": "write a trained policy as plain arrays",
}


def _help() -> str:
    lines = ["usage: jackbox COMMAND [options]; for its options: jackbox COMMAND --help", ""]
    lines += [f"  {name:<9} {text}" for name, text in _PACKAGED.items()]
    lines += ["", "from a checkout of the repository:"]
    lines += [f"  {name:<9} {text}" for name, text in _IN_CHECKOUT.items()]
    return "\n".join([*lines, "", "  -h, --help  show this help message and exit", "  --version   show the version"])


@command_line
def main() -> None:
    """Run the command that the first argument names; its help and messages begin with ``jackbox NAME``.

    Raises:
        ValueError: there is no such command.
        RuntimeError: the command needs a checkout, and this package is installed without one.
    """
    name = sys.argv.pop(1) if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help"):
        print(_help())
    elif name == "--version":
        print(f"jackbox {__version__}")
    elif name not in {**_PACKAGED, **_IN_CHECKOUT}:
        raise ValueError(f"the command must be one of {', '.join((*_PACKAGED, *_IN_CHECKOUT))}, got {name!r}")
    elif name in _IN_CHECKOUT and not in_checkout():
        raise RuntimeError(
            f"jackbox {name} needs a checkout: clone the repository and run pip install -e '.[all]' in it"
        )
    else:
        sys.argv[0] = f"{JACKBOX} {name}"
        if in_checkout():
            sys.path.insert(0, str(ROOT))  # scripts and agents are beside the package
        # There are two commands to play; that of a checkout builds the page first.
        home = "scripts" if name in _IN_CHECKOUT or (name == "play" and in_checkout()) else "jackbox_env.commands"
        importlib.import_module(f"{home}.{name}").main()


if __name__ == "__main__":
    main()
