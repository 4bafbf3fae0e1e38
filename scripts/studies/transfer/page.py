"""The numbers and the picture of docs/learning.md, from learning.json. The prose is written there, by hand."""

from __future__ import annotations

import json
import math
import shlex
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

import matplotlib
import numpy as np

matplotlib.use("Agg")

from matplotlib import pyplot as plt
from scipy import stats

from agents.evaluation.figures import ACCENT
from agents.files import read_json
from agents.runs import machine, read_settings, versions
from jackbox_env.recording.files import replacing, write_text
from scripts.studies.readme import fill
from scripts.studies.transfer.inference import MOST_TRAININGS, Estimate, crossed_estimate, t_estimate
from scripts.studies.transfer.longrun import Episodes
from scripts.studies.transfer.study import Returns, StudySettings, resolved_fidelities, run_folder, settings_from
from scripts.studies.transfer.verdict import EXACT, MARGIN, Comparison, Finding, compare, finding

PROSE = Path(__file__).parents[3] / "docs" / "learning.md"
SCRIPT = "python scripts/studies/transfer/transfer.py"
COLORS = {"safe": "#1b9e77", "undecided": ACCENT, "worse": "#d95f02", "harmful": "#d95f02", "reference": "#2f5fb3"}
KEYS = ("settings", "fidelities", "training", "trained", "run", "returns", "comparisons", "depth", "lost")


def gather(
    folder: Path, settings: StudySettings, returns: Mapping[Any, Returns], runs: Mapping[str, Mapping[str, Episodes]]
) -> dict[str, Any]:
    """All data that the page is written from, every return included, in the form of learning.json."""
    samples = {condition: {name: one.values for name, one in each.items()} for condition, each in runs.items()}
    return {
        "settings": asdict(settings),
        "fidelities": resolved_fidelities(),
        "training": asdict(read_settings(run_folder(folder, settings.tasks[0], settings.fidelities[0], 0))),
        "trained": _anywhere(read_json(folder / "study_run.json")),
        "run": {"versions": versions(), "machine": machine()},
        "returns": returns,
        "comparisons": [row._asdict() for row in compare(samples)],
        "depth": {condition: {name: one.depth for name, one in each.items()} for condition, each in runs.items()},
        "lost": {condition: {name: one.lost for name, one in each.items()} for condition, each in runs.items()},
    }


def too_short(task: str, returns: Returns) -> str:
    """A warning where a scripted policy earns more on exact than the trained ones do; else nothing."""
    trained = np.mean(returns["trained"][EXACT][EXACT])
    earned = {name: float(np.mean(of[EXACT])) for name, of in returns["baselines"].items()}
    best = max(earned, key=lambda name: earned[name])
    if trained >= earned[best]:
        return ""
    return (
        f"The trainings were short. On `{task}` they earn {trained:.1f} on `{EXACT}`, and the scripted `{best}` earns "
        f"{earned[best]:.1f}: this says little about learning."
    )


def _anywhere(run: dict[str, Any]) -> dict[str, Any]:
    """What a study was made by, without the folder that it was made in."""
    command = list(run["command"])
    if "--folder" in command:
        place = command.index("--folder")
        del command[place : place + 2]
    return {**run, "command": command}


def read_data(path: Path) -> dict[str, Any]:
    """Read what :func:`gather` wrote; ValueError if the file holds something else."""
    data: dict[str, Any] = read_json(path)
    if missing := [key for key in KEYS if key not in data]:
        raise ValueError(f"{path} holds no data of a study: {missing[0]!r} is missing")
    settings_from(data["settings"])  # refuses names of fidelities that are no more
    return data


def write(data: Mapping[str, Any], place: Path) -> str:
    """Write page, data and picture into a folder; return the page. A study with loss has files of its own."""
    lossy = data["settings"].get("restitution", 1.0) < 1.0
    name = "learning_loss" if lossy else "learning"
    text = page_with_loss(data, f"{name}.png") if lossy else page(data)
    picture(findings_of(data), place / f"{name}.png")
    write_text(place / f"{name}.json", json.dumps(data) + "\n")
    write_text(place / f"{name}.md", text)
    return text


def findings_of(data: Mapping[str, Any]) -> dict[str, list[Finding]]:
    """One for each fidelity, exact included, by task."""
    return {task: [finding(of["trained"], on) for on in of["trained"]] for task, of in data["returns"].items()}


def page(data: Mapping[str, Any]) -> str:
    """The prose of docs/learning.md with the numbers of a study in their places."""
    text, findings, trainings = PROSE.read_text(), findings_of(data), settings_from(data["settings"]).seeds
    names = ", ".join(f"`{name}` is {of[0]} with {of[1] or 'no'} substeps" for name, of in data["fidelities"].items())
    failing = 100.0 * stats.binomtest(0, trainings, alternative="less").proportion_ci().high  # Clopper and Pearson's
    average = (
        f"After {trainings} trainings without a failure, up to {failing:.0f} % of all trainings may still fail (95 % "
        "bound)."
    )
    blocks = {
        "answer": [decision(task, found) for task, found in findings.items()],
        "verdict": [f"{names}.", "", *verdict_table(findings), "", average],
        "undecided": [line for task, found in findings.items() for line in footnote(task, found)],
        "returns": [line for task, of in data["returns"].items() for line in [*returns_table(task, of), ""]],
        "long": long_table(data),
        "measured": measured(data),
    }
    for mark, lines in blocks.items():
        text = fill(text, mark, "\n".join(lines).strip())
    return text


def page_with_loss(data: Mapping[str, Any], name: str) -> str:
    """A short page on a scene with loss; docs/learning.md says what its words mean."""
    findings, restitution = findings_of(data), data["settings"]["restitution"]
    lines = [f"# What a fidelity does to a learner, at restitution {restitution:g}", ""]
    short = {task: too_short(task, of) for task, of in data["returns"].items()}
    lines += [short[task] or decision(task, found) for task, found in findings.items()]
    lines += ["", f"![What training on each fidelity earns on exact]({name})", ""]
    lines += ["[The elastic study](learning.md) says what the words mean.", "", *verdict_table(findings), ""]
    for task, of in data["returns"].items():
        lines += [*returns_table(task, of), ""]
    lines += [line for line in measured(data) if not line.startswith("- Long run")] + [""]
    lines += [line for task, found in findings.items() if not short[task] for line in footnote(task, found)]
    return "\n".join(lines).rstrip() + "\n"


def percent(estimate: Estimate, of: float) -> str:
    """A difference in percent of something, with its interval: ``+1.2 % (-0.3 to +2.7)``; plain where that is 0."""
    scale, unit, form = (100.0 / abs(of), " %", "+.1f") if of else (1.0, "", "+.3g")
    mean, low, high = (format(scale * value, form) for value in (estimate.mean, estimate.low, estimate.high))
    return f"{mean}{unit} ({low} to {high})"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a table."""
    return [f"| {' | '.join(cells)} |" for cells in (header, ["---"] * len(header), *rows)]


def decision(task: str, findings: Sequence[Finding]) -> str:
    """What to train on for a task, in one sentence; a footnote says what is undecided."""
    safe = ", ".join(f"`{found.fidelity}`" for found in findings if found.learning == "safe")
    costly = ", ".join(f"`{found.fidelity}`" for found in findings if found.learning in ("harmful", "worse"))
    what = f"learning on {safe} is safe too" if safe else f"stay with `{EXACT}`: no other fidelity is shown to be safe"
    note = f"[^{task}]" if footnote(task, findings) else ""
    return f"On `{task}`, {what}{f'; training on {costly} costs return' if costly else ''}.{note}"


def footnote(task: str, findings: Sequence[Finding]) -> list[str]:
    """What is undecided about a task and what would settle it; no line if nothing is."""
    reasons: dict[str, list[str]] = {}
    for found in findings:
        if found.learning == "undecided":
            reasons.setdefault(_missing(found), []).append(f"`{found.fidelity}`")
    texts = [f"{', '.join(names)}: {reason}." for reason, names in reasons.items()]
    return [f"[^{task}]: Undecided. {' '.join(texts)}", ""] if texts else []


def _missing(found: Finding) -> str:
    trainings = len(found.trainings)
    if trainings < 2:
        return "one training shows no spread"
    if found.starts >= found.margin:
        return "more episodes are needed first: the starts alone make the interval wider than the margin"
    needed = f"more than {MOST_TRAININGS:,}" if found.needed is None else f"about {max(found.needed, trainings + 1)}"
    return f"{trainings} trainings are too few to tell; {needed} would be needed"


def verdict_table(findings: Mapping[str, Sequence[Finding]]) -> list[str]:
    """What each fidelity's policies earn on exact, and whether its own returns are honest."""
    rows = []
    for task, found in ((task, found) for task, each in findings.items() for found in each):
        worst = f"{min(found.trainings):.1f}"
        if found.fidelity == EXACT:
            rows.append([task, EXACT, found.learning, f"{found.exact:.1f}", worst, "", ""])
            continue
        loss, shift = percent(found.loss, found.exact), percent(found.shift, found.exact)
        rows.append([task, found.fidelity, found.learning, loss, worst, found.promise, shift])
    header = ["task", "trained on", "to learn on", "earns on exact", "worst training", "own returns", "earns on itself"]
    return table(header, rows)


def returns_table(task: str, returns: Returns) -> list[str]:
    """Mean returns with intervals: rows trained on, columns run on, scripted policies below."""
    rows = {f"PPO, {name}": map(crossed_estimate, of.values()) for name, of in returns["trained"].items()}
    rows |= {f"{name} (scripted)": map(t_estimate, of.values()) for name, of in returns["baselines"].items()}
    shown = [
        [name, *(f"{one.mean:.1f} ± {one.half_width:.1f}" for one in estimates)] for name, estimates in rows.items()
    ]
    return table([f"{task}, trained on \\ run on", *returns["trained"]], shown)


def long_table(data: Mapping[str, Any]) -> list[str]:
    """A row a setting: where it differs from exact, how deep a foot was in a wall, how many jacks were lost."""
    comparisons = [Comparison(**{**row, "difference": Estimate(*row["difference"])}) for row in data["comparisons"]]
    rows = []
    for setting in next(iter(data["depth"].values())):
        found = [row for row in comparisons if row.setting == setting]
        depths = [f"{1000.0 * max(0.0, of[setting]):.3g}" for of in data["depth"].values()]
        lost = sum(of[setting] for of in data["lost"].values())
        rows.append([setting, *(_differences(found) if found else ("reference", "", "")), *depths, str(lost)])
    depths = [f"mm deep, {condition}" for condition in data["depth"]]
    return table(["setting", "differs", "in", "most", *depths, "lost"], rows)


def _differences(comparisons: Sequence[Comparison]) -> tuple[str, str, str]:
    """How often a setting differs, in which statistics and by how much, or the smallest difference detectable."""
    present = [row for row in comparisons if not math.isnan(row.difference.mean)]
    differing = [row for row in present if row.differs]
    count, statistics = f"{len(differing)} of {len(present)}", dict.fromkeys(row.statistic for row in differing)
    if differing:
        most = max(differing, key=lambda row: abs(row.difference.mean / row.exact) if row.exact else 0.0)
        return count, ", ".join(statistics), percent(most.difference, most.exact)
    seen = [100.0 * row.seen / abs(row.exact) for row in present if row.exact]
    return count, "", f"{min(seen):.1f} to {max(seen):.1f} % would have been seen" if seen else ""


def measured(data: Mapping[str, Any]) -> list[str]:
    """Numbers, command and versions of the study."""
    settings, run = settings_from(data["settings"]), data["training"]
    steps = ", ".join(f"{settings.steps_of(task):,} steps on {task}" for task in settings.tasks)
    return [
        f"- Trainings: {settings.seeds} of each task and fidelity, {steps}, all by the same settings.",
        f"- Policies: of each training the best by evaluations of {run['eval_episodes']} episodes on its own fidelity, "
        f"every {run['eval_steps']:,} steps. Each is run for {settings.episodes} episodes on each fidelity.",
        f"- Long run: {settings.long_episodes:,} episodes for each torque and setting.",
        f"- Made by `{SCRIPT} {shlex.join(data['trained']['command'][1:])}`.",
        f"- {', '.join(f'{name} {version}' for name, version in data['run']['versions'].items())}, trained at commit "
        f"{data['trained']['versions']['commit']}; {data['run']['machine']}.",
    ]


def picture(findings: Mapping[str, Sequence[Finding]], path: Path) -> None:
    """Write (again) a panel a task: a row a fidelity, a dot a training, a bar for the mean and its interval."""
    height = 0.7 + sum(0.6 + 0.4 * len(found) for found in findings.values())
    figure, panels = plt.subplots(len(findings), 1, figsize=(7.0, height), layout="constrained", squeeze=False)
    for axes, (task, found) in zip(panels[:, 0], findings.items(), strict=True):
        _draw(axes, task, found)
    panels[-1, 0].set_xlabel("return on exact, against training on exact [%]; dashed: the margin")
    with replacing(path) as partial:
        figure.savefig(partial, dpi=150)
    plt.close(figure)


def _draw(axes: Any, task: str, findings: Sequence[Finding]) -> None:
    """A panel; a bar that lies wholly right of the dashed line is safe."""
    for place, found in enumerate(findings):
        scale, color = 100.0 / abs(found.exact) if found.exact else 1.0, COLORS[found.learning]
        half = scale * found.loss.half_width if found.fidelity != EXACT and np.isfinite(found.loss.half_width) else 0.0
        dots = [scale * (mean - found.exact) for mean in found.trainings]
        axes.plot(dots, [place - 0.25] * len(dots), ".", color=color)
        axes.errorbar(scale * found.loss.mean, place, xerr=half, fmt="o", color=color, capsize=3)
        axes.annotate(found.learning, (1.02, place), xycoords=("axes fraction", "data"), va="center", color=color)
    for margin, style in ((0.0, "-"), (-100.0 * MARGIN, "--")):
        axes.axvline(margin, color=ACCENT, linewidth=0.8, linestyle=style, zorder=0)
    axes.set_yticks(range(len(findings)), [f"trained on {found.fidelity}" for found in findings])
    axes.set_title(task, loc="left")
    axes.set_ylim(len(findings) - 0.5, -0.5)
    axes.spines[["top", "right"]].set_visible(False)
