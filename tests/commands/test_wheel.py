"""The wheel alone: no extras, no checkout, in an empty folder. An editable install would hide what it lacks."""

from __future__ import annotations

import os
import re
import subprocess
import sys
from importlib import metadata
from pathlib import Path

import pytest
from packaging.requirements import Requirement

ROOT = Path(__file__).parents[2]

PYMUNK = "--fidelity", "balanced"  # which compiles nothing


@pytest.fixture(scope="module")
def site(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder of packages as a plain ``pip install`` of the wheel makes it, with links to those installed here."""
    built, folder = tmp_path_factory.mktemp("wheel"), tmp_path_factory.mktemp("site")
    build = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(built), str(ROOT)]
    subprocess.run(build, capture_output=True, check=True)  # hatchling is among the packages here
    install = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(folder)]
    subprocess.run([*install, *map(str, built.glob("*.whl"))], check=True, capture_output=True)
    found = asked_by(*metadata.distributions(path=[str(folder)]))
    for package in found:  # grows meanwhile
        distribution = metadata.distribution(package)
        found += [name for name in asked_by(distribution) if name not in found]
        for top in {file.parts[0] for file in distribution.files or []} - {"..", "__pycache__"}:
            if not (folder / top).exists():
                (folder / top).symlink_to(Path(str(distribution.locate_file(top))))
    return folder


def asked_by(package: metadata.Distribution) -> list[str]:
    """The names of what a package asks for without extras, on this system."""
    asked = map(Requirement, package.requires or [])
    return [one.name for one in asked if one.marker is None or one.marker.evaluate({"extra": ""})]


def jackbox(site: Path, cwd: Path, *arguments: str, status: int = 0) -> subprocess.CompletedProcess[str]:
    """Run the command that the wheel installs; -S leaves this environment's own packages out."""
    env = {**os.environ, "PYTHONPATH": str(site)}
    command = [sys.executable, "-S", str(site / "bin" / "jackbox"), *arguments]
    done = subprocess.run(command, capture_output=True, text=True, cwd=cwd, env=env, timeout=250, check=False)
    assert done.returncode == status, done.stderr
    return done


def test_a_wheel_holds_the_package_alone(site: Path) -> None:
    (wheel,) = metadata.distributions(name="jackbox", path=[str(site)])
    assert sorted(asked_by(wheel)) == ["gymnasium", "numba", "numpy", "pymunk"]
    names = {str(file) for file in wheel.files or []}
    tops = {name.split("/")[0] for name in names} - {"..", "bin"}
    assert tops == {"jackbox_env", f"jackbox-{wheel.version}.dist-info"}
    assert "jackbox_env/py.typed" in names
    assert {f"jackbox_env/page/{path.name}" for path in (ROOT / "jackbox_env" / "page").iterdir()} < names
    assert any(name.endswith("LICENSE") for name in names)


def test_simulate_writes_files_without_plots_and_refuses_to_draw_them(site: Path, tmp_path: Path) -> None:
    done = jackbox(site, tmp_path, "simulate", "--seconds", "2", "--html", "--folder", "out", *PYMUNK)
    assert sorted(path.name for path in (tmp_path / "out").iterdir()) == [
        "impacts.csv",
        "states.csv",
        "trajectory.html",
    ]
    assert "matplotlib is not installed" in done.stderr
    assert "pip install matplotlib" in jackbox(site, tmp_path, "simulate", "--plots", status=2).stderr
    jackbox(site, tmp_path, "simulate", "--seconds", "1", "--format", "npz", "--folder", "arrays", *PYMUNK)
    assert [path.name for path in (tmp_path / "arrays").iterdir()] == ["trajectory.npz"]


@pytest.mark.slow  # compiles anew
def test_check_finds_that_it_works_and_which_extras_are_missing(site: Path, tmp_path: Path) -> None:
    out = jackbox(site, tmp_path, "check").stdout
    assert out.count("ok      ") == 6
    assert re.search(r'extra render: not installed; to get it: pip install "pygame-ce>=2.5"', out)
    assert re.search(r'extra train: not installed; to get it: pip install .*"torch', out)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("command", "remedy"), [("play", "pip install 'pygame-ce>=2.5'"), ("demo", "git clone"), ("train", "git clone")]
)
def test_what_it_lacks_is_said_in_one_line(command: str, remedy: str, site: Path, tmp_path: Path) -> None:
    said = jackbox(site, tmp_path, command, status=2).stderr
    assert remedy in said
    assert said.count("\n") == 1
