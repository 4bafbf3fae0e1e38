"""What every policy earns on every task and both contact models: docs/results.md.

Each row is evaluated by itself and kept in a file, so an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from agents.settings import EnvSettings
from jackbox_env.commands.common import command_line
from jackbox_env.tasks import TASKS

POLICIES = ("zero", "level", "chirp", "best chirp", "ppo", "planner")
ON_JUGGLE = ("distilled",)
CONTACTS = ("exact", "pymunk")
SEED = 1
RESAMPLES = 2000


@dataclass(frozen=True)
class Arguments:
    """Evaluate all policies and write the page."""

    episodes: int = 256
    """Episodes of each policy."""
    planner_episodes: int = 64
    """Episodes of the planner on each task and contact model, a second or two of computing for each."""
    across_episodes: int = 128
    """Episodes of each policy in each of the scenes that vary."""
    kept: Path = Path("runs/results")
    """Folder of the rows that are evaluated already, which are not evaluated again; made if there is none."""
    out: Path = Path("docs")
    """Folder for results.md, results.json and results.png."""


def policies_on(task: str) -> tuple[str, ...]:
    """Names of the policies that are evaluated on a task."""
    return POLICIES[:-1] + (ON_JUGGLE if task == "juggle" else ()) + POLICIES[-1:]


def interquartile_mean(returns: NDArray[np.float64], axis: int = -1) -> Any:
    """Mean of the middle half."""
    from scipy.stats import trim_mean

    return trim_mean(returns, 0.25, axis=axis)


def measured(task: str, contact: str, name: str, episodes: int) -> dict[str, Any]:
    """One row: returns, the interquartile mean with its bootstrap interval, seconds for an episode."""
    from scipy.stats import bootstrap

    from agents.evaluation.returns import evaluate
    from agents.policies.registry import find_policy
    from agents.runs import machine, versions
    from scripts.studies.results.chirps import best_chirp

    settings = EnvSettings(task=task, contact=contact)
    policy, more = find_policy("chirp" if name == "best chirp" else name, settings, SEED)
    drive = best_chirp(task, SEED) if name == "best chirp" else None
    if drive is not None:
        more = {**more, "scene": {"drive": drive}}
    began = time.perf_counter()
    row = evaluate(name, policy, {**settings.env_settings, **more}, episodes, SEED, progress=True)
    taken = time.perf_counter() - began
    returns = np.array(row.returns)
    found = bootstrap(
        (returns,), interquartile_mean, n_resamples=RESAMPLES, method="percentile", rng=np.random.default_rng(0)
    )
    return {
        "task": task,
        "contact": contact,
        **row.as_json(),
        "iqm": float(interquartile_mean(returns)),
        "iqm_interval_95": [float(end) for end in found.confidence_interval],
        "drive": drive,
        "seconds_per_episode": taken / episodes,
        "commit": versions()["commit"],
        "machine": machine(),
    }


def rows_of(arguments: Arguments) -> list[dict[str, Any]]:
    """A row for each task, contact model and policy; those in files already are read."""
    from jackbox_env.recording.files import write_json

    rows = []
    for task in TASKS:
        for contact in CONTACTS:
            for name in policies_on(task):
                episodes = arguments.planner_episodes if name == "planner" else arguments.episodes
                file = arguments.kept / f"{task}-{contact}-{name.replace(' ', '-')}-{episodes}.json"
                if not file.exists():
                    write_json(file, measured(task, contact, name, episodes))
                rows.append(json.loads(file.read_text()))
                print(f"{task}, {contact}, {name}: {rows[-1]['mean']:.1f}", flush=True)
    return rows


def trained() -> dict[str, Any]:
    """Settings and times of the networks that come with the repository."""
    from agents.policies.network import SHIPPED
    from agents.runs import SETTINGS, TIME

    files = {"settings": SETTINGS, "time": TIME}
    return {
        task: {key: json.loads((SHIPPED / f"{task}-ppo" / name).read_text()) for key, name in files.items()}
        for task in TASKS
    }


@command_line
def main() -> None:
    """Parse, evaluate what is missing, write the page."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from jackbox_env import _validation as check
    from jackbox_env.recording.files import check_writable, write_bytes
    from scripts.studies.results.across import across
    from scripts.studies.results.ahead import ahead, plan_alone
    from scripts.studies.results.attainable import spin_bound
    from scripts.studies.results.curves import draw
    from scripts.studies.results.page import page

    for name in ("episodes", "planner_episodes", "across_episodes"):
        check.whole(name, getattr(arguments, name), at_least=4)
    check_writable(arguments.out)
    arguments.kept.mkdir(parents=True, exist_ok=True)
    record: dict[str, Any] = {
        "seed": SEED,
        "resamples": RESAMPLES,
        "rows": rows_of(arguments),
        "across": across(arguments.kept, arguments.across_episodes, SEED),
        "ahead": ahead(arguments.kept, arguments.episodes, SEED),
        "plan_alone": plan_alone(arguments.kept, arguments.episodes, SEED),
        "spin_bound": spin_bound(arguments.episodes, SEED),
        "trained": trained(),
    }
    write_bytes(arguments.out / "results.md", page(record).encode())
    draw(record["rows"], arguments.out / "results.png")
    for row in [
        *record["rows"],
        *record["ahead"],
        *(earned for scene in record["across"] for earned in scene["earned"].values()),
    ]:
        del row["returns"]
    write_bytes(arguments.out / "results.json", (json.dumps(record, indent=1) + "\n").encode())
    print(f"Written: {arguments.out / 'results.md'}")


if __name__ == "__main__":
    main()
