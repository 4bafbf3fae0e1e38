"""Run many trials in one folder: evaluations of policies, or trainings whose best model is evaluated.

``scripts/sweep.py`` and the studies use it. The folder has

sweep.json     the trials, the files of your own code that they name, and the versions and the code they are run with
trials.jsonl   a line for each finished trial, in the order of finishing, on the disk at once
table.csv      a row for each finished trial, in the order of the grid: the same bytes wherever the trials ran
runs/          the trainings' run folders
lock           locked by the process that uses the folder

A trial is its settings. Its work is a function from settings to a result; both are plain JSON. A runner calls the work
for each trial and yields the trials as they finish, in any order: in this process, on this machine's cores
(:mod:`agents.runners`) or on a cluster (:mod:`agents.sweep_ray`).
"""

from __future__ import annotations

import contextlib
import csv
import hashlib
import io
import json
import os
import shutil
import sys
from collections import Counter
from dataclasses import asdict, fields
from functools import cache
from itertools import product
from pathlib import Path
from typing import Any, NamedTuple

from tqdm import tqdm

from agents.evaluation.returns import evaluate
from agents.policies.registry import find_policy, is_function, runs_code, with_chosen_env
from agents.policies.scripted import PolicyWithEnv
from agents.runners import Finished, Runner, Work
from agents.runs import PACKAGES, installed, locked, machine
from agents.settings import INTERFACE, NAMES, EnvSettings, TrainSettings
from agents.training.models import make_vec_env
from agents.training.ppo import trained_in
from jackbox_env import FIDELITIES
from jackbox_env.model.action import EPISODE_STEPS
from jackbox_env.tools import checks as check
from jackbox_env.tools.files import new_folder, remove_partials, write_bytes, write_json, write_text
from jackbox_env.tools.model_files import MODEL, is_whole
from jackbox_env.tools.reading import (
    DamagedFileError,
    parsing,
    read_json,
    report_skipped,
)
from jackbox_env.tools.user_code import is_object, load, texts_of, with_objects

SWEEP, LOG, TABLE, RUNS = "sweep.json", "trials.jsonl", "table.csv", "runs"
_ROOT = Path(__file__).parents[1]
_ENV, _TRAIN = ([part.name for part in fields(kind)] for kind in (EnvSettings, TrainSettings))


class Code(NamedTuple):
    """The code of users that the trials of a sweep may run."""

    texts: dict[str, str]  # of files, by path
    names: tuple[str, ...] = ()  # of objects and functions
    trust: bool = False  # also pickled models, and objects that run folders name


# -- the folder --------------------------------------------------------------------------------------------------------


def key_of(settings: dict[str, Any]) -> str:
    """A trial's key: the same for the same settings, whatever their order."""
    return json.dumps(settings, sort_keys=True)


@cache
def made_with() -> dict[str, str]:
    """The versions that results depend on, and a digest of the code."""
    text = hashlib.sha256()
    for path in sorted(path for folder in ("jackbox_env", "agents") for path in (_ROOT / folder).rglob("*.py")):
        text.update(path.relative_to(_ROOT).as_posix().encode() + path.read_bytes())
    return {**installed((*PACKAGES, "numba")), "code": text.hexdigest()[:12]}


def differing(other: dict[str, str]) -> str:
    """The differences of another process's :func:`made_with` from this one's, in words; empty if they are equal."""
    return ", ".join(" ".join(part) for part in sorted(other.items() - made_with().items()))


def new_sweep(path: Path | None, trials: list[dict[str, Any]]) -> Path:
    """Make the folder of a sweep, with the text of each file of code that a trial names.

    Args:
        path: of the folder; None: ``runs/sweep-<date>-<time>``.
        trials: settings of each.

    Raises:
        FileExistsError: there is something at ``path`` already.
        ValueError: there is no trial, or one twice.
    """
    for key, count in Counter(map(key_of, trials)).most_common(1) or [("any", 0)]:
        if count != 1:
            raise ValueError(f"a sweep must have at least one trial, and each once, got {count} times {key}")
    code = texts_of(code_named(trials))
    record = {
        "command": sys.argv, "machine": machine(), "made_with": made_with(), "trials": trials, "code": code,
    }  # fmt: skip
    return new_folder(path, "sweep", lambda made: write_json(made / SWEEP, record))


def read_sweep(folder: Path, trust: bool = False) -> tuple[list[dict[str, Any]], Code]:
    """The trials of a sweep, and the code that they may run.

    Args:
        folder: of the sweep.
        trust: its trials may run code of its author.

    Raises:
        FileNotFoundError: it is no sweep.
        ValueError: its file is damaged; its trials run code, without ``trust``; or it was begun with other code or
            versions, so that its rows and new ones do not belong together.
    """
    record = read_json(folder / SWEEP)
    with parsing(folder / SWEEP):
        trials, other = [dict(settings) for settings in record["trials"]], differing(record["made_with"])
        texts = {str(path): str(text) for path, text in record["code"].items()}
        names = code_named(trials)
        running = [*names, *(trial["policy"] for trial in trials if runs_code(trial.get("policy", "")))]
    if running and not trust:
        raise ValueError(f"{folder} runs code ({check.shown(running[0])}): if you trust its author, use --trust")
    if other:
        raise ValueError(f"{folder} was begun with other code ({other}), so it cannot be continued: make another sweep")
    return trials, Code(texts, tuple(names), trust)


def code_named(trials: list[dict[str, Any]]) -> list[str]:
    """Names of the objects and functions of users that trials run.

    Raises:
        ValueError: one is of a module, whose text cannot be stored.
    """
    names = {str(trial[name]) for trial in trials for name in NAMES if is_object(trial.get(name))}
    names |= {trial["policy"] for trial in trials if is_function(trial.get("policy", ""))}
    for name in sorted(names):
        if not name.rpartition(":")[0].endswith(".py"):
            raise ValueError(f"a sweep stores the text of code, so its objects must be file.py:name, got {name}")
    return sorted(names)


def carry_out(
    folder: Path, trials: list[dict[str, Any]], work: Work, runner: Runner, progress: bool = True
) -> list[dict[str, Any]]:
    """Run the unfinished and failed trials, and write the table; each is logged when it finishes.

    Returns:
        The rows of the table in the order of ``trials``: settings, result and error (None if there is none) of each.

    Raises:
        FolderInUseError: another process works in the folder.
        OSError: it cannot be written to.
    """
    with locked(folder):
        remove_partials(folder)
        logged, keys = _read_log(folder / LOG), [key_of(settings) for settings in trials]
        to_run = [trial for trial, key in zip(trials, keys, strict=True) if key not in logged or logged[key]["error"]]
        disable = None if progress else True  # None: unless on a terminal
        bar = tqdm(total=len(trials), initial=len(trials) - len(to_run), unit="trial", disable=disable)
        try:
            with (folder / LOG).open("ab") as log, bar, contextlib.closing(runner(to_run, work)) as results:
                for done in results:
                    line = json.dumps(done._asdict()).encode()
                    log.write(line + b"\n")
                    log.flush()
                    os.fsync(log.fileno())
                    logged |= _row(line)
                    bar.update()
        finally:
            rows = [logged[key] for key in keys if key in logged]
            write_text(folder / TABLE, _csv(rows))
    return rows


def _read_log(path: Path) -> dict[str, dict[str, Any]]:
    """The log's rows, the last of each trial; damaged lines are skipped and named on standard error.

    This writes the log anew: without an unfinished last line, and as a file where it was a link.
    """
    content, rows = path.read_bytes() if path.is_file() else b"", dict[str, dict[str, Any]]()
    lines = content[: content.rfind(b"\n") + 1]
    write_bytes(path, lines)
    for number, line in enumerate(lines.splitlines(), 1):
        try:
            with parsing(Path(f"{path}, line {number},")):
                rows |= _row(line)
        except DamagedFileError as error:
            report_skipped(error)
    return rows


def _row(line: bytes) -> dict[str, dict[str, Any]]:
    """The table's row of a line of the log, by its trial's key; raises an exception if the line is damaged."""
    done = Finished(**json.loads(line))
    row = {**done.settings, **(done.result or {}), "error": done.error}
    _csv([row]).encode()  # raises for half a character
    return {key_of(done.settings): row}


def _csv(rows: list[dict[str, Any]]) -> str:
    """Rows with every column that any of them has, in the order of their first appearance, errors last."""
    file = io.StringIO()
    names = dict.fromkeys(name for row in rows for name in row if name != "error")
    writer = csv.DictWriter(file, [*names, "error"], lineterminator="\n")
    writer.writeheader()
    for row in rows:
        plain = {name: json.dumps(value) if isinstance(value, dict | list) else value for name, value in row.items()}
        writer.writerow(plain)
    return file.getvalue()


# -- the trials --------------------------------------------------------------------------------------------------------


def grid(
    *,
    policy: tuple[str, ...],
    train: str | None,
    task: tuple[str, ...],
    setting: tuple[str, ...],
    scene: tuple[str, ...],
    seeds: int,
    episodes: int,
    trust: bool = False,
) -> list[dict[str, Any]]:
    """The trials of a grid, as ``scripts/sweep.py`` names its sides: of policies, or with ``train`` of trainings.

    Raises:
        FileNotFoundError: there is no such policy.
        TypeError, ValueError: one of the sides is unknown or out of its range.
    """
    check.whole("seeds", seeds, at_least=1, at_most=2**32)
    check.whole("episodes", episodes, at_least=2)
    load([*filter(is_object, task), *filter(is_function, policy)])
    environments = [_environment(*names) for names in product(task, setting, scene)]
    if train is not None:
        return [
            {**asdict(settings), "episodes": episodes}
            for varied in _varied(check.from_json("train", train, dict))
            for (env, interface), seed in product(environments, range(seeds))
            for settings in [TrainSettings.suited(**asdict(env), **interface, **varied, seed=seed, torch_threads=1)]
        ]
    names = [str(Path(name).resolve()) if Path(name).exists() else name for name in policy]
    for name, (env, interface) in product(names, environments):
        if interface and not with_chosen_env(name):
            raise ValueError(f"setting must have no {' or '.join(interface)} for {name}: the policy has its own")
        _policy_in(name, env, interface, 0, trust)
    return [
        {"policy": name, **asdict(env), **interface, "seed": seed, "episodes": episodes}
        for name, (env, interface), seed in product(names, environments, range(seeds))
    ]


def _environment(task: str, setting: str, scene: str) -> tuple[EnvSettings, dict[str, Any]]:
    """An environment of a task, a fidelity or keywords as JSON, and fields of the scene as JSON.

    Making it once raises for settings that are invalid together, and compiles before the progress bar starts.

    Returns:
        its settings, and those of ``INTERFACE`` that are among the keywords.
    """
    keywords = {"fidelity": setting} if setting in FIDELITIES else check.from_json("setting", setting, dict)
    check.known_keys("setting", keywords, [name for name in (*_ENV, *INTERFACE) if name not in ("task", "scene")])
    interface = {name: keywords.pop(name) for name in INTERFACE if name in keywords}
    load(filter(is_object, interface.values()))
    fields_of_scene = json.dumps(check.from_json("scene", scene, dict), sort_keys=True)
    settings = EnvSettings(task=task, scene=fields_of_scene, **keywords)
    environments = make_vec_env({**settings.env_settings, **with_objects(interface)}, 1, 0)
    environments.reset()
    environments.close()
    return settings, interface


def _varied(train: dict[str, Any]) -> list[dict[str, Any]]:
    """Every combination of settings of training, from a list of values for each."""
    check.known_keys(
        "train", train, [name for name in _TRAIN if name not in (*_ENV, *INTERFACE, "seed", "torch_threads")]
    )
    for name, values in train.items():
        if not isinstance(values, list) or not values:
            raise TypeError(f"train must have a list of values for each setting, got {check.shown(values)} for {name}")
    return [dict(zip(train, values, strict=True)) for values in product(*train.values())]


def _policy_in(name: str, env: EnvSettings, interface: dict[str, Any], seed: int, trust: bool) -> PolicyWithEnv:
    """A policy in the environment of its row, also a model that env.json describes in another one."""
    length = {"episode_steps": EPISODE_STEPS, "max_episode_steps": None}
    return find_policy(name, env, seed, trust, {**env.env_settings, **length, **interface})


def run_trial(folder: Path, code: Code, settings: dict[str, Any]) -> dict[str, Any]:
    """Evaluate a policy, or train and evaluate the best model: columns of the table.

    Args:
        folder: of the sweep.
        code: that trials may run; settled before any of them has run.
        settings: the trial.
    """
    load(set(code_named([settings])).intersection(code.names), code.texts)
    if "policy" in settings:
        env, starts = EnvSettings(**{name: settings[name] for name in _ENV}), settings["seed"]
        interface = {name: settings[name] for name in INTERFACE if name in settings}
        acting = _policy_in(settings["policy"], env, interface, starts, code.trust)
    else:  # evaluated from the same starts, whatever the training's seed
        env, starts = TrainSettings.of({name: settings[name] for name in _TRAIN}), 0
        acting = find_policy(str(_trained(folder, env)), env)
    returns = evaluate("", acting, env.env_settings, settings["episodes"], starts)
    low, high = returns.interval
    return {"mean": returns.mean, "interval_low": low, "interval_high": high, "worst": min(returns.returns)}


def _trained(folder: Path, settings: TrainSettings) -> Path:
    """Train in a run folder below a sweep's.

    An interrupted training starts over. From a checkpoint it would use other starts than an uninterrupted run, and the
    table would depend on the moment of the interruption.

    Raises:
        FileNotFoundError: the sweep's folder is not on this machine.
    """
    if not folder.is_dir():
        raise FileNotFoundError(f"{folder} must be on a disk that all machines share: it is not on this one")
    run = folder / RUNS / hashlib.sha256(key_of(asdict(settings)).encode()).hexdigest()[:16]
    with contextlib.redirect_stdout(io.StringIO()):  # drops the times that it prints; its folder has them
        if run.exists() and not is_whole(run / MODEL):
            with locked(run):  # raises if a training still runs there
                shutil.rmtree(run)
        run.parent.mkdir(exist_ok=True)
        trained_in(run, settings, progress=False)
    return run
