"""A sweep's folder: what is to be run, what has finished, and the table. A folder is never used for another sweep.

sweep.json     the trials' settings, and the versions and the code that they are run with
trials.jsonl   a line for each trial that has finished, in the order in which they did, on the disk at once
table.csv      a row for each finished trial, in the order of the grid: the same bytes wherever the trials ran
times.csv      how long each took, and where
lock           held by the process that works here

A process killed at any moment leaves whole lines, and perhaps the beginning of one, which is cut off.
"""

from __future__ import annotations

import csv
import datetime
import hashlib
import io
import json
import os
import sys
from collections import Counter
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from agents.files import DamagedFileError, locked, parsing, say_skipped
from agents.runs import PACKAGES, installed, machine, versions
from agents.sweeps.in_process import Finished, Runner, Trial, Work
from jackbox_env.recording.files import new_folder, remove_partials, write_bytes, write_json, write_text

SWEEP, LOG, TABLE, TIMES = "sweep.json", "trials.jsonl", "table.csv", "times.csv"
ENGINES = ("numpy", "numba", "pymunk", *PACKAGES[-2:])
_TIMED = {"seconds": float | int, "place": str, "processor": str}
_KEPT = {"result": dict | None, "error": str | None, "details": str, **_TIMED}  # of a finished trial
_ROOT = Path(__file__).parents[2]


class Outcome(NamedTuple):
    """How a sweep ended."""

    finished: int  # trials, failed ones among them
    failed: list[Trial]
    processors: list[str]  # that trials ran on: bits are the same on one kind only


def made_with() -> dict[str, str]:
    """Versions, and a digest of the code, that results depend on."""
    text = hashlib.sha256()
    for path in sorted(path for folder in ("jackbox_env", "agents") for path in (_ROOT / folder).rglob("*.py")):
        text.update(path.relative_to(_ROOT).as_posix().encode() + path.read_bytes())
    return {**installed(ENGINES), "code": text.hexdigest()[:12]}


def differing(given: dict[str, str], here: dict[str, str]) -> str:
    """What differs between two answers of :func:`made_with`, in words; empty where nothing does."""
    names = [name for name in {**given, **here} if given.get(name) != here.get(name)]
    return ", ".join(f"{name} {given.get(name)} there and {here.get(name)} here" for name in names)


def new_sweep(path: Path | None, asked: dict[str, Any], trials: list[Trial]) -> Path:
    """Make the folder of a sweep; None: ``runs/sweep-<date>-<time>``.

    Args:
        path: to make.
        asked: what the trials were made from, plain JSON; it is kept.
        trials: in the order of the table.

    Raises:
        FileExistsError: there is something at ``path`` already.
        ValueError: there is no trial, or one twice.
    """
    if not trials:
        raise ValueError("a sweep must have at least one trial, got none")
    count = Counter(trial.key for trial in trials)
    for trial in trials:
        if count[trial.key] > 1:
            raise ValueError(f"a sweep must have each trial once, got twice {json.dumps(trial.settings)}")
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    record: dict[str, Any] = {"command": sys.argv, "started": started, "machine": machine(), "versions": versions()}
    record |= {"asked": asked, "made_with": made_with(), "trials": [trial.settings for trial in trials]}
    return new_folder(path, "sweep", lambda made: write_json(made / SWEEP, record))


def read_sweep(
    folder: Path, check: Callable[[dict[str, Any]], None] = lambda settings: None
) -> tuple[dict[str, Any], list[Trial]]:
    """What a sweep was asked for, and its trials.

    Args:
        folder: of the sweep.
        check: raises an error for settings that are no trial's.

    Raises:
        FileNotFoundError: it is no sweep.
        ValueError: its file is damaged, or it was begun with other code or versions, so that its rows and new ones do
            not belong together.
    """
    path = folder / SWEEP
    if not path.is_file():
        raise FileNotFoundError(f"{folder} is no sweep: it has no {SWEEP}")
    with parsing(path):
        record = json.loads(path.read_bytes())
        asked, trials = dict(record["asked"]), [Trial(dict(settings)) for settings in record["trials"]]
        other = differing(record["made_with"], made_with())
    if other:
        raise ValueError(f"{folder} was begun with other code ({other}), so it cannot be continued: make another sweep")
    with parsing(path):
        for trial in trials:
            check(trial.settings)
    return asked, trials


def carry_out(folder: Path, trials: list[Trial], work: Work, runner: Runner, progress: bool = True) -> Outcome:
    """Run what has not finished, and what has failed; the results log has each trial as soon as it finishes.

    Raises:
        FolderInUseError: another process works in the folder.
        OSError: it cannot be written to.
    """
    with locked(folder):
        remove_partials(folder)
        kept = _read_log(folder, trials)
        left = [trial for trial in trials if trial.key not in kept or kept[trial.key]["error"] is not None]
        try:
            _run(folder, left, kept, runner, work, tqdm(total=len(trials), unit="trial", disable=not progress))
        finally:
            _write_tables(folder, trials, kept)
    failed = [trial for trial in trials if trial.key in kept and kept[trial.key]["error"] is not None]
    return Outcome(len(kept), failed, sorted({line["processor"] for line in kept.values()} - {""}))


def _run(
    folder: Path, left: list[Trial], kept: dict[str, dict[str, Any]], runner: Runner, work: Work, bar: tqdm[Any]
) -> None:
    """Run what is left, and add it to the log and to ``kept``."""
    failed = 0
    with (folder / LOG).open("ab") as log, bar:
        bar.update(bar.total - len(left))
        for done in runner.run(left, work, bar.refresh):
            kept[done.trial.key] = line = _line(done)
            log.write(json.dumps(line).encode() + b"\n")
            log.flush()
            os.fsync(log.fileno())
            failed += done.error is not None
            bar.set_postfix(failed=failed, refresh=False)
            bar.update()


def _line(done: Finished) -> dict[str, Any]:
    """What the log keeps of a finished trial."""
    return {"key": done.trial.key, "settings": done.trial.settings} | {name: getattr(done, name) for name in _KEPT}


def _read_log(folder: Path, trials: Iterable[Trial]) -> dict[str, dict[str, Any]]:
    """The log's lines by key, the last of each; says which are skipped because they are damaged.

    The log is written anew without the beginning of a line at its end, and in place of a link.
    """
    path, kept, known = folder / LOG, dict[str, dict[str, Any]](), {trial.key for trial in trials}
    content = path.read_bytes() if path.is_file() else b""
    whole = content[: content.rfind(b"\n") + 1]
    write_bytes(path, whole)
    for number, text in enumerate(whole.splitlines(), 1):
        try:
            with parsing(Path(f"{path}, line {number},")):
                line = json.loads(text)
                json.dumps(line, ensure_ascii=False).encode()  # fails for half a character, which no table holds
                for name, kind in _KEPT.items():
                    if not isinstance(line[name], kind):
                        raise TypeError(f"{name} is a {type(line[name]).__name__}")
                if line["key"] in known:
                    kept[line["key"]] = line
        except DamagedFileError as error:
            say_skipped(error)
    return kept


def _write_tables(folder: Path, trials: list[Trial], kept: dict[str, dict[str, Any]]) -> None:
    """Both tables, in the order of the grid."""
    there = [(trial, kept[trial.key]) for trial in trials if trial.key in kept]
    rows = [{**trial.settings, **(line["result"] or {}), "error": line["error"]} for trial, line in there]
    times = [{"trial": trial.key} | {name: line[name] for name in _TIMED} for trial, line in there]
    write_text(folder / TABLE, _csv(rows, last=["error"]))
    write_text(folder / TIMES, _csv(times))


def _csv(rows: list[dict[str, Any]], last: Iterable[str] = ()) -> str:
    """Rows of a table with every name that any of them has, in the order of their first appearance."""
    file = io.StringIO()
    names = dict.fromkeys(name for row in rows for name in row if name not in last)
    writer = csv.DictWriter(file, [*names, *last], lineterminator="\n")
    writer.writeheader()
    plain = (str, int, float, type(None))
    for row in rows:
        writer.writerow({name: value if isinstance(value, plain) else json.dumps(value) for name, value in row.items()})
    return file.getvalue()
