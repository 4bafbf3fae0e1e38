"""Run the recipes of docs/recipes.md, shortened. Those of other libraries run in environments of their own."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import command_line

HERE, ROOT = Path(__file__).parent, Path(__file__).parents[2]
TORCH = "torch==2.13.0"  # else the newest build comes, of several GB


class Recipe(NamedTuple):
    """A program and the packages that it needs besides the checkout; with any it runs in a separate environment."""

    arguments: tuple[str, ...]
    needs: tuple[str, ...] = ()


def _script(name: str, *arguments: str) -> tuple[str, ...]:
    return (str(HERE / f"with_{name}.py"), *arguments)


_ZOO = "-m rl_zoo3.train --algo ppo --env JackInBox-v0 --gym-packages jackbox_env --conf-file agents.training.zoo"
# Ten steps of half the torque limit to one side and the other.
_GAME = (
    '{"version":1,"start":[0,0,0,0,0,0,0,0,0,0,0,0],"shares":"AAAAAAAA4D8AAAAAAADgvw","counts":"BQAFAA",'
    '"checks":"1imxpJRoc7MtYA","digest":"60a042424a8014fa"}'
)
RECIPES = {
    "sb3": Recipe(_script("sb3", "--steps", "16384")),
    "sb3_contrib": Recipe(_script("sb3", "TQC", "--steps", "1200")),
    "dqn": Recipe(_script("sb3", "DQN", "--task", "spin", "--steps", "8000")),
    "servo": Recipe(_script("servo", "4000")),
    "cleanrl": Recipe(_script("cleanrl", "--steps", "80000")),
    "pixels": Recipe(_script("pixels", "--steps", "512")),
    "rl_zoo3": Recipe((*_ZOO.split(), "-n", "32768", "--eval-freq", "-1", "-f", "runs/recipes/zoo-logs"),
                      ("rl_zoo3", "stable-baselines3", TORCH)),
    "minari": Recipe(_script("minari", "--game", _GAME), ("minari[create,hdf5]", "pillow", "tyro")),
    "jax": Recipe(_script("jax"), ("jax",)),
    "rllib": Recipe(_script("rllib", "--iterations", "4"), ("ray[rllib]==2.60.0", "gymnasium==1.2.2", TORCH)),
}  # fmt: skip


@dataclass(frozen=True)
class Arguments:
    """Run recipes."""

    names: tuple[str, ...]
    """Names of recipes; none: all. Their environments are in runs/recipes, and are used again."""


def python_for(recipe: Recipe, folder: Path) -> str:
    """The interpreter to run a recipe with; makes its environment if it needs one."""
    if not recipe.needs:
        return sys.executable
    python, ready = folder / "bin" / "python", folder / "ready"
    if not ready.exists() or ready.read_text() != "\n".join(recipe.needs):
        subprocess.run([sys.executable, "-m", "venv", "--clear", str(folder)], check=True)
        subprocess.run(
            [str(python), "-m", "pip", "install", "-q", "-e", str(ROOT), *recipe.needs], check=True
        )
        ready.write_text("\n".join(recipe.needs))
    return str(python)


@command_line
def main() -> None:
    """Parse, run, raise if some failed."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__, config=(tyro.conf.PositionalRequiredArgs,))
    names = [check.choice("a recipe", name, RECIPES) for name in arguments.names] or list(RECIPES)
    failed = []
    for name in names:
        recipe, began = RECIPES[name], time.monotonic()
        print(f"== {name}", flush=True)
        try:
            python = python_for(recipe, ROOT / "runs" / "recipes" / name)
            without = {
                key: value
                for key, value in os.environ.items()
                if not recipe.needs or key != "PYTHONPATH"
            }
            subprocess.run([python, *recipe.arguments], cwd=ROOT, env=without, check=True)
        except subprocess.CalledProcessError:
            failed.append(name)
        print(
            f"{'FAILED' if name in failed else 'done'} after {time.monotonic() - began:.0f} s",
            flush=True,
        )
    if failed:
        raise RuntimeError(f"{len(failed)} of {len(names)} recipes failed: {', '.join(failed)}")


if __name__ == "__main__":
    main()
