"""Write docs/learners.md: what the fidelity of training does to a trained agent."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np
from scipy.stats import bootstrap, trim_mean

from jackbox_env.model.states import Array
from jackbox_env.tools import checks as check
from jackbox_env.tools.files import replacing
from scripts.studies import study
from scripts.studies.learners import measured as these
from scripts.studies.pages import label_ends, table

FIDELITIES = ("exact", "coarse", "balanced", "fine")
MARGIN = 0.05  # of the return above zero torque: what is called equal, chosen before the first training
RESAMPLES = 20_000
FEWEST = 4  # trainings that are compared
TOO_FEW = ", too few for quartiles and a verdict, so their mean is shown"
WITHIN = f"{100.0 * MARGIN:g} %"
EQUAL, WORSE, BETTER = "equal", "worse", "better"


@dataclass(frozen=True)
class Arguments(study.Arguments):
    """Train PPO on each fidelity, and judge it on exact."""

    runs: Path | None = Path("runs/learners")
    """Folder of trainings and evaluations, made if missing. Finished ones in it are not repeated."""
    seeds: tuple[int, ...] = tuple(range(8))
    """Seeds of the trainings on each task and fidelity but fine. Stored trainings of other seeds stay."""
    fine: tuple[int, ...] = tuple(range(3))
    """Seeds of the trainings on fine, of juggle: each takes half an hour or more."""
    episodes: int = 256
    """Episodes of each evaluation."""
    planner_episodes: int = 32
    """Episodes of the planner by each contact model."""

    def __post_init__(self) -> None:
        """Raise TypeError or ValueError for what cannot be measured."""
        for name, seeds in (("seeds", self.seeds), ("fine", self.fine)):
            for seed in seeds:
                check.whole(name, seed, at_least=0)
        for name in ("episodes", "planner_episodes"):
            check.whole(name, getattr(self, name), at_least=4)


def trials(arguments: Arguments) -> study.Trials:
    """All trials of the page: one seed of all tasks after the other, then those on fine, the slowest."""
    every: study.Trials = [
        {"part": "untrained", "task": task, "episodes": arguments.episodes} for task in these.DECISIONS
    ]
    every += [
        {"part": "planned", "model": model, "episodes": arguments.planner_episodes} for model in ("exact", "pymunk")
    ]
    fine = [("juggle", "fine", seed) for seed in arguments.fine]
    others = [
        (task, fidelity, seed) for seed, task, fidelity in product(arguments.seeds, these.DECISIONS, FIDELITIES[:-1])
    ]
    trainings: study.Trials = [
        {"part": "trained", "runs": str(arguments.runs), "task": task, "fidelity": fidelity, "seed": seed}
        for task, fidelity, seed in others + fine
    ]
    every += [{**training, "episodes": arguments.episodes} for training in trainings]
    return every


def with_stored(new: study.Record, stored: study.Record) -> study.Record:
    """New results, with the stored trainings of other seeds."""
    trained = {_of(row): row for row in stored.get("trained", [])}
    others = trained.keys() - {_of(row) for row in new.get("trained", [])}
    if "trained" in new and others:
        new["trained"] = sorted([*new["trained"], *(trained[of] for of in others)], key=_of)
        made = {new["made"]["trained"].removesuffix("."), stored["made"]["trained"].removesuffix(".")}
        new["made"]["trained"] = "; ".join(sorted(made)) + "."
    return new


def _of(row: dict[str, Any]) -> tuple[int, int, int]:
    """Task, seed and fidelity of a training, as numbers in the order of the page."""
    return [*these.DECISIONS].index(row["task"]), row["seed"], FIDELITIES.index(row["fidelity"])


# -- the page ----------------------------------------------------------------------------------------------------------


def interval(*samples: Array) -> tuple[float, float, float]:
    """The interquartile mean of trainings, or how far the first lies above the second, with its 95 % interval.

    The bootstrap draws trainings anew, of each sample as many as it has. A single training has no finite interval.
    """

    def statistic(*drawn: Array, axis: int = -1) -> Any:
        means = [trim_mean(one, 0.25, axis=axis) for one in drawn]
        return means[0] if len(means) == 1 else means[0] - means[1]

    if min(map(len, samples)) < 2:
        return float(statistic(*samples)), -math.inf, math.inf
    drawn = bootstrap(
        samples, statistic, n_resamples=RESAMPLES, method="percentile", rng=np.random.default_rng(0)
    ).confidence_interval
    return float(statistic(*samples)), float(drawn.low), float(drawn.high)


def verdict(difference: tuple[float, float, float], margin: float, count: int) -> str:
    """Equal, better or worse, if the interval decides it; else how many trainings would, with a probability of 80 %."""
    middle, low, high = difference
    if -margin <= low and high <= margin:
        return EQUAL
    if high < -margin:
        return WORSE
    if low > margin:
        return BETTER
    arm, left = max(high - middle, middle - low), max(abs(margin - abs(middle)), 1e-9)
    needed = max(count + 1, math.ceil(2.0 * count * (arm / left) ** 2))  # the 2: (1.96 + 0.84)^2 / 1.96^2
    return f"undecided: {f'about {needed:,}' if needed < 1000 else 'more than 1,000'} trainings would do"


def compared(record: study.Record) -> dict[tuple[str, str], dict[str, Any]]:
    """Of each task and fidelity what its trainings earn, and the verdict against exact."""
    zero = {row["task"]: row["zero"] for row in record["untrained"]}
    means: dict[tuple[str, str], list[dict[str, Any]]] = {}
    for row in record["trained"]:
        means.setdefault((row["task"], row["fidelity"]), []).append(row)
    rows = {}
    for (task, fidelity), some in means.items():
        on = {judge: np.array([row["earned"][judge] for row in some]) for judge in these.JUDGES}
        best = np.array([row["earned"]["exact"] for row in means[task, "exact"]])
        above = float(trim_mean(best, 0.25)) - zero[task]
        difference = interval(on["exact"], best)
        rows[task, fidelity] = {
            "earns": {judge: interval(values) for judge, values in on.items()},
            "lowest": float(on["exact"].min()),
            "share": None if fidelity == "exact" else [100.0 * part / above for part in difference],
            "verdict": "",
            "seconds": float(np.mean([row["processor_seconds"] for row in some])),
            "count": len(some),
        }
        if fidelity != "exact" and len(some) >= FEWEST:
            rows[task, fidelity]["verdict"] = verdict(difference, MARGIN * above, len(some))
    return rows


def filled(record: study.Record) -> dict[str, Any]:
    """The numbers of docs/learners.md."""
    rows, planned = compared(record), {row["model"]: row for row in record["planned"]}
    counts = [row["count"] for (_, fidelity), row in rows.items() if fidelity != "fine"]
    fine = sum(row["count"] for (_, fidelity), row in rows.items() if fidelity == "fine")
    return {
        "verdict": sentence(rows),
        "within": WITHIN,
        "seeds": " ".join(map(str, sorted({row["seed"] for row in record["trained"] if row["fidelity"] != "fine"}))),
        "fine_seeds": "".join(f" {row['seed']}" for row in record["trained"] if row["fidelity"] == "fine"),
        "trainings": " to ".join(map(str, sorted({min(counts), max(counts)}))),
        "fine_too": f", and juggle {fine} on `fine`{TOO_FEW * (fine < FEWEST)}" if fine else "",
        "episodes": " or ".join(map(str, sorted({row["episodes"] for row in record["trained"]}))),
        "decisions": these.DECISIONS,
        "rows": table(
            ("task", "trained on", "earns on exact", "lowest", "against exact", "verdict", "seconds"),
            [
                (task, fidelity, _range(row["earns"]["exact"]), f"{row['lowest']:.1f}", _against(row), row["verdict"],
                 f"{row['seconds']:.0f}")
                for (task, fidelity), row in rows.items()
            ],
        ),
        "judged": table(
            ("task", "trained on", *these.JUDGES),
            [(task, name, *(_range(one) for one in row["earns"].values())) for (task, name), row in rows.items()],
        ),
        "planned": planned,
        "curve_episodes": these.CURVE_EPISODES,
        "resamples": RESAMPLES,
        "commits": ", ".join(sorted({row["commit"] for row in record["trained"]})),
    }  # fmt: skip


def sentence(rows: dict[tuple[str, str], dict[str, Any]]) -> str:
    """The verdicts, a sentence for each kind."""
    templates = {
        EQUAL: f"Judged on `exact`, PPO trained on {{}} earns the same within {WITHIN} as PPO trained on `exact`.",
        WORSE: "Judged on `exact`, PPO trained on {} earns less than PPO trained on `exact`.",
        BETTER: "Judged on `exact`, PPO trained on {} earns more than PPO trained on `exact`.",
        "undecided": "Undecided: PPO trained on {}.",
    }
    sentences = []
    for kind, template in templates.items():
        lists: dict[str, list[str]] = {}
        for (task, fidelity), row in rows.items():
            if row["verdict"].partition(":")[0] == kind:
                lists.setdefault(f"`{fidelity}`", []).append(task)
        if lists:
            sentences.append(
                template.format(" and on ".join(f"{on} ({_listed(tasks)})" for on, tasks in lists.items()))
            )
    return " ".join(sentences) or f"No verdict: it needs {FEWEST} trainings on each fidelity."


def _listed(names: list[str]) -> str:
    """Names in a sentence: a, b and c."""
    return " and ".join([*([", ".join(names[:-1])] if len(names) > 1 else []), names[-1]])


def for_the_readme(record: study.Record) -> str:
    """The README's sentence on training."""
    rows = compared(record)
    others = {of: row for of, row in rows.items() if row["verdict"]}
    longer = [row["seconds"] / rows[task, "exact"]["seconds"] for (task, _), row in others.items()]
    kinds = Counter(row["verdict"].partition(":")[0] for row in others.values())
    differing = ", ".join(f"{kinds[kind]} {kind}" for kind in (BETTER, WORSE, "undecided") if kinds[kind])
    return (
        f"PPO takes {min(longer):.0f} to {max(longer):.0f} times as long to train on pymunk. Judged on `exact`, it "
        f"then earns the same within {WITHIN} as PPO trained on `exact` in {kinds[EQUAL]} of "
        f"[{len(others)} comparisons](docs/learners.md){f' ({differing})' if differing else ''}."
    )


def _range(values: tuple[float, float, float]) -> str:
    middle, low, high = values
    return f"{middle:.1f} ({low:.1f} to {high:.1f})"


def _against(row: dict[str, Any]) -> str:
    return "" if row["share"] is None else "{:+.1f} % ({:+.1f} to {:+.1f})".format(*row["share"])


def draw(record: study.Record, folder: Path) -> None:
    """Draw the return on exact against the seconds of training, a line for each fidelity."""
    from matplotlib.figure import Figure

    from jackbox_env.commands.plots import BOX, GREY, JACK

    colours = dict(zip(FIDELITIES, (JACK, BOX, "#2e9e6b", GREY), strict=True))
    figure = Figure(figsize=(5.2, 7.4), layout="constrained")
    for axes, task in zip(figure.subplots(len(these.DECISIONS), 1, sharex=True), these.DECISIONS, strict=True):
        ends = {}
        for fidelity, style in zip(FIDELITIES, ("-", "--", "-.", ":"), strict=True):
            some = [row for row in record["trained"] if (row["task"], row["fidelity"]) == (task, fidelity)]
            if not some:
                continue
            seconds = np.mean([row["seconds"] for row in some], axis=0)
            middle, low, high = np.transpose(
                [interval(np.array(of)) for of in zip(*(row["curve"] for row in some), strict=True)]
            )
            axes.plot(seconds, middle, style, color=colours[fidelity], marker="o", markersize=3.5)
            axes.fill_between(seconds, low, high, color=colours[fidelity], alpha=0.2, linewidth=0)
            ends[fidelity] = (seconds[-1], middle[-1])
        axes.set_xscale("log")
        axes.set_title(f"{task}: return on exact", loc="left", fontsize="medium")
        label_ends(axes, ends, apart=0.12)
    axes.set_xlabel("processor seconds of training")
    with replacing(folder / "learners.png") as partial_file:
        figure.savefig(partial_file, dpi=150)


STUDY = study.Study(
    "learners",
    {"untrained": these.untrained, "planned": these.planned, "trained": these.trained},
    filled,
    Arguments,
    trials,
    draw=draw,
    joined=with_stored,
)

if __name__ == "__main__":
    study.main(STUDY, __doc__)
