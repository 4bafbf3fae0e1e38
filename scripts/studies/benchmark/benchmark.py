"""Write docs/benchmark.md: what policies earn, what algorithms learn, and what the fidelity of training does to it."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import trim_mean

from agents.policies.network import TRAINED
from agents.policies.planner import FAST_SEARCHES, SEARCHES
from jackbox_env import Scene
from jackbox_env.model.states import Array
from jackbox_env.tools import checks as check
from jackbox_env.tools.files import replacing
from scripts.studies import study
from scripts.studies.benchmark import policies, trainings
from scripts.studies.benchmark.trainings import ALGORITHMS, DECISIONS, SETTINGS, SHIPPED_PPO
from scripts.studies.pages import cell, label_ends, table

DOCS = Path(__file__).parents[3] / "docs"
FIDELITIES = ("exact", "coarse", "balanced", "fine")
MARGIN = 0.05  # of the return above zero torque: what is called equal, chosen before the first training
RESAMPLES = 20_000
FEWEST, PLANNED = 4, 32  # trainings that are compared; episodes of the planner, a second or two each
SEEDS = {SHIPPED_PPO: 10, "PPO": 10, "TQC": 5, "SAC": 5, "DQN": 5}
HIDDEN, TRAININGS = "hidden scene", ("trainings", "fidelities")  # a setting; parts whose rows are trainings
HARDER = ("PPO", "TQC")  # that are also trained in the other settings
LINES = {"planner": (0, (9, 3)), "distilled": "--", "zero": ":"}  # in the picture
Interval = tuple[float, float, float]  # interquartile mean, and its 95 % interval
Rows = list[dict[str, Any]]


@dataclass(frozen=True)
class Arguments(study.Arguments):
    """Train what is not stored yet, evaluate, and write the page."""

    algorithms: tuple[str, ...] = ALGORITHMS
    """Algorithms to train."""
    tasks: tuple[str, ...] = TRAINED
    """Tasks to train on."""
    seeds: int | None = None
    """Trainings of each; None: ten of PPO, five of the others. Stored ones stay and are not repeated."""
    settings: tuple[str, ...] = tuple(SETTINGS)
    """Settings to train in."""
    episodes: int = trainings.EPISODES
    """Episodes of each policy and of each trained model."""

    def __post_init__(self) -> None:
        """Raise TypeError or ValueError for what cannot be measured."""
        for name, known in (("algorithms", ALGORITHMS), ("tasks", TRAINED), ("settings", SETTINGS)):
            check.known_keys(name, getattr(self, name), known)
        check.whole("episodes", self.episodes, at_least=4)
        check.whole("seeds", 1 if self.seeds is None else self.seeds, at_least=1)


def trials(arguments: Arguments) -> study.Trials:
    """All trials of the page but for the trainings that are stored."""
    runs, episodes = str(arguments.runs), arguments.episodes
    counts = {**dict.fromkeys(policies.POLICIES, episodes), "planner": PLANNED}
    every: study.Trials = [
        {"part": "policies", "task": task, "contact": contact, "policy": policy, "episodes": count}
        for task, contact, (policy, count) in product(TRAINED, policies.CONTACTS, counts.items())
    ]
    every += [
        {
            "part": "policies",
            "contact": "exact",
            "setting": HIDDEN,
            "task": task,
            "policy": policy,
            "episodes": counts[policy],
        }
        for task, policy in product(TRAINED, ("zero", "planner"))
    ]
    trained: study.Trials = [
        {"part": "trainings", "algorithm": algorithm, "setting": setting, "task": task, "seed": seed}
        for algorithm, setting, task in product(arguments.algorithms, arguments.settings, arguments.tasks)
        if setting == "default" or algorithm in HARDER
        for seed in range(arguments.seeds or SEEDS[algorithm])
    ]
    trained += [
        {"part": "fidelities", "task": task, "fidelity": fidelity, "seed": seed}
        for task, fidelity in [*product(DECISIONS, FIDELITIES[:-1]), ("juggle", "fine")]
        for seed in range(3 if fidelity == "fine" else 8)  # on fine each takes half an hour
    ]
    record = STUDY.read(DOCS)
    stored = {_of(row) for part in TRAININGS for row in record.get(part, [])}
    every += [{**one, "runs": runs, "episodes": episodes} for one in trained if _of(one) not in stored]
    return [*every, {"part": "spin_bound", "episodes": episodes}]


def _of(row: dict[str, Any]) -> tuple[str, ...]:
    """The key of a training in the record."""
    return tuple(str(row.get(name, "")) for name in ("algorithm", "setting", "task", "fidelity", "seed"))


def with_stored(new: study.Record, stored: study.Record) -> study.Record:
    """New results, with the stored trainings."""
    for part in TRAININGS:
        if part in new:
            new[part] = sorted([*stored.get(part, []), *new[part]], key=_of)
    return new


# -- statistics --------------------------------------------------------------------------------------------------------


def _middle(*strata: Array) -> Any:
    """The mean of the middle half of several samples together, along the last axis."""
    return trim_mean(np.concatenate(strata, axis=-1), 0.25, axis=-1)


def interval(statistic: Callable[..., Any], *samples: Array) -> Interval:
    """A statistic of samples of trainings, with its 95 % interval by a stratified bootstrap.

    It draws trainings anew, of each sample as many as it has. A single training has no finite interval.
    """
    if min(map(len, samples)) < 2:
        return float(statistic(*samples)), -math.inf, math.inf
    rng = np.random.default_rng(0)
    drawn = statistic(*(rng.choice(sample, (RESAMPLES, len(sample))) for sample in samples))
    low, high = np.percentile(drawn, [2.5, 97.5])
    return float(statistic(*samples)), float(low), float(high)


def verdict(difference: tuple[float, float, float], margin: float, count: int) -> str:
    """Equal, better or worse, if the interval decides it; else how many trainings would, with a probability of 80 %."""
    middle, low, high = difference
    if -margin <= low and high <= margin:
        return "equal"
    if high < -margin:
        return "worse"
    if low > margin:
        return "better"
    arm, left = max(high - middle, middle - low), max(abs(margin - abs(middle)), 1e-9)
    needed = max(count + 1, math.ceil(2.0 * count * (arm / left) ** 2))  # the 2: (1.96 + 0.84)^2 / 1.96^2
    return f"undecided ({f'{needed:,}' if needed < 1000 else 'more than 1,000'})"


def compared(record: study.Record) -> dict[tuple[str, str], dict[str, Any]]:
    """The returns of the trainings for each task and fidelity, and the verdict against exact."""
    means: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in record["fidelities"]:
        means.setdefault((row["task"], row["fidelity"]), []).append(row)
    rows = {}
    for task, fidelity in product(DECISIONS, FIDELITIES):
        if not (some := means.get((task, fidelity))):
            continue
        on_exact = np.array([row["earned"]["exact"] for row in some])
        best = np.array([row["earned"]["exact"] for row in means[task, "exact"]])
        above = float(_middle(best)) - earned(record, task, "zero")
        difference = interval(lambda one, other: _middle(one) - _middle(other), on_exact, best)
        rows[task, fidelity] = {
            "share": ""
            if fidelity == "exact"
            else "{:+.1f} % ({:+.1f} to {:+.1f})".format(*(100.0 * part / above for part in difference)),
            "verdict": "",
            "seconds": float(np.mean([row["processor_seconds"] for row in some])),
        }
        if fidelity != "exact" and len(some) >= FEWEST:
            rows[task, fidelity]["verdict"] = verdict(difference, MARGIN * above, len(some))
    return rows


# -- the page ----------------------------------------------------------------------------------------------------------


def earned(record: study.Record, task: str, policy: str, contact: str = "exact", setting: str = "default") -> float:
    """The mean return of a policy."""
    wanted = {"task": task, "policy": policy, "contact": contact, "setting": setting}
    return float(next(row["mean"] for row in record["policies"] if wanted.items() <= row.items()))


def of_algorithms(record: study.Record, setting: str = "default") -> dict[str, dict[str, Rows]]:
    """The trainings of a setting, by algorithm and task; other algorithms than ours come last."""
    rows: dict[str, dict[str, Rows]] = {}
    names = dict.fromkeys([*ALGORITHMS, *(row["algorithm"] for row in record["trainings"])])
    for name, task in product(names, TRAINED):
        some = [one for one in record["trainings"] if _of(one)[:3] == (name, setting, task)]
        if some:
            rows.setdefault(name, {})[task] = some
    return rows


def learnt(record: study.Record, setting: str = "default") -> str:
    """The table of a setting's trainings: what they earn; by default also from zero to planner, and their cost."""
    lines, columns = [], None if setting == "default" else 2 + len(TRAINED)
    for name, by_task in of_algorithms(record, setting).items():
        means = {task: np.array([row["mean"] for row in rows]) for task, rows in by_task.items()}
        scaled = [
            (of - earned(record, task, "zero")) / (earned(record, task, "planner") - earned(record, task, "zero"))
            for task, of in means.items()
        ]
        score = _range(interval(_middle, *scaled), 2) if len(means) == len(TRAINED) else ""
        cells = [_range(interval(_middle, means[task])) if task in means else "not yet" for task in TRAINED]
        every = [row for rows in by_task.values() for row in rows]
        counts = sorted({len(rows) for rows in by_task.values()})
        spent = np.mean([row["processor_seconds"] for row in every])
        decisions = " or ".join(
            dict.fromkeys(f"{float(format(row['steps'][-1], '.2g')):,.0f}" for row in every if row["steps"][-1])
        )
        lines.append((name, " to ".join(map(str, counts)), *cells, score, decisions, f"{spent:.0f}")[:columns])
    heads = "algorithm", "trainings", *TRAINED, "score", "decisions", "seconds"
    return table(heads[:columns], lines) if lines else ""


def filled(record: study.Record) -> dict[str, Any]:
    """The numbers of docs/benchmark.md."""
    fidelities = compared(record)
    means = {task: {name: earned(record, task, name) for name in policies.POLICIES} for task in TRAINED}
    rows, fast = [*record["trainings"], *record["fidelities"]], 2.0 * Scene().speed_scale
    best = {row["task"]: row for row in record["policies"] if row["policy"] == "best chirp"}
    return {
        "earned": means,
        "by_pymunk": earned(record, "rattle", "planner", "pymunk"),
        "learnt": {setting: learnt(record, setting) for setting in SETTINGS},
        "hidden": {
            name: ", ".join(f"{earned(record, task, name, setting=HIDDEN):.1f}" for task in TRAINED)
            for name in ("zero", "planner")
        },
        "missing": ", ".join(_missing(record)) or "none",
        "policies": _table(record),
        "resamples": RESAMPLES,
        "tried": len(policies.chirps()),
        "starts": policies.STARTS,
        "chirps": ", ".join(f"{best[task]['drive']['start_frequency']:g} Hz on {task}" for task in TRAINED),
        "rollouts": _rollouts(SEARCHES),
        "fast_rollouts": _rollouts(FAST_SEARCHES),
        "upright": policies.best_upright(),
        "bound": record["spin_bound"],
        "reached": means["spin"]["planner"] / record["spin_bound"],
        "fast": [0.5 * fast, policies.rattle_at(0.5 * fast), policies.rattle_at(fast)],
        "within": f"{100.0 * MARGIN:g} %",
        "decisions": DECISIONS,
        "fidelities": table(
            ("task", "trained on", "against exact", "verdict", "seconds"),
            [
                (task, fidelity, row["share"], row["verdict"], f"{row['seconds']:.0f}")
                for (task, fidelity), row in fidelities.items()
            ],
        ),
        "machines": "; ".join(sorted({row["machine"] for row in [*rows, *record["policies"]]})),
    }  # fmt: skip


def _missing(record: study.Record) -> Iterable[str]:
    """The algorithms and settings of which trainings are not stored yet."""
    for setting, (name, count) in product(SETTINGS, SEEDS.items()):
        by_task = of_algorithms(record, setting).get(name, {})
        lacking = sum(count - len(by_task.get(task, [])) for task in TRAINED)
        if lacking and (setting == "default" or name in HARDER):
            yield f"{lacking} {name}{f' ({setting})' * (setting != 'default')}"


def _rollouts(searches: dict[str, dict[str, Any]]) -> str:
    """Numbers of rollouts in a decision of the planners of all tasks."""
    return ", ".join(f"{searches[task]['samples'] * searches[task]['iterations']:,}" for task in TRAINED)


def _table(record: study.Record) -> str:
    """Returns of policies on the exact model, and their longest computing time of the tasks."""
    lines = []
    for name in policies.POLICIES:
        wanted = {"policy": name, "contact": "exact", "setting": "default"}
        rows = {row["task"]: row for row in record["policies"] if wanted.items() <= row.items()}
        spent = max(row["milliseconds"] for row in rows.values())
        lines.append((name, *(cell(rows[task]) for task in TRAINED), f"{spent:.2g}"))
    return table(("policy", *TRAINED, "ms"), lines)


def _range(values: Interval, digits: int = 1) -> str:
    middle, low, high = (f"{value:z.{digits}f}" for value in values)
    return f"{middle} ({low} to {high})" if math.isfinite(values[1]) else middle


def draw(record: study.Record, folder: Path) -> None:
    """Draw what each algorithm earns by decisions and by processor seconds, and what policies earn."""
    from matplotlib.figure import Figure

    from jackbox_env.commands.plots import BOX, GREY, JACK

    colours = dict(zip(ALGORITHMS, (JACK, BOX, "#2e9e6b", GREY, "#8a5fbf"), strict=True))
    figure = Figure(figsize=(7.4, 8.4), layout="constrained")
    for line, task in zip(figure.subplots(len(TRAINED), 2, sharey="row", sharex="col"), TRAINED, strict=True):
        for axes, by in zip(line, ("steps", "seconds"), strict=True):
            ends = {}
            for (name, by_task), style in zip(of_algorithms(record).items(), ("-", "--", "-.", ":", "-"), strict=False):
                if task not in by_task:
                    continue
                at = np.mean([row[by] for row in by_task[task]], axis=0)
                middle, low, high = np.transpose(
                    [
                        interval(_middle, np.array(of))
                        for of in zip(*(row["curve"] for row in by_task[task]), strict=True)
                    ]
                )
                axes.plot(at, middle, style, color=colours[name], marker="o", markersize=3)
                axes.fill_between(at, low, high, color=colours[name], alpha=0.2, linewidth=0)
                ends[name] = (at[-1], middle[-1])
            axes.set_xscale("log")
            for name, dashes in LINES.items():
                axes.axhline(earned(record, task, name), color=GREY, linewidth=1.2, linestyle=dashes)
                ends[f"{name} {earned(record, task, name):.0f}"] = (axes.get_xlim()[1], earned(record, task, name))
            if by == "seconds":
                label_ends(axes, ends, apart=0.1)
        line[0].set_title(f"{task}: return", loc="left", fontsize="medium")
    line[0].set_xlabel("decisions")
    line[1].set_xlabel("processor seconds of training")
    with replacing(folder / "benchmark.png") as partial_file:
        figure.savefig(partial_file, dpi=150)


STUDY = study.Study(
    "benchmark",
    {
        "policies": policies.policy_row,
        "trainings": trainings.training,
        "fidelities": trainings.on_fidelity,
        "spin_bound": policies.spin_bound,
    },
    filled,
    Arguments,
    trials,
    single=frozenset({"spin_bound"}),
    joined=with_stored,
    draw=draw,
)

if __name__ == "__main__":
    study.main(STUDY, __doc__)
