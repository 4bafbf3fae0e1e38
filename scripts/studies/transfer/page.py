"""The page on what a fidelity does to a learner: verdict first, then the numbers, then how they were found."""

from __future__ import annotations

import math
import shlex
from collections.abc import Mapping, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np

from agents.runs import machine, read_settings, versions
from agents.storage import read_json
from scripts.studies.transfer.inference import POWER, Estimate, crossed_estimate, t_estimate
from scripts.studies.transfer.longrun import DT, SETTINGS, STATISTICS, STEPS, Episodes
from scripts.studies.transfer.study import Cells, StudySettings, resolved_fidelities, run_folder
from scripts.studies.transfer.verdict import (
    EXACT,
    MARGIN,
    Comparison,
    Finding,
    baseline_shift,
    failures_sentence,
    finding,
    headline,
    percent,
    sentence,
    statistics_sentence,
)


def shown(estimate: Estimate) -> str:
    """``251.3 ± 4.2``."""
    return f"{estimate.mean:.1f} ± {estimate.half_width:.1f}"


def findings_of(cells: Cells) -> list[Finding]:
    """One for each fidelity but exact."""
    return [finding(cells.task, cells.trained, name) for name in cells.trained if name != EXACT]


def matrix_table(cells: Cells) -> list[str]:
    """Mean returns with intervals: rows trained on, columns run on, scripted policies below."""
    columns = list(cells.trained)
    lines = [f"| trained on \\ run on | {' | '.join(columns)} |", f"|---|{'---:|' * len(columns)}"]
    for row, returns in cells.trained.items():
        lines.append(f"| PPO, {row} | {' | '.join(shown(crossed_estimate(returns[name])) for name in columns)} |")
    for row, scripted in cells.baselines.items():
        lines.append(f"| {row} (scripted) | {' | '.join(shown(t_estimate(scripted[name])) for name in columns)} |")
    return lines


def seeds_table(cells: Cells) -> list[str]:
    """Mean returns on exact, training by training: one that learnt little stands out."""
    count = len(next(iter(cells.trained.values()))[EXACT])
    lines = [f"| trained on | {' | '.join(f'seed {seed}' for seed in range(count))} |", f"|---|{'---:|' * count}"]
    for row, returns in cells.trained.items():
        lines.append(f"| {row} | {' | '.join(f'{mean:.1f}' for mean in returns[EXACT].mean(axis=1))} |")
    return lines


def difference_table(cells: Cells, findings: Sequence[Finding]) -> list[str]:
    """The two differences the verdict stands on, for trained and for scripted policies."""
    lines = [
        "| fidelity | run on exact: trained on it less trained on exact | verdict | "
        "trained on it: run on it less run on exact | verdict |",
        "|---|---|---|---|---|",
    ]
    for found in findings:
        lines.append(
            f"| {found.fidelity} | {percent(found.loss, found.exact)} | {found.learning} | "
            f"{percent(found.shift, found.exact)} | {found.promise} |"
        )
    lines += ["", "| scripted policy | " + " | ".join(f"{found.fidelity} less exact" for found in findings) + " |"]
    lines.append(f"|---|{'---|' * len(findings)}")
    for policy, returns in cells.baselines.items():
        shifts = [baseline_shift(returns, found.fidelity) for found in findings]
        of = float(returns[EXACT].mean())
        lines.append(f"| {policy} | {' | '.join(percent(shift, of) for shift in shifts)} |")
    return lines


def statistics_table(condition: str, comparisons: Sequence[Comparison]) -> list[str]:
    """Differences from exact under one kind of torque; bold where shown to differ."""
    rows = [row for row in comparisons if row.condition == condition]
    settings = list(dict.fromkeys(row.setting for row in rows))
    lines = [f"| statistic | exact | {' | '.join(settings)} | would have been seen |"]
    lines.append(f"|---|---:|{'---:|' * len(settings)}---:|")
    for statistic in STATISTICS:
        of = {row.setting: row for row in rows if row.statistic == statistic}
        exact = next(iter(of.values())).exact
        # a single survivor would have shown nothing; its own cell says so
        largest = max((row.seen for row in of.values() if math.isfinite(row.seen)), default=math.inf)
        texts = [_difference(of[setting]) for setting in settings]
        lines.append(f"| {statistic} | {exact:.3g} | {' | '.join(texts)} | {_share(largest, exact)} |")
    return lines


def _difference(row: Comparison) -> str:
    if row.absent:
        return row.absent
    if not row.exact:
        return f"{row.difference.mean:+.3g}"
    mean, half = (100.0 * value / abs(row.exact) for value in row.difference)
    text = f"{mean:+.1f} ± {half:.1f} %"
    return f"**{text}**" if row.differs else text


def _share(value: float, of: float) -> str:
    return f"{100.0 * value / abs(of):.1f} %" if of else f"{value:.3g}"


def depth_table(runs: Mapping[str, Mapping[str, Episodes]]) -> list[str]:
    """Deepest penetration and lost jacks: what the equality of statistics does not show."""
    settings = list(next(iter(runs.values())))
    lines = [f"| torque | {' | '.join(settings)} |", f"|---|{'---:|' * len(settings)}"]
    for condition, measured in runs.items():
        texts = [
            f"{1000.0 * max(0.0, one.depth):.3g} mm" + (f", {one.lost} lost" if one.lost else "")
            for one in measured.values()
        ]
        lines.append(f"| {condition} | {' | '.join(texts)} |")
    return lines


METHOD = """\
- Intervals are 95 % ones. Of trained policies they hold for another training and for other starts: the t-interval over
  the seeds' means and the one over the starts' means, added by their squares. Trainings on different fidelities are
  compared as independent samples (Welch), the runs of one policy as pairs. They are for one comparison each, not for
  all together.
- Safe: the interval of what is lost on average, run on exact, stays above -{margin:.0%} of the return of training on
  exact. Harmful: it lies below that; worse: it lies below 0; undecided: else. The margin was chosen beforehand. Honest:
  a fidelity's own return is within {margin:.0%} of what the same policies earn on exact. The intervals take trainings
  as normally distributed; so few cannot show that none fails. Trainings that would tell: so many of each that, if
  nothing is lost, safe comes out with probability {power:g}, by the spread of those there are.
- Statistics: {long:,} episodes of {steps} steps of {dt:g} s for each torque and setting, each with its own starts and
  torques, so that the samples are independent. Every statistic is one number per episode, because what follows within
  an episode is correlated. Two tests each: of the means (Welch) and of the distributions (Kolmogorov and Smirnov's
  distance, by permutation); Holm's correction over all of them together. Bold: equality refused at 5 %. The last column
  is the difference of means that would have been seen with probability {power:g}.
- `one iteration` is {one_iteration}; no policy was trained on it. `exact again` is
  exact with other seeds: the negative control.
- Again: `{command}` trains, runs and writes this page;
  `{resume}` goes on with an interrupted study, or makes this page from a finished one."""


def counted(number: int | None, what: str) -> str:
    """``2 substeps``, ``1 substep``, ``no substeps``."""
    return f"{'no' if number is None else number} {what}{'' if number == 1 else 's'}"


def fidelities_line() -> str:
    """What the names stand for, at their first mention."""
    named = resolved_fidelities().items()
    texts = [f"`{name}` ({contact}, {counted(steps, 'substep')})" for name, (contact, steps) in named]
    return (
        f"Fidelities: {', '.join(texts)}. Train elastic scenes on `{EXACT}`: it is the reference, and the fastest. "
        "A shortcut is any of the others. *Safe*: what is learnt on it earns as much on exact. *Honest*: what a policy "
        "earns on it is what it earns on exact. *Undecided*: the interval is wider than the margin, often by one "
        "failed training, which is no evidence against the fidelity."
    )


def one_iteration() -> str:
    """The deliberately coarse setting in words."""
    setting = SETTINGS["one iteration"]
    substeps, iterations = counted(setting["substeps"], "substep"), counted(setting["iterations"], "solver iteration")
    return f"{setting['contact']} with {substeps} and {iterations}"


def commands(settings: StudySettings, out: Path | None) -> tuple[str, str]:
    """Command lines that make such a study, and that go on with one; ``out`` as it was given."""
    chosen: list[str] = []
    for field in fields(settings):
        value = getattr(settings, field.name)
        if value != field.default:
            values = value if isinstance(value, tuple) else (value,)
            chosen += [f"--{field.name.replace('_', '-')}", *map(str, values)]
    where = [] if out is None else ["--out", str(out)]
    script = "python scripts/studies/transfer/transfer.py"
    again, resume = f"{script} {shlex.join([*chosen, *where])}", f"{script} --resume <its folder> {shlex.join(where)}"
    return again.strip(), resume.strip()


def how(folder: Path, settings: StudySettings, out: Path | None) -> list[str]:
    """Settings, numbers, versions, machine, command."""
    run = read_settings(run_folder(folder, settings.tasks[0], settings.fidelities[0], 0))
    trained_with = read_json(folder / "study_run.json")["versions"]
    steps = ", ".join(f"{settings.steps_of(task):,} steps on {task}" for task in settings.tasks)
    now = versions()
    same = {name: version for name, version in now.items() if trained_with.get(name) == version}
    changed = [f"{name} {trained_with[name]} at the training, {now[name]} now" for name in now if name not in same]
    again, resume = commands(settings, out)
    text = METHOD.format(
        margin=MARGIN, long=settings.long_episodes, steps=STEPS, dt=DT, power=POWER, one_iteration=one_iteration(),
        command=again, resume=resume,
    )  # fmt: skip
    return [
        f"- Trainings: {steps}; {settings.seeds} for each task and fidelity, by the same settings: {run.num_envs} "
        f"environments, {run.rollout_steps} steps of each between updates, batches of {run.batch_size}, {run.epochs} "
        f"epochs, learning rate {run.learning_rate:g} falling to 0, gamma {run.gamma:g}, networks {run.hidden_units}.",
        f"- What is run is the best model by the evaluations that a training makes every {run.eval_steps:,} steps, "
        f"{run.eval_episodes} episodes on its own fidelity.",
        f"- Runs: {settings.episodes} episodes of {STEPS} steps in each cell for each seed, deterministic actions, "
        "from the same starts in every cell.",
        text,
        f"- {', '.join(f'{name} {version}' for name, version in same.items())}"
        + "".join(f"; {one}" for one in changed)
        + f"; {machine()}.",
    ]


def page(
    folder: Path,
    settings: StudySettings,
    results: Sequence[Cells],
    runs: Mapping[str, Mapping[str, Episodes]],
    comparisons: Sequence[Comparison],
    out: Path | None,
) -> str:
    """The page in Markdown; ``out``: the folder that was asked for, None for the study's own."""
    found = {cells.task: findings_of(cells) for cells in results}
    shortcuts = list(dict.fromkeys(row.setting for row in comparisons))
    lines = ["# What a fidelity does to a learner", "", fidelities_line(), ""]
    for task, findings in found.items():
        lines += [headline(task, findings), ""] if findings else []
    for cells in results:
        lines += [f"On `{cells.task}`:", "", *(f"- {sentence(one)}" for one in found[cells.task])]
        lines += [f"- {failures_sentence(cells.trained)}", ""]
    lines += ["Long-run statistics:", ""]
    lines += [*(f"- {statistics_sentence(name, comparisons)}" for name in shortcuts), ""]
    for cells in results:
        lines += [f"## {cells.task}", "", f"![Returns of policies on each fidelity](learning_{cells.task}.png)", ""]
        lines += ["Mean return of an episode ± half its 95 % interval.", "", *matrix_table(cells), ""]
        lines += ["Run on exact, training by training:", "", *seeds_table(cells), ""]
        lines += ["In percent of the return on exact, with 95 % intervals:", ""]
        lines += [*difference_table(cells, found[cells.task]), ""]
    lines += ["## Long-run statistics", ""]
    for condition in runs:
        lines += [f"Under {condition}, differences of means from exact:", ""]
        lines += [*statistics_table(condition, comparisons), ""]
    lines += ["Deepest that a foot was in a wall at the end of a step:", "", *depth_table(runs), ""]
    lines += ["## How it was measured", "", *how(folder, settings, out), ""]
    return "\n".join(lines)


def as_json(
    folder: Path,
    settings: StudySettings,
    results: Sequence[Cells],
    runs: Mapping[str, Mapping[str, Episodes]],
    comparisons: Sequence[Comparison],
) -> dict[str, Any]:
    """Everything on the page and each return."""

    begun = read_json(folder / "study_run.json")

    def plain(returns: Mapping[str, Any]) -> dict[str, Any]:
        return {name: np.round(values, 2).tolist() for name, values in returns.items()}

    return {
        "settings": asdict(settings),
        "fidelities": resolved_fidelities(),
        "trained": {"started": begun["started"], "versions": begun["versions"]},
        "run": {"versions": versions(), "machine": machine()},
        "margin": MARGIN,
        "findings": [
            {**asdict(found), "learning": found.learning, "promise": found.promise}
            for cells in results
            for found in findings_of(cells)
        ],
        "returns": {
            cells.task: {
                "trained": {name: plain(row) for name, row in cells.trained.items()},
                "baselines": {name: plain(row) for name, row in cells.baselines.items()},
            }
            for cells in results
        },
        "comparisons": [{**row._asdict(), "differs": row.differs} for row in comparisons],
        "depth": {condition: {name: one.depth for name, one in each.items()} for condition, each in runs.items()},
        "lost": {condition: {name: one.lost for name, one in each.items()} for condition, each in runs.items()},
    }
