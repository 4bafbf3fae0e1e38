"""The command ``jackbox``, also ``python -m jackbox_env``: hands on to the command that is named first."""

from __future__ import annotations

import importlib
import sys

from jackbox_env.commands.common import JACKBOX, ROOT, command_line, in_checkout

_OWN = {
    "simulate": "simulate the scene: CSV or npz, plots, an animated page",
    "play": "play with the keyboard (needs the render extra)",
    "check": "does this installation work?",
}
_OF_A_CHECKOUT = {
    "demo": "train an agent, compare it with baselines, film it",
    "train": "train PPO",
    "evaluate": "evaluate policies",
    "export": "write a trained policy as plain arrays",
}


def _help() -> str:
    lines = ["usage: jackbox COMMAND [options]; jackbox COMMAND --help says more", ""]
    lines += [f"  {name:<9} {text}" for name, text in _OWN.items()]
    lines += ["", "from a checkout of the repository:"]
    lines += [f"  {name:<9} {text}" for name, text in _OF_A_CHECKOUT.items()]
    return "\n".join([*lines, "", "  -h, --help  show this help message and exit", "  --version   show the version"])


def _run_script(name: str) -> None:
    """Run a command of the checkout that this package is part of.

    Raises:
        RuntimeError: it is part of none.
    """
    if not in_checkout():
        raise RuntimeError(
            f"jackbox {name} needs a checkout: git clone the repository, and there pip install -e '.[all]'"
        )
    sys.path.insert(0, str(ROOT))  # scripts and agents are beside the package
    _run(f"scripts.{name}", name)


def _run(module: str, name: str) -> None:
    """Run a command whose help and messages name it as it was called."""
    sys.argv[0] = f"{JACKBOX} {name}"
    importlib.import_module(module).main()


@command_line
def main() -> None:
    """Run the command that the first argument names, with the others."""
    name = sys.argv[1] if len(sys.argv) > 1 else "--help"
    if name in ("-h", "--help"):
        print(_help())
    elif name == "--version":
        from jackbox_env import __version__

        print(f"jackbox {__version__}")
    elif name in _OF_A_CHECKOUT or (name == "play" and in_checkout()):  # which brings the trained agents
        del sys.argv[1]
        _run_script(name)
    elif name in _OWN:
        del sys.argv[1]
        _run(f"jackbox_env.commands.{name}", name)
    else:
        known = ", ".join((*_OWN, *_OF_A_CHECKOUT))
        raise ValueError(f"the command must be one of {known}, got {name!r}")


if __name__ == "__main__":
    main()
