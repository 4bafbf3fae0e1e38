"""What every policy earns on every task and both contact models: docs/results.md.

Each row is evaluated by itself and kept in a file, so an interrupted run goes on where it stopped.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
import tyro
from numpy.typing import NDArray

from agents.settings import EPISODE_STEPS, EnvSettings
from jackbox_env import Chirp, JackInBoxVectorEnv, Scene
from jackbox_env.commands.common import command_line
from jackbox_env.tasks import TASKS

POLICIES = ("zero", "level", "chirp", "best chirp", "ppo", "planner")
CONTACTS = ("exact", "pymunk")
SEED = 1
RESAMPLES = 2000
# The chirps that the best one of a task is chosen from: amplitudes over the torque's limit, Hz, Hz/s.
AMPLITUDES = tuple(sign * share for share in (0.1, 0.2, 0.4, 0.7, 1.0) for sign in (1.0, -1.0))
FREQUENCIES = (0.05, 0.1, 0.2, 0.3, 0.5, 0.8, 1.2, 2.0)
RATES = (0.0, 0.03, 0.1, 0.3, 0.9)
STARTS = 32  # of each chirp, the same for all, others than those of the evaluation
ATTAINABLE = {
    "juggle": "A jack that bounces upright without spin, its highest point h above the box's middle, earns "
    "500 (1 - (4 h / 3 sqrt(h / D) - h + D / 3) / 5) with D = h + 5: 333 at h = 0, 347 at best.",
    "spin": "The reward is at most 1 in each of the 500 steps, so 500 is a bound. It is not attainable: a jack that "
    "starts at rest has to be hit to turn, and the box has to turn to hit it.",
    "rattle": "The knock of a step is at most 1, so 500 is a bound. It is far off: a jack that flies at v0 crosses the "
    "box in about a second.",
}


BEST = "exact", "best chirp"
CHIRPS = (
    f"Amplitudes of {', '.join(f'{share:g}' for share in AMPLITUDES if share > 0)} of the torque's limit, of either "
    f"sign, first frequencies from {FREQUENCIES[0]:g} to {FREQUENCIES[-1]:g} Hz and rates from {RATES[0]:g} to "
    f"{RATES[-1]:g} Hz/s are tried on the exact model, from {STARTS} starts each. The best of them is then evaluated "
    "as all others are."
)


@dataclass(frozen=True)
class Arguments:
    """Evaluate all policies and write the page."""

    episodes: int = 256
    """Episodes of each policy."""
    planner_episodes: int = 32
    """Episodes of the planner, which takes some seconds for each."""
    kept: Path = Path("runs/results")
    """Folder of the rows that are evaluated already, which are not evaluated again; made if there is none."""
    out: Path = Path("docs")
    """Folder for results.md and results.json."""


def interquartile_mean(returns: NDArray[np.float64], axis: int = -1) -> Any:
    """Mean of the middle half."""
    from scipy.stats import trim_mean

    return trim_mean(returns, 0.25, axis=axis)


def chirps() -> list[dict[str, float]]:
    """The fields of all chirps that are tried."""
    limit = Scene().torque_limit
    return [
        {"amplitude": share * limit, "start_frequency": frequency, "rate": rate}
        for share, frequency, rate in product(AMPLITUDES, FREQUENCIES, RATES)
    ]


def returns_of(task: str, tried: list[dict[str, float]], starts: int, seed: int) -> NDArray[np.float64]:
    """What chirps earn on the exact model, shape (chirps, starts), all from the same starts."""
    scenes = [Scene(drive=Chirp(**fields)) for fields in tried for _ in range(starts)]
    env = JackInBoxVectorEnv(len(scenes), scene=scenes, contact="exact", task=task, torque="chirp")
    env.reset(seed=[seed + start for _ in tried for start in range(starts)])
    total = np.zeros(len(scenes))
    for _ in range(EPISODE_STEPS):
        total += env.step(None)[1]
    return total.reshape(len(tried), starts)


def best_chirp(task: str) -> dict[str, float]:
    """The chirp of the sweep that earns most on a task."""
    from agents.models import derived_seed

    tried = chirps()
    return tried[int(returns_of(task, tried, STARTS, derived_seed("chirps", SEED)).mean(axis=1).argmax())]


def measured(task: str, contact: str, name: str, episodes: int) -> dict[str, Any]:
    """One row: returns, the interquartile mean with its bootstrap interval, seconds for an episode."""
    from scipy.stats import bootstrap

    from agents.evaluation import evaluate, find_policy
    from agents.runs import machine, versions

    settings = EnvSettings(task=task, contact=contact)
    policy, more = find_policy("chirp" if name == "best chirp" else name, settings, SEED)
    drive = best_chirp(task) if name == "best chirp" else None
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


def page(record: dict[str, Any]) -> str:
    """The page, from what was measured."""
    rows = record["rows"]
    best = {row["policy"]: row for row in rows if row["task"] == "juggle" and row["contact"] == "exact"}
    lines = [
        "# What the policies earn",
        "",
        f"On juggle the planner earns {best['planner']['mean']:.0f} of at most 347, the trained network "
        f"{best['ppo']['mean']:.0f}, a law that holds the box level {best['level']['mean']:.0f}.",
        "",
        "`ppo` is the network in `agents/trained`, which needs no training first. `planner` plays many torques ahead "
        "by the exact model. `chirp` is the scene's own drive, `best chirp` the best of "
        f"{len(AMPLITUDES) * len(FREQUENCIES) * len(RATES)} others. `zero` is no torque.",
    ]
    for task in TASKS:
        lines += ["", f"## {task}", "", ATTAINABLE[task], ""]
        lines += [
            "| policy | contact | mean return | 95 % interval | interquartile mean | 95 % interval | episodes |",
            "|---|---|---:|:---:|---:|:---:|---:|",
        ]
        for row in (row for row in rows if row["task"] == task):
            (low, high), (iqm_low, iqm_high) = row["interval_95"], row["iqm_interval_95"]
            lines.append(
                f"| {row['policy']} | {row['contact']} | {row['mean']:.1f} | {low:.1f} to {high:.1f} "
                f"| {row['iqm']:.1f} | {iqm_low:.1f} to {iqm_high:.1f} | {row['episodes']} |"
            )
    lines += [
        "",
        "## The best chirps",
        "",
        CHIRPS,
        "",
        "| task | amplitude [N m] | first frequency [Hz] | rate [Hz/s] |",
    ]
    lines.append("|---|---:|---:|---:|")
    for task in TASKS:
        (drive,) = (row["drive"] for row in rows if (row["task"], row["contact"], row["policy"]) == (task, *BEST))
        lines.append(f"| {task} | {drive['amplitude']:,.0f} | {drive['start_frequency']:g} | {drive['rate']:g} |")
    lines += ["", "## How it was measured", ""]
    lines += [
        f"`make results` evaluates whole episodes of 10 s from starts that no training has seen (seed {SEED}). The "
        "first interval is that of the mean, 1.96 standard errors to each side. The interquartile mean leaves out the "
        f"best and the worst quarter; its interval is scipy's percentile bootstrap with {RESAMPLES} resamples. One row "
        "again:",
        "",
        "```sh",
        f"python scripts/evaluate.py --task juggle --contact exact --policy ppo --episodes 256 --seed {SEED}",
        "```",
        "",
        f"Measured at {', '.join(sorted({row['commit'] for row in rows}))} on "
        f"{'; '.join(sorted({row['machine'] for row in rows}))}.",
        "",
        "The networks are from these runs, one seed each:",
        "",
        "| task | steps | control steps of each | network |",
        "|---|---:|---:|---|",
    ]
    for task, settings in record["trained"].items():
        units = " x ".join(map(str, settings["hidden_units"]))
        lines.append(f"| {task} | {settings['total_steps']:,} | {settings['hold']} | {units} |")
    lines += ["", "`agents/trained/<task>-ppo/settings.json` holds all settings of a run, for `scripts/train.py`.", ""]
    return "\n".join(lines)


@command_line
def main() -> None:
    """Parse, evaluate what is missing, write the page."""
    arguments = tyro.cli(Arguments, description=__doc__)
    from agents.network import SHIPPED
    from jackbox_env import _validation as check
    from jackbox_env.storage import write_bytes, write_json

    for name in ("episodes", "planner_episodes"):
        check.whole(name, getattr(arguments, name), at_least=4)
    if not arguments.out.is_dir():
        raise FileNotFoundError(f"{arguments.out} is no folder to write results.md to")
    arguments.kept.mkdir(parents=True, exist_ok=True)
    rows = []
    for task in TASKS:
        for contact in CONTACTS:
            for name in POLICIES:
                episodes = arguments.planner_episodes if name == "planner" else arguments.episodes
                file = arguments.kept / f"{task}-{contact}-{name.replace(' ', '-')}-{episodes}.json"
                if not file.exists():
                    write_json(file, measured(task, contact, name, episodes))
                rows.append(json.loads(file.read_text()))
                print(f"{task}, {contact}, {name}: {rows[-1]['mean']:.1f}", flush=True)
    trained = {task: json.loads((SHIPPED / f"{task}-ppo" / "settings.json").read_text()) for task in TASKS}
    record = {"rows": rows, "trained": trained}
    write_bytes(arguments.out / "results.md", page(record).encode())
    for row in rows:
        del row["returns"]
    write_bytes(arguments.out / "results.json", (json.dumps(record, indent=1) + "\n").encode())
    print(f"Written: {arguments.out / 'results.md'}")


if __name__ == "__main__":
    main()
