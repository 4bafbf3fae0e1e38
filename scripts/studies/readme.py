"""Write the README's numbers and picture: a demo run's table, the fidelities, the throughput, and the film as a GIF."""

from __future__ import annotations

import json
import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from jackbox_env.commands.common import command_line

ROOT = Path(__file__).parents[2]
SWEEP = ROOT / "docs" / "accuracy"
SPEED = ROOT / "docs" / "speed.json"
PICTURE = ROOT / "docs" / "jackbox.gif"


@dataclass(frozen=True)
class Arguments:
    """Write the README's numbers and picture from a run of the demo."""

    run: Path | None = None
    """Folder of a demo run; None: the newest in runs/."""
    picture: bool = True
    """Film the picture anew."""


def newest_demo() -> Path:
    """The newest finished demo in runs/.

    Raises:
        FileNotFoundError: there is none.
    """
    found = sorted(path.parent for path in Path("runs").glob("demo-*/results.json"))
    if not found:
        raise FileNotFoundError("runs/ holds no finished demo: make demo first, or give --run")
    return found[-1]


def fill(page: str, mark: str, text: str) -> str:
    """Replace what stands between ``<!-- mark -->`` and ``<!-- /mark -->``.

    Raises:
        ValueError: the page has no such marks.
    """
    pattern = re.compile(rf"(<!-- {mark} -->\n).*?(<!-- /{mark} -->)", re.DOTALL)
    if not pattern.search(page):
        raise ValueError(f"the page has no place marked {mark}")
    return pattern.sub(lambda match: f"{match[1]}{text}\n{match[2]}", page)


def results_table(results: dict[str, Any]) -> str:
    """The demo's tables, one for each contact model, and what they were made with."""
    from agents.evaluation import Returns, table

    tables = [
        f'With `contact="{contact}"`:\n\n' + table([Returns(row["policy"], tuple(row["returns"])) for row in rows])
        for contact, rows in results["results"].items()
    ]
    made = ", ".join(f"{name} {results['versions'][name]}" for name in ("gymnasium", "pymunk", "stable-baselines3"))
    return "\n\n".join(tables) + f"\n\nWritten by `make demo` and `make readme` ({made})."


def take_picture(run: Path) -> None:
    """Film chirp, trained agent and planner side by side, small enough for a page."""
    from agents.evaluation import find_policy
    from agents.film import film
    from agents.models import derived_seed
    from agents.runs import read_settings

    partial = PICTURE.with_name("new.gif")
    partial.unlink(missing_ok=True)
    settings = read_settings(run)
    named = {"chirp": "chirp", "PPO": str(run), "planner": "planner"}
    acts = {caption: find_policy(name, settings, 0) for caption, name in named.items()}
    film(acts, settings.env_settings, partial, seed=derived_seed("evaluation", 0), seconds=8.0, width=256)
    partial.replace(PICTURE)


@command_line
def main() -> None:
    """Parse, collect, write."""
    import tyro

    from scripts.studies.accuracy.page import for_the_readme
    from scripts.studies.accuracy.results import Results
    from scripts.studies.speed import page as speed

    arguments = tyro.cli(Arguments, description=__doc__)
    run = arguments.run or newest_demo()
    page = (ROOT / "README.md").read_text()
    page = fill(page, "baselines", results_table(json.loads((run / "results.json").read_text())))
    page = fill(page, "fidelity", for_the_readme(Results.load(SWEEP)))
    if arguments.picture:
        take_picture(run)
    page = fill(page, "benchmark", speed.for_the_readme(json.loads(SPEED.read_text())))
    (ROOT / "README.md").write_text(page)
    print(f"Wrote README.md from {run}")


if __name__ == "__main__":
    main()
