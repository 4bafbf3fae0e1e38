"""Train a PPO agent on JackInBox-v0, compare it with the scripted baselines, and film it beside them and a planner.

It trains on fidelity exact, and plays on that and on balanced, what `gymnasium.make` gives.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path

from agents.settings import TrainSettings
from jackbox_env.command_line import command_line


@dataclass(frozen=True)
class Arguments:
    """Train, evaluate, plot and film."""

    folder: Path | None = None
    """New folder for all that is written; None: runs/demo-<date>-<time>."""
    total_steps: int = TrainSettings.total_steps
    """Steps to train for, each an action held for `repeat` control steps."""
    max_minutes: float | None = None
    """Stop training after this time at the latest [min]; None: after all steps."""
    episodes: int = 128
    """Episodes of each policy."""
    seed: int = 0
    """Seed of all that is drawn; evaluation starts from others than training."""


@command_line
def main() -> None:
    """Run the four steps."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    began = time.monotonic()
    from agents.evaluation.figures import learning_figure
    from agents.evaluation.film import film
    from agents.evaluation.returns import Returns, above, evaluate, table
    from agents.policies.registry import SCRIPTED, find_policy
    from agents.runs import describe, machine, versions
    from agents.training.models import derived_seed
    from agents.training.ppo import train
    from jackbox_env import checks as check
    from jackbox_env.files import new_folder, write_json

    check.whole("episodes", arguments.episodes, at_least=2)
    settings = TrainSettings(total_steps=arguments.total_steps, max_minutes=arguments.max_minutes, seed=arguments.seed)
    folder = new_folder(arguments.folder, "demo", lambda made: describe(made, settings))
    limit = "" if settings.max_minutes is None else f" (at most {settings.max_minutes:g} min)"
    print(f"Training PPO for {settings.total_steps:,} steps of {settings.repeat} control steps each{limit}")
    train(settings, folder)

    print(f"Evaluating {arguments.episodes} episodes of each policy on fidelity exact, and on gym.make's balanced")
    acts = {name: find_policy(name, settings, arguments.seed) for name in SCRIPTED}
    acts["PPO"] = find_policy(str(folder), settings)
    settings_on = {fidelity: {**settings.env_settings, "fidelity": fidelity} for fidelity in ("exact", "balanced")}
    rows: dict[str, list[Returns]] = {
        fidelity: [
            evaluate(name, act.policy, {**env_settings, **act.env_settings}, arguments.episodes, arguments.seed)
            for name, act in acts.items()
        ]
        for fidelity, env_settings in settings_on.items()
    }
    results = {
        "seed": arguments.seed,
        "machine": machine(),
        "versions": versions(),
        "results": {fidelity: [row.as_json() for row in returns] for fidelity, returns in rows.items()},
    }
    write_json(folder / "results.json", results)
    learning_figure(folder, rows["exact"], settings.task)

    print("Filming chirp, level, PPO and the planner side by side")
    acts["planner"] = find_policy("planner", settings, arguments.seed)
    shown = {name: acts[name] for name in ("chirp", "level", "PPO", "planner")}
    film(shown, settings_on["exact"], folder / "film.gif", seed=derived_seed("evaluation", arguments.seed), width=288)
    for fidelity, returns in rows.items():
        print(f"\nFidelity {fidelity}:\n\n{table(returns)}")
    print(f"\nModel, settings, results.json, results.png and film.gif: {folder}")
    print(f"Took {time.monotonic() - began:.0f} s")
    print("; ".join(f"on {fidelity}, {above(returns, 'PPO', 'level')}" for fidelity, returns in rows.items()) + ".")


if __name__ == "__main__":
    main()
