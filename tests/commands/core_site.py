"""A folder of packages as a plain ``pip install`` of the wheel makes it, from those installed here."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Iterator
from importlib import metadata
from pathlib import Path

ROOT = Path(__file__).parents[2]


def _needed(package: str, found: set[str]) -> None:
    """Add a package and what it asks for without extras, where it is installed."""
    name = package.lower().replace("_", "-")
    try:
        asked = metadata.requires(package) or []
    except metadata.PackageNotFoundError:  # for another system or Python
        return
    if name not in found:
        found.add(name)
        for line in asked:
            if "extra ==" not in line:
                _needed(re.split(r"[\s;<>=!~\[(]", line)[0], found)


def _tops(package: str) -> Iterator[Path]:
    """What a package has put into the folder of packages."""
    files = metadata.files(package) or []
    base = Path(str(metadata.distribution(package).locate_file("")))
    for top in sorted({file.parts[0] for file in files}):
        if top not in ("..", "__pycache__"):
            yield base / top


def make_core_site(folder: Path, wheel: Path) -> None:
    """Fill a folder with the wheel and links to what the wheel asks for; no extra is there, nor the checkout."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--no-deps", "--no-index", "--target", str(folder)]
    subprocess.run([*command, str(wheel)], check=True, capture_output=True)
    found = set[str]()
    for package in ("gymnasium", "numba", "numpy", "pymunk"):
        _needed(package, found)
    for package in found:
        for path in _tops(package):
            if not (folder / path.name).exists():
                (folder / path.name).symlink_to(path)


def build_wheel(folder: Path) -> Path:
    """Build the wheel in this environment: hatchling is among its packages."""
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    subprocess.run(command, capture_output=True, check=True)
    (wheel,) = folder.glob("*.whl")
    return wheel
