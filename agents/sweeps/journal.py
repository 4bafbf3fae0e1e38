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
import time
from collections.abc import Callable, Iterable, Iterator
from importlib import metadata
from pathlib import Path
from typing import Any, NamedTuple, TypeVar

from tqdm import tqdm

from agents.files import DamagedFileError, held, open_own, parsing, read_json, say_skipped
from agents.runs import PACKAGES, machine, versions
from agents.sweeps.in_process import Finished, Runner, Trial, Work
from jackbox_env.recording.files import check_writable, new_folder, remove_partials, write_json, write_text

SWEEP, JOURNAL, TABLE, TIMES = "sweep.json", "trials.jsonl", "table.csv", "times.csv"
ENGINES = ("numpy", "numba", "pymunk", *PACKAGES[-2:])
_TIMED = {"seconds": float | int, "place": str, "processor": str}
_TOLD = {"result": dict | None, "error": str | None, "details": str, **_TIMED}
_LINE = {"key": str, "settings": dict, **_TOLD}
_Made = TypeVar("_Made")
_ROOT = Path(__file__).parents[2]
_TABLE_EVERY = 10.0  # [s] between two versions of the table
_SHARE = 20.0  # times as long as writing one takes


class Outcome(NamedTuple):
    """How a sweep ended."""

    finished: int  # trials, failed ones among them
    failed: list[Trial]
    processors: list[str]  # that trials ran on: bits are the same on one kind only


def made_with() -> dict[str, str]:
    """Versions, and a digest of the code, that results depend on."""
    found = {"python": ".".join(map(str, sys.version_info[:3]))}
    for package in ENGINES:
        try:
            found[package] = metadata.version(package)
        except metadata.PackageNotFoundError:
            found[package] = "not installed"
    text = hashlib.sha256()
    for path in sorted(path for folder in ("jackbox_env", "agents") for path in (_ROOT / folder).rglob("*.py")):
        text.update(path.relative_to(_ROOT).as_posix().encode() + path.read_bytes())
    return {**found, "code": text.hexdigest()[:12]}


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
    seen = set[str]()
    for trial in trials:
        if trial.key in seen:
            raise ValueError(f"a sweep must have each trial once, got twice {json.dumps(trial.settings)}")
        seen.add(trial.key)
    started = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
    record: dict[str, Any] = {"command": sys.argv, "started": started, "machine": machine(), "versions": versions()}
    record |= {"asked": asked, "made_with": made_with(), "trials": [trial.settings for trial in trials]}
    return new_folder(path, "sweep", lambda made: write_json(made / SWEEP, record))


def read_sweep(
    folder: Path, check: Callable[[dict[str, Any]], None] = lambda settings: None
) -> tuple[dict[str, Any], list[Trial]]:
    """What a sweep was asked for, and its trials; says which are left out because they are damaged, or listed before.

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
    record = read_json(path)
    with parsing(path):
        asked, listed = dict(record["asked"]), list(record["trials"])
        other = differing(record["made_with"], made_with())
    if other:
        raise ValueError(f"{folder} was begun with other code ({other}), so it cannot be continued: make another sweep")
    trials = dict[str, Trial]()

    def read(settings: Any) -> None:
        trial = Trial(dict(settings))
        check(trial.settings)
        _as_text(trial.settings)
        if trials.setdefault(trial.key, trial) is not trial:
            raise ValueError("it is listed before")

    _each(path, "trial", listed, read)
    return asked, list(trials.values())


def _each(path: Path, part: str, parts: Iterable[_Made], read: Callable[[_Made], None]) -> None:
    """Read each part of a file; say which are skipped because they are damaged."""
    for number, one in enumerate(parts, 1):
        try:
            with parsing(Path(f"{path}, {part} {number},")):
                read(one)
        except DamagedFileError as error:
            say_skipped(error)


def _as_text(values: Any) -> bytes:
    """JSON that a table can hold; raises UnicodeEncodeError for half a character."""
    return json.dumps(values, ensure_ascii=False).encode()


def carry_out(folder: Path, trials: list[Trial], work: Work, runner: Runner, progress: bool = True) -> Outcome:
    """Run what has not finished, and what has failed; the journal has each trial as soon as it finishes.

    Raises:
        FolderInUseError: another process works in the folder.
        OSError: it cannot be written to.
    """
    with held(folder):
        check_writable(folder)
        remove_partials(folder)
        kept = _kept(folder, trials)
        left = [trial for trial in trials if trial.key not in kept or kept[trial.key]["error"] is not None]
        try:
            _run(folder, trials, left, kept, runner.run, work, progress)
        finally:
            _write_tables(folder, trials, kept)
    failed = [trial for trial in trials if trial.key in kept and kept[trial.key]["error"] is not None]
    return Outcome(len(kept), failed, sorted({line["processor"] for line in kept.values()} - {""}))


def _run(
    folder: Path,
    trials: list[Trial],
    left: list[Trial],
    kept: dict[str, dict[str, Any]],
    run: Callable[..., Iterator[Finished]],
    work: Work,
    progress: bool,
) -> None:
    """Run what is left, and add it to the journal, to ``kept`` and now and then to the tables."""
    failed, next_table = 0, time.monotonic() + _TABLE_EVERY
    with (
        open_own(folder / JOURNAL) as journal,
        tqdm(total=len(trials), initial=len(trials) - len(left), unit="trial", disable=not progress) as bar,
    ):
        for done in run(left, work, bar.refresh):
            kept[done.trial.key] = line = _line(done)
            journal.write(json.dumps(line).encode() + b"\n")
            journal.flush()
            os.fsync(journal.fileno())
            failed += done.error is not None
            bar.set_postfix(failed=failed, refresh=False)
            bar.update()
            if (began := time.monotonic()) >= next_table:
                _write_tables(folder, trials, kept)
                ended = time.monotonic()
                next_table = ended + max(_TABLE_EVERY, _SHARE * (ended - began))


def _line(done: Finished) -> dict[str, Any]:
    """What the journal keeps of a finished trial."""
    return {"key": done.trial.key, "settings": done.trial.settings} | {name: getattr(done, name) for name in _TOLD}


def _kept(folder: Path, trials: Iterable[Trial]) -> dict[str, dict[str, Any]]:
    """The journal's lines by key, the last of each; the beginning of a line at its end is cut off."""
    path, kept, known = folder / JOURNAL, dict[str, dict[str, Any]](), {trial.key for trial in trials}
    with open_own(path) as file:
        file.seek(0)
        content = file.read()
        whole = content.rfind(b"\n") + 1
        if whole < len(content):
            file.truncate(whole)

    def read(text: bytes) -> None:
        line = json.loads(text)
        _as_text(line)
        for name, kind in _LINE.items():
            if not isinstance(line[name], kind):
                raise TypeError(f"{name} is a {type(line[name]).__name__}")
        kept[line["key"]] = line

    _each(path, "line", content[:whole].splitlines(), read)
    return {key: line for key, line in kept.items() if key in known}


def _write_tables(folder: Path, trials: list[Trial], kept: dict[str, dict[str, Any]]) -> None:
    """Both tables, in the order of the grid."""
    there = [(trial, kept[trial.key]) for trial in trials if trial.key in kept]
    rows = [{**trial.settings, **(line["result"] or {}), "error": line["error"]} for trial, line in there]
    times = [{"trial": trial.key} | {name: line[name] for name in _TIMED} for trial, line in there]
    write_text(folder / TABLE, _csv(rows, last="error"))
    write_text(folder / TIMES, _csv(times))


def _csv(rows: list[dict[str, Any]], last: str | None = None) -> str:
    """Rows of a table with every name that any of them has, in the order of their first appearance."""
    names = dict.fromkeys(name for row in rows for name in row)
    if last in names:
        names = dict.fromkeys([name for name in names if name != last] + [last])
    file = io.StringIO()
    writer = csv.DictWriter(file, list(names), lineterminator="\n")
    writer.writeheader()
    plain = (str, int, float, type(None))
    for row in rows:
        writer.writerow({name: value if isinstance(value, plain) else json.dumps(value) for name, value in row.items()})
    return file.getvalue()
