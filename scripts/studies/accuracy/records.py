"""The sweep's run folder: one line per setting and case as soon as it is measured, so that nothing is done twice.

arguments.json   what the sweep was asked for, and a digest of the code it measures
records.jsonl    one measured case per line
results.json     all of it summed up, written last
"""

from __future__ import annotations

import hashlib
import json
import math
import os
from pathlib import Path
from typing import Any

from agents.runs import new_folder, versions
from agents.storage import DamagedFileError, read_json, say_skipped, write_json
from jackbox_env.accuracy import Case, Reference, compare, follow, quantities, restarts
from scripts.studies.accuracy.settings import Setting, look_of

ROOT = Path(__file__).parents[3]
ARGUMENTS, RECORDS, RESULTS = "arguments.json", "records.jsonl", "results.json"
_MEASURED = ("jackbox_env", "scripts/studies/accuracy", "scripts/studies/rivals", "tests/data")
_WORDS = ("page.py", "pictures.py", "summary.py")  # what becomes of the records does not change them
_ENGINES = ("numpy", "numba", "pymunk", "mujoco", "box2d")


def digest() -> str:
    """A digest of all code that a measurement depends on."""
    text = hashlib.sha256()
    for folder in _MEASURED:
        for path in sorted([*(ROOT / folder).rglob("*.py"), *(ROOT / folder).glob("*.json")]):
            if path.name in _WORDS and path.parent.name == "sweep":
                continue
            text.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return text.hexdigest()[:16]


def open_folder(arguments: dict[str, Any], folder: Path | None, kind: str) -> Path:
    """A folder to go on in, or a new one: an unfinished sweep of the same code and arguments is taken up again.

    Raises:
        FileExistsError: ``folder`` holds something else, or a finished sweep.
    """
    asked = {**arguments, "code": digest(), "engines": {name: versions((name,))[name] for name in _ENGINES}}
    if folder is None:
        runs = sorted(Path("runs").glob(f"{kind}-*"), reverse=True)
        folder = next((run for run in runs if _unfinished(run, asked)), None)
    elif folder.exists() and not _unfinished(folder, asked):
        raise FileExistsError(
            f"{folder} is finished or was made from other code or arguments, and runs are never overwritten: choose "
            "another folder"
        )
    if folder is not None and folder.exists():
        return folder
    return new_folder(folder, kind, lambda made: write_json(made / ARGUMENTS, asked))


def _unfinished(folder: Path, asked: dict[str, Any]) -> bool:
    try:
        found = read_json(folder / ARGUMENTS)
    except (OSError, DamagedFileError):
        return False
    return bool(found == asked) and not _finished(folder)


def _finished(folder: Path) -> bool:
    try:
        read_json(folder / RESULTS)
    except FileNotFoundError:
        return False
    except DamagedFileError as error:
        say_skipped(error)
        return False
    return True


def read(folder: Path) -> dict[tuple[str, str], dict[str, Any]]:
    """What is measured already, by the names of setting and case; a line that was cut short is left out."""
    path = folder / RECORDS
    found: dict[tuple[str, str], dict[str, Any]] = {}
    for line in path.read_bytes().splitlines() if path.is_file() else []:
        try:
            record = json.loads(line)
            found[record["setting"], record["case"]] = record
        except (ValueError, TypeError, KeyError):
            continue
    return found


def measured(setting: Setting, kind: str, case: Case, reference: Reference) -> dict[str, Any]:
    """Everything that is measured of one setting on one case."""
    assert setting.make is not None
    simulator = setting.make(case.scene)
    course = follow(simulator, case, look_of(simulator))
    again = restarts(simulator, case, reference)
    record = {"setting": setting.name, "kind": kind, "case": case.name}
    record |= quantities(course, compare(case, course, reference), again, case.dt)
    plain: dict[str, Any] = _plain(record)
    return plain


def append(folder: Path, record: dict[str, Any]) -> None:
    """Add a line, on a line of its own even after one that was cut short."""
    path = folder / RECORDS
    with path.open("ab") as file:
        if file.tell() > 0 and not _ends_a_line(path):
            file.write(b"\n")
        file.write(json.dumps(record).encode() + b"\n")
        file.flush()
        os.fsync(file.fileno())


def _ends_a_line(path: Path) -> bool:
    with path.open("rb") as file:
        file.seek(-1, os.SEEK_END)
        return file.read() == b"\n"


def _plain(value: Any) -> Any:
    """JSON knows neither NaN nor infinity: null, and the word."""
    if isinstance(value, dict):
        return {name: _plain(part) for name, part in value.items()}
    if isinstance(value, list):
        return [_plain(part) for part in value]
    if isinstance(value, float) and not math.isfinite(value):
        return None if math.isnan(value) else "inf"
    return value
