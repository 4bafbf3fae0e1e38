"""The API reference has every public name, in its index and in full."""

from __future__ import annotations

import importlib
import inspect
import json
import re
from pathlib import Path

import pytest

import jackbox_env

DOCS = Path(__file__).parents[1] / "docs"
INDEX = (DOCS / "api.md").read_text(encoding="utf-8")
DETAILS = "".join(path.read_text(encoding="utf-8") for path in sorted((DOCS / "api").glob("*.md")))
MODULES = ("mechanics", "sb3", "torch")  # public ones, CONTRIBUTING.md


def _public(module: str) -> list[str]:
    """Names that a module offers: those of ``__all__``, or what it defines and documents without an underscore."""
    loaded = importlib.import_module(f"jackbox_env.{module}")
    if hasattr(loaded, "__all__"):
        return list(loaded.__all__)
    members = inspect.getmembers(loaded, lambda member: inspect.isclass(member) or inspect.isfunction(member))
    return [
        name
        for name, member in members
        if not name.startswith("_") and member.__doc__
        if member.__module__ == loaded.__name__
    ]


def _missing(names: list[str], index: str, details: str) -> list[str]:
    """The names that are not in the index, or have no full entry."""
    indexed = re.findall(r"^   ([\w.]+)$", index, re.MULTILINE)
    entries = re.findall(r"auto(?:class|exception|function|data):: jackbox_env\.([\w.]+)", details)
    for module, members in re.findall(r"automodule:: jackbox_env\.([\w.]+)\n   :members: (.*)", details):
        entries += [f"{module}.{member}" for member in members.split(", ")]
    return [name for name in names if name not in indexed or name not in entries]


def test_every_public_name_is_in_the_reference() -> None:
    assert _missing(jackbox_env.__all__, INDEX, DETAILS) == []


@pytest.mark.parametrize("module", MODULES)
def test_every_name_of_a_public_module_is_in_the_reference(module: str) -> None:
    if module != "mechanics":
        pytest.importorskip({"torch": "torch"}.get(module, "stable_baselines3"))
    names = [f"{module}.{name}" for name in _public(module)]
    assert names
    assert _missing(names, INDEX, DETAILS) == []
    assert module in (DOCS.parent / "CONTRIBUTING.md").read_text(encoding="utf-8")


def test_a_name_that_is_left_out_is_seen() -> None:
    assert _missing(["rollout"], INDEX.replace("   rollout\n", ""), DETAILS) == ["rollout"]
    assert _missing(["rollout"], INDEX, DETAILS.replace("jackbox_env.rollout\n", "\n")) == ["rollout"]
    assert _missing(["mechanics.gaps"], INDEX, DETAILS.replace("members: gaps, ", "members: ")) == ["mechanics.gaps"]


@pytest.mark.parametrize("notebook", sorted(DOCS.glob("*.ipynb")), ids=lambda path: path.name)
def test_notebooks_import_public_names_alone(notebook: Path) -> None:
    cells = json.loads(notebook.read_text(encoding="utf-8"))["cells"]
    code = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    imported = [
        f"{module}.{name.strip()}".removeprefix(".")
        for module, names in re.findall(r"^from jackbox_env(\S*) import ([\w, ]+)", code, re.MULTILINE)
        for name in names.split(",")
    ]
    assert "jackbox_env" in code
    assert _missing(imported, INDEX, DETAILS) == []
