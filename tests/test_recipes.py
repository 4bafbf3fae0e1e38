"""The recipes that run in the environment of the checkout; ``make recipes`` runs the others too."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

from scripts.recipes.run import HERE, RECIPES

DOCS = Path(__file__).parents[1] / "docs"


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, recipe in RECIPES.items() if not recipe.needs])
def test_a_recipe_runs(name: str, tmp_path: Path) -> None:
    subprocess.run([sys.executable, *RECIPES[name].arguments], cwd=tmp_path, check=True)


def test_every_recipe_is_run_and_shown() -> None:
    page = (DOCS / "recipes.md").read_text()
    for path in HERE.glob("with_*.py"):
        assert path.stem.removeprefix("with_") in RECIPES
        assert f"../scripts/recipes/{path.name}" in page
    zoo = RECIPES["rl_zoo3"].arguments
    assert "python " + " ".join(zoo[: zoo.index("-n")]) in page
