"""The package as people install and import it."""

from __future__ import annotations

import doctest
import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import jackbox_env
from scripts.studies import readme

ROOT = Path(__file__).parents[1]
HEAVY = ("pymunk", "pygame", "numba", "torch", "stable_baselines3", "matplotlib", "scipy")


def run(*words: str, cwd: Path | None = None) -> str:
    command = [sys.executable, *words]
    return subprocess.run(command, capture_output=True, text=True, check=True, cwd=cwd).stdout.strip()


@pytest.mark.parametrize(
    ("code", "loaded"),
    [
        ("", []),
        ("e = gymnasium.make('JackInBox-v0'); e.reset(); e.step(None)", ["pymunk"]),
        ("e = gymnasium.make_vec('JackInBox-v0', 2, contact='exact'); e.reset(); e.step(None)", ["numba"]),
    ],
)
def test_nothing_heavy_is_loaded_that_is_not_stepped(code: str, loaded: list[str]) -> None:
    names = run(
        "-c", f"import sys, gymnasium, jackbox_env\n{code}\nprint([name for name in {HEAVY} if name in sys.modules])"
    )
    assert names.replace(", 'scipy'", "") == str(loaded)  # numba itself tries scipy


def test_every_public_name_is_there() -> None:
    for name in jackbox_env.__all__:
        assert getattr(jackbox_env, name) is not None
        assert name in dir(jackbox_env)
    with pytest.raises(AttributeError, match="module 'jackbox_env' has no attribute 'nothing'"):
        _ = jackbox_env.nothing


WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "jackbox_env").rglob("*.py")
    if "    >>> " in path.read_text()
)


@pytest.mark.parametrize("module", WITH_EXAMPLES)
def test_the_docstrings_examples_run(module: str) -> None:
    results = doctest.testmod(importlib.import_module(module))
    assert results.attempted > 0
    assert results.failed == 0


def test_the_pins_cover_the_requirements_of_the_project() -> None:
    pins = (ROOT / "constraints.txt").read_text().lower()
    assert "torch==2.13.0" in pins.splitlines()
    asked = re.findall(r'^    "([\w-]+)[>=]', (ROOT / "pyproject.toml").read_text(), re.MULTILINE)
    assert len(asked) > 15
    for package in asked:
        assert re.search(rf"^{package.replace('-', '[-_]')}==", pins, re.MULTILINE), package


def test_the_versions_agree() -> None:
    for file in ("pyproject.toml", "CITATION.cff", "CHANGELOG.md"):
        assert jackbox_env.__version__ in (ROOT / file).read_text(), file


def test_no_shipped_line_names_a_machine_or_a_registry() -> None:
    # No path of anybody's machine and no package registry's host.
    tracked = subprocess.run(["git", "-C", str(ROOT), "ls-files"], capture_output=True, text=True, check=False).stdout
    for name in tracked.splitlines():
        path = ROOT / name
        if path.is_file() and path.suffix in (".py", ".md", ".toml", ".txt", ".json", ".jsonl", ".cff", ""):
            text = path.read_text()
            assert not re.search(r"/(?:home|work|root|Users)/\w|https?://[\w.]*pypi", text), name
            assert not name.startswith("docs/") or "/tmp/" not in text, name


def blocks(path: Path) -> list[str]:
    """The Python of a page."""
    return re.findall(r"```python\n(.*?)```", path.read_text(), re.DOTALL)


@pytest.mark.parametrize("number", [pytest.param(0, marks=pytest.mark.slow), 1])
def test_each_block_of_the_readme_runs_alone(number: int, tmp_path: Path) -> None:
    pytest.importorskip("stable_baselines3")
    examples = blocks(ROOT / "README.md")
    assert len(examples) == 2
    assert len([line for line in examples[number].splitlines() if line]) <= 13
    run("-c", examples[number].replace("learn(400_000,", "learn(20_000,"), cwd=tmp_path)  # make readme trains in full
    for words in re.findall(r"^# jackbox (.*)", examples[number], re.MULTILINE):
        run("-m", "jackbox_env", *words.split(), "--episodes", "2", cwd=tmp_path)
        assert (tmp_path / "juggler.gif").stat().st_size > 100_000


def test_the_readme_is_short_and_its_tables_have_the_measured_numbers() -> None:
    page = (ROOT / "README.md").read_text()
    assert len(page.splitlines()) <= 110
    assert readme.filled(page) == page, "make readme"
    assert readme.ENVIRONMENT.read_text() == readme.environment_page(), "make readme"
    for link in re.findall(r"\]\(([^)#]+)", page):
        assert "://" in link or (ROOT / link).exists(), link


PAGES = sorted(path.name for path in (ROOT / "docs").glob("*.md") if blocks(path))


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_each_block_of_a_page_runs_alone(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("stable_baselines3")
    monkeypatch.chdir(tmp_path)
    for block in blocks(ROOT / "docs" / page):
        exec(compile(block, page, "exec"), {"__name__": "__main__"})
        names = capsys.readouterr().out
        for line, wanted in re.findall(r"^print\((.*)\)  # ([-\d.]+)", block, re.MULTILINE):
            assert wanted in names, line
