"""Write the README's tables from stored results, its moving picture, and the environment's page in docs/."""

from __future__ import annotations

import inspect
import json
import re
import shutil
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from agents.policies.network import TRAINED
from jackbox_env.envs.single import JackInBoxEnv
from jackbox_env.tools.command_line import command_line
from scripts.studies.pages import cell, fill

ROOT = Path(__file__).parents[2]
SPEED = ROOT / "docs" / "speed.json"
BENCHMARK = ROOT / "docs" / "benchmark.json"
ENVIRONMENT = ROOT / "docs" / "environment.md"
PICTURE = ROOT / "docs" / "jackbox.gif"
PAGE = ROOT / "docs" / "play.png"
SHOWN = ("zero", "best chirp", "ppo", "distilled", "planner")  # policies in the README
FIRST = 1.44  # time of the picture's first frame [s]: the jacks are in the air, and the boxes have turned


@dataclass(frozen=True)
class Arguments:
    """Write the README's tables and picture."""

    picture: bool = True
    """Film the picture and photograph the page anew; the page needs playwright and Chromium."""


def returns_table(record: dict[str, Any]) -> str:
    """The mean returns of some policies on each task, on the exact model."""
    default = [row for row in record["policies"] if (row["contact"], row["setting"]) == ("exact", "default")]
    rows = {(row["policy"], row["task"]): row for row in default}
    lines = [f"| policy | {' | '.join(TRAINED)} |", f"|---|{'---:|' * len(TRAINED)}"]
    lines += [f"| {policy} | {' | '.join(cell(rows[policy, task]) for task in TRAINED)} |" for policy in SHOWN]
    return "\n".join(lines)


def film_picture() -> None:
    """Film chirp, trained network and planner side by side, small enough for a page."""
    from agents.evaluation.film import film
    from agents.policies.registry import find_policy
    from agents.settings import EnvSettings
    from agents.training.models import derived_seed

    partial = PICTURE.with_name("new.gif")
    partial.unlink(missing_ok=True)
    settings = EnvSettings(contact="exact")
    acts = {caption: find_policy(caption.lower(), settings, 0) for caption in ("chirp", "PPO", "planner")}
    start = derived_seed("evaluation", 0)
    film(acts, settings.env_settings, partial, start, seconds=8.0, width=256, begin=FIRST)
    partial.replace(PICTURE)


def photograph_page() -> None:
    """Photograph the page to play on, in which the trained agent has just turned the box under the jack."""
    from playwright.sync_api import expect, sync_playwright

    from scripts.site.build import ensure_page

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=shutil.which("chromium"), args=["--no-sandbox"])
        page = browser.new_page(viewport={"width": 1000, "height": 838})
        page.goto(ensure_page().as_uri())
        page.keyboard.press("a")
        expect(page.locator("#clock")).to_have_text(re.compile("^3"), timeout=30_000)
        page.keyboard.press(" ")
        page.add_style_tag(content="#hint { visibility: hidden; }")
        page.screenshot(path=PAGE)
        browser.close()


def filled(page: str) -> str:
    """The README with its tables filled from the stored results."""
    from scripts.studies.speed import speed

    page = fill(page, "returns", returns_table(json.loads(BENCHMARK.read_text())))
    sentence = speed.for_the_readme(json.loads(SPEED.read_text()))
    return re.sub("(<!-- speed -->).*?(<!-- /speed -->)", rf"\1{sentence}\2", page)


def environment_page() -> str:
    """The environment's page: its docstring, which is Markdown in the order of Gymnasium's own pages."""
    text = inspect.cleandoc(JackInBoxEnv.__doc__ or "").split("\nRaises:")[0]
    first, rest = text.split("\n", 1)
    example = re.compile(r"((?:^(?:>>>|\.\.\.) .*\n)+)(^\(\(.*\n)?", re.MULTILINE)
    rest = example.sub(lambda match: f"```pycon\n{match[0]}```\n", rest)
    picture = "![The chirp, a trained agent and a planner, from the same start](jackbox.gif)"
    sketch = "![Box, jack, angles and signs](sketch.svg)"
    whom = "*For everybody who steps the environment: its contract, whole.*"
    return f"# JackInBox-v0\n\n{whom}\n\n{picture}\n\n{first}\n\n{sketch}\n{rest}"


@command_line
def main() -> None:
    """Parse, collect, write."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    if arguments.picture:
        film_picture()
        photograph_page()
    (ROOT / "README.md").write_text(filled((ROOT / "README.md").read_text()))
    ENVIRONMENT.write_text(environment_page())
    print("Wrote README.md and docs/environment.md")


if __name__ == "__main__":
    main()
