"""Runs a sweep. What is measured is written at once, so that the same command continues an interrupted sweep.

In the run folder:
digest                   of what was asked for and of the code that is measured
records/                 one file for each setting and kind of cases
accuracy.md, accuracy/   the page and its files; accuracy/results.json comes last: the sweep is finished
"""

from __future__ import annotations

import hashlib
import json
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from agents.files import DamagedFileError, held, read_json, say_skipped
from agents.runs import PACKAGES, machine, versions
from agents.sweeps.in_process import InTurn, Runner, Trial
from jackbox_env import Scene, rollout
from jackbox_env.measure.accuracy import Case, Reference, between, compare, follow, quantities, restarts
from jackbox_env.recording.files import new_folder, remove_partials, write_json, write_text
from jackbox_env.simulators import Simulator
from scripts.studies import baselines
from scripts.studies.accuracy import cases, pictures
from scripts.studies.accuracy.page import DEFAULT, page
from scripts.studies.accuracy.results import ABOUT, Record, Results, rows_of, rows_of_kinds
from scripts.studies.accuracy.settings import TOGETHER, Setting, settings
from scripts.studies.timing import Timed, measure, others, ratios, repeat

ROOT = Path(__file__).parents[3]
DIGEST, RECORDS, PAGE, BESIDE = "digest", "records", "accuracy.md", "accuracy"
_STUDY = [f"scripts/studies/accuracy/{name}.py" for name in ("cases", "settings", "sweep")]  # no words and pictures
CODE = ("jackbox_env/**/*.py", "scripts/studies/baselines/*.py", "tests/data/*.json", *_STUDY)
ENGINES = ("numpy", "numba", "pymunk", "mujoco", "box2d")


def run(
    quick: bool, count: int, rounds: int, seconds: float, folder: Path | None, bars: bool, runner: Runner | None = None
) -> tuple[Results, Path]:
    """Sweep, or continue an interrupted sweep of the same code; return the results and the run folder.

    ``runner`` runs what is measured of errors; costs are measured here, where nothing else runs.
    """
    before, chosen = others(), settings(quick)
    asked = {"quick": quick, "cases": count}
    folder = open_folder("benchmark-quick" if quick else "benchmark", asked, folder)
    with held(folder):
        remove_partials(folder, folder / RECORDS)
        try:
            records = measured_all(folder, chosen, count, bars, runner)
            rates = measure({setting.name: cost_of(setting, seconds) for setting in chosen}, rounds, bars)
        except KeyboardInterrupt:
            print(f"\nInterrupted; the same command continues in {folder}", file=sys.stderr)
            raise
    rows = []
    for setting in chosen:
        cost = [1e6 / rate for rate in rates[setting.name]], ratios(rates, DEFAULT, setting.name)
        rows += rows_of(setting, records[setting.name], *cost)
    return Results(rows, asked | {"rounds": rounds, "seconds": seconds} | _circumstances(before)), folder


def with_loss(stored: Results, bars: bool) -> Results:
    """A stored sweep with its trajectories with loss measured anew; all else stays, costs included."""
    before, known = others(), cases.with_references(cases.LOSS, 0)
    rows = [row for row in stored.rows.values() if row.kind != cases.LOSS]
    chosen = [setting for setting in settings(quick=False) if setting.takes_loss and setting.name in stored.settings]
    for setting in tqdm(chosen, desc=cases.LOSS, unit="setting", disable=not bars, leave=False):
        rows += rows_of_kinds(setting, [measured(setting, cases.LOSS, *case) for case in known])
    return Results(rows, stored.about | {"loss": _circumstances(before)})


def write(results: Results, folder: Path) -> None:
    """The page, and beside it the pictures and the numbers."""
    beside = folder / BESIDE
    beside.mkdir(exist_ok=True)
    pictures.draw(results, beside / pictures.PICTURE)
    pictures.draw_loss(results, beside / pictures.WITH_LOSS)
    pictures.interactive(results, beside / pictures.INTERACTIVE)
    write_text(folder / PAGE, page(results))
    results.save(beside)


def _circumstances(before: tuple[float, float]) -> dict[str, Any]:
    """Where the figures come from; ``before``: the machine's time that others had used at the start."""
    taken, there = others()
    return {
        "command": " ".join(["python scripts/studies/accuracy/benchmark.py", *sys.argv[1:]]),
        "machine": machine(),
        "versions": versions((*PACKAGES[:-1], "numba", "mujoco", "box2d")),
        "busy": round(max(0.0, taken - before[0]) / max(there - before[1], 1e-9), 2),
        "missing": baselines.missing(),
    }


# -- what is measured already ------------------------------------------------------------------------------------------


def digest(asked: dict[str, Any]) -> str:
    """A digest of what was asked for, and of all code, data and engines that a measurement depends on."""
    engines = versions(ENGINES) | {"commit": ""}
    text = hashlib.sha256(json.dumps([asked, engines]).encode())
    for path in sorted(path for pattern in CODE for path in ROOT.glob(pattern)):
        text.update(path.relative_to(ROOT).as_posix().encode() + path.read_bytes())
    return text.hexdigest()[:12]


def open_folder(kind: str, asked: dict[str, Any], folder: Path | None) -> Path:
    """An unfinished sweep with the same digest, in ``folder`` or in runs/, or a new one.

    Raises:
        FileExistsError: ``folder`` holds something else, or a finished sweep.
    """
    mark, runs = digest(asked), [folder] if folder else sorted(Path("runs").glob(f"{kind}-*"))
    for run in runs:
        same = (run / DIGEST).is_file() and (run / DIGEST).read_text() == mark
        if same and not _finished(run):
            return run
    return new_folder(folder, kind, lambda made: write_text(made / DIGEST, mark))


def _finished(run: Path) -> bool:
    """Whether a sweep came to its end: the file that is written last is whole."""
    return _kept(run / BESIDE / ABOUT) is not None


def _kept(path: Path) -> Any:
    """Contents of a JSON file; None if it is missing, or damaged, which is printed."""
    try:
        return read_json(path)
    except FileNotFoundError:
        return None
    except DamagedFileError as error:
        say_skipped(error)
        return None


# -- measuring ---------------------------------------------------------------------------------------------------------


def measured_all(
    folder: Path, chosen: list[Setting], count: int, bars: bool, runner: Runner | None = None
) -> dict[str, list[Record]]:
    """Measure what is not measured yet, and return all records by setting.

    Raises:
        RuntimeError: a setting failed; the records of the others are kept.
    """
    paths = dict[Path, Trial]()  # in the order of the records
    (folder / RECORDS).mkdir(exist_ok=True)
    for kind in (cases.DIGITS, cases.LOSS, *cases.KINDS):
        for setting in chosen:
            if setting.takes_loss if kind == cases.LOSS else setting.make:
                trial = Trial({"setting": setting.name, "kind": kind, "count": count})
                paths[folder / RECORDS / f"{setting.name}; {kind}.json"] = trial
    left = {trial.key: path for path, trial in paths.items() if _kept(path) is None}
    work, failed = partial(_measured_kind, {setting.name: setting for setting in chosen}, {}), list[str]()
    with tqdm(total=len(paths), initial=len(paths) - len(left), unit="setting", disable=not bars, leave=False) as bar:
        for done in (runner or InTurn()).run([paths[path] for path in left.values()], work, bar.refresh):
            if done.error is None:
                write_json(left[done.trial.key], done.result)
            else:
                failed.append(f"{left[done.trial.key].stem}: {done.error}")
            bar.update()
    if failed:
        raise RuntimeError(f"{len(failed)} of {len(paths)} settings could not be measured: {'; '.join(failed)}")
    records = {setting.name: list[Record]() for setting in chosen}
    for path, trial in paths.items():
        records[trial.settings["setting"]] += read_json(path)
    return records


def _measured_kind(
    chosen: dict[str, Setting], known: dict[str, list[tuple[Case, Reference]]], asked: dict[str, Any]
) -> list[Record]:
    """All errors of one setting on the cases of a kind; ``known`` keeps the references from one call to the next."""
    kind = asked["kind"]
    if kind not in known:
        known[kind] = cases.with_references(kind, asked["count"])
    return [measured(chosen[asked["setting"]], kind, *case) for case in known[kind]]


def measured(setting: Setting, kind: str, case: Case, reference: Reference) -> Record:
    """All errors of one setting on one case."""
    assert setting.make is not None
    simulator: Any = setting.make(case.scene)
    course = follow(simulator, case, getattr(simulator, "look", between))  # baselines look into their steps themselves
    again = restarts(simulator, case, reference)
    record = {"setting": setting.name, "kind": kind, "case": case.name}
    return record | quantities(course, compare(case, course, reference), again, case.dt)


def cost_of(setting: Setting, seconds: float) -> Timed:
    """Simulated seconds per second of this thread's own time, which stops while others use the processor."""
    block = _stepped(setting.make) if setting.make else _together()
    timed = repeat(block, seconds, clock=time.thread_time)
    return lambda: cases.DT * timed()


def _stepped(make: Callable[[Scene], Simulator]) -> Callable[[], int]:
    """A block that steps a contact model through some cases."""
    chosen = [cases.seeded(kind, seed) for kind in cases.KINDS for seed in range(2)]
    made = [make(case.scene) for case in chosen]

    def block() -> int:
        for simulator, case in zip(made, chosen, strict=True):
            simulator.reset(case.state)
            try:
                for number in range(case.steps):
                    simulator.step(cases.DT, None if case.torques is None else case.torques[number])
            except RuntimeError:  # the jack left: the steps until then count
                pass
        return sum(round(simulator.time / cases.DT) for simulator in made)

    return block


def _together() -> Callable[[], int]:
    """A block of the exact model under held torques in one compiled loop on one thread."""
    chosen = [cases.seeded("held", seed) for seed in range(TOGETHER)]
    states, torques = np.array([case.state for case in chosen]), np.array([case.torques for case in chosen])

    def block() -> int:
        rollout(chosen[0].scene, states, torques, cases.DT, num_threads=1)
        return torques.size

    return block
