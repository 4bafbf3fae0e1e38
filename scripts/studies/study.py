"""The runner of all studies: trials as a sweep, their results as one record, and a page filled from it.

A study is a table of parts, by name, and a function from its record to the numbers of its page. A part is a function of
a trial: it receives plain keywords and returns plain JSON. The record, ``docs/<study>.json``, has for each part the
result of its one trial, or the list of results of its trials. Its entry ``made`` names, by part, the machine and the
versions. The page ``docs/<study>.md`` is the template ``scripts/studies/<study>/page.md``, filled from the record.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Collection, Iterable, Mapping
from dataclasses import dataclass, fields, replace
from functools import partial
from pathlib import Path
from typing import Any

from agents.runners import Runner, Work, in_turn
from agents.sweep import TABLE, carry_out, new_sweep, read_sweep
from agents.sweep_ray import runner_for
from jackbox_env.tools import checks as check
from jackbox_env.tools.command_line import command_line
from jackbox_env.tools.files import check_writable, stamped, write_text
from scripts.studies import timing

Record = dict[str, Any]
Trials = list[dict[str, Any]]  # of each the name of its "part", and that function's keywords
Parts = Mapping[str, Callable[..., Any]]
_RESULTS = "result", "made", "busy", "error"  # columns of a finished trial


@dataclass(frozen=True)
class Arguments:
    """Arguments of every study; those that a study adds are keywords of its parts."""

    parts: tuple[str, ...] = ()
    """Parts to measure; the others stay as stored. None given: all."""
    render: bool = False
    """Measure nothing: write the page and draw the pictures from the stored results."""
    runs: Path | None = None
    """Folder of finished trials, made if missing. What is finished there is not done again. None: a new one in runs."""
    workers: int | None = None
    """Trials side by side, each in a process of its own; None: one after the other. Those that time run alone."""
    address: str | None = None
    """With Ray on a cluster: the address of its head, or auto on one of its machines."""
    out: Path | None = Path("docs")
    """Folder of the page, its record and its pictures; None: the folder of the trials."""
    progress: bool = True
    """Show progress bars."""


@dataclass(frozen=True)
class TimedArguments(Arguments):
    """Measure in interleaved rounds; every figure is the median over the rounds."""

    rounds: int = 5
    """Rounds; each measures everything in turn, so that a slow moment of the machine falls on all."""
    seconds: float = 0.4
    """Time per measurement [s]."""

    def __post_init__(self) -> None:
        """Raise TypeError or ValueError for what cannot be measured."""
        check.whole("rounds", self.rounds, at_least=1)
        check.real("seconds", self.seconds, above=0.0)


def once_each(parts: Parts, arguments: Arguments) -> Trials:
    """One trial of each part, with all arguments that the study adds."""
    common = {one.name for one in fields(Arguments)}
    added = {one.name: getattr(arguments, one.name) for one in fields(arguments) if one.name not in common}
    return [{"part": name, **added} for name in parts]


@dataclass(frozen=True)
class Study:
    """A study; its name is that of its folder, page and record."""

    name: str
    parts: Parts
    filled: Callable[[Record], dict[str, Any]]  # the fields of the page's template
    arguments: type[Arguments] = Arguments
    trials: Callable[[Any], Trials] | None = None  # of the arguments; None: each part once
    single: frozenset[str] = frozenset()  # parts of one trial; without ``trials`` all are
    alone: frozenset[str] = frozenset()  # parts that time: their trials run in this process, one after the other
    packages: tuple[str, ...] = ("jackbox", "numpy", "numba")  # named with the results
    joined: Callable[[Record, Record], Record] = lambda new, stored: new  # new results, with what stays of the stored
    draw: Callable[[Record, Path], object] = lambda record, folder: None
    report: Callable[[Record], object] = lambda record: None  # prints; raises RuntimeError if a claim does not hold

    def page(self, record: Record) -> str:
        """The page's text."""
        template = (Path(__file__).parent / self.name / "page.md").read_text(encoding="utf-8")
        return template.format(**{"made": made_lines(record["made"]), **self.filled(record)})

    def path(self, folder: Path) -> Path:
        """The record's file in a folder."""
        return folder / f"{self.name}.json"

    def read(self, folder: Path) -> Record:
        """The record in a folder; empty if there is none."""
        path = self.path(folder)
        return json.loads(path.read_text(encoding="utf-8")) if path.exists() else {"made": {}}


# -- measuring ---------------------------------------------------------------------------------------------------------


def measured(parts: Parts, packages: tuple[str, ...], trial: dict[str, Any]) -> dict[str, Any]:
    """The work of a trial."""
    before, keywords = timing.core_seconds(), {name: value for name, value in trial.items() if name != "part"}
    result, made = parts[trial["part"]](**keywords), timing.measured_with(packages)
    return {"result": result, "made": made, "busy": timing.busy_since(before)}


def swept(folder: Path, trials: Trials, alone: Collection[str], work: Work, runner: Runner, bar: bool) -> Trials:
    """Run the unfinished trials in ``folder``, and return the rows of its table, in the order of ``trials``.

    Raises:
        RuntimeError: some trials failed.
        ValueError: the folder's sweep was begun with other trials or other code.
    """
    if not folder.exists():
        new_sweep(folder, trials)
    elif read_sweep(folder)[0] != trials:
        raise ValueError(f"{folder} was begun with other arguments: choose another folder")
    shared, rows = [trial for trial in trials if trial["part"] not in alone], Trials()
    try:
        for some, run in ((shared, runner), (trials, in_turn)):
            rows = carry_out(folder, some, work, run, bar) if some else []
            errors = [row["error"] for row in rows if row["error"] is not None]
            if errors:
                raise RuntimeError(
                    f"{len(errors)} of {len(some)} trials failed, marked in {folder / TABLE}: {errors[0]}"
                )
    except KeyboardInterrupt:
        print(f"\nInterrupted. Finished trials are in {folder}; --runs {folder.parent} continues", file=sys.stderr)
        raise
    return rows


def by_part(study: Study, rows: Trials) -> Record:
    """The record of finished trials. Of a part of one trial it has the settings, and how busy the machine was."""
    record: Record = {"made": {}}
    for part in dict.fromkeys(row["part"] for row in rows):
        some = [row for row in rows if row["part"] == part]
        record[part], made = [row["result"] for row in some], _with_commits(row["made"] for row in some)
        if part in study.single or not study.trials:
            (row,) = some
            settings = [f"; {name} {value}" for name, value in row.items() if name not in ("part", *_RESULTS)]
            record[part], made = row["result"], f"{made}{''.join(settings)}. {row['busy']}"
        record["made"][part] = made.removesuffix(".") + "."
    return record


def _with_commits(made: Iterable[str]) -> str:
    """Machines and versions of trials, each once, with all their commits."""
    commits = dict[str, set[str]]()
    for text in made:
        shared, _, commit = text.partition(", commit ")
        commits.setdefault(shared, set()).add(commit)
    return "; ".join(f"{shared}, commit {', '.join(sorted(of))}" for shared, of in sorted(commits.items()))


def made_lines(made: Mapping[str, str]) -> str:
    """Machine and versions, commit, settings and noise, each once for all parts that share them."""
    groups = dict[str, dict[str, list[str]]]()
    for part, text in made.items():
        shared, _, rest = text.partition(", commit ")
        groups.setdefault(shared, {}).setdefault(rest, []).append(f"`{part}`")
    lines = []
    for shared, of in groups.items():
        measured_at = (f"{', '.join(parts)} at commit {rest}" for rest, parts in of.items())
        lines.append(f"- {shared}: {' '.join(measured_at)}")
    return "\n".join(lines)


# -- the command -------------------------------------------------------------------------------------------------------


def run(study: Study, arguments: Arguments) -> None:
    """Measure, unless only the page is to be written; then write record, page and pictures.

    Raises:
        RuntimeError: some trials failed, or a claim of the study does not hold.
        ValueError: a part is unknown, or neither chosen nor stored.
    """
    check.known_keys("parts", arguments.parts, study.parts)
    runs = (arguments.runs or stamped(study.name)).resolve()
    out, chosen = arguments.out or runs, () if arguments.render else arguments.parts or tuple(study.parts)
    for folder in [runs] * bool(chosen) + [out] * (arguments.out is None):
        folder.mkdir(parents=True, exist_ok=True)
    check_writable(out)
    record = study.read(out)
    missing = [part for part in study.parts if part not in {*chosen, *record}]
    if missing:
        raise ValueError(f"parts must name {' and '.join(missing)} too: {study.path(out)} has no such results yet")
    if chosen:
        new = study.joined(_measured(study, replace(arguments, runs=runs), runs / "sweep", chosen), record)
        record |= {**new, "made": record["made"] | new["made"]}
        write_text(study.path(out), as_text(record))
    write_text(out / f"{study.name}.md", study.page(record))
    study.draw(record, out)
    print(f"Written: {out / study.name}.md")
    study.report(record)


def _measured(study: Study, arguments: Arguments, folder: Path, chosen: Collection[str]) -> Record:
    every = study.trials(arguments) if study.trials else once_each(study.parts, arguments)
    trials = [trial for trial in every if trial["part"] in chosen]
    runner, work = runner_for(arguments.workers, arguments.address), partial(measured, study.parts, study.packages)
    return by_part(study, swept(folder, trials, study.alone, work, runner, arguments.progress))


def as_text(record: Record) -> str:
    """A record as JSON, with a line for each trial of a part, or for each entry of its one result."""
    return re.sub(r"\n {6,}|\n {4}(?=[]}])", " ", json.dumps(record, indent=2)) + "\n"


def main(study: Study, description: str | None) -> None:
    """The command of a study: parse, run."""

    def parsed() -> None:
        import tyro

        run(study, tyro.cli(study.arguments, description=description))

    command_line(parsed)()
