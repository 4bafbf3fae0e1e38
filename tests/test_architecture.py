"""The house: every import goes down the list below, also those inside functions."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]

# From the ground up. A module may import what stands above it in this list, which is below it in the house.
PACKAGE = """
    checks files colours command_line
    scene
    states
    randomization
    complementarity
    mechanics
    tasks observation landing
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
    compiled.tangents
    simulators.base simulators.fidelity simulators.flight
    simulators.replay simulators.contacts simulators.functions
    simulators.pymunk simulators.exact
    simulators
    scoring
    recording.trajectory
    recording.samples
    recording.page
    render.canvas
    render.renderer
    env
    batches.base batches.threads
    batches.scenes batches.given
    batches.exact batches.single
    vector_env
    sb3 planning.rollouts
    planning planning.linearization
    torch
    planning.icem
    planning.features
    planning.wrappers
    planning.landing_control
    planning.sb3_wrappers
    sb3_wrappers render.window
    measure.accuracy
    measure.choosing measure.recordings
    measure.shooting
    measure.fitting
    commands.options commands.plots
    commands.simulate commands.play commands.fit commands.check
    commands.main
    __main__
"""
AGENTS = """
    policies.scripted policies.landing_features files training.archives training.timing policies.observing
    settings training.extractor
    policies.playing
    training.holding
    runs evaluation.film training.checkpoints
    training.models policies.network
    policies.value
    policies.planner policies.one_bounce
    policies.registry
    training.best evaluation.returns evaluation.exporting evaluation.episodes training.zoo
    training.ppo evaluation.provenance
    sweep evaluation.figures
    sweep_ray
"""


EMPTY = {
    f"jackbox_env.{name}" for name in ("batches", "commands", "compiled", "measure", "recording", "render")
}  # a docstring at most
EMPTY |= {f"agents.{name}" for name in ("evaluation", "policies", "training")}
EMPTY |= {"jackbox_env", "agents", "scripts", "scripts.studies"}  # the first: lazy names
FLOORS = {
    f"{package}.{name}": ground + floor
    for package, listed, ground in (("jackbox_env", PACKAGE, 0), ("agents", AGENTS, 100))
    for floor, line in enumerate(listed.strip().splitlines())
    for name in line.split()
}


def _floor(name: str) -> int:
    """Above the package and the agents stand the scripts, and above those the studies."""
    return FLOORS[name] if not name.startswith("scripts") else 300 if name.startswith("scripts.studies") else 200


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


def _violations(sources: dict[str, Path]) -> list[str]:
    """Imports that do not go down; scripts may import each other, and studies too."""
    return [
        f"{name} imports {imported}"
        for name in set(sources) - EMPTY
        for imported in set(_imports(ast.parse(sources[name].read_text()), set(sources))) - EMPTY
        if not _floor(imported) < _floor(name) + name.startswith("scripts")
    ]


def test_every_module_has_its_floor() -> None:
    assert {name for name in set(_sources()) - EMPTY if not name.startswith("scripts")} == set(FLOORS)


def test_imports_go_down() -> None:
    assert _violations(_sources()) == []


# -- privates ---------------------------------------------------------------------------------------------------------


def _room(name: str) -> str:
    """The folder of a module; a file beside the folders is a room of its own."""
    return ".".join(name.split(".")[:-1] if name.startswith("scripts") else name.split(".")[:2])


def _own_names(tree: ast.AST) -> set[str]:
    """Names that a module defines, attributes of its objects among them."""
    stored = (node for node in ast.walk(tree) if isinstance(getattr(node, "ctx", None), ast.Store))
    names = {getattr(node, "id", getattr(node, "attr", "")) for node in stored}
    return names | {node.name for node in ast.walk(tree) if isinstance(node, ast.FunctionDef | ast.ClassDef)}


def _read_names(tree: ast.AST) -> Iterator[str]:
    """Names that a module imports, or reads of an object that is not its own."""
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom):
            yield from (alias.name for alias in node.names)
        if isinstance(node, ast.Attribute) and getattr(node.value, "id", "") not in ("self", "cls"):
            yield node.attr


def _privates_read(sources: dict[str, Path]) -> list[str]:
    """Underscored names of other rooms that modules read; a name that the own room has too is not seen."""
    trees, names = {name: ast.parse(path.read_text()) for name, path in sources.items()}, dict[str, set[str]]()
    for name, tree in trees.items():
        names.setdefault(_room(name), set()).update(_own_names(tree))
    return [
        f"{name} reads {private}"
        for name, tree in trees.items()
        for private in set(_read_names(tree)) - names[_room(name)]
        if private.startswith("_") and not private.startswith("__")
        if any(private in own for own in names.values())
    ]


def test_no_room_reads_anothers_privates() -> None:
    assert _privates_read(_sources()) == []


@pytest.mark.parametrize("line", ["from jackbox_env.env import _read", "env._parts", "import numpy\nnumpy.put._parts"])
def test_a_private_name_that_is_read_is_seen(tmp_path: Path, line: str) -> None:
    (tmp_path / "bad.py").write_text(line)
    (tmp_path / "env.py").write_text("class Env:\n    def __init__(self):\n        self._parts = _read = 1")
    found = _privates_read({"jackbox_env.sb3": tmp_path / "bad.py", "jackbox_env.env": tmp_path / "env.py"})
    assert len(found) == 1


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("jackbox_env.scene", "import jackbox_env.env"),
        ("jackbox_env.scene", "def f():\n    from jackbox_env.env import JackInBoxEnv"),
        ("jackbox_env.env", "from agents import runs"),
        ("agents.runs", "import scripts.train"),
        ("scripts.train", "from scripts.studies import timing"),
    ],
)
def test_an_import_that_goes_up_is_seen(tmp_path: Path, name: str, line: str) -> None:
    bad = tmp_path / "bad.py"
    bad.write_text(line)
    assert len(_violations(_sources() | {name: bad})) == 1
