"""Train a PPO agent on JackInBox-v0, compare it with scripted baselines, and film it with them and a planner.

It trains on fidelity exact, and evaluates on that and on balanced, the default of `gymnasium.make`.
"""

from __future__ import annotations

import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from agents.settings import TrainSettings
from jackbox_env.tools.command_line import command_line, progress

if TYPE_CHECKING:
    from agents.evaluation.returns import Returns
    from agents.policies.scripted import PolicyWithEnv


@dataclass(frozen=True)
class Arguments:
    """Train, evaluate, plot and film."""

    folder: Path | None = None
    """New folder for all that is written; None: runs/demo-<date>-<time>."""
    total_steps: int = TrainSettings.total_steps
    """Steps to train for, each a decision that lasts until the next impact."""
    episodes: int = 128
    """Episodes of each policy."""
    seed: int = 0
    """Seed of all random numbers; evaluation and training use different starts."""


@command_line
def main() -> None:
    """Run the four steps."""
    import tyro

    arguments = tyro.cli(Arguments, description=__doc__)
    began = time.monotonic()
    progress("Loading PyTorch and Stable-Baselines3 ...")
    from agents.evaluation.figures import learning_figure
    from agents.evaluation.film import film
    from agents.evaluation.returns import above, table
    from agents.policies.registry import SCRIPTED, find_policy
    from agents.runs import describe
    from agents.training.models import derived_seed
    from agents.training.ppo import train
    from jackbox_env.tools import checks as check
    from jackbox_env.tools.files import new_folder

    check.whole("episodes", arguments.episodes, at_least=2)
    settings = TrainSettings(total_steps=arguments.total_steps, seed=arguments.seed)
    folder = new_folder(arguments.folder, "demo", lambda made: describe(made, settings))
    print(f"Training PPO for {settings.total_steps:,} decisions, one per bounce")
    train(settings, folder)

    print(f"Evaluating {arguments.episodes} episodes of each policy on fidelity exact, and on gym.make's balanced")
    acts = {name: find_policy(name, settings, arguments.seed) for name in SCRIPTED}
    acts["PPO"] = find_policy(str(folder), settings)
    settings_on = {fidelity: {**settings.env_settings, "fidelity": fidelity} for fidelity in ("exact", "balanced")}
    rows = {name: _returns(acts, on, arguments.episodes, arguments.seed) for name, on in settings_on.items()}
    _write_results(folder, arguments.seed, rows)
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


def _returns(acts: dict[str, PolicyWithEnv], env_settings: dict[str, Any], episodes: int, seed: int) -> list[Returns]:
    """Evaluate the policies in one environment."""
    from agents.evaluation.returns import evaluate

    return [evaluate(name, act, env_settings, episodes, seed) for name, act in acts.items()]


def _write_results(folder: Path, seed: int, rows: dict[str, list[Returns]]) -> None:
    """Write results.json: all returns by fidelity, machine and versions."""
    from agents.runs import machine, versions
    from jackbox_env.tools.files import write_json

    returns = {fidelity: [row.as_json() for row in of] for fidelity, of in rows.items()}
    record = {"seed": seed, "machine": machine(), "versions": versions(), "results": returns}
    write_json(folder / "results.json", record)


if __name__ == "__main__":
    main()
