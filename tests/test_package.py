"""The package as people install and import it."""

from __future__ import annotations

import doctest
import importlib
import json
import re
import subprocess
import sys
from pathlib import Path

import pytest

import jackbox_env
from scripts.recipes.run import HERE, RECIPES
from scripts.studies import readme
from tests.script import script

ROOT = Path(__file__).parents[1]
RENDERER = "jackbox_env.render.renderer"
HEAVY = ("pymunk", "pygame", "numba", "torch", "stable_baselines3", "matplotlib", "scipy", RENDERER)


LOADED = f"""
import sys, gymnasium, jackbox_env
def loaded():
    print(sorted(set({HEAVY}).intersection(sys.modules)))
def stepped(**settings):
    for env in (gymnasium.make("JackInBox-v0", **settings), gymnasium.make_vec("JackInBox-v0", 2, **settings)):
        env.reset(seed=0)
        env.step(None)
    loaded()
loaded()
stepped(contact=sys.argv[1])
stepped(contact=sys.argv[1], render_mode="rgb_array")
"""


@pytest.mark.parametrize(("contact", "engine"), [("pymunk", "pymunk"), ("exact", "numba")])
def test_nothing_heavy_is_loaded_that_is_not_stepped_or_drawn(contact: str, engine: str) -> None:
    done = subprocess.run([sys.executable, "-c", LOADED, contact], capture_output=True, text=True, check=True)
    names = done.stdout.replace(", 'scipy'", "")  # numba itself tries scipy
    assert names.splitlines() == [str(sorted(loaded)) for loaded in ([], [engine], [engine, "pygame", RENDERER])]


WITH_EXAMPLES = sorted(
    ".".join(path.relative_to(ROOT).with_suffix("").parts)
    for path in (ROOT / "jackbox_env").rglob("*.py")
    if re.search("^ *>>> ", path.read_text(), re.MULTILINE)
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


def test_the_blocks_of_the_readme_are_short_and_the_second_runs() -> None:
    examples = blocks(ROOT / "README.md")
    assert len(examples) == 2  # tests/test_first_day.py runs the first
    assert max(len(example.splitlines()) for example in examples) <= 14
    exec(compile(examples[1], "README.md", "exec"), {"__name__": "__main__"})


def test_the_readme_is_short_and_its_tables_have_the_measured_numbers() -> None:
    page = (ROOT / "README.md").read_text()
    assert len(page.splitlines()) <= 112
    assert readme.filled(page) == page, "make readme"
    assert readme.ENVIRONMENT.read_text() == readme.environment_page(), "make readme"
    trust = (ROOT / "docs" / "trust.md").read_text()
    proven = re.findall(r"^\|[^|]+\|[^|]+\|[^|]+\| ([\d,]+) +\| [\d,]+ +\| 0 ", trust, re.MULTILINE)
    assert f"[{sum(int(one.replace(',', '')) for one in proven):,} control steps are proven]" in page


WRITTEN = [ROOT / "README.md", ROOT / "CHANGELOG.md", ROOT / "CONTRIBUTING.md", *sorted((ROOT / "docs").rglob("*.md"))]


def anchors(page: Path) -> set[str]:
    """The anchors of a page's headings, as the site makes them; those of a notebook are strings of JSON."""
    headings = re.findall(r'^(?: +")?#+ (.*?)(?:\\n",|")?$', page.read_text(), re.MULTILINE)
    return {re.sub(r"[^\w -]", "", heading).strip().lower().replace(" ", "-") for heading in headings}


def broken(page: Path) -> list[str]:
    """Links of a page to files or headings that do not exist."""
    links = re.findall(r"\]\(([^)\s]+)\)", page.read_text())
    dangling = []
    for link in (link for link in links if "://" not in link and link != "ADDRESS"):
        name, _, anchor = link.partition("#")
        target = page.parent / name if name else page
        if not target.exists() or (anchor and anchor not in anchors(target)):
            dangling.append(link)
    return dangling


@pytest.mark.parametrize("page", [path for path in WRITTEN if "_build" not in path.parts], ids=lambda path: path.name)
def test_links_of_a_page_lead_somewhere(page: Path) -> None:
    assert broken(page) == []


def test_broken_links_are_reported(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text("# `One` thing\n[a](#one-thing) [b](#two) [c](page.md#one-thing) [d](gone.md)")
    assert broken(page) == ["#two", "gone.md"]


def test_numbers_in_hand_written_sentences_are_the_stored_ones() -> None:
    pytest.importorskip("scipy")
    from scripts.studies.benchmark.policies import best_upright

    results = json.loads((ROOT / "docs" / "benchmark.json").read_text())
    earned = {
        (row["task"], row["policy"]): row["mean"]
        for row in results["policies"]
        if (row["setting"], row["contact"]) == ("default", "exact")
    }
    level, ppo = (round(earned["juggle", policy]) for policy in ("level", "ppo"))
    seconds = [
        row["processor_seconds"]
        for row in results["trainings"]
        if (row["task"], row["algorithm"]) == ("spin", "jackbox train")
    ]
    wanted = {
        "index": [f"earns {level}"],
        "start": [f"a PD controller earns {level}", f"reaches {ppo}"],
        "make_it_yours": [
            f"{best_upright():.0f} at best",
            f"earns {earned['juggle', 'zero']:.0f}",
        ],
        "training": [f"about {round(sum(seconds) / len(seconds), -1):.0f} s"],
        "faq": [f"less than {earned['juggle', 'zero']:.0f}?"],
    }
    accuracy = (ROOT / "docs" / "accuracy.md").read_text()
    right = dict(re.findall(r"^\| (exact|box2d, 64 substeps) +\| (\d+) of 189 ", accuracy, re.MULTILINE))
    wanted["../README"] = [f"`exact` finds {right['exact']}, Box2D {right['box2d, 64 substeps']}."]
    for name, sentences in wanted.items():
        page = (ROOT / "docs" / f"{name}.md").read_text()
        assert [words for words in sentences if words not in page] == [], name


@pytest.mark.slow
def test_what_is_written_about_chaos_is_what_the_notebook_on_control_prints(
    capsys: pytest.CaptureFixture[str],
) -> None:
    plots = pytest.importorskip("matplotlib.pyplot")
    cells = json.loads((ROOT / "docs" / "control_through_impacts.ipynb").read_text())["cells"]
    source = "\n".join("".join(cell["source"]) for cell in cells if cell["cell_type"] == "code")
    plots.switch_backend("agg")
    exec(source.partition("improved = ilqr(")[0], {})  # make docs runs all
    plots.close("all")
    printed = capsys.readouterr().out
    growth, ends = re.findall(r"multiplies an error (.*)\.$|float64 predicts (.*) impacts\.$", printed, re.MULTILINE)
    assert f"[{growth[0]}]" in (ROOT / "docs" / "faq.md").read_text()
    assert f"[{ends[1]}]" in (ROOT / "docs" / "physics.md").read_text()
    assert f"predicts only {ends[1]} impacts" in (ROOT / "jackbox_env" / "simulators" / "exact.py").read_text()


PAGES = sorted(path.name for path in (ROOT / "docs").glob("*.md") if blocks(path))


@pytest.mark.slow
@pytest.mark.parametrize("page", PAGES)
def test_each_block_of_a_page_runs_alone(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    pytest.importorskip("stable_baselines3")
    (tmp_path / "docs").symlink_to(ROOT / "docs")
    monkeypatch.chdir(tmp_path)
    for block in blocks(ROOT / "docs" / page):
        shortened = re.sub(r"learn\([\d_]+,", "learn(5_000,", block)
        exec(compile(shortened, page, "exec"), {"__name__": "__main__"})
        names = capsys.readouterr().out
        for line, wanted in re.findall(r"^print\((.*)\)  # ([-\d.]+)", block, re.MULTILINE):
            assert wanted in names, line


# -- recipes: make recipes runs those that need other environments -----------------------------------------------------


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, recipe in RECIPES.items() if not recipe.needs])
def test_a_recipe_runs(name: str, tmp_path: Path) -> None:
    file, *arguments = RECIPES[name].arguments
    script(f"recipes/{Path(file).stem}", *arguments, cwd=tmp_path)


def test_every_recipe_is_run_and_shown() -> None:
    page = (ROOT / "docs" / "recipes.md").read_text()
    for path in HERE.glob("with_*.py"):
        assert path.stem.removeprefix("with_") in RECIPES
        assert f"../scripts/recipes/{path.name}" in page
