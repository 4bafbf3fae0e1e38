"""docs/results.md, from what was measured."""

from __future__ import annotations

from typing import Any

import numpy as np

from jackbox_env.tasks import TASKS
from scripts.studies.results import across, ahead
from scripts.studies.results.attainable import texts
from scripts.studies.results.chirps import AMPLITUDES, FREQUENCIES, RATES, STARTS

BEST = "exact", "best chirp"
CHIRPS = (
    f"Amplitudes of {', '.join(f'{share:g}' for share in AMPLITUDES if share > 0)} of the torque's limit, of either "
    f"sign, first frequencies from {FREQUENCIES[0]:g} to {FREQUENCIES[-1]:g} Hz and rates from {RATES[0]:g} to "
    f"{RATES[-1]:g} Hz/s are tried on the exact model, from {STARTS} starts each. The best of them is then evaluated "
    "as all others are."
)


def page(record: dict[str, Any]) -> str:
    """The page."""
    best: dict[str, dict[str, float]] = {row["task"]: {} for row in record["rows"]}
    for row in record["rows"]:
        if row["contact"] == "exact":
            best[row["task"]][row["policy"]] = row["mean"]
    juggle = best["juggle"]
    count = len(AMPLITUDES) * len(FREQUENCIES) * len(RATES)
    lines = [
        "# What the policies earn",
        "",
        f"On juggle the planner earns {juggle['planner']:.0f}, the distilled policy {juggle['distilled']:.0f}, PPO "
        f"{juggle['ppo']:.0f}, a law that holds the box level {juggle['level']:.0f}. A jack that bounces upright earns "
        "up to 347 on average.",
        "",
        "![Learning curves of the shipped networks](results.png)",
        "",
        "`ppo` is the network in `agents/trained`, which needs no training first. `planner` plays many torques ahead "
        "by the exact model. `distilled`, on juggle, judges by a network what one bounce would lead to, for 155 ways "
        "to meet the jack. It tries no sequences of torques; `scripts/studies/distil.py` makes it. "
        f"`chirp` is the scene's own drive, `best chirp` the best of {count} others. `zero` is no torque.",
    ]
    attainable = texts(record["spin_bound"], {task: earned["planner"] for task, earned in best.items()})
    for task in TASKS:
        lines += ["", f"## {task}", "", attainable[task], "", *_table(record["rows"], task)]
    return "\n".join(
        [
            *lines,
            *_best_chirps(record),
            *ahead.text(record["ahead"], record["plan_alone"]),
            *_across(record["across"]),
            *_method(record),
            "",
        ]
    )


def _table(rows: list[dict[str, Any]], task: str) -> list[str]:
    lines = [
        "| policy | contact | mean return | 95 % interval | interquartile mean | 95 % interval | episodes |",
        "|---|---|---:|:---:|---:|:---:|---:|",
    ]
    for row in (row for row in rows if row["task"] == task):
        (low, high), (iqm_low, iqm_high) = row["interval_95"], row["iqm_interval_95"]
        lines.append(
            f"| {row['policy']} | {row['contact']} | {row['mean']:.1f} | {low:.1f} to {high:.1f} "
            f"| {row['iqm']:.1f} | {iqm_low:.1f} to {iqm_high:.1f} | {row['episodes']} |"
        )
    return lines


def _best_chirps(record: dict[str, Any]) -> list[str]:
    lines = ["", "## The best chirps", "", CHIRPS, ""]
    lines += ["| task | amplitude [N m] | first frequency [Hz] | rate [Hz/s] |", "|---|---:|---:|---:|"]
    for task in TASKS:
        rows = record["rows"]
        (drive,) = (row["drive"] for row in rows if (row["task"], row["contact"], row["policy"]) == (task, *BEST))
        lines.append(f"| {task} | {drive['amplitude']:,.0f} | {drive['start_frequency']:g} | {drive['rate']:g} |")
    return lines


def _across(rows: list[dict[str, Any]]) -> list[str]:
    names = list(rows[0]["earned"])
    means = {name: float(np.mean([row["earned"][name]["mean"] for row in rows])) for name in names}
    own = next(row["earned"] for row in rows if across.is_default(row["scene"]))
    masses, restitutions = across.RANGES["jack_mass"], across.RANGES["restitution"]
    lines = [
        "",
        "## Across scenes",
        "",
        f"Trained on varied scenes PPO earns {means['varied scenes']:.0f} on juggle in the mean over these "
        f"{len(rows)} scenes, trained on the default scene alone {means['one scene']:.0f}, and a level box "
        f"{means['level']:.0f}. On the default scene itself they earn {own['varied scenes']['mean']:.0f}, "
        f"{own['one scene']['mean']:.0f} and {own['level']['mean']:.0f}.",
        "",
        f"Both trainings are those of `make demo`. The varied one draws the jack's mass from {masses[0]:g} to "
        f"{masses[1]:g} kg and the restitution from {restitutions[0]:g} to {restitutions[1]:g} in each episode; its "
        "observation does not say which. One seed each.",
        "",
        f"| restitution | jack's mass [kg] | {' | '.join(names)} |",
        f"|---:|---:|{'---:|' * len(names)}",
    ]
    for row in rows:
        cells = [f"{row['earned'][name]['mean']:.1f} ± {_half_width(row['earned'][name]):.1f}" for name in names]
        scene = row["scene"]
        lines.append(f"| {scene['restitution']:g} | {scene['jack_mass']:g} | {' | '.join(cells)} |")
    return lines


def _half_width(earned: dict[str, Any]) -> float:
    low, high = earned["interval_95"]
    return float(0.5 * (high - low))


def _method(record: dict[str, Any]) -> list[str]:
    rows = record["rows"]
    lines = ["", "## How it was measured", ""]
    lines += [
        "`make results` evaluates whole episodes of 10 s from starts that no training has seen (seed "
        f"{record['seed']}). The first interval is Student's, of the mean. The "
        "interquartile mean leaves out the best and the worst quarter; its interval is scipy's percentile bootstrap "
        f"with {record['resamples']} resamples. One row again:",
        "",
        "```sh",
        f"python scripts/evaluate.py --task juggle --contact exact --policy ppo --episodes 256 --seed {record['seed']}",
        "```",
        "",
        f"Measured at {', '.join(sorted({row['commit'] for row in rows}))} on "
        f"{'; '.join(sorted({row['machine'] for row in rows}))}.",
        "",
        "The networks are from these runs, one seed each; `make networks` trains them again. A step is one action, "
        "held for some control steps:",
        "",
        "| task | steps | control steps of each | network | minutes | steps per second |",
        "|---|---:|---:|---|---:|---:|",
    ]
    for task, trained in record["trained"].items():
        settings, spent = trained["settings"], trained["time"]
        units = " x ".join(map(str, settings["hidden_units"]))
        lines.append(
            f"| {task} | {settings['total_steps']:,} | {settings['hold']} | {units} | {spent['seconds'] / 60.0:.1f} "
            f"| {spent['steps'] / spent['seconds']:,.0f} |"
        )
    lines += ["", "`agents/trained/<task>-ppo/settings.json` holds all settings of a run, for `scripts/train.py`."]
    return lines
