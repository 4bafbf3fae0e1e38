"""Train a PPO agent on JackInBox-v0, compare it with the scripted baselines, and film it beside the chirp."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from agents.settings import TrainSettings
from scripts.common import command_line


@dataclass(frozen=True)
class Arguments:
    """Train, evaluate, plot and film."""

    folder: Path | None = None
    """Run folder to make; None: runs/demo-<date>-<time>."""
    total_steps: int = TrainSettings.total_steps
    """Environment steps to train for."""
    max_minutes: float = 3.5
    """Stop training after this time at the latest [min]."""
    episodes: int = 128
    """Episodes of each policy."""
    seed: int = 0
    """Of everything; evaluation starts from others than training."""


@command_line
def main() -> None:
    """Run the four steps."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    began = time.monotonic()
    from agents.evaluation import evaluate, table
    from agents.figures import learning_figure
    from agents.film import film
    from agents.models import derived_seed, load_model
    from agents.policies import BASELINES, Baseline, baseline
    from agents.runs import describe, machine, new_folder, versions
    from agents.storage import write_json
    from agents.training import train
    from jackbox_env import Scene
    from jackbox_env import _validation as check

    check.whole("episodes", arguments.episodes, at_least=2)
    settings = replace(
        TrainSettings(),
        total_steps=arguments.total_steps,
        max_minutes=arguments.max_minutes,
        seed=arguments.seed,
    )
    folder = new_folder(arguments.folder, "demo", lambda made: describe(made, settings))
    print(f"Training PPO for {settings.total_steps:,} steps (at most {settings.max_minutes:g} min)")
    train(settings, folder)

    print(f"Evaluating {arguments.episodes} episodes of each policy")
    acts = {name: baseline(name, Scene(), arguments.seed) for name in BASELINES}
    acts["PPO"] = Baseline(load_model(folder), {})
    rows = [
        evaluate(name, act.policy, {**settings.env_settings, **act.env_settings}, arguments.episodes, arguments.seed)
        for name, act in acts.items()
    ]
    results = {
        "seed": arguments.seed,
        "machine": machine(),
        "versions": versions(),
        "results": [row.as_json() for row in rows],
    }
    write_json(folder / "results.json", results)
    learning_figure(folder, rows, settings.task)

    print("Filming PPO beside the chirp")
    pair = {"PPO": acts["PPO"], "chirp": acts["chirp"]}
    film(pair, settings.env_settings, folder / "film.gif", seed=derived_seed("evaluation", arguments.seed), width=384)
    print()
    print(table(rows))
    print(f"\nModel, settings, results.json, results.png and film.gif: {folder}")
    print(f"Took {time.monotonic() - began:.0f} s")


if __name__ == "__main__":
    main()
