"""The house: every import goes down the list below, also those inside functions."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# From the ground up. A module may import what stands above it in this list, which is below it in the house.
PACKAGE = """
    _validation storage
    scene
    states
    randomization
    complementarity
    mechanics
    tasks observation
    compiled.kept compiled.status compiled.address
    compiled.compiler
    compiled.workspace compiled.trigonometry compiled.generator
    compiled.drives compiled.impacts
    compiled.interpolation
    compiled.motion
    compiled.bounds
    compiled.search
    compiled.constrained
    compiled.rest
    compiled.advance
    compiled.step
    compiled.score
    compiled.glide
    compiled.loop
    compiled.restart
    compiled.rollouts
    simulators.base simulators.fidelity simulators.flight
    simulators.replay simulators.contacts simulators.functions
    simulators.pymunk simulators.exact
    simulators
    trajectory
    samples
    report
    scoring
    canvas
    rendering
    tiles
    env
    batches.base batches.threads
    batches.scenes batches.given
    batches.exact batches.single
    vector_env
    sb3 planning
    plans
    futures
    lookahead
    sb3_wrappers
    playing_window
    accuracy
    choosing
    commands.common commands.plots
    commands.simulate commands.play commands.check
    commands.main
    __main__
"""
AGENTS = """
    policies preview storage archives timing observing
    settings extractor
    playing
    holding
    runs film checkpoints
    sweeping
    journal
    on_ray
    models network
    value
    planner landing
    best evaluation exporting episodes zoo
    training notes
    trials
    figures
"""


def _floors(listed: str, package: str) -> dict[str, int]:
    """Floor of each module, counted from the ground."""
    floors = enumerate(line.split() for line in listed.strip().splitlines())
    return {f"{package}.{name}": floor for floor, names in floors for name in names}


FLOORS = _floors(PACKAGE, "jackbox_env") | {name: floor + 100 for name, floor in _floors(AGENTS, "agents").items()}
EMPTY = {f"jackbox_env.{name}" for name in ("compiled", "batches", "commands")}  # a docstring at most
EMPTY |= {"agents", "scripts", "scripts.studies"}


def _name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def _sources(*folders: str) -> dict[str, Path]:
    return {_name(path): path for folder in folders for path in sorted((ROOT / folder).rglob("*.py"))}


def _imports(tree: ast.AST, known: set[str]) -> Iterator[str]:
    """Modules of this project that are imported anywhere in a file, for type checking too."""
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in known)
        if isinstance(node, ast.ImportFrom) and node.module in known:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in known else node.module


def _violations(sources: dict[str, Path]) -> list[str]:
    """Imports that do not go down."""
    known, found = set(sources), []
    for name, path in sources.items():
        for imported in _imports(ast.parse(path.read_text()), known):
            if imported == "jackbox_env" or imported in EMPTY:
                continue  # the lazy names of the package's front
            if not FLOORS[imported] < FLOORS[name]:
                found.append(f"{name} (floor {FLOORS[name]}) imports {imported} (floor {FLOORS[imported]})")
    return found


def test_every_module_has_its_floor() -> None:
    modules = set(_sources("jackbox_env", "agents")) - EMPTY - {"jackbox_env"}
    assert modules == set(FLOORS)


def test_imports_go_down() -> None:
    sources = {name: path for name, path in _sources("jackbox_env", "agents").items() if name in FLOORS}
    assert _violations(sources) == []


def test_nothing_stands_on_the_studies() -> None:
    sources = _sources("jackbox_env", "agents", "scripts")
    for name, path in sources.items():
        for imported in _imports(ast.parse(path.read_text()), set(sources)):
            package = imported.split(".")[0]
            if name.split(".")[0] != "scripts":
                assert package != "scripts", f"{name} imports {imported}"
            if not name.startswith("scripts.studies"):
                assert not imported.startswith("scripts.studies"), f"{name} imports {imported}"
            if name.split(".")[0] == "jackbox_env":
                assert package == "jackbox_env", f"{name} imports {imported}"


@pytest.mark.parametrize("line", ["import jackbox_env.env", "def f():\n    from jackbox_env.env import JackInBoxEnv"])
def test_an_import_that_goes_up_is_seen(tmp_path: Path, line: str) -> None:
    sources = _sources("jackbox_env")
    sources = {name: path for name, path in sources.items() if name in FLOORS}
    bad = tmp_path / "scene.py"
    bad.write_text(line)
    assert len(_violations(sources | {"jackbox_env.scene": bad})) == 1
