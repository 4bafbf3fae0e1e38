"""The architecture: imports between packages go one way, and none is of another package's privates.

Imports inside functions count too, and no modules form a circle.
``python tests/test_architecture.py`` prints rooms, floors, arrows and statements.
"""

from __future__ import annotations

import ast
import re
from collections import Counter
from collections.abc import Iterator
from functools import cache
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# From the ground up: a module imports only from its line and from those above it in this list. A name is a file or a
# folder.
ORDER = """
    tools
    model
    mechanics
    jit
    exact
    gpu
    simulators
    render
    planning
    torch
    measure
    envs
    recording fits
    sb3
    commands
    __main__
    agents.settings agents.runs agents.runners
    agents.policies
    agents.training
    agents.evaluation
    agents.sweep agents.sweep_ray
    scripts
    scripts.studies
    scripts.benchmark
"""
LEVELS = {
    name if name.startswith(("agents", "scripts")) else f"jackbox_env.{name}": level
    for level, line in enumerate(ORDER.strip().splitlines())
    for name in line.split()
}
LAZY = {"jackbox_env", "agents", "scripts"}  # names that load modules when they are read


def _level(name: str) -> int:
    """The level of the longest listed name that a module's name begins with.

    Raises:
        KeyError: there is none.
    """
    while name not in LEVELS:
        if "." not in name:
            raise KeyError(name)
        name = name.rpartition(".")[0]
    return LEVELS[name]


@cache
def _tree(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


@cache
def _sources() -> dict[str, Path]:
    """Each module's file."""
    paths = [path for folder in ("jackbox_env", "agents", "scripts") for path in (ROOT / folder).rglob("*.py")]
    return {".".join(path.relative_to(ROOT).with_suffix("").parts).removesuffix(".__init__"): path for path in paths}


def _imports(tree: ast.AST, known: set[str]) -> Iterator[str]:
    """Modules of this project that are imported anywhere in a file, for type checking too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        if isinstance(node, ast.ImportFrom) and node.module in known:
            inner = [f"{node.module}.{alias.name}" for alias in node.names]
            yield from (name if name in known else node.module for name in inner)


def _graph(sources: dict[str, Path]) -> dict[str, set[str]]:
    """The modules that each module imports."""
    known = set(sources)
    return {
        name: set(_imports(_tree(path), known)) - LAZY - {name} for name, path in sources.items() if name not in LAZY
    }


def _violations(sources: dict[str, Path]) -> list[str]:
    """Imports that go up."""
    return [
        f"{name} imports {imported}"
        for name, all_imported in _graph(sources).items()
        for imported in all_imported
        if _level(imported) > _level(name)
    ]


def _circle(sources: dict[str, Path]) -> list[str]:
    """Modules that import each other in a circle; empty if there are none."""
    try:
        TopologicalSorter(_graph(sources)).prepare()
    except CycleError as error:
        return list(error.args[1])
    return []


def test_every_name_of_the_order_is_a_module() -> None:
    assert set(LEVELS) <= set(_sources())


def test_the_page_has_every_package_in_this_order() -> None:
    rows = (ROOT / "docs" / "architecture.md").read_text().split("|---|---|---|")[1].split("\n\n")[0].splitlines()
    named = [re.findall(r"`([\w.]+)`", row.split("|")[1]) for row in rows if row]
    assert [name for names in named for name in names] == ORDER.split()


def test_loose_files_of_the_package_are_faces() -> None:
    loose = [path for path in (ROOT / "jackbox_env").glob("*.py") if path.stem not in ("__init__", "__main__")]
    for path in loose:
        body = ast.parse(path.read_text()).body[1:]  # without the docstring
        assert all(
            isinstance(node, ast.ImportFrom) or getattr(node, "targets", [None])[0].id == "__all__" for node in body
        )


def test_imports_go_down_and_not_in_circles() -> None:
    assert _violations(_sources()) == []
    assert _circle(_sources()) == []


# -- privates ---------------------------------------------------------------------------------------------------------


def _package(name: str) -> str:
    """The folder of a module; a file beside the folders is a package by itself."""
    return ".".join(name.split(".")[:-1] if name.startswith("scripts") else name.split(".")[:2])


def _privates_imported(sources: dict[str, Path]) -> list[str]:
    """Underscored names that modules import from other packages."""
    return [
        f"{name} imports {alias.name}"
        for name, path in sources.items()
        for node in ast.walk(_tree(path))
        if isinstance(node, ast.ImportFrom) and node.module in sources and _package(node.module) != _package(name)
        for alias in node.names
        if alias.name.startswith("_") and not alias.name.startswith("__")
    ]


def test_no_package_imports_anothers_privates(tmp_path: Path) -> None:
    assert _privates_imported(_sources()) == []
    bad = tmp_path / "bad.py"
    bad.write_text("from jackbox_env.envs.single import _read")
    assert _privates_imported({**_sources(), "jackbox_env.sb3": bad}) == ["jackbox_env.sb3 imports _read"]


@pytest.mark.parametrize(
    ("name", "line", "imported"),
    [
        ("jackbox_env.model.scene", "import jackbox_env.envs.single", "jackbox_env.envs.single"),
        ("jackbox_env.model.scene", "def f():\n    from jackbox_env.envs.single import A", "jackbox_env.envs.single"),
        ("jackbox_env.envs.single", "from agents import runs", "agents.runs"),
        ("agents.policies.network", "from agents.training import models", "agents.training.models"),
        ("agents.runs", "import scripts.train", "scripts.train"),
        ("scripts.train", "from scripts.studies import timing", "scripts.studies.timing"),
    ],
)
def test_an_import_that_goes_up_is_seen(tmp_path: Path, name: str, line: str, imported: str) -> None:
    bad, packages = tmp_path / "bad.py", ("agents", "agents.training", "scripts.studies")
    bad.write_text(line)
    few = {one: path for one, path in _sources().items() if one in (imported, *packages)}
    assert _violations(few | {name: bad}) == [f"{name} imports {imported}"]


def test_a_circle_within_a_package_is_seen(tmp_path: Path) -> None:
    bad = tmp_path / "bad.py"
    bad.write_text("from agents.policies import registry")
    policies = {name: path for name, path in _sources().items() if name.startswith("agents.policies")}
    assert "agents.policies.registry" in _circle(policies | {"agents.policies.network": bad})


def _statements(path: Path) -> int:
    """The statements of a file without its docstrings."""
    nodes = (node for node in ast.walk(_tree(path)) if isinstance(node, ast.stmt))
    return sum(not (isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)) for node in nodes)


def _purpose(sources: dict[str, Path], room: str) -> str:
    """The first line of a room's docstring."""
    return str(ast.get_docstring(ast.parse(sources[room].read_text()))).splitlines()[0]


def _layout() -> list[str]:
    """Rooms of the package with their statements, from the ground up, and the numbers of rooms, floors and arrows."""
    sources = {name: path for name, path in _sources().items() if name.startswith("jackbox_env.")}
    arrows, statements = {_package(name): set[str]() for name in sources}, Counter[str]()
    for name, imported in _graph(sources).items():
        arrows[_package(name)] |= {_package(one) for one in imported} - {_package(name)}
        statements[_package(name)] += _statements(sources[name])
    floor = dict[str, int]()
    for room in TopologicalSorter(arrows).static_order():
        floor[room] = 1 + max([floor[below] for below in arrows[room]], default=0)
    rows = [
        f"{floor[room]} {room.split('.')[1]:<11}{statements[room]:6,}  {_purpose(sources, room)}"
        for room in sorted(floor, key=lambda room: floor[room])
    ]
    count = sum(map(len, arrows.values()))
    return [
        "floor, room, statements",
        *rows,
        f"{statements.total():6,} statements, {len(floor)} rooms, {max(floor.values())} floors, {count} arrows",
    ]


if __name__ == "__main__":
    print(*_layout(), sep="\n")
